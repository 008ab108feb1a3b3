"""Rules of a contract, and the words for a broken one."""

import contextlib
import warnings
from collections.abc import Callable, Iterator

from zswarm.nets.representation import Representation
from zswarm.plugins import portability
from zswarm.plugins import registry as plugins
from zswarm.sims.simulator import Simulator


class BrokenRule(AssertionError):
    """A part breaks a rule of its contract."""


class PortabilityWarning(UserWarning):
    """A line of a simulator that may compute other bits on another machine."""


def lint(simulator: Simulator) -> None:
    """Warn of each line that may compute other bits elsewhere, if the simulator promises them."""
    for file, line, text in portability.findings(type(simulator)):
        if simulator.repeatable:
            warnings.warn_explicit(text, PortabilityWarning, str(file), line)


@contextlib.contextmanager
def checking(part: str) -> Iterator[None]:
    """Put the name of the checked part, or of its method, before the text of a broken rule."""
    try:
        yield
    except BrokenRule as error:
        error.args = (f"{part}{error}",)
        raise


def require(holds: object, text: str) -> None:
    """Raise ``BrokenRule`` unless the rule holds.

    Args:
        holds: true if the rule is kept.
        text: continues the part's name, such as ``".ask must return a list"``.
    """
    if not holds:
        raise BrokenRule(text)


def require_raises(error: type[Exception], call: Callable[[], object], text: str) -> None:
    """Raise ``BrokenRule`` unless the call raises the error."""
    try:
        call()
    except error:
        return
    raise BrokenRule(f"{text} must raise {error.__name__}")


def require_accepted(network: Representation, genomes: list[bytes], text: str) -> None:
    """Raise ``BrokenRule`` if the representation refuses one of the genomes."""
    try:
        network.parameters(genomes)
    except ValueError as error:
        raise BrokenRule(f"{text}: {error}") from error


def fully_meshed(inputs: int, outputs: int) -> Representation:
    """Return a small fully-meshed network."""
    kind = plugins.load("representation", "fully-meshed")
    network: Representation = kind(kind.settings_type(), inputs, outputs)
    return network
