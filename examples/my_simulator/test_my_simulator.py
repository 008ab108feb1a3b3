"""The simulator keeps zswarm's contract. The check says what is wrong, and how fast it is: python -m pytest -s."""

from my_simulator import MySimulator

from zswarm.testing import check_simulator


def test_it_keeps_the_contract() -> None:
    """With its defaults, and with as little as there can be."""
    print(check_simulator(MySimulator))
    check_simulator(MySimulator, {"robots": 2, "steps": 1})
