"""Both state machines together: real ``Dispatch`` and real ``Slots`` on a simulated network that fails in every way it can.

A seed decides everything. One that fails is replayed by its number, with what happened last in the assertion's text::

    pytest "tests/test_machines_together.py::test_whatever_fails_every_trial_is_counted_once_and_nothing_leaks[17]"
"""

import copy
import hashlib
import heapq
import itertools
import random
from collections import deque
from collections.abc import Callable

import numpy as np
import pytest

from zswarm.ot import dispatch
from zswarm.ot.dispatch import Dispatch, Workload
from zswarm.protocol import codec, messages
from zswarm.ss import slots
from zswarm.ss.slots import Slots, SlotState

SEEDS = 200
EVENTS = 3000  # in a second; more is a loop without delay
CHAOS_S = 60.0  # failures end then
CALM_S = 150.0  # then the last link is back
END_S = 3000.0  # by then all is done
QUERY_S = {"offer": 3.0, "reserve": 10.0, "renew": 25.0, "evaluate": 60.0, "cancel": 3.0, "release": 3.0}
TRIAL_TIMEOUT_S = 20.0
PROBE, WRONG_PROBE = b"p" * 16, b"w" * 16
GENOMES, SEEDS_PER_GENOME = 8, 5
DEATHS = 2  # of a worker by chance at one trial: one fewer than would put it in quarantine

Trial = tuple[bytes, int]  # genome and seed


def outcome(trial: Trial) -> float:
    """What the simulated problem says: a pure function of genome and seed, sometimes NaN."""
    number = hashlib.blake2b(trial[0] + trial[1].to_bytes(8, "little"), digest_size=4).digest()
    return float("nan") if number[0] == 0 else int.from_bytes(number, "little") / 2**16


def poisonous(trial: Trial) -> bool:
    """Whether a trial ends every process that plays it."""
    return outcome(trial) % 1.0 < 0.02


class World:
    """The time, what happens when, and who takes part."""

    def __init__(self, seed: int) -> None:
        self.seed, self.random, self.now = seed, random.Random(seed), 0.0
        self.servers: list[Server] = []
        self.optimizers: list[Optimizer] = []
        self.deaths: dict[Trial, int] = {}
        self.trace: deque[str] = deque(maxlen=60)
        self.failing = self.random.choice([0.0, 0.002, 0.02])  # share of messages that get no answer, and of trials that die
        self._queue: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()

    def at(self, delay: float, call: Callable[[], None]) -> None:
        heapq.heappush(self._queue, (self.now + delay, next(self._order), call))

    def soon(self, call: Callable[[], None]) -> None:
        """After the way through the network; a later message may overtake."""
        self.at(self.random.uniform(0.0001, 0.02), call)

    def chance(self, share: float) -> bool:
        return self.now < CHAOS_S and self.random.random() < share

    def check(self, holds: bool, text: str) -> None:
        if not holds:
            raise AssertionError(f"seed {self.seed}, {self.now:.3f} s: {text}; what happened last:\n" + "\n".join(self.trace))

    def tell(self, *words: object) -> None:
        self.trace.append(f"{self.now:9.4f} " + " ".join(str(word)[:150] for word in words))

    def run(self, until: float, done: Callable[[], bool] = lambda: False) -> None:
        second, events = 0, 0
        while self._queue and self._queue[0][0] <= until and not done():
            self.now, _, call = heapq.heappop(self._queue)
            call()
            events = events + 1 if second == int(self.now) else 0
            second = int(self.now)
            self.check(events < EVENTS, "a loop without delay")


