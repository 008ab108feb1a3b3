"""A slot's process and the parent's end of it: real processes."""

import math
import multiprocessing.connection
import multiprocessing.forkserver
import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from small import playable

from zswarm import plugins
from zswarm.draws import Stream
from zswarm.evaluate import build
from zswarm.protocol import codec
from zswarm.protocol.messages import MIN_MEMORY_MB, Evaluate, Outcomes, Part, Reserve
from zswarm.ss import worker
from zswarm.ss.worker import LONGEST_PAUSE_S, Ready, Worker
from zswarm.version_hash import version_hash

ANSWER_S = 120.0  # a compiler may be at work


@pytest.fixture
def new_worker() -> Iterator[Callable[..., Worker]]:
    worker.start_fork_server()
    made: list[Worker] = []

    def new(memory_mb: int = 1024) -> Worker:
        made.append(Worker(memory_mb))
        start(made[-1])
        return made[-1]

    yield new
    for one in made:
        one.close()


def reserve(simulator: str = "minisim", representation: str = "fully-meshed", trial_memory_mb: int = 0) -> Reserve:
    return Reserve(
        nonce=bytes(16), epoch=0, slots=1, simulator=Part(simulator, {}), representation=Part(representation, {}),
        version_hash=version_hash(simulator, representation), trial_timeout_s=1.0, trial_memory_mb=trial_memory_mb,
    )  # fmt: skip


def start(slot: Worker) -> None:
    """Wait until its process is here."""
    slot.start()
    assert not slot.here
    assert answer(slot) == (b"H", b"")
    assert slot.here


def answer(of: Worker) -> tuple[bytes, bytes]:
    assert of.pipe is not None
    assert of.pipe.poll(ANSWER_S)
    return of.receive()


TOO_LARGE = {("pettingzoo", "mealy")}  # a machine's table has a row for each combination of 18 inputs


def pairs() -> Iterator[Any]:
    """Of bundled simulators and representations: each part in one; all others are long."""
    simulators, representations = playable(plugins.BUNDLED["simulator"]), list(plugins.BUNDLED["representation"])
    for row, simulator in enumerate(simulators):
        for column, representation in enumerate(representations):
            if (simulator, representation) in TOO_LARGE:
                continue
            first = row % len(representations) == column or column % len(simulators) == row
            yield pytest.param(simulator, representation, marks=[] if first else pytest.mark.long)


def pid(of: Worker) -> int:
    """Its number, which the thread that started it may learn after it said that it is here."""
    assert of._process is not None
    end = time.monotonic() + ANSWER_S
    while of._process.pid is None:
        assert time.monotonic() < end
        time.sleep(0.001)
    return of._process.pid


def limit(of: Worker, name: str) -> str:
    lines = Path(f"/proc/{pid(of)}/limits").read_text().splitlines()
    return next(line for line in lines if line.startswith(name)).removeprefix(name).split()[0]


@pytest.mark.parametrize(("simulator", "representation"), [*pairs()])
def test_bundled_parts_work_with_the_least_memory_that_may_be_asked_for(
    simulator: str, representation: str, new_worker: Callable[..., Worker]
) -> None:
    slot = new_worker()
    slot.prepare(reserve(simulator, representation, MIN_MEMORY_MB), probe=True)
    letter, body = answer(slot)
    assert letter == b"R", body
    assert len(msgspec.msgpack.decode(body, type=Ready).probe) == 16
    assert limit(slot, "Max data size") == str(MIN_MEMORY_MB << 20)
    assert limit(slot, "Max core file size") == "0"
    assert int(Path(f"/proc/{pid(slot)}/oom_score_adj").read_text()) >= 500
    network = build(simulator, {}, representation, {})[1]
    genomes = network.random(3, Stream(1))
    batch = Evaluate(lease=bytes(16), batch=5, genomes=genomes, participants=np.arange(3, dtype="<u4").tobytes(), seeds=bytes(24))
    replies = []
    for first, alone in ((0, -1), (0, 1), (1, 2)):
        slot.evaluate(codec.encode(batch), first, alone)
        letter, body = answer(slot)
        assert letter == b"O"
        reply = codec.decode_reply(body)
        assert isinstance(reply, Outcomes)
        replies.append(reply)
    whole, split, rest = (reply.fitness for reply in replies)
    assert len(whole) == 3 * 8
    assert split == whole, "a trial that is played by itself decides the same"
    assert rest == whole[8:]
    assert slot.trial() == 2


