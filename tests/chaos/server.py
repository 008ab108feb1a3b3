"""Run the real slot table in a simulated server, with workers that fail."""

import itertools
from collections.abc import Sequence

import numpy as np

from zswarm.protocol import codec, messages
from zswarm.ss.slots import events
from zswarm.ss.slots.table import SlotTable

from .fairness import Fairness
from .network import Link
from .problem import Trial, outcome, poisonous
from .world import Node, World

TICK_S = 0.25
TRIAL_TIMEOUT_S = 20.0
TRIALS_S = [0.001, 0.03, 0.2, 0.8, 16.0]  # of a trial
PROBE_BYTES = messages.PROBE_TRIALS * messages.PROBE_DIGEST
PROBE, WRONG_PROBE = bytes(range(PROBE_BYTES)), b"w" * PROBE_BYTES
ALONE_S = 0.25  # a process plays trials of the probe for so long before it reports them
WRONG, LIAR = "-wrong", "-liar"  # ends of the ids of servers that are
# Of a worker by chance at one trial: one fewer than would put it in quarantine.
DEATHS = 2


class Server(Node[events.Event]):
    """Simulate a server."""

    def __init__(
        self,
        world: World,
        number: int,
        deaths: dict[Trial, int],
        *,
        sound: bool,
        lies: float,
        trials_s: Sequence[float],
        most: int,
        machine: str = "",
    ) -> None:
        super().__init__(world)
        self.links: dict[str, Link] = {}  # by optimizer
        self.deaths = deaths
        # It computes other numbers, which the probe shows.
        self.wrong = not sound and world.random.random() < 0.05
        # Share of the trials with other numbers; the probe is never among them.
        self.lies = lies
        self.id = f"ss-{number}{WRONG if self.wrong else LIAR if lies else ''}"
        self.machine = machine or self.id  # of several servers, perhaps
        self.broken = not sound and world.random.random() < 0.05  # cannot be prepared
        # Every third trial ends its process.
        self.faulty = not sound and world.random.random() < 0.05
        self.trial_s = world.random.choice(trials_s)
        self.prepare_deaths = 0
        self.pending: dict[int, tuple[Link, int]] = {}  # queries to answer
        # Lease, batch, trials.
        self.ran: set[tuple[bytes, int, tuple[Trial, ...]]] = set()
        self.fairness = Fairness()
        self.alone = False  # the only server of the world, for one run
        self.finished: set[tuple[bytes, Trial]] = set()  # trials by lease
        capacity = world.random.randint(1, most)
        offer = messages.Offer(
            server=self.id,
            program="",
            machine="",
            capacity=capacity,
            free=0,
            leases=0,
            simulators=[],
            representations=[],
            features=messages.FEATURES if world.random.random() < 0.8 else [],
        )
        tokens = itertools.count()
        self.slots = SlotTable(
            capacity, offer, lambda _: "", lambda: f"{number:8}{next(tokens):8}".encode()
        )
        self.workers = [Worker(self, index) for index in range(capacity)]
        self._queries = itertools.count()
        self._ticking = False

    def good(self) -> bool:
        """Return whether runs can rely on this server."""
        return not (
            self.ended
            or self.wrong
            or self.lies
            or self.broken
            or self.faulty
            or self.slots.draining
        )

    def receive(self, link: Link, question: int, message: messages.Request) -> None:
        """Handle a request."""
        if self.frozen:
            self.when_awake(lambda: self.receive(link, question, message))
            return
        query = next(self._queries)
        self.pending[query] = (link, question)
        token = getattr(message, "lease", b"")
        if any(
            lease.token == token and lease.reserve.nonce != link.optimizer.nonce
            for lease in self.slots.leases.values()
        ):
            self.world.fail(f"{self.id}: a lease is used by two")
        sender = link.optimizer
        self.handle(events.Asked(query, sender.user, sender.run, message))

    def react(self, event: events.Event) -> None:
        """Give the slot table an event and execute its commands."""
        world = self.world
        if not isinstance(event, events.Tick):
            world.tell(self.id, getattr(event, "message", event))
        for command in self.slots.handle(event, self.clock()):
            match command:
                case events.Answer():
                    if command.query not in self.pending:
                        world.fail(f"{self.id} answers a query twice")
                    link, question = self.pending.pop(command.query)
                    link.answer(question, command.body)
                case events.PrepareSlot():
                    self.workers[command.slot].prepare(command)
                case events.PlayProbe():
                    self.workers[command.slot].play_probe(command)
                case events.RunChunk():
                    self.workers[command.slot].evaluate(command.work)
                case events.StopSlot():
                    self.workers[command.slot].stop()
                case events.KillSlot():
                    self.workers[command.slot].restart()
                case events.Drained():
                    if self.pending:
                        world.fail(f"{self.id} drained with queries unanswered")
                    self.ended = True
                    world.at(0.1, self.disappear)
        self._check()
        if not self._ticking:
            self._ticking = True
            world.at(TICK_S, self._tick)

    def _tick(self) -> None:
        if self.frozen:
            # After all events that came meanwhile.
            self.when_awake(lambda: self.world.at(0.0, self._tick))
            return
        self._ticking = False
        if self.slots.busy() or self.slots.draining:
            if broken := self.fairness.passed(self.slots, TICK_S):
                self.world.fail(f"{self.id}: {broken}")
            self.handle(events.Tick(tuple(worker.progress() for worker in self.workers)))

    def _check(self) -> None:
        """Check that a slot belongs to at most one lease and works when the table says so."""
        held = set()
        for lease in self.slots.leases.values():
            for slot in lease.slots:
                if slot.index in held:
                    self.world.fail(f"{self.id}: slot {slot.index} belongs to two leases")
                held.add(slot.index)
        for slot, worker in zip(self.slots.slots, self.workers, strict=True):
            state = slot.state
            if (slot.index in held) == (state in ("free", "stopping")):
                self.world.fail(
                    f"{self.id}: slot {slot.index} is {state} with a wrong lease"
                )
            if (state in ("busy", "preparing", "stopping")) != (worker.since is not None):
                self.world.fail(
                    f"{self.id}: slot {slot.index} is {state}, its worker not"
                )
        begun = [worker.since for worker in self.workers]
        broken = self.fairness.broken(self.slots, self.world.now, self.clock(), begun)
        if broken:
            self.world.fail(f"{self.id}: {broken}")

    def disappear(self) -> None:
        """Remove its links for good."""
        for link in self.links.values():
            link.set("down")

    def end(self) -> None:
        """Crash or be killed."""
        self.ended, self.frozen = True, False
        self.disappear()

    def drain(self) -> None:
        """Drain: the token goes first."""
        for link in self.links.values():
            link.undeclare()
        self.handle(events.Drain())


