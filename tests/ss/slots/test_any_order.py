"""Random requests and events of processes: every request gets one answer of the right type.

A seed decides everything, and replays a failure. The assertion's text has the last events.
"""

import random
from collections import Counter, deque
from typing import Any

import msgspec
import pytest

from zswarm.protocol import codec, messages
from zswarm.protocol.messages import (
    PROBE_DIGEST,
    PROBE_TRIALS,
    Done,
    Evaluate,
    Fault,
    Lease,
    Offer,
    Outcomes,
    Part,
    Refused,
    Reserve,
    Running,
)
from zswarm.ss.slots import events
from zswarm.ss.slots.table import SlotTable

SEEDS = 60
STEPS = 400
# With the codes of refusals.
ANSWERS: dict[
    type[messages.Request], tuple[tuple[type[messages.Reply], ...], set[str]]
] = {
    messages.Requirements: ((Offer,), set()),
    Reserve: ((Lease,), {"superseded", "busy", "draining", "mismatch"}),
    messages.Renew: ((Lease,), {"lease-lost"}),
    Evaluate: (
        (Outcomes, Running, Fault),
        {"lease-lost", "busy", "draining", "mismatch", "cancelled"},
    ),
    messages.Cancel: ((Done,), {"lease-lost"}),
    messages.Release: ((Done,), {"lease-lost"}),
}
TRIALS = 6  # in every batch
PROBE = bytes(range(PROBE_TRIALS * PROBE_DIGEST))
RUNS = [("ada", "one"), ("ada", "two"), ("bob", "one")]
UNKNOWN = b"no such lease..."
WORK: dict[str, Any] = {
    "genomes": [b""],
    "participants": bytes(4 * TRIALS),
    "seeds": b"".join(trial.to_bytes(8, "little") for trial in range(TRIALS)),
}


def outcomes(first: int, end: int) -> Outcomes:
    """Return the outcomes of trials, which are known by their fitness."""
    return Outcomes(
        batch=0,
        fitness=b"".join(bytes([trial] * 8) for trial in range(first, end)),
        metrics=b"",
        seconds=1.0,
    )


class Process:
    """Track what a slot's process does, by the commands it got."""

    def __init__(self) -> None:
        self.does = ""  # "prepare", "play" the probe, "evaluate", or nothing
        self.probe = 0, 0  # the first trial of the probe that it plays, and how many
        self.prepared = ""  # the problem
        self.recycled = False
        self.trials = range(0)  # of its chunk

    def end(self) -> None:
        self.does, self.prepared, self.recycled = "", "", False


