"""Unequal machines and links: a generation takes no longer than it must, in simulated time."""

import numpy as np
import pytest

from tests.ot.cluster.dispatching import Optimizer, batch, fault, outcomes, trials
from tests.ot.cluster.simulated_lab import Lab, Machine
from zswarm.ot.cluster.events import Ask, Complete, Work
from zswarm.ot.workload import Workload
from zswarm.protocol import codec
from zswarm.protocol.messages import Refused, Running


def test_what_a_large_server_had_is_split_among_all_others() -> None:
    """Ten rounds of 40 slots are needed: what a dead server had goes to no single one."""
    small = {f"pc{number}": Machine(4, 60.0) for number in range(10)}
    lab = Lab({"large": Machine(64, 60.0), **small})
    seconds = lab.generation(400, faults={30.0: lab.machines["large"].die})
    assert seconds <= 660.0
    assert lab.noted("requeued") >= 64


NEAR = Machine(4, 0.02)
FAR = Machine(4, 0.02, delay_s=0.1, rate=125_000.0)  # 1 Mbit/s
FAST = {f"fast{number}": Machine(4, 60.0) for number in range(10)}


def seconds(
    machines: dict[str, Machine], trials: int, *, genome: int = 240, verify: float = 0.0
) -> list[float]:
    """Return the seconds of each generation after the first, which measures."""
    lab = Lab(machines, genome=genome, verify=verify)
    return [lab.generation(trials) for _ in range(4)][1:]


@pytest.mark.parametrize(
    ("genome", "each", "trial_s", "trials"),
    [
        # A genome of 42 kB takes a third of a second on the way.
        (42_000, 1, 0.02, 100),
        (42_000, 4, 0.05, 160),
        (18_000, 4, 0.05, 160),
        # Half a second of work, and a round trip takes 0.2 s.
        (240, 1, 0.02, 100),
        (240, 1, 0.001, 2000),
    ],
)
def test_a_server_behind_a_slow_link_makes_no_generation_slower(
    genome: int, each: int, trial_s: float, trials: int
) -> None:
    """Nor the first one, before anything was measured but how fast the servers answer."""
    near, far = NEAR._replace(trial_s=trial_s), FAR._replace(trial_s=trial_s)
    alone = Lab({"near": near}, genome=genome)
    expected = [alone.generation(trials, each=each) for _ in range(4)]
    for machines in ({"near": near, "far": far}, {"far": far, "near": near}):
        lab = Lab(machines, genome=genome)
        for alone_s in expected:
            assert lab.generation(trials, each=each) <= 1.05 * alone_s


@pytest.mark.parametrize(
    "times",
    [
        3.0,
        *(pytest.param(times, marks=pytest.mark.thorough) for times in (1.0, 2.0, 5.0)),
    ],
)
def test_slow_machines_make_no_generation_slower(times: float) -> None:
    """Whether they come first or last."""
    alone = max(seconds(FAST, 100))
    slow = {f"slow{number}": Machine(4, 60.0 * times) for number in range(2)}
    for machines in (FAST | slow, slow | FAST):
        assert max(seconds(machines, 100)) <= 1.05 * alone


def test_a_slow_machine_helps_where_it_can() -> None:
    near, slow = Machine(4, 0.5), Machine(4, 2.5)
    alone = max(seconds({"near": near}, 40))
    assert max(seconds({"near": near, "slow": slow}, 40)) < 0.95 * alone


def test_a_slow_machine_that_verifies_makes_no_generation_slower() -> None:
    two = {"a": Machine(4, 0.5), "b": Machine(4, 0.5)}
    alone = max(seconds(two, 80, verify=0.1))
    slow = {"slow": Machine(4, 5.0)}
    assert max(seconds(two | slow, 80, verify=0.1)) <= 1.05 * alone


def test_short_trials_fill_a_long_way() -> None:
    """Of 340 trials of 5 ms, 425 ms of work are 100 ms away."""
    far = Machine(4, 0.005, delay_s=0.05)
    assert max(seconds({"a": far}, 340)) <= 0.425 + 0.1 + 0.005
    assert max(seconds({"a": far, "b": far}, 340)) < 0.4


def test_kernels_of_a_millisecond_keep_all_slots_busy() -> None:
    four = {f"s{number}": Machine(4, 0.001) for number in range(4)}
    assert max(seconds(four, 4000)) <= 1.05 * 0.25
    assert max(seconds(four | {"slow": Machine(4, 0.01)}, 4000)) <= 1.05 * 0.25


def test_trials_of_a_minute_wait_here_and_not_behind_others() -> None:
    """Their lengths vary by a factor of three: whoever is idle first gets the next one."""
    four = {f"s{number}": Machine(4, 60.0) for number in range(4)}
    lab = Lab(four, length=lambda seed: 0.5 + seed * 0.6180339 % 1.0)
    ideal = 100 * 60.0 / 16
    assert lab.generation(100) <= ideal + 60.0


