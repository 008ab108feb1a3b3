"""A slot's process and the server's end of it: real processes."""

import ctypes
import math
import multiprocessing.connection
import multiprocessing.forkserver
import os
import select
import selectors
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from tests.installed_parts import playable
from zswarm.evaluate import build
from zswarm.kernels.random import Stream
from zswarm.plugins import registry as plugins
from zswarm.plugins.version_hash import version_hash
from zswarm.protocol import codec
from zswarm.protocol.messages import (
    MIN_MEMORY_MB,
    PROBE_DIGEST,
    PROBE_TRIALS,
    Evaluate,
    Outcomes,
    Part,
    Reserve,
)
from zswarm.ss.slots.events import (
    Died,
    Finished,
    PlayProbe,
    Prepared,
    PrepareSlot,
    Preparing,
    RunChunk,
    Unprepared,
)
from zswarm.ss.workers import child, parent
from zswarm.ss.workers.child import FromSlot, Here
from zswarm.ss.workers.parent import LONGEST_PAUSE_S, Worker

ANSWER_S = 120.0  # a compiler may be at work


class Owner:
    """Count the processes that ended."""

    def __init__(self) -> None:
        self.ended = 0
        self.full: list[Worker] = []

    def on_message(self, worker: Worker) -> None: ...

    def on_output(self, worker: Worker) -> None: ...

    def on_exit(self, _: Worker) -> None:
        self.ended += 1

    def on_full_pipe(self, worker: Worker) -> None:
        self.full.append(worker)


def unstarted(memory_mb: int = 1024) -> Worker:
    return Worker(0, memory_mb, selectors.PollSelector(), Owner())


@pytest.fixture
def new_worker() -> Iterator[Callable[..., Worker]]:
    parent.start_fork_server()
    made: list[Worker] = []

    def new(memory_mb: int = 1024) -> Worker:
        made.append(unstarted(memory_mb))
        start(made[-1])
        return made[-1]

    yield new
    for one in made:
        one.close()
        assert set(one._selector.get_map()) <= {
            one.leaving.sentinel if one.leaving else -1
        }


def prepare(slot: Worker, wanted: Reserve, most: int = 1) -> None:
    """Have a slot prepared; it plays so many trials of the probe, if they are short."""
    slot.prepare(PrepareSlot(0, wanted, most=most))


def reserve(
    simulator: str = "minisim",
    representation: str = "fully-meshed",
    trial_memory_mb: int = 0,
) -> Reserve:
    return Reserve(
        nonce=bytes(16),
        epoch=0,
        slots=1,
        simulator=Part(simulator, {}),
        representation=Part(representation, {}),
        version_hash=version_hash(simulator, representation),
        trial_timeout_s=1.0,
        trial_memory_mb=trial_memory_mb,
    )


def start(slot: Worker) -> None:
    """Start a process and wait until it is here."""
    slot.start()
    assert not slot.here
    assert answer(slot) == Here(0)
    assert slot.here
    pid(slot)


def die(slot: Worker) -> None:
    os.kill(pid(slot), signal.SIGKILL)
    while not isinstance(answer(slot), Died):
        pass


def answer(of: Worker) -> FromSlot | None:
    """Return the next message that ends something; None if no process could be started."""
    while of.pipe is not None:
        message = of.receive()  # several messages may have come at once
        while isinstance(message, Preparing):
            message = of.receive()
        if message is not None:
            return message
        if of.pipe is None:
            break
        wanted = select.POLLIN | (select.POLLOUT if of.pipe.sending else 0)
        poll = select.poll()
        poll.register(of.pipe, wanted)
        assert poll.poll(ANSWER_S * 1000)
        of.pipe.flush()
    return None


# A machine's table has a row for each combination of 18 inputs.
TOO_LARGE = {("pettingzoo", "mealy")}