class Server:
    """A server: the real slot table, and workers and links that fail."""

    names = itertools.count()

    def __init__(self, world: World) -> None:
        self.world, self.id = world, f"ss-{next(self.names)}"
        self.link, self.breaks, self.ended = "up", 0, False
        capacity = world.random.randint(1, 3)
        offer = messages.Offer(
            server=self.id, program="", machine="", capacity=capacity, free=0, leases=0, simulators=[], representations=[]
        )
        tokens = itertools.count()
        self.slots = Slots(capacity, offer, lambda _: "", lambda: f"{self.id[-8:]:8}{next(tokens):8}".encode())
        self.wrong = world.random.random() < 0.05  # computes other numbers
        self.broken = world.random.random() < 0.05  # cannot be prepared
        self.trial_s = world.random.choice([0.001, 0.03, 0.2, 0.8, 16.0])
        self.workers = [Worker(self, index) for index in range(capacity)]
        self.pending: dict[int, tuple[Optimizer, int]] = {}
        self.prepare_deaths = 0
        self._queries = itertools.count()
        world.servers.append(self)
        self._tick()
        for optimizer in world.optimizers:
            self.meet(optimizer)

    def good(self) -> bool:
        return not (self.ended or self.wrong or self.broken or self.slots.draining)

    def meet(self, optimizer: "Optimizer") -> None:
        """Each sees the other's token."""
        self.world.soon(lambda: optimizer.handle(dispatch.Seen(self.id)))
        self.world.soon(lambda: self.handle(slots.HolderSeen("user", optimizer.run)))

    def _tick(self) -> None:
        if not self.ended:
            if self.slots.busy() or self.slots.draining:
                self.handle(slots.Tick(tuple(worker.progress() for worker in self.workers)))
            self.world.at(0.25, self._tick)

    def receive(self, optimizer: "Optimizer", question: int, message: messages.Request, breaks: int) -> None:
        if self.ended or breaks != self.breaks:
            return  # it was lost with the link
        query = next(self._queries)
        self.pending[query] = (optimizer, question)
        self.handle(slots.Asked(query, "user", optimizer.run, message, codec.encode(message)))

    def handle(self, event: slots.Event) -> None:
        if self.ended:
            return
        world = self.world
        if not isinstance(event, slots.Tick):
            world.tell(self.id, getattr(event, "message", event))
        for command in self.slots.handle(event, world.now):
            match command:
                case slots.Answer():
                    world.check(command.query in self.pending, f"{self.id} answers a query twice")
                    self._answer(*self.pending.pop(command.query), command.body)
                case slots.Prepare():
                    self.workers[command.slot].prepare(command.probe)
                case slots.Run():
                    self.workers[command.slot].evaluate(command.body)
                case slots.Stop():
                    self.workers[command.slot].stop()
                case slots.Kill():
                    self.workers[command.slot].restart()
                case slots.Drained():
                    world.check(not self.pending, f"{self.id} drained with queries unanswered")
                    self.ended = True
                    world.at(0.1, lambda: self.set_link("down"))
        self._check()

    def _check(self) -> None:
        held = [slot for lease in self.slots.leases.values() for slot in lease.slots]
        self.world.check(len(held) == len(set(held)), f"{self.id}: a slot belongs to two leases")
        for slot, worker in zip(self.slots.slots, self.workers, strict=True):
            free = slot.state in (SlotState.FREE, SlotState.STOPPING)
            self.world.check((slot in held) != free, f"{self.id}: slot {slot.index} is {slot.state} with a wrong lease")
            works = slot.state in (SlotState.BUSY, SlotState.PREPARING, SlotState.STOPPING)
            self.world.check(works == (worker.since is not None), f"{self.id}: slot {slot.index} is {slot.state}, its worker not")

    def _answer(self, optimizer: "Optimizer", question: int, body: bytes) -> None:
        world, breaks = self.world, self.breaks
        reply: messages.Reply | str | None = codec.decode_reply(body)
        if world.chance(world.failing):
            reply = world.random.choice([None, "not a message"])

        def arrive() -> None:
            if breaks == self.breaks:
                optimizer.answer(question, reply)

        world.soon(arrive)
        if world.chance(world.failing):
            world.at(1.0, lambda: optimizer.handle(dispatch.Answered(question, reply)))  # once more

    def set_link(self, link: str) -> None:
        """Break or mend the link; what is on the way is lost.

        Queries end empty while it is *down* or *mute*, and by their timeout while it is *deaf*; the optimizers notice the
        first by the token, the server the first and the last.
        """
        world = self.world
        world.tell(self.id, "link is", link)
        self.link, self.breaks = link, self.breaks + 1
        for optimizer in world.optimizers:
            if link == "up" and not self.ended:
                self.meet(optimizer)
                continue
            if link in ("down", "deaf"):
                world.soon(lambda optimizer=optimizer: self.handle(slots.HolderGone("user", optimizer.run)))
            if link == "down":
                world.soon(lambda optimizer=optimizer: optimizer.handle(dispatch.Gone(self.id)))
            if link in ("down", "mute"):
                for question in [question for question, server in optimizer.open.items() if server is self]:
                    delay = world.random.choice([0.001, 0.01, 5.0])
                    world.at(delay, lambda optimizer=optimizer, question=question: optimizer.answer(question, None))

    def end(self) -> None:
        """It crashes or is killed."""
        self.ended = True
        self.set_link("down")

    def drain(self) -> None:
        self.handle(slots.Drain())
        for optimizer in self.world.optimizers:
            self.world.soon(lambda optimizer=optimizer: optimizer.handle(dispatch.Gone(self.id)))


