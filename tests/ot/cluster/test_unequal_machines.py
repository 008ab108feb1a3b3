"""Unequal machines and links: a generation takes no longer than it must, in simulated time."""

from tests.ot.cluster.simulated_lab import Lab, Machine


def test_what_a_large_server_had_is_split_among_all_others() -> None:
    """Ten rounds of 40 slots are needed: what a dead server had goes to no single one."""
    small = {f"pc{number}": Machine(4, 60.0) for number in range(10)}
    lab = Lab({"large": Machine(64, 60.0), **small})
    seconds = lab.generation(400, faults={30.0: lab.machines["large"].die})
    assert seconds <= 660.0
    assert lab.noted("requeued") >= 64