def test_a_machine_that_was_slow_for_a_while_is_measured_again() -> None:
    lab = Lab({"near": Machine(4, 0.1), "other": Machine(4, 2.0)})
    lab.generation(40)
    lab.generation(40)
    assert "other" not in lab.counted
    lab.machines["other"].machine = Machine(4, 0.1)
    for _ in range(40):
        lab.generation(40)
    assert lab.counted["other"] >= 10


def test_a_stalled_server_costs_no_more_than_a_second_start() -> None:
    lab = Lab({"a": Machine(4, 1.0), "b": Machine(4, 1.0)})
    lab.generation(16)
    stalls = {0.5: lambda: lab.machines["b"].stall(100.0)}
    assert lab.generation(8, faults=stalls) <= 6.0
    assert lab.noted("second_start") == 4


def test_equal_machines_start_nothing_twice() -> None:
    lab = Lab({f"s{number}": Machine(4, 1.0) for number in range(4)})
    for count in (16, 20, 100):
        lab.generation(count)
    assert lab.noted("second_start") == 0


@pytest.mark.parametrize("verify", [0.0, 1.0])
def test_the_last_trial_is_sent_though_its_genome_goes_with_it_alone(
    verify: float,
) -> None:
    """Several trials of a candidate share its genome on the way, so that the last takes longer."""
    optimizer = Optimizer(verify=verify, second_starts=False)
    optimizer.join("a", "b", slots=4, trial_s=0.0008)
    for server in optimizer.dispatch.servers.by_id.values():
        server.machine = server.id
        server.pace.round_trip_s, server.pace.link_measured = 0.005, True
        server.pace.byte_s, server.pace.batch_at = 2e-6, optimizer.now
    last = Workload([bytes(450)], np.zeros((8, 1), int), np.arange(8).astype("<u8"), 0)
    last.counted[:7] = True
    asks = optimizer.feed(Work(last)) + optimizer.wait(0.1)
    assert trials(asks) == [7]
    checks = optimizer.answer(asks[0], outcomes(asks[0])) + optimizer.wait(0.1)
    assert trials(checks) == ([7] if verify else [])


# ---- second starts, event by event


def started_again() -> tuple[Optimizer, Ask, Ask]:
    """Server a, which is slow, has trial 0, and server b, which is idle, gets it, too."""
    optimizer = Optimizer(quarantine=True)
    optimizer.join("a", trial_s=100.0)
    (first,) = optimizer.work(1)
    optimizer.join("b", trial_s=1.0)
    (copy,) = [ask for ask in optimizer.wait(1.0) if ask.server == "b"]
    assert trials([first]) == trials([copy]) == [0]
    return optimizer, first, copy


def test_the_first_outcome_is_counted_and_the_other_copy_cancelled() -> None:
    for number in range(2):
        optimizer, *copies = started_again()
        won, lost = copies[number], copies[1 - number]
        (cancel,) = optimizer.answer(won, outcomes(won, 7.0))
        assert (cancel.server, cancel.message.batches) == (lost.server, [batch(lost)])
        assert optimizer.answer(lost, outcomes(lost, 8.0)) == []
        assert optimizer.counted == [0]


def test_a_batch_is_cancelled_of_which_another_server_sent_what_is_left() -> None:
    optimizer = Optimizer()
    optimizer.join("a", slots=2, trial_s=100.0)
    (first,) = optimizer.work(2)
    optimizer.join("b", trial_s=60.0)
    (copy,) = [ask for ask in optimizer.wait(1.0) if ask.server == "b"]
    optimizer.answer(copy, outcomes(copy))
    assert trials([copy]) == [1]
    told = {"trials": codec.indices([0]), "fitness": bytes(8), "seconds": 1.0}
    running = Running(batch=batch(first), done=1, **told)
    (cancel,) = optimizer.answer(first, running)
    assert (cancel.server, cancel.message.batches) == ("a", [batch(first)])
    assert optimizer.counted == [1, 0]


def test_a_lost_copy_leaves_its_trial_to_the_other_server() -> None:
    for number in range(2):
        optimizer, *copies = started_again()
        lost, left = copies[number], copies[1 - number]
        assert optimizer.answer(lost, Refused(code="lease-lost", reason="")) == []
        assert optimizer.requeued == 0
        optimizer.answer(left, outcomes(left))
        assert optimizer.counted == [0]
        assert Complete() in optimizer.commands


def test_a_fault_of_a_copy_is_one_attempt_and_starts_no_third_one() -> None:
    optimizer, first, copy = started_again()
    assert optimizer.answer(copy, fault(copy)) == []
    assert optimizer.notes("fault")[0].text.endswith("attempt 1)")
    optimizer.join("c", trial_s=1.0)
    assert [ask for ask in optimizer.wait(10.0) if ask.trials is not None] == []
    optimizer.answer(first, outcomes(first))
    assert optimizer.counted == [0]


def test_nothing_is_started_twice_where_outcomes_differ() -> None:
    optimizer = Optimizer(second_starts=False)
    optimizer.join("a", trial_s=100.0)
    optimizer.work(1)
    optimizer.join("b", trial_s=1.0)
    assert [ask for ask in optimizer.wait(10.0) if ask.trials is not None] == []