def test_a_process_gets_what_the_server_gives_when_the_run_asks_for_nothing(new_worker: Callable[..., Worker]) -> None:
    slot = new_worker(700)
    slot.prepare(reserve(), probe=False)
    assert answer(slot)[0] == b"R"
    assert limit(slot, "Max data size") == str(700 << 20)


def test_a_process_does_not_compute_with_other_code_than_the_server_said(new_worker: Callable[..., Worker]) -> None:
    slot = new_worker()
    slot.prepare(msgspec.structs.replace(reserve(), version_hash="0" * 32), probe=False)
    letter, why = answer(slot)
    assert letter == b"F"
    assert why.startswith(b"files of minisim, fully-meshed or zswarm changed after the server was started; ")


def test_a_process_is_prepared_once(new_worker: Callable[..., Worker]) -> None:
    """What a problem left behind takes no memory from the next one."""
    slot = new_worker()
    slot.prepare(reserve(), probe=False)
    answer(slot)
    first = pid(slot)
    slot.prepare(reserve("emergency-exit"), probe=False)
    assert (slot.pipe, slot.start_at) == (None, 0.0)
    start(slot)
    assert answer(slot)[0] == b"R"
    assert pid(slot) != first


def test_the_same_problem_keeps_the_process(new_worker: Callable[..., Worker]) -> None:
    """A run that is started again is served at once; the probe is played again."""
    slot = new_worker()
    slot.prepare(reserve(), probe=False)
    answer(slot)
    first = pid(slot)
    slot.prepare(reserve(), probe=True, known=True)
    letter, body = answer(slot)
    assert letter == b"R"
    assert len(msgspec.msgpack.decode(body, type=Ready).probe) > 0
    assert pid(slot) == first


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (signal.SIGKILL, "was killed by signal 9 (the machine may have run out of memory)"),
        (signal.SIGSEGV, "was killed by signal 11 (SIGSEGV)"),
        (signal.SIGRTMIN + 3, f"was killed by signal {signal.SIGRTMIN + 3}"),
    ],
)
def test_how_a_process_ended_is_told(number: int, words: str, new_worker: Callable[..., Worker]) -> None:
    slot = new_worker()
    os.kill(pid(slot), number)
    with pytest.raises((EOFError, OSError)):
        answer(slot)
    assert slot.exit_reason().partition("; it said")[0] == words


def test_a_process_that_dies_at_its_start_again_and_again_is_started_after_growing_pauses(
    new_worker: Callable[..., Worker],
) -> None:
    slot = new_worker()
    pauses = []
    for _ in range(12):
        os.kill(pid(slot), signal.SIGKILL)
        slot.exit_reason()
        pauses.append(slot.start_at - time.monotonic())
        start(slot)
    assert pauses[0] <= 0.0, "the first time at once"
    assert sorted(pauses[:7]) == pauses[:7]
    assert LONGEST_PAUSE_S / 2 < pauses[-1] <= LONGEST_PAUSE_S
    slot.prepare(reserve(), probe=False)
    assert answer(slot)[0] == b"R"
    os.kill(pid(slot), signal.SIGKILL)
    slot.exit_reason()
    assert slot.start_at <= time.monotonic(), "one that answered is replaced at once"


def test_what_is_sent_while_no_process_is_there_waits_for_it_unless_it_is_killed(new_worker: Callable[..., Worker]) -> None:
    slot = new_worker()
    os.kill(pid(slot), signal.SIGKILL)
    slot.exit_reason()
    slot.prepare(msgspec.structs.replace(reserve(), simulator=Part("nothing-of-this-name", {})), probe=True)
    slot.kill()
    slot.prepare(reserve(), probe=True)
    start(slot)
    assert answer(slot)[0] == b"R"


