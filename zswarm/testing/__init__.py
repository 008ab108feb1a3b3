"""Checks that a simulator, representation or optimizer keeps its contract, and a clock for tests.

Run them in the tests of your own part::

    from zswarm.testing import check_simulator

    def test_my_simulator_keeps_the_contract():
        check_simulator(MySimulator)

A check raises ``AssertionError`` with a text that names the broken rule. Errors that the part
itself raises pass through. ``check_simulator`` warns of lines whose bits may differ between
machines.
"""

from zswarm.testing.clock import FakeClock
from zswarm.testing.optimizers import check_optimizer
from zswarm.testing.representations import check_representation
from zswarm.testing.rules import PortabilityWarning
from zswarm.testing.simulators import Speed, check_simulator

__all__ = [
    "FakeClock",
    "PortabilityWarning",
    "Speed",
    "check_optimizer",
    "check_representation",
    "check_simulator",
]
