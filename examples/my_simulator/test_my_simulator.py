"""Check the simulator's contract. ``python -m pytest -s`` also prints its speed."""

from my_simulator import MySimulator

from zswarm.testing import check_simulator


def test_it_keeps_the_contract() -> None:
    """Check it with its defaults, and with the smallest settings."""
    print(check_simulator(MySimulator))
    check_simulator(MySimulator, {"robots": 2, "steps": 1})
