"""The probe is played by all slots of a lease at once, and the run knows how far it is."""

import heapq
import itertools

import msgspec
import pytest

from tests.ss.slots.table_server import PROBE, Server, evaluate, reserve
from zswarm.protocol.messages import PROBE_DIGEST, PROBE_TRIALS, Lease, Release, Renew
from zswarm.ss.slots.events import (
    Died,
    Event,
    PlayProbe,
    Prepared,
    PrepareSlot,
    Preparing,
    RunChunk,
    Tick,
)

COMPILE_S, LOAD_S = 40.0, 0.5


def digests(first: int, count: int = 1) -> bytes:
    return PROBE[first * PROBE_DIGEST : (first + count) * PROBE_DIGEST]


class Lab:
    """A server whose processes take their time, in simulated time."""

    def __init__(
        self, slots: int, trial_s: float, *, cold: bool = False, repeatable: bool = True
    ) -> None:
        self.server, self.begun = Server(slots), 100.0
        self.trial_s, self.cold, self.repeatable = trial_s, cold, repeatable
        self.trials: list[int] = []  # that were played
        self._coming: list[tuple[float, int, Event]] = []
        self._count = itertools.count()

    def first_evaluation_s(self) -> float:
        """Return the seconds from the lease to the first trial of the run."""
        wanted = reserve(slots=len(self.server.slots.slots))
        lease = self.server.ask(msgspec.structs.replace(wanted, trial_timeout_s=600.0))
        token = self.server.answer(lease, Lease).lease
        self._carry_out()
        self.server.ask(evaluate(token, 1))
        while not any(isinstance(one, RunChunk) for one in self.server.commands):
            at = self._coming[0][0] if self._coming else self.server.now + 0.25
            if at <= self.server.now:
                self.server.feed(heapq.heappop(self._coming)[2])
            else:
                self.server.now = min(at, self.server.now + 0.25)
                self.server.ask(Renew(lease=token))
                self.server.feed(Tick((0,) * len(self.server.slots.slots)))
            self._carry_out()
        return self.server.now - self.begun

    def _carry_out(self) -> None:
        for command in self.server.commands:
            if isinstance(command, PrepareSlot):
                self._prepare(command)
            elif isinstance(command, PlayProbe):
                self._play(command.slot, command.first, command.count, 0.0, loaded=True)

    def _prepare(self, command: PrepareSlot) -> None:
        trials, slot, after_s = (
            PROBE_TRIALS if self.repeatable else 1,
            command.slot,
            LOAD_S,
        )
        if self.cold:
            self._later(0.0, Preparing(slot, 12, trials))
            self.cold, after_s = False, COMPILE_S
        self._later(after_s, Preparing(slot, 0, trials))
        short = self.repeatable and self.trial_s * command.most < 0.25
        self._play(slot, command.first, command.most if short else 1, after_s)

    def _play(
        self, slot: int, first: int, count: int, after_s: float, *, loaded: bool = False
    ) -> None:
        self.trials += range(first, first + count)
        digest = digests(first, count) if self.repeatable else b""
        event = Prepared(slot, digest, self.trial_s, first, loaded)
        self._later(after_s + count * self.trial_s, event)

    def _later(self, seconds: float, event: Event) -> None:
        at = self.server.now + seconds
        heapq.heappush(self._coming, (at, next(self._count), event))

    def lease(self) -> Lease:
        return self.server.slots.leases["user", "a"].status()


@pytest.mark.parametrize("slots", [1, 2, 4, 8, 16])
def test_trials_of_15_s_delay_the_first_evaluation_by_one_trial(slots: int) -> None:
    lab = Lab(slots, 15.0)
    assert lab.first_evaluation_s() <= 15.0 + 2 * LOAD_S
    assert sorted(set(lab.trials))[0] == 0


@pytest.mark.parametrize("slots", [1, 2, 4, 8, 16])
def test_on_a_cold_server_they_delay_it_by_two_at_most(slots: int) -> None:
    """Besides the compiler."""
    lab = Lab(slots, 15.0, cold=True)
    assert lab.first_evaluation_s() - COMPILE_S <= 2 * 15.0


@pytest.mark.parametrize(
    ("slots", "trial_s", "trials", "most_s"),
    [
        (1, 0.01, 8, 1.0),
        (1, 1.0, 8, 9.0),
        (2, 1.0, 8, 5.0),
        (4, 1.0, 8, 3.0),
        (8, 1.0, 8, 2.0),
        (16, 1.0, 8, 2.0),
        (1, 4.0, 2, 9.0),
        (4, 4.0, 8, 9.0),
        (8, 4.0, 8, 5.0),
        (1, 300.0, 1, 301.0),
        (8, 9.0, 8, 10.0),
    ],
)
def test_all_slots_play_the_probe_within_its_time(
    slots: int, trial_s: float, trials: int, most_s: float
) -> None:
    """It is the same trials, in the same order, on any number of slots."""
    lab = Lab(slots, trial_s)
    assert lab.first_evaluation_s() <= most_s
    assert lab.lease().probe == digests(0, trials)
    assert lab.lease().trial_s == trial_s


