"""What a server did wrong is held against its machine, over new ids and later programs."""

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

from tests.ot.cluster.dispatching import (
    PROBE,
    Optimizer,
    fault,
    lease,
    offer,
    outcomes,
    trials,
    verbs,
)
from zswarm.ot.cluster.announced import SAME_NAME, Announced
from zswarm.ot.cluster.events import (
    Answered,
    Arbitrated,
    Ask,
    Complete,
    Counted,
    Disputed,
    Gone,
    ProbeArbitrated,
    ProbeDisputed,
    Retracted,
    Seen,
    Work,
)
from zswarm.ot.cluster.machines import BLAMED, THIS, Known, machine, name_of
from zswarm.ot.cluster.remote_server import Phase
from zswarm.ot.cluster.servers import RETRY_S
from zswarm.ot.notes import Note
from zswarm.ot.workload import Workload
from zswarm.protocol.messages import Evaluate, Refused, Reserve

TRUE, WRONG = 0.0, 1e6  # outcomes


def join(
    optimizer: Optimizer,
    server: str,
    at: str = "",
    *,
    slots: int = 1,
    probe: bytes = PROBE,
    trial_s: float = 1.0,
) -> list[Ask]:
    """Let a server of a machine appear and become ready, if it is used."""
    (ask,) = optimizer.feed(Seen(server))
    asks = optimizer.feed(Answered(ask.question, offer(slots), at))
    for ask in asks:
        if isinstance(ask.message, Reserve):
            slots = min(slots, ask.message.slots)
            return optimizer.answer(
                ask, lease(server, slots, probe=probe, trial_s=trial_s)
            )
    return asks


def evaluations(asks: list[Ask]) -> list[Ask]:
    return [ask for ask in asks if isinstance(ask.message, Evaluate)]


# ---- what a machine is


@pytest.mark.parametrize(
    ("server", "address", "members", "found"),
    [
        ("lab-02-0123abcd", "", (), "lab-02"),
        ("lab-02-0123abcd", "tcp/192.168.0.7:7467", (), "192.168.0.7"),
        ("lab-02-0123abcd", "tcp/[fe80::1%eth0]:7467", (), "fe80::1%eth0"),
        ("lab-02-0123abcd", "tls/192.168.0.7:7467", ("lab-01", "lab-02"), "lab-02"),
        ("lab-02-x-0123abcd", "tls/192.168.0.8:7467", ("lab-01", "lab-02"), "lab-02"),
        ("lab-02-0123abcd", "", ("lab-01", "lab-02"), "lab-02"),
        ("local-0123abcd", "unixsock-stream//tmp/z/ss.sock", (), THIS),
        ("local-0123abcd", "unixsock-stream//tmp/z/ss.sock", ("lab-01",), THIS),
        ("local-0123abcd", "tcp/192.168.0.9:7467", (), "192.168.0.9"),
        ("local-0123abcd", "", (), "local"),
        ("stranger", "", (), "stranger"),
    ],
)
def test_a_machine_is_a_certificate_or_an_address(
    server: str, address: str, members: tuple[str, ...], found: str
) -> None:
    local = "unixsock-stream//tmp/z/ss.sock"
    assert machine(server, address, local, members) == found


# ---- many tokens


def test_of_300_tokens_of_a_name_sixteen_are_used_and_the_next_ones_as_these_go() -> None:
    announced = Announced(name_of)
    servers = [f"lab-02-{number:08x}" for number in range(300)]
    used = [server for server in servers if announced.add(server, server)]
    assert used == servers[:SAME_NAME]
    assert announced.add("lab-01-00000000", "")
    assert announced.remove(servers[200]) is None, "it was not used"
    assert announced.remove(servers[3]) == (servers[16], servers[16])
    assert announced.remove(servers[16]) == (servers[17], servers[17])
    for server in servers:
        announced.remove(server)
    assert list(announced._by_name) == ["lab-01"]


@pytest.mark.parametrize("how", ["mismatch", "refused", "silent", "banned"])
def test_a_machine_is_reported_once_however_many_servers_it_is(how: str) -> None:
    known = Known(banned={"lab-02": "lab-02-ffffffff"} if how == "banned" else {})
    optimizer = Optimizer(known=known)
    notes: list[Note] = []

    def take() -> None:
        notes.extend(note for note in optimizer.commands if isinstance(note, Note))

    for number in range(300):
        server = f"lab-02-{number:08x}"
        (ask,) = optimizer.feed(Seen(server))
        if how == "silent":
            for _ in RETRY_S:
                optimizer.answer(optimizer.asked[server, "offer"], None)
                optimizer.wait(2.0)
            optimizer.answer(optimizer.asked[server, "offer"], None)
        elif how == "refused":
            (ask,) = optimizer.answer(ask, offer())
            optimizer.answer(ask, Refused(code="draining", reason="it drains"))
        else:
            optimizer.answer(ask, offer(mismatch="no such simulator"))
        take()
        optimizer.feed(Gone(server))
        take()
    assert len(notes) == 1
    known = len(optimizer.dispatch.servers.by_id)
    assert known == (20 if how == "silent" else 300), "of the last two minutes"


