"""How many slots a run asks for, of which servers."""

from collections import Counter

from tests.ot.cluster.dispatching import Optimizer, lease, offer, trials, verbs
from zswarm.ot.cluster.allotment import ALLOT_AFTER_S
from zswarm.ot.cluster.events import Ask, Gone, Pause, Seen, Superseded
from zswarm.ot.cluster.matching import Choice
from zswarm.ot.cluster.remote_server import Phase
from zswarm.ot.cluster.roster import FORGET_S
from zswarm.ot.cluster.servers import Servers
from zswarm.protocol.messages import Refused, Release, Reserve


def lab(
    servers: int,
    slots: int,
    capacity: int = 4,
    *,
    free: int | None = None,
    **options: object,
) -> "Wanting":
    """Return a run that wants some slots, and has seen servers that offered."""
    optimizer = Wanting(slots, **options)
    asks = [
        ask for number in range(servers) for ask in optimizer.feed(Seen(f"s{number}"))
    ]
    held = capacity if free is None else free
    for ask in asks:
        optimizer.settle(optimizer.answer(ask, offer(capacity, free=held)))
    return optimizer


class Wanting(Optimizer):
    """A run whose servers grant what it asks for, unless ``grants`` has another number."""

    def __init__(self, slots: int, **options: object) -> None:
        super().__init__(slots, **options)
        self.grants: dict[str, int] = {}

    def settle(self, asks: list[Ask]) -> None:
        """Answer all that asks for slots, until nothing does."""
        while asks:
            ask = asks.pop(0)
            if isinstance(ask.message, Reserve):
                slots = self.grants.get(ask.server, ask.message.slots)
                state = "ready" if slots else "waiting"
                asks += self.answer(ask, lease(ask.server, slots, state=state))

    def held(self) -> dict[str, int]:
        """Return the slots of each server that granted some."""
        return {name: server.slots for name, server in self.servers.roster.ready.items()}

    @property
    def servers(self) -> Servers:
        return self.dispatch.servers


def test_a_run_holds_as_many_slots_as_it_has_trials_at_once_of_all_servers() -> None:
    assert sum(lab(50, 16).held().values()) == 16
    assert sum(lab(50, 16, 64).held().values()) == 16
    assert sum(lab(3, 16).held().values()) == 12


def test_runs_spread_over_servers_of_one_rank() -> None:
    """The order in which servers are asked depends on the run."""
    used: Counter[str] = Counter()
    for run in range(20):
        used.update(lab(20, 4, nonce=bytes([run] * 16)).held())
    assert len(used) > 10
    assert max(used.values()) < 16, "of 80 slots"


def test_free_servers_and_this_machine_come_first() -> None:
    for run in range(8):
        optimizer = Wanting(4, nonce=bytes([run] * 16))
        names = ("full", "free", "own", "local-1")
        asks = [
            ask for name in names for ask in optimizer.feed(Seen(name, own=name == "own"))
        ]
        for ask in asks:
            free = {"full": 0}.get(ask.server, 2)
            optimizer.settle(optimizer.answer(ask, offer(2, free=free)))
        assert optimizer.held()["own"] == 2, run
        assert "full" not in optimizer.held(), run


def test_slots_of_a_server_that_died_are_asked_for_elsewhere_at_once() -> None:
    optimizer = lab(10, 16)
    name = next(iter(optimizer.held()))
    optimizer.settle(optimizer.feed(Gone(name)))
    assert name not in optimizer.held()
    assert sum(optimizer.held().values()) == 16


def test_a_server_gives_more_slots_if_others_are_gone() -> None:
    """The lease stays the same."""
    optimizer = lab(2, 16, 10)
    assert sorted(optimizer.held().values()) == [6, 10]
    largest = max(optimizer.held(), key=lambda name: optimizer.held()[name])
    optimizer.settle(optimizer.feed(Gone(largest)))
    (other,) = optimizer.held()
    assert optimizer.held() == {other: 10}
    assert optimizer.servers.by_id[other].phase == Phase.LEASED