class Worker:
    """The process of a slot."""

    def __init__(self, server: Server, index: int) -> None:
        self.server, self.index = server, index
        self.life = 0  # what was to come from an earlier life does not
        self.since: float | None = None  # it works since then
        self.trials: list[Trial] = []
        self.trial_s = 1.0

    def restart(self) -> None:
        self.life, self.since = self.life + 1, None

    def _later(self, delay: float, event: Callable[[], slots.Event]) -> None:
        life = self.life

        def happen() -> None:
            if life == self.life:
                self.restart()
                self.server.handle(event())

        self.server.world.at(delay, happen)

    def prepare(self, probe: bool) -> None:
        server = self.server
        server.world.check(self.since is None, f"{server.id}: a slot that works is prepared")
        self.since, self.trials = server.world.now, []
        delay = server.world.random.uniform(0.05, 3.0)
        if server.broken:
            self._later(delay, lambda: slots.Unprepared(self.index, "broken"))
        elif server.prepare_deaths < DEATHS and server.world.chance(0.05):
            server.prepare_deaths += 1
            self._later(delay, lambda: slots.Died(self.index, 0, "while it was prepared"))
        else:
            digest = (WRONG_PROBE if server.wrong else PROBE) if probe else b""
            self._later(delay, lambda: slots.Prepared(self.index, digest, server.trial_s))

    def evaluate(self, body: bytes) -> None:
        server, world = self.server, self.server.world
        batch = codec.decode_request(body)
        assert isinstance(batch, messages.Evaluate)
        world.check(self.since is None, f"{server.id}: a slot that works is given a batch")
        participants, seeds = codec.trials(batch, 1)
        self.since, self.trial_s = world.now, server.trial_s
        self.trials = [(batch.genomes[i], int(seed)) for i, seed in zip(participants[:, 0], seeds, strict=True)]
        for index, trial in enumerate(self.trials):
            if poisonous(trial) or self._dies_at(trial):
                if world.random.random() < 0.3:
                    self.trials = self.trials[: index + 1]  # it hangs there, until it is killed
                else:
                    self._later(index * self.trial_s, lambda index=index: slots.Died(self.index, index, "crash"))
                return
        fitness = np.array([outcome(trial) + server.wrong for trial in self.trials])
        seconds = len(self.trials) * self.trial_s
        reply = messages.Outcomes(batch=batch.batch, fitness=fitness.tobytes(), metrics=fitness.tobytes(), seconds=seconds)
        self._later(seconds, lambda: slots.Finished(self.index, codec.encode(reply)))

    def _dies_at(self, trial: Trial) -> bool:
        """By chance, but not so often that the trial is taken for poisonous."""
        deaths = self.server.world.deaths
        if deaths.get(trial, 0) == DEATHS or not self.server.world.chance(self.server.world.failing):
            return False
        deaths[trial] = deaths.get(trial, 0) + 1
        return True

    def stop(self) -> None:
        """The present trial ends; one in three times it takes too long."""
        if self.since is not None and self.server.world.random.random() < 0.7:
            self._later(self.trial_s, lambda: slots.Finished(self.index, codec.encode(messages.Done())))

    def progress(self) -> int:
        if self.since is None or not self.trials:
            return 0
        return min(int((self.server.world.now - self.since) / self.trial_s), len(self.trials) - 1)


