"""How users and runs share slots: equal rights, slots that are lent, and turns."""

import itertools
from collections import Counter

import pytest

from tests.ss.slots.table_server import OFFER, PROBE, TIMEOUT_S, evaluate, played, reserve
from zswarm.protocol import codec
from zswarm.protocol.messages import Lease, Release, Renew
from zswarm.ss.slots import events
from zswarm.ss.slots.sharing import LEND_S, TURN_S, divide
from zswarm.ss.slots.table import SlotTable

TICK_S = 0.25
Who = tuple[str, str]  # user and run


class Busy:
    """A server whose slots compute in simulated time, and runs that always have work, or none.

    Attributes:
        held: slot-seconds by user and run.
        working: runs that have work.
    """

    def __init__(
        self,
        capacity: int,
        trial_s: float = 0.5,
        prepare_s: float = 0.5,
        name: str = "ss",
    ) -> None:
        tokens, self._queries = itertools.count(1), itertools.count(1)
        offer = OFFER if name == "ss" else type(OFFER)(**_fields(name))
        self.table = SlotTable(
            capacity, offer, lambda _: "", lambda: next(tokens).to_bytes(16, "big")
        )
        self.now, self.trial_s, self.prepare_s = 100.0, trial_s, prepare_s
        self.ends: dict[int, tuple[float, events.SlotEvent]] = {}
        self.held: Counter[Who] = Counter()
        self.working: set[Who] = set()
        self.known: dict[Who, Lease] = {}
        self._asked: dict[int, Who] = {}
        self._batch = itertools.count(1)

    def reserve(
        self, user: str, run: str, slots: int = 100, kind: str = "minisim"
    ) -> None:
        nonce = len(self.known) + 1
        self.known[user, run] = Lease(lease=bytes(16), state="waiting", slots=0, ready=0)
        self.ask((user, run), reserve(nonce=nonce, slots=slots, simulator=kind))

    def release(self, user: str, run: str) -> None:
        self.working.discard((user, run))
        self.ask((user, run), Release(lease=self.known.pop((user, run)).lease))

    def ask(self, who: Who, message: object) -> None:
        query = next(self._queries)
        self._asked[query] = who
        self.feed(events.Asked(query, *who, message))

    def feed(self, event: events.Event) -> None:
        for command in self.table.handle(event, self.now):
            match command:
                case events.Answer():
                    reply, who = (
                        codec.decode_reply(command.body),
                        self._asked.pop(command.query),
                    )
                    if isinstance(reply, Lease) and who in self.known:
                        self.known[who] = reply
                case events.PrepareSlot():
                    done = events.Prepared(command.slot, PROBE, self.trial_s)
                    self.ends[command.slot] = (self.now + self.prepare_s, done)
                case events.RunChunk():
                    count = len(command.work.seeds) // 8
                    end = events.Finished(
                        command.slot, played(0, count, trial_s=self.trial_s)
                    )
                    self.ends[command.slot] = (self.now + count * self.trial_s, end)

    def slots(self) -> Counter[Who]:
        leases = self.table.leases.items()
        return Counter({who: len(lease.slots) for who, lease in leases})

    def of_user(self, user: str) -> int:
        return sum(count for who, count in self.slots().items() if who[0] == user)

    def wait(self, seconds: float) -> None:
        """Let time pass; runs with work always have trials that wait, and renew their leases."""
        for _ in range(round(seconds / TICK_S)):
            self.now += TICK_S
            for slot, (at, event) in list(self.ends.items()):
                if at <= self.now:
                    del self.ends[slot]
                    self.feed(event)
            for who, lease in list(self.table.leases.items()):
                if who in self.working and not lease.jobs.waiting and lease.ready():
                    self.ask(who, evaluate(lease.token, next(self._batch), 400))
                if round(self.now / TICK_S) % 80 == 0:
                    self.ask(who, Renew(lease=lease.token, known_ready=-1))
            for who, count in self.slots().items():
                self.held[who] += count * TICK_S
            self.feed(events.Tick((0,) * len(self.table.slots)))


def _fields(name: str) -> dict[str, object]:
    return {field: getattr(OFFER, field) for field in OFFER.__struct_fields__} | {
        "server": name
    }