@pytest.mark.parametrize("slots", [1, 4])
def test_of_a_simulator_that_is_not_repeatable_each_slot_plays_one_trial(
    slots: int,
) -> None:
    """It loads the simulator; nothing is compared."""
    lab = Lab(slots, 300.0, repeatable=False)
    assert lab.first_evaluation_s() <= 300.0 + 2 * LOAD_S
    assert len(lab.trials) == slots
    assert lab.lease().probe == b""


# ---- what happens meanwhile


def probing(slots: int = 3) -> tuple[Server, bytes]:
    """Return a server all of whose slots play a trial of the probe, and its lease."""
    server = Server(slots)
    lease = server.reserve(slots=slots).lease
    commands = server.feed(Preparing(0, 0, PROBE_TRIALS))
    assert commands == [
        PrepareSlot(slot, reserve(slots=slots), slot) for slot in range(1, slots)
    ]
    return server, lease


def test_slots_wait_for_the_probe_before_they_evaluate() -> None:
    server, lease = probing(2)
    server.evaluate(lease, 1)
    assert server.feed(Prepared(1, digests(1), 0.5, 1)) == [PlayProbe(1, 2, 3)]
    assert server.reserve(slots=2).ready == 0
    assert server.feed(Prepared(1, digests(2, 3), 0.5, 2, loaded=True)) == [
        PlayProbe(1, 5, 2)
    ]
    assert server.feed(Prepared(1, digests(5, 2), 0.5, 5, loaded=True)) == [
        PlayProbe(1, 7, 1)
    ]
    assert server.feed(Prepared(1, digests(7), 0.5, 7, loaded=True)) == []
    assert server.states() == ["preparing", "ready"]
    (chunk,) = server.feed(Prepared(0, digests(0), 0.5))
    assert isinstance(chunk, RunChunk)
    assert server.slots.leases["user", "a"].status().probe == PROBE


def test_a_trial_whose_process_died_is_played_again() -> None:
    server, _ = probing(2)
    server.feed(Prepared(1, digests(1), 2.0, 1))
    assert server.feed(Died(0, 0, "killed")) == [PrepareSlot(0, reserve(slots=2))]
    server.now += 11.0
    assert server.feed(Prepared(1, digests(2, 3), 2.0, 2, loaded=True)) == []
    assert server.reserve(slots=2).ready == 0, "the first trial is awaited"
    server.feed(Prepared(0, digests(0), 2.0))
    lease = server.reserve(slots=2)
    assert (lease.ready, lease.probe) == (2, digests(0, 5))


def test_a_slot_that_is_late_is_not_waited_for_but_its_trial_counts() -> None:
    server, _ = probing(3)
    server.now += 15.0
    server.feed(Prepared(1, digests(1), 15.0, 1))
    assert server.feed(Prepared(0, digests(0), 15.0)) == []
    lease = server.reserve(slots=3)
    assert (lease.ready, lease.probe) == (2, digests(0, 2))
    server.feed(Prepared(2, digests(2), 15.0, 2))
    lease = server.reserve(slots=3)
    assert (lease.ready, lease.probe) == (3, digests(0, 3))


def test_slots_that_a_lease_left_while_it_played_go_on_with_the_probe() -> None:
    """Their processes are prepared for the problem already."""
    server, lease = probing(2)
    server.ask(Release(lease=lease))
    for slot in range(2):
        server.feed(Prepared(slot, digests(slot), 0.5, slot))
    server.ask(reserve(nonce=2, slots=2))
    assert server.commands == [PlayProbe(0, 0, 1), PlayProbe(1, 1, 1)]


# ---- what the run knows


def test_a_run_knows_what_its_slots_do() -> None:
    server = Server(2)
    lease = server.reserve(slots=2).lease
    query = server.ask(Renew(lease=lease, known_ready=0))
    server.feed(Preparing(0, 12, PROBE_TRIALS, 14))
    assert query in server.open, "at most once a second"
    server.wait(1.0)
    told = server.answer(query, Lease)
    assert (told.compiling, told.kernels) == (12, 14)
    assert (told.probe_begun, told.probe_trials) == (0, 0)
    query = server.ask(Renew(lease=lease, known_ready=0))
    server.wait(2.0)
    assert query in server.open, "nothing else happened"
    server.feed(Preparing(0, 0, PROBE_TRIALS))
    told = server.answer(query, Lease)
    assert (told.compiling, told.probe_begun, told.probe_trials) == (0, 2, 8)
    server.feed(Prepared(0, PROBE, 0.01))
    server.feed(Prepared(1, digests(1), 0.01, 1))
    told = server.reserve(slots=2)
    assert (told.ready, told.compiling, told.probe_begun, told.probe_trials) == (
        *(2, 0, 0, 0),
    )


def test_a_run_knows_that_one_trial_is_played() -> None:
    server = Server(2)
    server.reserve(slots=2)
    server.feed(Preparing(0, 0, 1))
    lease = server.reserve(slots=2)
    assert (lease.probe_begun, lease.probe_trials) == (1, 1)