def test_a_machine_cannot_fill_the_record_with_ever_new_reasons() -> None:
    optimizer = Optimizer()
    count = 0
    for number in range(300):
        (ask,) = optimizer.feed(Seen(f"lab-02-{number:08x}"))
        optimizer.answer(ask, offer(mismatch=f"reason {number}"))
        count += len(optimizer.notes("server_mismatch"))
    assert count == 16


# ---- verification


def test_no_server_of_the_same_machine_verifies() -> None:
    optimizer = Optimizer(verify=1.0)
    join(optimizer, "lab-02-00000001")
    (ask,) = optimizer.work(1)
    join(optimizer, "lab-02-00000002")
    assert optimizer.answer(ask, outcomes(ask, WRONG)) == []
    assert optimizer.notes("unverified"), "nobody else can"
    assert Complete() in optimizer.commands
    (ask,) = optimizer.work(1)
    join(optimizer, "lab-01-00000001")
    (check,) = optimizer.answer(ask, outcomes(ask, WRONG))
    assert check.server == "lab-01-00000001"


def test_servers_at_one_address_are_one_machine_under_any_name() -> None:
    optimizer = Optimizer(verify=1.0)
    join(optimizer, "lab-02-00000001", "10.0.0.7")
    (ask,) = optimizer.work(1)
    join(optimizer, "lab-03-00000001", "10.0.0.7")
    assert optimizer.answer(ask, outcomes(ask, WRONG)) == []
    assert Complete() in optimizer.commands


def test_a_slot_of_another_machine_that_is_getting_ready_is_waited_for() -> None:
    optimizer = Optimizer(verify=1.0)
    join(optimizer, "lab-02-00000001", "10.0.0.7")
    (ask,) = optimizer.work(1)
    (own,) = optimizer.feed(Seen("local-00000001"))
    (own,) = optimizer.feed(Answered(own.question, offer(1), THIS))
    (own,) = optimizer.answer(own, lease("own", 0, state="preparing", slots=1))
    optimizer.answer(ask, outcomes(ask, WRONG))
    assert Complete() not in optimizer.commands
    asks = evaluations(optimizer.answer(own, lease("own", 1)))
    assert [check.server for check in asks] == ["local-00000001"]
    optimizer.answer(asks[0], outcomes(asks[0], TRUE))
    assert Disputed(0) in optimizer.commands


def test_with_verify_no_machine_gets_all_slots() -> None:
    optimizer = Optimizer(slots=2, verify=0.01)
    for number in range(3):
        join(optimizer, f"lab-66-{number:08x}", slots=2)
    optimizer.wait(1.0)
    join(optimizer, "lab-01-00000001", slots=2)
    roster = optimizer.dispatch.servers.roster
    assert roster.machines == {"lab-66": 2, "lab-01": 1}
    assert "lab-01-00000001" in roster.ready


def test_the_first_trial_of_each_machine_is_verified() -> None:
    optimizer = Optimizer(verify=0.001)
    for server in ("lab-01-00000001", "lab-02-00000001", "lab-03-00000001"):
        join(optimizer, server)
    asks, by, checked = optimizer.work(30), {}, Counter[str]()
    while asks:
        ask = asks.pop(0)
        for trial in trials([ask]):
            if trial in by:
                checked[name_of(by[trial])] += 1
            by.setdefault(trial, ask.server)
        asks += optimizer.answer(ask, outcomes(ask))
    assert checked == {"lab-01": 1, "lab-02": 1, "lab-03": 1}


def test_the_next_trial_of_a_machine_is_verified_that_nobody_could_verify() -> None:
    optimizer = Optimizer(verify=0.001)
    join(optimizer, "lab-02-00000001")
    (ask,) = optimizer.work(1)
    optimizer.answer(ask, outcomes(ask, WRONG))
    assert optimizer.notes("unverified")
    join(optimizer, "lab-01-00000001")
    asks = optimizer.work(2)
    checks = [
        check
        for ask in asks
        for check in evaluations(optimizer.answer(ask, outcomes(ask, TRUE)))
    ]
    assert {check.server for check in checks} == {"lab-01-00000001"}