def test_slots_are_divided_evenly_as_far_as_they_are_wanted() -> None:
    assert divide(8, [100, 1, 100, 100]) == [3, 1, 2, 2]
    assert divide(2, [0, 5, 5, 5]) == [0, 1, 1, 0]
    assert divide(8, []) == []
    assert divide(5, [3, 100]) == [3, 2], "the remainder is not for those who want most"


def test_users_share_evenly_however_many_runs_they_have() -> None:
    """Also what cannot be divided: it is another user's in each turn."""
    lab = Busy(4)
    for who in [("ada", str(run)) for run in range(9)] + [("bob", "b"), ("eve", "e")]:
        lab.reserve(*who)
        lab.working.add(who)
    lab.wait(600.0)
    users = Counter[str]()
    for (user, _), seconds in lab.held.items():
        users[user] += seconds
    assert min(users.values()) > 0.8 * max(users.values())
    of_ada = [seconds for (user, _), seconds in lab.held.items() if user == "ada"]
    assert len(of_ada) == 9
    assert min(of_ada) > 0.4 * max(of_ada)


def test_a_second_user_gets_half_of_the_slots_of_a_study_within_5_s() -> None:
    lab = Busy(8)
    for number in range(16):
        lab.reserve("ada", f"run-{number}")
        lab.working.add(("ada", f"run-{number}"))
    lab.wait(20.0)
    assert lab.of_user("ada") == 8
    lab.reserve("bob", "run")
    lab.working.add(("bob", "run"))
    lab.wait(5.0)
    assert (lab.of_user("ada"), lab.of_user("bob")) == (4, 4)


def test_runs_of_a_user_share_what_the_user_gets() -> None:
    lab = Busy(8)
    for who in (("ada", "1"), ("ada", "2"), ("bob", "1")):
        lab.reserve(*who)
        lab.working.add(who)
    lab.wait(10.0)
    assert sorted(lab.slots().items()) == [
        (("ada", "1"), 2),
        (("ada", "2"), 2),
        (("bob", "1"), 4),
    ]


def test_idle_slots_are_lent_and_come_back_for_work() -> None:
    """The lease that lends them is told that they are ready: it may send work at any time."""
    lab = Busy(4)
    for who in (("ada", "a"), ("bob", "b")):
        lab.reserve(*who)
    lab.wait(2.0)
    lab.working.add(("ada", "a"))
    lab.wait(LEND_S + 3.0)
    assert lab.slots() == {("ada", "a"): 4, ("bob", "b"): 0}
    lab.ask(("bob", "b"), Renew(lease=lab.known["bob", "b"].lease, known_ready=-1))
    told = lab.known["bob", "b"]
    assert (told.state, told.slots, told.ready) == ("ready", 2, 2)
    lab.working.add(("bob", "b"))
    lab.wait(3.0)
    assert lab.slots() == {("ada", "a"): 2, ("bob", "b"): 2}


@pytest.mark.parametrize("borrower", ["1", "2"])
def test_an_idle_slot_that_was_lent_comes_back_at_once(borrower: str) -> None:
    """The event that brings the work gives it a slot; both runs of the other user have one."""
    lab = Busy(2, trial_s=0.05)
    for who in (("ada", "a"), ("eve", "1"), ("eve", "2")):
        lab.reserve(*who, slots=1)
    lab.wait(LEND_S + 2.0)
    lab.working.add(("eve", borrower))
    lab.wait(LEND_S + 2.0)
    lab.working.clear()
    while lab.table.leases["eve", borrower].jobs.jobs:
        lab.wait(TICK_S)
    assert lab.slots() == {("ada", "a"): 0, ("eve", "1"): 1, ("eve", "2"): 1}
    lab.ask(("ada", "a"), evaluate(lab.table.leases["ada", "a"].token, 1000, 5))
    assert lab.slots()["ada", "a"] == 1


def test_idle_slots_stay_where_nobody_needs_them() -> None:
    lab = Busy(4)
    for who in (("ada", "a"), ("bob", "b")):
        lab.reserve(*who)
    lab.wait(10.0)
    assert lab.slots() == {("ada", "a"): 2, ("bob", "b"): 2}