def test_a_process_that_cannot_be_started_is_told_and_tried_again(
    new_worker: Callable[..., Worker], monkeypatch: pytest.MonkeyPatch
) -> None:
    slot = new_worker()
    slot.kill()
    with monkeypatch.context() as patch:
        patch.setattr(worker._context, "Process", Unborn)
        for _ in range(2):
            slot.start()
            letter, reason = answer(slot)
            assert letter == b"N"
            assert b"could not be started: BlockingIOError" in reason
        assert slot.pipe is None
        assert slot.pauses(time.monotonic())
    start(slot)
    slot.prepare(reserve(), probe=False)
    assert answer(slot)[0] == b"R"


class Unborn:
    """A process where there is no room for one."""

    def __init__(self, **_: object) -> None:
        pass

    def start(self) -> None:
        raise BlockingIOError("no more processes")


def test_a_fork_server_that_stands_still_holds_nobody_up(new_worker: Callable[..., Worker]) -> None:
    """A killed process is waited for by its sentinel, a new one by its pipe; what is missed is told."""
    slot, fresh = new_worker(), Worker(1024)
    process = slot._process
    forking = multiprocessing.forkserver._forkserver._forkserver_pid  # type: ignore[attr-defined]  # private
    os.kill(forking, signal.SIGSTOP)
    try:
        begin = time.monotonic()
        slot.kill()
        fresh.start()
        fresh.prepare(reserve(), probe=False)
        assert time.monotonic() - begin < 2.0
        assert slot.leaving is process
        assert math.isinf(slot.start_at), "the one before it is not gone"
        slot.look()
        now = time.monotonic() + 60.0
        assert slot.missed(now, 30.0) == "its killed process does not go away"
        assert fresh.missed(now, 30.0) == "the fork server does not start its process"
        assert (slot.missed(now, 90.0), fresh.missed(now, 90.0)) == ("", "")
    finally:
        os.kill(forking, signal.SIGCONT)
    assert slot.leaving is not None
    assert multiprocessing.connection.wait([slot.leaving.sentinel], ANSWER_S)
    slot.look()
    start(slot)
    assert answer(fresh)[0] == b"H"
    assert answer(fresh)[0] == b"R"
    assert (slot.missed(now, 30.0), fresh.missed(now, 30.0)) == ("", "")
    fresh.close()


def test_a_process_that_is_killed_before_it_started_ends_by_itself(new_worker: Callable[..., Worker]) -> None:
    slot = new_worker()
    slot.kill()
    slot.start()
    early = slot._process
    assert early is not None
    slot.kill()
    start(slot)
    assert slot._process is not early
    early.join(ANSWER_S)
    assert early.exitcode is not None


def test_what_a_process_says_is_heard_but_for_floods(new_worker: Callable[..., Worker]) -> None:
    """Whole lines, the first twenty; the last one is told when it ends before it answered again."""
    slot = new_worker()

    def say(text: bytes) -> list[str]:
        with Path(f"/proc/{pid(slot)}/fd/1").open("wb") as said:
            said.write(text)
        return slot.listen()

    assert say(b"one\n\ntwo, beg") == ["one"]
    assert say(b"un\n\xff\n") == ["two, begun", "\\xff"]
    assert say(b"".join(b"%d\n" % number for number in range(100))) == [
        *(str(number) for number in range(17)),
        "... what it says more is not logged",
    ]
    assert say(b"x" * 60_000 + b"\n") == []
    assert slot.listen() == [], "there is nothing more to hear"
    assert say(b"last words") == []
    os.kill(pid(slot), signal.SIGKILL)
    with pytest.raises((EOFError, OSError)):
        answer(slot)
    assert slot.exit_reason().endswith("; it said: last words")
    assert slot.said is None


def test_a_process_leads_a_session_and_nobody_else_has_its_pipe(new_worker: Callable[..., Worker]) -> None:
    """So what it starts is known, and it is over when it ends."""
    slot = new_worker()
    assert os.getsid(slot.session) == slot.session == pid(slot)
    slot.close()
    assert slot.session == 0
