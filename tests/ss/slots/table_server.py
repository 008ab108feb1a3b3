"""Drive a slot table with a clock, for tests that feed events and compare commands."""

import itertools
from typing import TypeVar

from zswarm.protocol import codec
from zswarm.protocol.messages import (
    PROBE_DIGEST,
    PROBE_TRIALS,
    Evaluate,
    Lease,
    Offer,
    Outcomes,
    Part,
    Refused,
    Reply,
    Request,
    Reserve,
)
from zswarm.ss.slots.events import (
    Answer,
    Asked,
    Event,
    Finished,
    Log,
    Prepared,
    RunChunk,
    Tick,
)
from zswarm.ss.slots.table import SlotTable

T = TypeVar("T")
OFFER = Offer(
    server="ss",
    program="0",
    machine="m",
    capacity=2,
    free=0,
    leases=0,
    simulators=[],
    representations=[],
)
PROBE = bytes(range(PROBE_TRIALS * PROBE_DIGEST))
TIMEOUT_S = 10.0  # of a trial


class Server:
    """A slot table with a clock that collects answers to queries and commands for slots."""

    def __init__(self, capacity: int = 2, mismatch: str = "") -> None:
        tokens = itertools.count(1)
        self.slots = SlotTable(
            capacity, OFFER, lambda _: mismatch, lambda: next(tokens).to_bytes(16, "big")
        )
        self.now = 100.0
        self.commands: list[object] = []  # of the last event, without answers and logs
        self.answers: dict[int, Reply] = {}
        self.queries = itertools.count(1)
        self.open: set[int] = set()
        self.trials = [0] * capacity

    def feed(self, event: Event) -> list[object]:
        """Feed an event; return the commands for slots."""
        self.commands = []
        for command in self.slots.handle(event, self.now):
            if isinstance(command, Answer):
                assert command.query in self.open, "nobody waits for this answer"
                self.open.remove(command.query)
                self.answers[command.query] = codec.decode_reply(command.body)
            elif not isinstance(command, Log):
                self.commands.append(command)
        return self.commands

    def ask(self, message: Request, run: str = "a") -> int:
        """Send a request; return the number of the query."""
        query = next(self.queries)
        self.open.add(query)
        self.feed(Asked(query, "user", run, message))
        return query

    def asked(self, message: Request, run: str = "a") -> Reply:
        """Send a request; return the immediate answer."""
        return self.answers[self.ask(message, run)]

    def answer(self, query: int, kind: type[T]) -> T:
        """Return the answer to a query, which must be of this kind."""
        answer = self.answers[query]
        assert isinstance(answer, kind)
        return answer

    def reserve(self, run: str = "a", **fields: object) -> Lease:
        return self.answer(self.ask(reserve(**fields), run), Lease)

    def ready(self, run: str = "a", trial_s: float = 0.5, **fields: object) -> bytes:
        """Return the token of a lease whose slots are all prepared."""
        lease = self.reserve(run, **fields)
        for slot in self.slots.leases["user", run].slots:
            if slot.state == "preparing":
                self.feed(Prepared(slot.index, PROBE, trial_s))
        return lease.lease

    def evaluate(self, lease: bytes, *batches: int, run: str = "a") -> list[int]:
        return [self.ask(evaluate(lease, batch), run) for batch in batches]

    def finish(self, slot: int, batch: int) -> list[object]:
        return self.feed(Finished(slot, outcomes(batch)))

    def wait(self, seconds: float, every: float = 0.25) -> list[object]:
        """Let time pass, with ticks; return the commands of all of them."""
        commands: list[object] = []
        for _ in range(round(seconds / every)):
            self.now += every
            commands += self.feed(Tick(tuple(self.trials)))
        return commands

    def states(self) -> list[str]:
        return [slot.state for slot in self.slots.slots]


def running_one(trials: int = 1) -> tuple[Server, bytes, int]:
    """Return a server of one slot that runs batch 1 of a lease, the lease and the query."""
    server = Server(1)
    lease = server.ready()
    return server, lease, server.ask(evaluate(lease, 1, trials))


def reserve(
    nonce: int = 1,
    epoch: int = 0,
    slots: int = 100,
    simulator: str = "minisim",
    memory_mb: int = 0,
    proof: bytes = b"",
) -> Reserve:
    return Reserve(
        nonce=nonce.to_bytes(16, "big"),
        epoch=epoch,
        slots=slots,
        simulator=Part(simulator, {}),
        representation=Part("fully-meshed", {}),
        version_hash="",
        trial_timeout_s=TIMEOUT_S,
        trial_memory_mb=memory_mb,
        proof=proof,
    )


def evaluate(lease: bytes, batch: int, trials: int = 1) -> Evaluate:
    """Return a batch in which every trial has its own genome."""
    numbers = range(trials)
    return Evaluate(
        lease=lease,
        batch=batch,
        genomes=[b"%d" % number for number in numbers],
        participants=codec.indices(numbers),
        seeds=b"".join(number.to_bytes(8, "little") for number in numbers),
    )


def run(
    slot: int, lease: bytes, batch: int, first: int = 0, end: int = 1, of: int = 1
) -> RunChunk:
    """Return the command to run some trials of a batch."""
    return RunChunk(slot, codec.cut(evaluate(lease, batch, of), first, end), first)


def seeds(commands: list[object]) -> list[tuple[int, list[int]]]:
    """Return the chunks that slots get: slot, and the seeds of the trials."""
    chunks = [command for command in commands if isinstance(command, RunChunk)]
    return [
        (chunk.slot, codec.array(chunk.work.seeds, "<u8").tolist()) for chunk in chunks
    ]


def outcomes(batch: int) -> Outcomes:
    return Outcomes(batch=batch, fitness=b"\0" * 8, metrics=b"", seconds=0.5)


def code(answer: object) -> str:
    return answer.code if isinstance(answer, Refused) else f"no refusal: {answer}"


def some(first: int, end: int) -> Outcomes:
    """Return outcomes of some trials of batch 1, which took a second each; trial 2 raised."""
    return Outcomes(
        batch=1,
        fitness=bytes(range(first, end)),
        metrics=bytes(range(end, first, -1)),
        seconds=float(end - first),
        error="no way" if first <= 2 < end else "",
    )


def played(first: int, end: int, *, trial_s: float = 0.5) -> Outcomes:
    """Return outcomes of these trials: fitness is the trial's number, and no metrics."""
    fitness = bytes(number % 256 for number in range(first, end))
    return Outcomes(
        batch=1, fitness=fitness, metrics=b"", seconds=trial_s * (end - first)
    )