def pairs() -> Iterator[Any]:
    """Yield pairs of bundled parts: each part is in a fast pair, all others are marked long."""
    simulators, representations = (
        playable(plugins.BUNDLED["simulator"]),
        list(plugins.BUNDLED["representation"]),
    )
    for row, simulator in enumerate(simulators):
        for column, representation in enumerate(representations):
            if (simulator, representation) in TOO_LARGE:
                continue
            first = (
                row % len(representations) == column or column % len(simulators) == row
            )
            yield pytest.param(
                simulator, representation, marks=[] if first else pytest.mark.long
            )


def pid(of: Worker) -> int:
    """Return the process's id, which its parent may read only after the process reported."""
    assert of._process is not None
    end = time.monotonic() + ANSWER_S
    while of._process.pid is None:
        assert time.monotonic() < end
        time.sleep(0.001)
    return of._process.pid


def limit(of: Worker, name: str) -> str:
    lines = Path(f"/proc/{pid(of)}/limits").read_text().splitlines()
    return (
        next(line for line in lines if line.startswith(name))
        .removeprefix(name)
        .split()[0]
    )


@pytest.mark.parametrize(("simulator", "representation"), [*pairs()])
def test_bundled_parts_work_with_the_least_memory_that_may_be_asked_for(
    simulator: str, representation: str, new_worker: Callable[..., Worker]
) -> None:
    slot = new_worker()
    prepare(slot, reserve(simulator, representation, MIN_MEMORY_MB), PROBE_TRIALS)
    prepared = answer(slot)
    assert isinstance(prepared, Prepared), prepared
    assert len(prepared.probe) in range(PROBE_DIGEST, 65, PROBE_DIGEST)
    assert limit(slot, "Max data size") == str(MIN_MEMORY_MB << 20)
    assert limit(slot, "Max core file size") == "0"
    assert int(Path(f"/proc/{pid(slot)}/oom_score_adj").read_text()) >= 500
    network = build(simulator, {}, representation, {})[1]
    in_parallel = simulator == "emergency-exit" and network.step_lanes is not None
    genomes = network.random(3, Stream(1))
    participants, seeds = np.arange(3, dtype="<u4").tobytes(), bytes(24)
    batch = Evaluate(
        lease=bytes(16), batch=5, genomes=genomes, participants=participants, seeds=seeds
    )
    fitness, last = [], []
    for first, end in ((0, 3), (0, 1), (1, 2), (2, 3)):
        slot.run(RunChunk(0, codec.cut(batch, first, end), first))
        finished = answer(slot)
        assert isinstance(finished, Finished)
        assert isinstance(finished.reply, Outcomes)
        fitness.append(finished.reply.fitness)
        last.append(slot.trial())
    assert last == [0 if in_parallel else 2, 0, 0, 0], "counted in each chunk"
    assert len(fitness[0]) == 3 * 8
    assert b"".join(fitness[1:]) == fitness[0], (
        "a trial that is played alone decides the same"
    )


def test_a_process_gets_the_servers_memory_by_default(
    new_worker: Callable[..., Worker],
) -> None:
    slot = new_worker(700)
    prepare(slot, reserve())
    assert isinstance(answer(slot), Prepared)
    assert limit(slot, "Max data size") == str(700 << 20)


def test_a_process_refuses_code_that_changed_since_the_server_started(
    new_worker: Callable[..., Worker],
) -> None:
    slot = new_worker()
    prepare(slot, msgspec.structs.replace(reserve(), version_hash="0" * 32))
    refused = answer(slot)
    assert isinstance(refused, Unprepared)
    assert refused.reason.startswith(
        "files of minisim, fully-meshed or zswarm changed after the server was started; "
    )