class Worker:
    """Simulate the process of a slot."""

    def __init__(self, server: Server, index: int) -> None:
        self.server, self.index = server, index
        self.life = 0  # events from before a restart are dropped
        self.since: float | None = None  # it works since then
        self.trials: list[Trial] = []  # of its chunk
        self.lease = b""
        self.trial_s = 1.0

    def restart(self) -> None:
        """Kill the server and start a new one."""
        self.life, self.since = self.life + 1, None

    def die(self) -> None:
        """Die because another process killed it."""
        self.life += 1
        self._later(0.0, events.Died(self.index, self.progress(), "killed"))

    def _later(self, delay: float, event: events.Event) -> None:
        life = self.life

        def happen() -> None:
            if life == self.life:
                if isinstance(event, events.Finished):
                    self.server.finished |= {(self.lease, trial) for trial in self.trials}
                self.restart()
                self.server.handle(event)

        self.server.world.at(delay, lambda: self.server.when_awake(happen))

    def prepare(self, command: events.PrepareSlot) -> None:
        """Compile, and play at least one trial of the probe."""
        server, world = self.server, self.server.world
        if self.since is not None:
            world.fail(f"{server.id}: a slot that works is prepared")
        self.since, self.trials = world.now, []
        delay = world.random.uniform(0.05, 3.0)
        if server.broken:
            self._later(delay, events.Unprepared(self.index, "broken"))
        elif server.prepare_deaths < DEATHS and world.chance(0.05):
            server.prepare_deaths += 1
            self._later(delay, events.Died(self.index, 0, "while it was prepared"))
        else:
            if not world.chance(0.3):  # it is built before it ends
                compiling = events.Preparing(self.index, 0, messages.PROBE_TRIALS)
                life = self.life

                def built() -> None:
                    if life == self.life:
                        server.handle(compiling)

                world.at(delay / 2, lambda: server.when_awake(built))
            count = command.most if server.trial_s < ALONE_S else 1
            self._played(delay + count * server.trial_s, command.first, count)

    def play_probe(self, command: events.PlayProbe) -> None:
        """Play further trials of the probe."""
        server, world = self.server, self.server.world
        if self.since is not None:
            world.fail(f"{server.id}: a slot that works is to play the probe")
        self.since, self.trials = world.now, []
        seconds = command.count * server.trial_s
        self._played(seconds, command.first, command.count, loaded=True)

    def _played(
        self, seconds: float, first: int, count: int, *, loaded: bool = False
    ) -> None:
        server, size = self.server, messages.PROBE_DIGEST
        whole = WRONG_PROBE if server.wrong else PROBE
        digest = whole[first * size : (first + count) * size]
        self._later(
            seconds,
            events.Prepared(self.index, digest, server.trial_s, first, loaded),
        )

    def evaluate(self, batch: messages.Evaluate) -> None:
        """Play the trials of a chunk."""
        server, world = self.server, self.server.world
        if self.since is not None:
            world.fail(f"{server.id}: a slot that works is given a batch")
        participants, seeds = codec.trials(batch, 1)
        self.since, self.trial_s, self.lease = world.now, server.trial_s, batch.lease
        rows = zip(participants[:, 0], seeds, strict=True)
        self.trials = [(batch.genomes[row], int(seed)) for row, seed in rows]
        chunk = (batch.lease, batch.batch, tuple(self.trials))
        if chunk in server.ran:
            world.fail(f"{server.id}: trials of batch {batch.batch} are run twice")
        server.ran.add(chunk)
        if server.alone and any(
            (batch.lease, trial) in server.finished for trial in self.trials
        ):
            world.fail(f"{server.id}: a trial that it has the outcome of is run again")
        if len(self.trials) > 1 and world.chance(10 * world.failing):
            at = world.random.randrange(len(self.trials))
            self._later(at * self.trial_s, events.Exhausted(self.index, at))
            return
        for index, trial in enumerate(self.trials):
            if poisonous(trial) or self._dies_at(trial):
                if world.random.random() < 0.3:
                    # It hangs there, until it is killed.
                    self.trials = self.trials[: index + 1]
                else:
                    self._later(
                        index * self.trial_s, events.Died(self.index, index, "crash")
                    )
                return
        fitness = np.array([outcome(trial) + self._lie(trial) for trial in self.trials])
        seconds = len(self.trials) * self.trial_s
        reply = messages.Outcomes(
            batch=batch.batch,
            fitness=fitness.tobytes(),
            metrics=fitness.tobytes(),
            seconds=seconds,
        )
        recycled = world.chance(10 * world.failing)
        self._later(seconds, events.Finished(self.index, reply, recycled))

    def _lie(self, trial: Trial) -> float:
        return float(self.server.wrong or outcome(trial) % 0.1 < 0.1 * self.server.lies)

    def _dies_at(self, trial: Trial) -> bool:
        """Choose at random where it dies, but rarely enough that no trial goes to quarantine."""
        server = self.server
        deaths = server.deaths.get(trial, 0)
        dies = server.world.chance(server.world.failing) or (
            server.faulty and server.world.chance(0.3)
        )
        if deaths == DEATHS or not dies:
            return False
        server.deaths[trial] = deaths + 1
        return True

    def stop(self) -> None:
        """End the current trial; one in three times this takes too long."""
        if self.since is not None and self.server.world.random.random() < 0.7:
            self._later(
                self.trial_s,
                events.Finished(
                    self.index, messages.Refused(code="cancelled", reason="")
                ),
            )

    def progress(self) -> int:
        """Return the current trial."""
        if self.since is None or not self.trials:
            return 0
        played = int((self.server.world.now - self.since) / self.trial_s)
        return min(played, len(self.trials) - 1)