def test_all_servers_of_a_machine_are_banned_and_their_outcomes_retracted() -> None:
    optimizer = Optimizer(verify=0.001)
    servers = [f"lab-02-0000000{number}" for number in range(3)]
    for server in servers:
        join(optimizer, server)
    asks = optimizer.work(4)
    workload = optimizer.workload
    for ask in asks[:3]:
        optimizer.answer(ask, outcomes(ask, *[WRONG] * len(trials([ask]))))
    join(optimizer, "lab-01-00000001")
    check = optimizer.asked["lab-01-00000001", "evaluate"]
    optimizer.answer(check, outcomes(check, TRUE))
    (trial,) = trials([check])
    asks = optimizer.feed(Arbitrated(trial, np.array([TRUE]), np.zeros(0)))
    retracted = [one.server for one in optimizer.commands if isinstance(one, Retracted)]
    assert sorted(retracted) == servers
    assert not workload.counted.any()
    assert sorted(one for one in verbs(asks) if one[1] == "release") == [
        (server, "release") for server in servers
    ]
    (note,) = optimizer.notes("server_wrong")
    assert note.machine == "lab-02"


# ---- later servers, and later programs


@pytest.mark.parametrize("at", ["", "10.0.0.7"])
def test_a_banned_machine_is_not_used_under_a_new_id(at: str) -> None:
    known = Known(banned={at or "lab-02": "lab-02-ffffffff"})
    optimizer = Optimizer(known=known)
    assert join(optimizer, "lab-02-00000001", at) == []
    (note,) = optimizer.notes("server_banned")
    assert "computed wrong outcomes as lab-02-ffffffff" in note.text
    assert f"--trust '{at or 'lab-02'}'" in note.text
    assert optimizer.dispatch.servers.by_id["lab-02-00000001"].phase == Phase.IDLE
    optimizer.feed(Gone("lab-02-00000001"))
    assert join(optimizer, "lab-02-00000002", at) == []
    assert optimizer.notes("server_banned") == [], "one line is enough"
    assert join(optimizer, "lab-01-00000001", "10.0.0.6") == []
    assert list(optimizer.dispatch.servers.roster.ready) == ["lab-01-00000001"]


def test_what_a_machine_counted_for_an_earlier_program_is_not_verified_by_itself() -> (
    None
):
    known = Known(machines={"lab-02-00000001": "10.0.0.7"})
    optimizer = Optimizer(verify=1.0, known=known)
    join(optimizer, "lab-02-00000002", "10.0.0.7")
    workload = Workload([b"g"], np.zeros((3, 1), int), np.arange(3).astype(np.uint64), 0)
    workload.counted[:], workload.source[:] = True, "lab-02-00000001"
    workload.fitness[:] = WRONG
    assert optimizer.feed(Work(workload)) == []
    assert optimizer.notes("unverified")


def test_what_a_machine_counted_for_an_earlier_program_is_retracted_with_it() -> None:
    known = Known(machines={"lab-02-00000001": "10.0.0.7"})
    optimizer = Optimizer(verify=1.0, known=known)
    join(optimizer, "lab-02-00000002", "10.0.0.7")
    join(optimizer, "lab-01-00000001", "10.0.0.6")
    workload = Workload([b"g"], np.zeros((3, 1), int), np.arange(3).astype(np.uint64), 0)
    workload.counted[:2], workload.source[:2] = True, "lab-02-00000001"
    workload.fitness[:2] = WRONG
    (mine, check) = sorted(
        optimizer.feed(Work(workload)), key=lambda ask: ask.server, reverse=True
    )
    assert (mine.server, check.server) == ("lab-02-00000002", "lab-01-00000001")
    optimizer.answer(check, outcomes(check, *[TRUE] * len(trials([check]))))
    optimizer.feed(Arbitrated(0, np.array([TRUE]), np.zeros(0)))
    assert Retracted("lab-02-00000001") in optimizer.commands
    assert Retracted("lab-02-00000002") in optimizer.commands


def test_a_probe_that_an_earlier_program_decided_is_not_played_again() -> None:
    optimizer = Optimizer(probe=b"right" * 2, known=Known(arbitrated=b"right" * 2))
    join(optimizer, "lab-02-00000001", probe=b"other" * 2)
    assert optimizer.notes("server_wrong")
    assert not [one for one in optimizer.commands if isinstance(one, ProbeDisputed)]