def test_a_process_is_prepared_once(new_worker: Callable[..., Worker]) -> None:
    """Memory that one problem leaves allocated is not lost for the next."""
    slot = new_worker()
    prepare(slot, reserve())
    answer(slot)
    first = pid(slot)
    prepare(slot, reserve("emergency-exit"))
    if slot.leaving is not None:  # on a busy machine it takes a while to be gone
        multiprocessing.connection.wait([slot.leaving.sentinel], ANSWER_S)
        slot.look()
    assert (slot.pipe, slot.start_at) == (None, 0.0)
    start(slot)
    assert isinstance(answer(slot), Prepared)
    assert pid(slot) != first


def test_a_prepared_process_plays_further_trials_of_the_probe(
    new_worker: Callable[..., Worker],
) -> None:
    slot = new_worker()
    prepare(slot, reserve(), PROBE_TRIALS)
    whole = answer(slot)
    assert isinstance(whole, Prepared)
    first = pid(slot)
    slot.play_probe(PlayProbe(0, 0, 3))
    some = answer(slot)
    assert isinstance(some, Prepared)
    assert (some.first, some.loaded) == (0, True)
    assert len(some.probe) == 3 * PROBE_DIGEST
    assert whole.probe.startswith(some.probe)
    slot.play_probe(PlayProbe(0, 2, 2))
    later = answer(slot)
    assert isinstance(later, Prepared)
    assert later.first == 2
    assert later.probe[:PROBE_DIGEST] == some.probe[-PROBE_DIGEST:]
    assert pid(slot) == first


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (
            signal.SIGKILL,
            "was killed by signal 9 (SIGKILL; the machine may have run out of memory)",
        ),
        (signal.SIGSEGV, "was killed by signal 11 (SIGSEGV)"),
        (signal.SIGRTMIN + 3, f"was killed by signal {signal.SIGRTMIN + 3}"),
    ],
)
def test_the_reason_describes_how_a_process_ended(
    number: int, words: str, new_worker: Callable[..., Worker]
) -> None:
    slot = new_worker()
    os.kill(pid(slot), number)
    died = answer(slot)
    assert isinstance(died, Died)
    assert died.reason.partition("; it wrote")[0] == f"the slot's process {words}"


def test_a_process_that_keeps_dying_early_is_started_after_growing_pauses(
    new_worker: Callable[..., Worker],
) -> None:
    slot = new_worker()
    pauses = []
    for _ in range(12):
        die(slot)
        pauses.append(slot.start_at - time.monotonic())
        start(slot)
    assert pauses[0] <= 0.0, "the first time at once"
    assert sorted(pauses[:7]) == pauses[:7]
    assert LONGEST_PAUSE_S / 2 < pauses[-1] <= LONGEST_PAUSE_S
    prepare(slot, reserve())
    assert isinstance(answer(slot), Prepared)
    die(slot)
    assert slot.start_at <= time.monotonic(), "one that answered is replaced at once"


def test_a_message_waits_for_the_next_process_unless_that_is_killed(
    new_worker: Callable[..., Worker],
) -> None:
    slot = new_worker()
    die(slot)
    prepare(
        slot,
        msgspec.structs.replace(reserve(), simulator=Part("nothing-of-this-name", {})),
    )
    slot.kill()
    prepare(slot, reserve())
    start(slot)
    assert isinstance(answer(slot), Prepared)


