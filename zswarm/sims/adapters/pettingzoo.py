"""Environments of PettingZoo and MPE2 whose agents act at the same time.

PettingZoo (pettingzoo.farama.org) has two interfaces. In its agent-environment cycle (AEC) agents
act one after the other; in its parallel interface, used here, they act at the same time.
"""

import importlib.util
import pkgutil
import re
from typing import Annotated, Any, ClassVar

import msgspec

from zswarm.config.meta import about
from zswarm.errors import ConfigError
from zswarm.sims.adapters.environments import (
    ParallelEnvironment,
    ParallelSettings,
    check_name,
    without_window,
)
from zswarm.system.extras import need

LIBRARIES = ("pettingzoo", "mpe2", "box2d", "pygame", "pygame-ce", "pymunk", "scipy")
FAMILIES = (
    "mpe2",
    *(f"pettingzoo.{name}" for name in ("butterfly", "sisl", "classic", "atari", "mpe")),
)
VERSIONED = re.compile(r"\w+_v\d+")


class PettingZooSettings(ParallelSettings, frozen=True):
    """Settings of ``[problem.settings]``."""

    environment: Annotated[
        str, about("name and version of an environment with the parallel interface")
    ] = "simple_spread_v3"


class PettingZoo(ParallelEnvironment):
    """An environment of PettingZoo or MPE2 whose agents act at the same time.

    Observation: an agent's, flattened as by Gymnasium: numbers as they are, a choice of n as n
        numbers, one of them 1. If there are several types of agents, the first number is the type:
        0, 1, ..., in the order of the environment's agents. Shorter observations end in zeros.
    Action: for a number between bounds one output, 0 the lower and 1 the upper bound, clipped; for
        one without bounds 2 output - 1; for a choice of n as many outputs, of which the highest
        wins, the first of equals; for a bit one output, set above 0.5. Agents with fewer actions
        ignore the last outputs.
    Turns: all present agents, in the environment's order. Agents may leave and return.
    Start: from the trial's seed, folded to 32 bits, which also seeds numpy's and Python's
        generators.
    End: when no agent is present, or after ``steps`` steps.
    Fitness: sum or mean of the returns of the participant's agents. A return is the sum of an
        agent's rewards.
    Metrics: ``steps``; for each type ``return_`` and its name, the mean return of its agents. The
        type is the agent's name without the number at the end.
    """

    settings_type: ClassVar[type[msgspec.Struct]] = PettingZooSettings

    def make(self, **options: Any) -> Any:
        """Return the environment that the settings name, one of those installed."""
        need("pettingzoo", "gym", "simulator pettingzoo")
        known = environments()
        name = self.settings.environment
        check_name(name, known, "pettingzoo")
        without_window()
        module = need(f"{known[name]}.{name}", "gym", name)
        if not hasattr(module, "parallel_env"):
            text = "its agents act one after the other (AEC)"
            raise ConfigError(
                f"pettingzoo: {name}: {text}; expected a parallel interface"
            )
        return module.parallel_env(**options)


def environments() -> dict[str, str]:
    """Return the packages of the installed environments by name, without importing these."""
    found: dict[str, str] = {}
    for family in FAMILIES:
        package = family.partition(".")[0]
        spec = importlib.util.find_spec(package) and importlib.util.find_spec(family)
        folders = list(spec.submodule_search_locations or []) if spec else []
        for module in pkgutil.iter_modules(folders):
            if VERSIONED.fullmatch(module.name):
                found.setdefault(module.name, family)
    return found
