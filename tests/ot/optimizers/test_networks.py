"""Test optimizers with all networks that they take."""

from collections.abc import Callable
from functools import partial

import pytest

from tests.fitting_parts import NETWORKS, evolves
from tests.ot.optimizers.test_optimizers import NEEDED
from zswarm.config.decode import convert
from zswarm.errors import ConfigError
from zswarm.nets.representation import Representation
from zswarm.ot.optimizers.optimizer import Optimizer
from zswarm.plugins import registry as plugins
from zswarm.testing import optimizers


def maker(name: str, network: Representation) -> Callable[..., Optimizer]:
    """Return what makes an optimizer of a seed, with a small population."""
    loaded = plugins.load("optimizer", name)
    known = loaded.settings_type.__struct_fields__
    given = {"population": 8, "measures": ["first", "second"], **NEEDED.get(name, {})}
    settings = {key: value for key, value in given.items() if key in known}

    def make(seed: int, *, relative: bool = False) -> Optimizer:
        optimizer: Optimizer = loaded(
            convert(settings, loaded.settings_type, name), network, seed
        )
        optimizer.relative = relative
        return optimizer

    return make


@pytest.mark.long
@pytest.mark.parametrize("representation", plugins.names("representation"))
def test_every_optimizer_resumes_with_every_network(representation: str) -> None:
    """It asks for the same genomes, also with relative fitness; what does not fit is refused."""
    loaded = plugins.load("representation", representation)
    settings = convert(
        NETWORKS.get(representation, {}), loaded.settings_type, representation
    )
    network = loaded(settings, 3, 2)
    toy = optimizers._Toy(network)
    for name in plugins.names("optimizer"):
        make = maker(name, network)
        if not evolves(name, representation):
            with pytest.raises(ConfigError, match=r"^optimizer: "):
                make(1)
            continue
        optimizers._check_repeats(make, toy)
        if plugins.load("optimizer", name).competes:
            optimizers._check_repeats(partial(make, relative=True), toy)