def test_the_verdict_on_the_probe_is_reported_for_the_record() -> None:
    optimizer = Optimizer()
    join(optimizer, "lab-01-00000001", probe=b"right")
    join(optimizer, "lab-02-00000001", probe=b"other")
    optimizer.feed(ProbeArbitrated(b"right"))
    (note,) = optimizer.notes("probe_arbitrated")
    assert bytes.fromhex(note.text) == b"right"


# ---- faults


def test_three_faults_of_one_machine_are_one_attempt() -> None:
    optimizer = Optimizer()
    for number in range(3):
        join(optimizer, f"lab-02-0000000{number}")
    (ask,) = optimizer.work(1)
    join(optimizer, "lab-01-00000001")
    (ask,) = optimizer.answer(ask, fault(ask))
    assert ask.server == "lab-01-00000001", "no server of the same machine"
    optimizer.answer(ask, outcomes(ask))
    assert Complete() in optimizer.commands
    assert optimizer.dispatch.servers.machines.blamed["lab-02"] == 1


def test_a_trial_that_fails_on_all_machines_ends_the_workload() -> None:
    optimizer = Optimizer()
    for number in range(3):
        join(optimizer, f"lab-02-0000000{number}")
    (ask,) = optimizer.work(1)
    for _ in range(2):
        (ask,) = optimizer.answer(ask, fault(ask))
    optimizer.answer(ask, fault(ask))
    assert "3 times" in repr(optimizer.commands)


def test_a_faulty_machine_is_backed_off_with_all_its_servers() -> None:
    optimizer = Optimizer()
    for server in ("lab-02-00000001", "lab-02-00000002", "lab-01-00000001"):
        join(optimizer, server)
    for _ in range(BLAMED):
        (ask,) = optimizer.work(1)
        assert ask.server.startswith("lab-02")
        (ask,) = optimizer.answer(ask, fault(ask))
        optimizer.answer(ask, outcomes(ask))
    assert len(optimizer.notes("server_faulty")) == 1
    assert list(optimizer.dispatch.servers.roster.ready) == ["lab-01-00000001"]


# ---- a lab with a liar


def evolve(optimizer: Optimizer, asks: list[Ask], lies: Callable[[str], bool]) -> None:
    """Answer all questions; this machine computes the truth."""
    waited = 0
    while asks or optimizer.dispatch.batches.workload is not None:
        if not asks:
            asks = optimizer.wait(1.0)
            waited += 1
            assert waited < 100, "it hangs"
            continue
        ask = asks.pop(0)
        optimizer.now += 0.001
        if isinstance(ask.message, Evaluate):
            outcome = WRONG if lies(ask.server) else TRUE
            trial_s = optimizer.dispatch.servers.by_id[ask.server].pace.trial_s
            reply = outcomes(ask, *[outcome] * len(trials([ask])), seconds=trial_s)
            asks += optimizer.answer(ask, reply)
        for one in [one for one in optimizer.commands if isinstance(one, Disputed)]:
            truth = Arbitrated(one.trial, np.array([TRUE]), np.zeros(0))
            asks += optimizer.feed(truth)


def test_a_slow_machine_verifies_what_many_fast_servers_of_another_one_counted() -> None:
    optimizer = Optimizer(verify=1.0)
    join(optimizer, "lab-01-00000001", trial_s=1.0)
    for number in range(5):
        join(optimizer, f"lab-66-{number:08x}", trial_s=0.01)
    asks = optimizer.work(30)
    workload = optimizer.workload
    evolve(optimizer, asks, lambda server: server.startswith("lab-66"))
    assert workload.counted.all()
    assert (workload.fitness == TRUE).all()


@pytest.mark.parametrize("honest", [1, 3])
@pytest.mark.parametrize("servers", [1, 5, 20])
def test_no_wrong_outcome_of_a_machine_with_many_ids_stays(
    servers: int, honest: int
) -> None:
    """All answers of a machine are wrong, and one trial in a hundred is verified."""
    optimizer = Optimizer(verify=0.01)
    for number in range(servers):
        join(optimizer, f"lab-66-{number:08x}", slots=4)
    for number in range(honest):
        join(optimizer, f"lab-0{number}-00000001", slots=4)
    asks = optimizer.work(400)
    workload = optimizer.workload
    evolve(optimizer, asks, lambda server: server.startswith("lab-66"))
    assert workload.counted.all()
    assert (workload.fitness == TRUE).all()
    assert {name_of(server) for server in workload.source} <= {
        f"lab-0{number}" for number in range(honest)
    }
    assert list(optimizer.dispatch.servers.machines.banned) == ["lab-66"]
    assert join(optimizer, "lab-66-ffffffff") == [], "it was restarted"
    assert Counted not in map(type, optimizer.commands)