def test_one_slot_is_lent_for_each_trial_that_waits() -> None:
    lab = Busy(8, trial_s=20.0)
    lab.reserve("ada", "a", kind="minisim")
    lab.reserve("bob", "b", kind="maze")
    lab.wait(LEND_S + 2.0)
    lab.ask(("bob", "b"), evaluate(lab.table.leases["bob", "b"].token, 1, 5))
    lab.wait(2 * TICK_S)
    assert lab.slots() == {("ada", "a"): 3, ("bob", "b"): 5}


def test_a_lease_without_a_right_gets_a_slot_that_is_idle() -> None:
    for name in ("ss-1", "ss-2", "ss-3", "ss-4"):  # whoever stands first in line there
        lab = Busy(1, name=name)
        lab.reserve("ada", "a")
        lab.wait(LEND_S + 2.0)
        lab.reserve("bob", "b")
        lab.working.add(("bob", "b"))
        lab.wait(3.0)
        assert lab.of_user("bob") == 1


def test_servers_of_one_slot_do_not_all_begin_with_the_same_run() -> None:
    first = Counter[Who]()
    for number in range(32):
        lab = Busy(1, name=f"ss-{number}")
        for run in range(4):
            lab.reserve("ada", f"run-{run}")
            lab.working.add(("ada", f"run-{run}"))
        lab.wait(3.0)
        first += lab.slots()
    assert len(first) == 4


def test_a_run_that_takes_over_keeps_what_it_used() -> None:
    lab = Busy(1)
    lab.reserve("ada", "a")
    lab.wait(20.0)
    used = lab.table.leases["ada", "a"].used
    assert used > 10.0
    lab.ask(("ada", "a"), reserve(nonce=9, epoch=1))
    assert lab.table.leases["ada", "a"].used == used


def test_slots_that_were_lent_are_no_more_after_the_lease_ended() -> None:
    lab = Busy(2)
    for who in (("ada", "a"), ("bob", "b")):
        lab.reserve(*who)
    lab.wait(2.0)
    lab.working.add(("ada", "a"))
    lab.wait(5.0)
    lab.release("bob", "b")
    assert lab.slots() == {("ada", "a"): 2}
    lab.working.clear()
    lab.wait(300.0)
    assert not any(lease.lent for lease in lab.table.leases.values())


@pytest.mark.parametrize("runs", [2, 3, 5])
def test_runs_take_turns_where_there_are_fewer_slots(runs: int) -> None:
    lab = Busy(1)
    names = [("ada", str(number)) for number in range(runs)]
    for who in names:
        lab.reserve(*who)
        lab.working.add(who)
    lab.wait(TURN_S * runs * 10)
    shares = [lab.held[who] / lab.held.total() for who in names]
    assert max(shares) < 1.3 / runs
    assert min(shares) > 0.7 / runs


def test_a_turn_is_longer_than_what_is_prepared_for_it() -> None:
    """Half a minute would be spent on preparing."""
    lab = Busy(1, prepare_s=30.0)
    lab.reserve("ada", "a", kind="minisim")
    lab.reserve("bob", "b", kind="maze")
    lab.working |= {("ada", "a"), ("bob", "b")}
    lab.wait(1200.0)
    computed = lab.table.seconds
    assert computed > 0.7 * 1200
    assert min(lab.held.values()) > 0.3 * 1200


@pytest.mark.long
def test_servers_of_one_slot_do_not_all_begin_with_the_same_user() -> None:
    labs = [Busy(1, name=f"ss-{number}") for number in range(64)]
    for lab in labs:
        for number in range(4):
            lab.reserve("ada", f"run-{number}")
            lab.working.add(("ada", f"run-{number}"))
        lab.wait(2.0)
        lab.reserve("bob", "run")
        lab.working.add(("bob", "run"))
        lab.wait(5.0)
    assert 20 <= sum(lab.of_user("bob") for lab in labs) <= 44
    some = labs[:16]
    for lab in some:
        lab.wait(6 * TURN_S)
    of_bob = sum(lab.held["bob", "run"] for lab in some)
    share = of_bob / sum(lab.held.total() for lab in some)
    assert 0.4 < share < 0.6


def test_no_trial_times_out_because_it_waits_for_a_turn() -> None:
    lab = Busy(1, trial_s=TIMEOUT_S / 2)
    for number in range(3):
        lab.reserve("ada", str(number))
        lab.working.add(("ada", str(number)))
    lab.wait(600.0)
    assert not lab.table.faults