class Optimizer:
    """An optimizer: the real dispatch, and two workloads to be evaluated one right after the other."""

    def __init__(self, world: World, run: str, epoch: int = 0, workloads: list[Workload] | None = None) -> None:
        self.world, self.run, self.epoch = world, run, epoch
        self.nonce = world.random.randbytes(16)
        self.dispatch = Dispatch(1, 1, wanted_slots=world.random.choice([1, 2, 100]), quarantine=True, probe=PROBE)
        self.open: dict[int, Server] = {}
        self.workloads = workloads if workloads is not None else [self._workload() for _ in range(2)]
        self.counted = [workload.counted.copy() for workload in self.workloads]
        self.current, self.ended, self.left, self.taken_over = 0, False, False, False
        self._wake = float("inf")
        world.optimizers.append(self)
        for server in world.servers:
            if server.link == "up" and not server.ended:
                server.meet(self)
        world.soon(lambda: self.handle(dispatch.Work(self.workloads[0])))

    def _workload(self) -> Workload:
        genomes = [self.world.random.randbytes(8) for _ in range(GENOMES)]
        seeds = np.array([self.world.random.getrandbits(64) for _ in range(SEEDS_PER_GENOME)], np.uint64)
        return Workload(
            genomes, np.repeat(np.arange(GENOMES), SEEDS_PER_GENOME).reshape(-1, 1), np.tile(seeds, GENOMES), metrics=1
        )

    def handle(self, event: dispatch.Event) -> None:
        if self.ended:
            return
        world = self.world
        if not isinstance(event, dispatch.Tick):
            world.tell(self.run, event)
        for command in self.dispatch.handle(event, world.now):
            match command:
                case dispatch.Ask():
                    self._ask(command)
                case dispatch.Counted():
                    counted = self.counted[self.current]
                    world.check(not counted[command.trials].any(), "a trial was counted twice")
                    counted[command.trials] = True
                case dispatch.Complete():
                    self._next_workload()
                case dispatch.Failed():
                    world.check("taken over" in command.reason and self.taken_over, f"{self.run} failed: {command.reason}")
                    self.end()
        self._check()
        if self.dispatch.next_time() < self._wake:
            self._wake = self.dispatch.next_time()
            world.at(max(0.0, self._wake - world.now), self._tick)

    def _tick(self) -> None:
        self._wake = float("inf")
        self.handle(dispatch.Tick())

    def _next_workload(self) -> None:
        self.current += 1
        if self.current < len(self.workloads):
            self.world.at(0.0, lambda: self.handle(dispatch.Work(self.workloads[self.current])))
        else:
            self.world.at(0.0, self.leave)

    def leave(self) -> None:
        self.handle(dispatch.Leave())
        self.left = True
        self.world.at(0.1, self.end)

    def end(self) -> None:
        """It ends or crashes; its tokens vanish."""
        self.ended = True
        self.world.tell(self.run, "ended")
        for server in self.world.servers:
            self.world.soon(lambda server=server: server.handle(slots.HolderGone("user", self.run)))

    def resume(self) -> None:
        """Another one goes on with what is recorded, whether this one ended or not."""
        self.taken_over = True
        for workload, counted in zip(self.workloads, self.counted, strict=True):
            self.world.check(np.array_equal(workload.counted, counted), "the workload's record is not what was counted")
        Optimizer(self.world, self.run, self.epoch + 1, copy.deepcopy(self.workloads))

    def _check(self) -> None:
        """Every trial is in one place."""
        state = self.dispatch
        if state._workload is not None:
            waiting = [piece.trials for piece in state._waiting]
            out = [batch.trials for server in state.servers.values() for batch in server.batches.values()]
            places = np.concatenate([*waiting, *out, np.flatnonzero(state._workload.counted)])
            complete = np.array_equal(np.sort(places), np.arange(len(state._workload.seeds)))
            self.world.check(complete, f"{self.run}: a trial is lost, or in two places")
        for server in state.servers.values():
            self.world.check(server.phase.name in ("LEASED", "LEAVING") or not server.batches, f"{server.id} has batches")

    def answer(self, question: int, reply: messages.Reply | str | None) -> None:
        if question in self.open:
            del self.open[question]
            self.handle(dispatch.Answered(question, reply))

    def _ask(self, ask: dispatch.Ask) -> None:
        world, server = self.world, next(server for server in self.world.servers if server.id == ask.server)
        self.open[ask.question] = server
        world.at(QUERY_S[ask.verb], lambda: self.answer(ask.question, None))
        message, breaks = self._message(ask), server.breaks
        if server.ended or server.link in ("down", "mute") or world.chance(world.failing):
            world.soon(lambda: self.answer(ask.question, None))
        elif server.link == "up":
            world.soon(lambda: server.receive(self, ask.question, message, breaks))

    def _message(self, ask: dispatch.Ask) -> messages.Request:
        match ask.verb:
            case "offer":
                return messages.Requirements()
            case "reserve":
                return messages.Reserve(
                    nonce=self.nonce, epoch=self.epoch, slots=self.dispatch._wanted, version_hash="",
                    simulator=messages.Part(self.run, {}), representation=messages.Part("", {}),
                    trial_timeout_s=TRIAL_TIMEOUT_S,
                )  # fmt: skip
            case "renew":
                return messages.Renew(lease=ask.lease, known_ready=ask.known_ready)
            case "cancel":
                return messages.Cancel(lease=ask.lease, batches=list(ask.batches))
            case "release":
                return messages.Release(lease=ask.lease)
        assert ask.trials is not None
        genomes, participants, seeds = self.workloads[self.current].batch(ask.trials)
        return messages.Evaluate(
            lease=ask.lease, batch=ask.batch, genomes=genomes,
            participants=participants.astype("<u4").tobytes(), seeds=seeds.astype("<u8").tobytes(),
        )  # fmt: skip