def test_a_server_asked_for_more_slots_may_say_that_the_run_was_taken_over() -> None:
    """No other server may be left that would."""
    optimizer = lab(2, 16, 10)
    largest = max(optimizer.held(), key=lambda name: optimizer.held()[name])
    (other,) = optimizer.held().keys() - {largest}
    (ask,) = optimizer.feed(Gone(largest))
    optimizer.answer(ask, Refused(code="superseded", reason="taken over"))
    assert Superseded(other, "taken over") in optimizer.commands
    assert not optimizer.held()


def test_servers_without_a_free_slot_are_asked_in_rounds() -> None:
    """Each round asks as many as could grant what is missing; none grants any yet."""
    optimizer = Wanting(8)
    asks = [ask for number in range(8) for ask in optimizer.feed(Seen(f"s{number}"))]
    optimizer.grants = {f"s{number}": 0 for number in range(8)}
    for ask in asks:
        optimizer.settle(optimizer.answer(ask, offer(4, free=0)))
    rounds = []
    for _ in range(5):
        rounds.append(optimizer.servers.standing().leased)
        optimizer.settle(optimizer.wait(ALLOT_AFTER_S))
    assert rounds == [2, 4, 6, 8, 8]


def test_what_servers_grant_late_is_given_back_where_it_is_too_much() -> None:
    optimizer = Wanting(4)
    optimizer.grants = {"a": 0}
    (ask,) = optimizer.feed(Seen("a"))
    (waiting,) = optimizer.answer(ask, offer(4, free=0))
    optimizer.answer(waiting, lease("a", 0, state="waiting"))
    assert optimizer.servers.standing().leased == 1
    (ask,) = optimizer.feed(Seen("b"))
    (ask,) = optimizer.answer(ask, offer(4))
    asks = optimizer.answer(ask, lease("b", 4))
    assert ("a", "release") in verbs(asks), "b has all that is wanted"
    assert optimizer.held() == {"b": 4}


def test_with_verify_a_second_server_has_a_slot() -> None:
    assert sorted(lab(2, 4, verify=0.1).held().values()) == [1, 4]
    limited = lab(2, 4, verify=0.1, choice=Choice(max_slots=4))
    limited.settle(limited.wait(ALLOT_AFTER_S))
    assert list(limited.held().values()) == [4]


def test_a_paused_run_holds_no_slots_and_takes_them_again() -> None:
    """What was counted stays counted, and the rest is evaluated after the pause."""
    optimizer = lab(3, 8)
    asks = optimizer.work(20)
    released = optimizer.feed(Pause(paused=True))
    assert sum(isinstance(ask.message, Release) for ask in released) == 2
    assert optimizer.held() == {}
    assert optimizer.wait(100.0) == []
    (ask,) = optimizer.feed(Seen("late"))
    assert optimizer.answer(ask, offer(4)) == []
    assert asks
    assert optimizer.requeued == len(trials(asks))
    optimizer.settle(optimizer.feed(Pause(paused=False)))
    assert sum(optimizer.held().values()) == 8
    assert optimizer.workload.counted.sum() == 0


def test_servers_that_were_restarted_are_forgotten() -> None:
    """Two minutes after they left: then no lease can be resumed any more."""
    optimizer = Optimizer()
    for number in range(2000):
        optimizer.now += 1.0
        (ask,) = optimizer.feed(Seen(f"s{number}"))
        optimizer.answer(ask, offer(1, "another version"))
        optimizer.feed(Gone(f"s{number}"))
    servers = optimizer.dispatch.servers
    assert len(servers.by_id) == FORGET_S
    assert sum(servers.roster.phases.values()) == FORGET_S
    assert len(servers.forgotten) == 2000 - FORGET_S
    optimizer.now += FORGET_S - 1.0
    optimizer.feed(Seen("s1999"))
    optimizer.feed(Gone("s1999"))
    assert set(servers.by_id) == {"s1999"}, "it was seen again"