def test_a_process_that_cannot_be_started_is_tried_again(
    new_worker: Callable[..., Worker], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reason is logged when it happens again."""
    slot, logged = new_worker(), list[tuple[str, str]]()
    slot.kill()
    with monkeypatch.context() as patch:
        patch.setattr(parent._context, "Process", Unborn)
        patch.setattr(
            parent.log,
            "warning",
            lambda event, **fields: logged.append((event, fields["reason"])),
        )
        for _ in range(2):
            slot.start()
            assert answer(slot) is None
            assert slot.missing_from(0.0) == math.inf
        ((event, reason),) = logged
        assert event == "slot_pauses"
        assert reason.startswith("could not be started: no more processes; ")
        assert slot.pipe is None
        assert slot.pauses(time.monotonic())
    start(slot)
    prepare(slot, reserve())
    assert isinstance(answer(slot), Prepared)


class Unborn:
    """A process where there is no room for one."""

    def __init__(self, **_: object) -> None:
        pass

    def start(self) -> None:
        raise BlockingIOError("no more processes")


def test_a_suspended_fork_server_does_not_block_the_loop(
    new_worker: Callable[..., Worker],
) -> None:
    """Its sentinel tells when a killed process is gone; a missing process is reported."""
    slot, fresh = new_worker(), unstarted()
    process = slot._process
    forking = multiprocessing.forkserver._forkserver._forkserver_pid  # type: ignore[attr-defined]  # private
    os.kill(forking, signal.SIGSTOP)
    os.waitid(os.P_PID, forking, os.WSTOPPED | os.WNOWAIT)
    try:
        begin = time.monotonic()
        slot.kill()
        fresh.start()
        prepare(fresh, reserve())
        assert time.monotonic() - begin < 2.0
        assert slot.leaving is process
        assert math.isinf(slot.start_at), "the one before it is not gone"
        slot.look()
        now = time.monotonic() + 60.0
        assert slot.missing_from(30.0) < now < slot.missing_from(90.0)
        assert fresh.missing_from(30.0) < now < fresh.missing_from(90.0)
        assert slot.missing_reason() == "its process was killed but has not exited"
        assert fresh.missing_reason() == "the fork server does not start its process"
    finally:
        os.kill(forking, signal.SIGCONT)
    assert slot.leaving is not None
    assert multiprocessing.connection.wait([slot.leaving.sentinel], ANSWER_S)
    slot.look()
    start(slot)
    assert answer(fresh) == Here(0)
    assert isinstance(answer(fresh), Prepared)
    assert slot.missing_from(30.0) == fresh.missing_from(30.0) == math.inf
    fresh.close()


def test_a_stopped_process_does_not_block_the_loop(
    new_worker: Callable[..., Worker],
) -> None:
    """Megabytes wait for it; its trial is timed only once it has them."""
    slot = new_worker()
    prepare(slot, reserve())
    assert isinstance(answer(slot), Prepared)
    (small,) = build("minisim", {}, "fully-meshed", {})[1].random(1, Stream(1))
    work = Evaluate(
        lease=bytes(16),
        batch=5,
        genomes=[small, bytes(2_000_000), bytes(2_000_000)],
        participants=np.zeros(1, "<u4").tobytes(),
        seeds=bytes(8),
    )
    os.kill(pid(slot), signal.SIGSTOP)
    slot.run(RunChunk(0, work))
    assert slot.trial() == -1, "it cannot have begun"
    assert slot._selector.get_key(slot.pipe).events & selectors.EVENT_WRITE
    slot.stop()
    assert slot.receive() is None
    os.kill(pid(slot), signal.SIGCONT)
    finished = answer(slot)
    assert isinstance(finished, Finished)
    assert slot.trial() == 0
    slot._on_pipe()
    slot.watch_pipe()
    assert slot._selector.get_key(slot.pipe).events == selectors.EVENT_READ


def test_answers_that_do_not_fit_into_the_pipe_wait(
    new_worker: Callable[..., Worker],
) -> None:
    """Another thread may give them; the loop sends on."""
    slot = new_worker()
    os.kill(pid(slot), signal.SIGSTOP)
    thread = threading.Thread(target=slot.answer, args=(bytes(2_000_000),))
    thread.start()
    thread.join(ANSWER_S)
    assert not thread.is_alive()
    assert slot._owner.full == [slot]
    slot.watch_pipe()
    assert slot._selector.get_key(slot.pipe).events & selectors.EVENT_WRITE


@pytest.mark.parametrize(
    ("stray", "words"),
    [
        (b"stray", "b'stray'... is not the beginning of a message"),
        (bytes(300_000), "is not the beginning of a message"),
    ],
)
def test_what_is_no_message_ends_the_process(
    stray: bytes, words: str, new_worker: Callable[..., Worker]
) -> None:
    slot = new_worker()
    before = pid(slot)
    assert slot.pipe is not None
    (number,) = (
        path.name
        for path in Path(f"/proc/{before}/fd").iterdir()
        if "socket" in str(path.readlink())
    )
    assert int(number) > 512, "nobody reaches it by counting"
    with socket.socket(fileno=borrowed(before, int(number))) as pipe:
        pipe.setblocking(False)
        pipe.send(stray)
    died = answer(slot)
    assert isinstance(died, Died)
    assert died.kind == "crashed"
    assert words in died.reason
    assert slot.pipe is None
    start(slot)
    assert pid(slot) != before


def borrowed(process: int, number: int) -> int:
    """Return a copy of a descriptor of another process."""
    opened = os.pidfd_open(process)
    try:
        # pidfd_getfd, which Python has not
        return ctypes.CDLL(None, use_errno=True).syscall(438, opened, number, 0)
    finally:
        os.close(opened)


def test_shared_memory_that_a_process_leaves_is_removed(
    new_worker: Callable[..., Worker],
) -> None:
    slot, other = new_worker(), SharedMemory(create=True, size=10)
    left = SharedMemory(create=True, size=10)
    name = f"/{left.name}"
    slot._take_shared_memory(child.SharedMemory(0, f"/{other.name}", exists=True))
    slot._take_shared_memory(child.SharedMemory(0, f"/{other.name}", exists=False))
    slot._take_shared_memory(child.SharedMemory(0, name, exists=True))
    slot.close()
    left.close()
    with pytest.raises(FileNotFoundError):
        SharedMemory(left.name)
    SharedMemory(other.name).close()
    other.close()
    other.unlink()


def test_a_process_killed_before_its_start_ends_on_its_own(
    new_worker: Callable[..., Worker],
) -> None:
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


def test_the_output_of_a_process_is_read_but_for_floods(
    new_worker: Callable[..., Worker],
) -> None:
    """Whole lines, the first twenty; the last one is told when it ends before it answered again."""
    slot = new_worker()

    def say(text: bytes) -> list[str]:
        with Path(f"/proc/{pid(slot)}/fd/1").open("wb") as said:
            said.write(text)
        return slot.read_output()

    assert say(b"one\n\ntwo, beg") == ["one"]
    assert say(b"un\n\xff\n") == ["two, begun", "\\xff"]
    assert say(b"".join(b"%d\n" % number for number in range(100))) == [
        *(str(number) for number in range(17)),
        "... further output is not logged",
    ]
    assert say(b"x" * 60_000 + b"\n") == []
    assert slot.read_output() == [], "there is nothing more to hear"
    assert say(b"last words") == []
    os.kill(pid(slot), signal.SIGKILL)
    died = answer(slot)
    assert isinstance(died, Died)
    assert died.reason.endswith("; it wrote: last words")


def test_last_words_are_kept_where_the_output_ends_before_the_pipe(
    new_worker: Callable[..., Worker],
) -> None:
    slot = new_worker()
    with Path(f"/proc/{pid(slot)}/fd/1").open("wb") as said:
        said.write(b"last words")
    os.kill(pid(slot), signal.SIGKILL)
    assert slot._process is not None
    slot._process.join(ANSWER_S)
    deadline = time.monotonic() + ANSWER_S
    while slot._output is not None and time.monotonic() < deadline:
        slot.read_output()
    assert slot._output is None
    died = answer(slot)
    assert isinstance(died, Died)
    assert died.reason.endswith("; it wrote: last words")


def test_a_slot_process_leads_its_session(
    new_worker: Callable[..., Worker],
) -> None:
    """The session identifies the processes that it starts, which end with it."""
    slot = new_worker()
    process = pid(slot)
    assert os.getsid(process) == slot.session == process
    slot.close()
    assert slot.session == 0