def fail_something(world: World) -> None:
    """One failure, and another one later."""
    if world.now > CHAOS_S:
        return
    world.at(world.random.expovariate(0.3), lambda: fail_something(world))
    server = world.random.choice(world.servers)
    optimizer = world.random.choice(world.optimizers)
    match world.random.choice(["down", "mute", "deaf", "crash", "drain", "worker", "worker", "optimizer", "takeover"]):
        case "down" | "mute" | "deaf" as link if server.link == "up" and not server.ended:
            server.set_link(link)
            world.at(world.random.choice([0.1, 0.1, 3.0, 20.0, 70.0]), lambda: server.set_link("up"))
        case "crash" if not server.ended:
            server.end()
            world.at(world.random.uniform(0.1, 5.0), lambda: Server(world))
        case "drain" if not server.slots.draining:
            server.drain()
        case "worker" if not server.ended:
            worker = world.random.choice(server.workers)
            trial = worker.progress()
            if worker.trials and worker.since is not None:
                if world.deaths.get(worker.trials[trial], 0) == DEATHS:
                    return
                world.deaths[worker.trials[trial]] = world.deaths.get(worker.trials[trial], 0) + 1
            elif worker.since is not None:
                return
            worker.restart()
            server.handle(slots.Died(worker.index, trial, "killed"))
        case "optimizer" if not optimizer.ended and not optimizer.taken_over:
            optimizer.end()
            world.at(world.random.uniform(0.1, 40.0), optimizer.resume)
        case "takeover" if not optimizer.ended and not optimizer.taken_over:
            optimizer.resume()


@pytest.mark.parametrize("seed", range(SEEDS))
def test_whatever_fails_every_trial_is_counted_once_and_nothing_leaks(seed: int) -> None:
    world = World(seed)
    Server(world)
    for _ in range(world.random.randint(0, 3)):
        world.at(world.random.choice([0.0, 5.0]), lambda: Server(world))
    for run in ["run-1", "run-2"][: world.random.randint(1, 2)]:
        Optimizer(world, run)
    world.at(1.0, lambda: fail_something(world))
    world.run(CALM_S)
    if not any(server.good() for server in world.servers):
        late = Server(world)
        late.wrong = late.broken = False
    world.run(END_S, lambda: all(optimizer.left or optimizer.taken_over for optimizer in world.optimizers))
    world.run(world.now + 100.0)

    for optimizer in world.optimizers:
        if optimizer.taken_over:
            continue
        world.check(optimizer.left, f"{optimizer.run} is not done")
        for workload in optimizer.workloads:
            trials = [(workload.genomes[i], int(s)) for (i,), s in zip(workload.participants, workload.seeds, strict=True)]
            poison = np.array([poisonous(trial) for trial in trials])
            fitness = np.where(poison, np.nan, [outcome(trial) for trial in trials])
            world.check(bool(workload.counted.all()), "a trial is not counted")
            world.check(np.array_equal(workload.fitness[:, 0], fitness, equal_nan=True), "a fitness is wrong")
            world.check(np.array_equal(workload.metrics[:, 0], fitness, equal_nan=True), "a metric is wrong")
            world.check(np.array_equal(workload.faulted, poison), "a trial is blamed for another's fault, or not for its own")
    for server in world.servers:
        if not server.ended:
            world.check(not server.pending, f"{server.id} left queries unanswered")
            world.check(not server.slots.busy() and not server.slots._kept_bytes, f"{server.id} leaks a lease or a slot")