class Server:
    """The slot table, and what happens to it."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.now, self.queries, self.drained = 0.0, 0, False
        self.open: dict[int, messages.Request] = {}
        self.tokens = [UNKNOWN]
        self.trial = 0
        self.seen: Counter[str] = Counter()
        self.trace: deque[str] = deque(maxlen=30)
        capacity = self.random.randint(1, 3)
        self.processes = [Process() for _ in range(capacity)]
        offer = Offer(
            server="s",
            program="",
            machine="",
            capacity=capacity,
            free=0,
            leases=0,
            simulators=[],
            representations=[],
        )
        self.slots = SlotTable(capacity, offer, self._mismatch, self._token)

    def _mismatch(self, asked: messages.Requirements | Reserve) -> str:
        return (
            "not here"
            if isinstance(asked, Reserve) and asked.simulator.kind == "unknown"
            else ""
        )

    def _token(self) -> bytes:
        self.tokens.append(f"{len(self.tokens):16}".encode())
        return self.tokens[-1]

    def feed(self, event: events.Event) -> None:
        self.trace.append(f"{self.now:8.2f} {event}"[:300])
        for command in self.slots.handle(event, self.now):
            self.seen[type(command).__name__] += 1
            match command:
                case events.Answer():
                    self._answered(
                        self.open.pop(command.query), codec.decode_reply(command.body)
                    )
                case events.PrepareSlot():
                    process = self.processes[command.slot]
                    assert not process.does, "a slot that works is prepared"
                    assert not process.recycled, "a recycled process is prepared"
                    process.does, process.prepared = "prepare", ""
                    process.probe = command.first, command.most
                case events.PlayProbe():
                    process = self.processes[command.slot]
                    assert process.prepared, "a slot that is not prepared plays the probe"
                    assert not process.recycled, "a recycled process plays the probe"
                    assert not process.does, "a slot that works plays the probe"
                    process.does, process.probe = "play", (command.first, command.count)
                case events.RunChunk():
                    process = self.processes[command.slot]
                    assert process.prepared, (
                        "a slot that is not prepared is given a batch"
                    )
                    assert not process.recycled, "a recycled process is given a batch"
                    assert not process.does, "a slot that works is given a batch"
                    seeds = codec.array(command.work.seeds, "<u8").tolist()
                    process.does = "evaluate"
                    process.trials = range(seeds[0], seeds[-1] + 1)
                    assert [*process.trials] == seeds
                    assert command.first == seeds[0]
                case events.KillSlot():
                    self.processes[command.slot].end()
                case events.Drained():
                    self.drained = True
                    assert not self.open, "it drained with queries unanswered"

    def _answered(self, request: messages.Request, reply: messages.Reply) -> None:
        kinds, codes = ANSWERS[type(request)]
        assert isinstance(reply, kinds) or (
            isinstance(reply, Refused) and reply.code in codes
        ), f"{reply} to {request}"
        self.seen[reply.code if isinstance(reply, Refused) else type(reply).__name__] += 1
        if isinstance(reply, Outcomes | Running | Fault):
            told = codec.array(reply.trials, "<u4").tolist() or (
                [*range(TRIALS)] if isinstance(reply, Outcomes) else []
            )
            right = b"".join(outcomes(trial, trial + 1).fitness for trial in told)
            assert reply.fitness == right, (
                "a trial's outcome is missing, twice or at a wrong place"
            )
            self.seen["told early"] += isinstance(reply, Running) and bool(told)

    def ask(self, who: tuple[str, str], message: messages.Request) -> None:
        self.queries += 1
        self.open[self.queries] = message
        self.feed(events.Asked(self.queries, *who, message))

    # ---- what may happen

    def step(self) -> None:
        steps = {
            self.reserve: 6,
            self.evaluate: 12,
            self.ask_of_a_lease: 3,
            self.process_tells: 16,
            self.time_passes: 6,
            self.token_of_a_run: 1,
        }
        self.random.choices([*steps], [*steps.values()])[0]()

    def reserve(self) -> None:
        draw = self.random.choice
        message = Reserve(
            nonce=bytes([draw([0, 0, 0, 1])] * 16),
            epoch=draw([0] * 9 + [1, 2]),
            proof=draw([b"", b"ours", b"ours", b"ours", b"theirs"]),
            slots=draw([1, 2, 100]),
            simulator=Part(draw(["a", "a", "a", "b", "unknown"]), {}),
            representation=Part("n", {}),
            version_hash="",
            trial_timeout_s=5.0,
            trial_memory_mb=draw([0, 0, 0, 512]),
        )
        self.ask(draw(RUNS), message)

    def evaluate(self) -> None:
        """Ask for trials as a well-behaved run does; some ids come again."""
        if self.slots.leases:
            held = self.random.choice([*self.slots.leases.values()])
            batch = self.random.choice(
                [self.queries, self.queries, max(0, self.queries - 3)]
            )
            self.ask(
                (held.user, held.run), Evaluate(lease=held.token, batch=batch, **WORK)
            )

    def ask_of_a_lease(self) -> None:
        """Send a request about a present, past, foreign or unknown lease."""
        by_token = {held.token: held for held in self.slots.leases.values()}
        lease = self.random.choice([UNKNOWN, *self.tokens[-3:], *by_token, *by_token])
        held = by_token.get(lease)
        who = (
            (held.user, held.run)
            if held is not None and self.random.random() < 0.8
            else self.random.choice(RUNS)
        )
        batches = [
            self.random.randint(max(0, self.queries - 6), self.queries) for _ in range(3)
        ]
        message: messages.Request = self.random.choice(
            [
                messages.Requirements(),
                Evaluate(lease=lease, batch=batches[0], **WORK),
                *[messages.Renew(lease=lease, known_ready=self.random.randint(-1, 3))]
                * 2,
                *[messages.Cancel(lease=lease, batches=batches)] * 2,
                messages.Release(lease=lease),
            ]
        )
        self.ask(who, message)

    def token_of_a_run(self) -> None:
        who = self.random.choice(RUNS)
        self.feed(events.HolderAlive(*who, self.random.choice([True, False])))

    def process_tells(self) -> None:
        """One that works, most times; any may die."""
        working = [slot for slot, process in enumerate(self.processes) if process.does]
        slot = self.random.choice(working or range(len(self.processes)))
        if self.random.random() < 0.02:
            slot = self.random.randrange(len(self.processes))
        process = self.processes[slot]
        does, process.does = process.does, ""
        how = self.random.choices(
            ["well", "recycled", "spoiled", "exhausted", "badly", "dies", "memory"],
            [60, 10, 10, 20, 1, 3, 3],
        )[0]
        if how in ("dies", "memory") and (does or self.random.random() < 0.1):
            process.end()
            self.feed(
                events.Died(
                    slot,
                    1,
                    "it ended",
                    "memory" if how == "memory" and does else "crashed",
                )
            )
        elif does == "prepare" and how == "badly":
            self.feed(events.Unprepared(slot, "it does not fit"))
        elif does == "prepare" and how == "recycled":
            process.does = does
            compiling = self.random.choice([0, 0, 5])
            self.feed(events.Preparing(slot, compiling, PROBE_TRIALS))
        elif does in ("prepare", "play"):
            process.prepared = "a problem"
            first, count = process.probe
            if does == "prepare":
                count = self.random.choice([1, count])
            digest = PROBE[8 * first : 8 * (first + count)]
            trial_s = self.random.choice([0.01, 1.0, 5.0, 15.0])
            self.feed(events.Prepared(slot, digest, trial_s, first, does == "play"))
        elif does == "evaluate" and how == "exhausted":
            process.recycled = True
            self.feed(events.Exhausted(slot, self.random.randrange(len(process.trials))))
            self.seen["exhausted"] += 1
        elif does == "evaluate" and how == "spoiled":
            process.recycled, first = True, process.trials.start
            end = first + self.random.randint(1, len(process.trials))
            ended = codec.indices(range(end - first))
            reply = msgspec.structs.replace(outcomes(first, end), trials=ended, left="x")
            self.feed(events.Finished(slot, reply))
        elif does == "evaluate":
            process.recycled, trials = how == "recycled", process.trials
            reply = outcomes(trials.start, trials.stop)
            self.feed(events.Finished(slot, reply, recycle=process.recycled))

    def time_passes(self) -> None:
        """Mostly as the clock ticks; sometimes the server stood still, or a trial hangs."""
        self.trial = self.random.randrange(TRIALS)
        for _ in range(self.random.choices([1, 4], [8, 2])[0]):
            self.tick(self.random.choices([0.25, 1.5, 31.0, 70.0], [60, 20, 1, 1])[0])

    def tick(self, seconds: float) -> None:
        self.now += seconds
        if not self.drained:
            self.feed(events.Tick((self.trial,) * len(self.processes)))

    # ---- what always holds

    def check(self) -> None:
        held = [slot for lease in self.slots.leases.values() for slot in lease.slots]
        assert len(held) == len(set(held)), "a slot belongs to two leases"
        for slot, process in zip(self.slots.slots, self.processes, strict=True):
            assert (slot in held) == (slot.state not in ("free", "stopping"))
            works = slot.state in ("busy", "preparing", "stopping")
            assert works == bool(process.does), (
                f"slot {slot.index} is {slot.state}, its process does {process.does!r}"
            )
            assert slot.state not in ("ready", "busy") or process.prepared
            assert process.prepared or slot.prepared_for is None or process.does, (
                "a fresh process is taken for prepared"
            )
        table = self.slots.leases
        rights, shares = table.sharing.shares(
            table.values(), len(self.slots.slots), self.now
        )
        anew = msgspec.structs.replace(table.sharing, _rights=None).shares(
            table.values(), len(self.slots.slots), self.now
        )
        assert [list(each.items()) for each in (rights, shares)] == [
            list(each.items()) for each in anew
        ], "rights are remembered that do not hold any more"
        for lease, right in rights.items():
            assert not lease.lent or lease.lent + len(lease.slots) <= right, (
                "more is lent than the lease has a right to"
            )
        if self.slots.free() and not self.slots.draining:
            short = [lease for lease, share in shares.items() if len(lease.slots) < share]
            assert not short, "a slot is free, and a run has less than its share"
        replies = self.slots.leases.replies
        assert {lease for lease, _ in replies} <= {
            lease.token for lease in self.slots.leases.values()
        }
        assert bool(replies.size) == bool(replies)
        for lease in self.slots.leases.values():
            queue = lease.jobs
            idle = any(slot.state == "ready" for slot in lease.slots)
            known = lease.probe is not None
            assert not (known and idle and queue.waiting), (
                "a batch waits while a slot is ready"
            )
            assert known or not lease.slots or not idle or lease.playing(), (
                "slots are ready, and nobody plays the probe"
            )
            assert not known or PROBE.startswith(lease.probe.digest), "of other trials"
            assert not lease.slots or any(
                slot.state != "assigned" for slot in lease.slots
            ), "no slot is prepared"
            waiting = {job for job in queue.jobs.values() if job.waiting}
            assert (set(queue.waiting), len(queue.waiting)) == (waiting, len(waiting)), (
                "trials wait and are not handed out"
            )
            chunks = [slot.chunk for slot in lease.slots if slot.chunk is not None]
            for job in queue.jobs.values():
                assert job.running == sum(chunk.job is job for chunk in chunks)
                assert job.running or job in queue.waiting, "a batch is forgotten"
        held_batches = [
            batch
            for lease in self.slots.leases.values()
            for batch in lease.jobs.jobs.values()
        ]
        renewals = {
            renewal.query
            for lease in self.slots.leases.values()
            for renewal in lease.renewals
        }
        assert set(self.open) <= {batch.query for batch in held_batches} | renewals, (
            "a query is forgotten"
        )


def play(seed: int) -> Server:
    server = Server(seed)
    try:
        for _ in range(STEPS):
            server.step()
            server.check()
        if seed % 2:
            server.feed(events.Drain())
            for _ in range(100):
                if not server.drained:
                    server.step()
        for _ in range(300):
            server.tick(1.5)
        if not server.drained:
            assert not server.open, "a query was never answered"
            assert not server.slots.busy(), "a lease or a slot leaks"
            assert not server.slots.leases.replies.size
        assert server.drained or not seed % 2
    except (AssertionError, KeyError) as error:
        raise AssertionError(
            f"seed {seed}: {error!r}; what happened last:\n" + "\n".join(server.trace)
        ) from error
    return server


@pytest.mark.long
def test_requests_in_any_order_are_answered_once_and_nothing_leaks() -> None:
    seen = sum((play(seed).seen for seed in range(SEEDS)), Counter())
    every = {
        "Outcomes",
        "Running",
        "Fault",
        "Lease",
        "Offer",
        "Done",
        "superseded",
        "lease-lost",
        "busy",
        "mismatch",
        "cancelled",
        "draining",
    }
    assert {what for what in every if not seen[what]} == set(), "too little happens"
    assert seen["exhausted"] > 100
    assert seen["told early"] > 20
