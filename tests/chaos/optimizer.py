"""Run the real dispatch in a simulated optimizer, with some generations and a record."""

import copy

import numpy as np

from zswarm.ot.cluster import events
from zswarm.ot.cluster.dispatch import Dispatch
from zswarm.ot.cluster.machines import Known
from zswarm.ot.cluster.matching import Choice, Terms
from zswarm.ot.cluster.remote_server import Phase
from zswarm.ot.notes import Note, RunEvent
from zswarm.ot.record.history_hash import History
from zswarm.protocol import messages

from .awaited import Awaited
from .network import Link
from .problem import Experiment, outcome
from .server import LIAR, PROBE, TRIAL_TIMEOUT_S, WRONG
from .world import Node, World

UNSYNCED_S = 0.1  # what a crash may lose

Row = tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray, str]


class Journal:
    """Record a run: finished generations, and outcomes of the current one."""

    def __init__(self) -> None:
        self.finished: list[tuple[list[bytes], np.ndarray]] = []
        # Wrong outcomes of a server may have remained undetected.
        self.doubtful = False
        self.machines: dict[str, str] = {}  # by server
        self.banned: dict[str, str] = {}  # machines, and as which server
        self.counted: list[Row] = []
        # When each generation ended, and its outcomes.
        self.ended: list[tuple[float, list[Row]]] = []

    def survives(self, now: float) -> "Journal":
        """Return what is on the disk after a crash: all but the last tenth of a second.

        Generations that ended then are unfinished again.
        """
        left = Journal()
        left.doubtful, left.banned = self.doubtful, dict(self.banned)
        left.machines = dict(self.machines)
        left.finished, left.ended = list(self.finished), list(self.ended)
        left.counted = self.counted
        while left.ended and left.ended[-1][0] >= now - UNSYNCED_S:
            left.counted = left.ended.pop()[1]
            left.finished.pop()
        left.counted = [row for row in left.counted if row[0] < now - UNSYNCED_S]
        return copy.deepcopy(left)

    def history(self) -> str:
        """Return the history hash."""
        history = History()
        for genomes, fitness in self.finished:
            history.add(genomes, fitness)
        return history.hex()


class Optimizer(Node[events.Event]):
    """Start or resume an experiment in the simulated world."""

    def __init__(
        self,
        world: World,
        experiment: Experiment,
        *,
        verify: float,
        second_starts: bool = True,
        user: str = "ada",
        breeds_s: float = 0.0,
        epoch: int = 0,
        journal: Journal | None = None,
    ) -> None:
        super().__init__(world)
        self.experiment, self.user, self.run = experiment, user, experiment.name
        self.epoch, self.verify, self.breeds_s = epoch, verify, breeds_s
        self.name = f"{self.user}/{self.run}"
        self.nonce, self.second_starts = world.random.randbytes(16), second_starts
        self.journal = journal or Journal()
        self.links: dict[str, Link] = {}  # by server
        self.awaited = Awaited()
        self.paused = False
        self.left = False  # it is done
        self.superseded = False  # another one has resumed its run
        self.progressed_at = self.unserved_at = world.now
        self._verified, self._missed = 0, False
        # A check needs a second server.
        choice = Choice(max_slots=0 if verify else world.random.choice([0, 0, 1, 3]))
        reserve = messages.Reserve(
            nonce=self.nonce,
            epoch=epoch,
            slots=world.random.choice([1, 2, 100]),
            simulator=messages.Part(self.run, {}),
            representation=messages.Part("", {}),
            version_hash="",
            trial_timeout_s=TRIAL_TIMEOUT_S,
        )
        slots = reserve.slots + bool(verify)
        self.max_slots = min(slots, choice.max_slots or slots)
        self.dispatch = Dispatch(
            Terms(
                requirements=messages.Requirements(),
                reserve=reserve,
                choice=choice,
                metrics=1,
                quarantine=True,
                verify=verify,
                second_starts=second_starts,
                known=Known(self.journal.machines, self.journal.banned),
            )
        )
        self.workload = experiment.workload(None)  # the one that runs
        self._wake_at = float("inf")
        world.soon(self._next_generation)

    def _next_generation(self) -> None:
        if self.ended:
            return
        if len(self.journal.finished) == self.experiment.generations:
            self._leave()
            return
        before = self.journal.finished[-1][1] if self.journal.finished else None
        self.workload = self.experiment.workload(before)
        for _, trials, fitness, metrics, faulted, server in self.journal.counted:
            self.workload.fitness[trials], self.workload.metrics[trials] = (
                fitness,
                metrics,
            )
            self.workload.counted[trials], self.workload.faulted[trials] = True, faulted
            self.workload.source[trials] = server
        self._once = np.ones(len(self.workload.seeds), int)
        self.handle(events.Work(self.workload))

    def _slots_held(self) -> int:
        """Return the slots that it has leased or requested."""
        phases = {Phase.LEASED: "slots", Phase.RESERVING: "wanted"}
        servers = self.dispatch.servers.by_id.values()
        return sum(
            getattr(server, phases[server.phase])
            for server in servers
            if server.phase in phases
        )

    def _overdue(self) -> bool:
        """Return whether a question is open though its time is over."""
        now = self.clock()
        return any(
            query.asked_at + events.QUERY_S[query.verb] + events.MARGIN_S <= now
            for query in self.dispatch.out.queries.values()
        )

    def react(self, event: events.Event) -> None:
        """Give the dispatch an event and execute its commands."""
        world = self.world
        if not isinstance(event, events.TimePassed):
            world.tell(
                self.name, self.epoch, "Work" if isinstance(event, events.Work) else event
            )
        commands = self.dispatch.handle(event, self.clock())
        if isinstance(event, events.Answered):
            self.awaited.answered(event)
        elif isinstance(event, events.TimePassed) and self._overdue():
            world.fail(f"{self.name} awaits an answer for longer than it may take")
        if (held := self._slots_held()) > self.max_slots:
            world.fail(f"{self.name} holds or asks for {held} slots of {self.max_slots}")
        roster = self.dispatch.servers.roster
        if self.paused and (roster.preparing or roster.ready):
            world.fail(f"{self.name} holds slots while it pauses")
        for command in commands:
            match command:
                case events.Ask():
                    self.awaited.asked(command)
                    self._check_second(command)
                    self.links[command.server].ask(command.question, command.message)
                case events.Counted():
                    self._record(command)
                case events.Disputed():
                    trial, (index,) = (
                        command.trial,
                        self.workload.participants[command.trial],
                    )
                    truth = np.array(
                        [
                            outcome(
                                (
                                    self.workload.genomes[index],
                                    int(self.workload.seeds[trial]),
                                )
                            )
                        ]
                    )
                    world.at(
                        0.5,
                        lambda trial=trial, truth=truth: self.handle(
                            events.Arbitrated(trial, truth, truth)
                        ),
                    )
                case events.ProbeDisputed():
                    world.at(2.0, lambda: self.handle(events.ProbeArbitrated(PROBE)))
                case events.Retracted():
                    # Earlier generations already used its outcomes.
                    self.journal.doubtful |= bool(self.journal.finished)
                    self.journal.counted = [
                        row for row in self.journal.counted if row[-1] != command.server
                    ]
                case events.Complete():
                    self._finish()
                case events.Failed():
                    world.fail(f"{self.name} failed: {command.reason}")
                case events.Superseded():
                    if self.superseded:  # as the record of its run shows
                        self.end()
                case Note(event="answer_failed"):
                    world.fail(f"{self.name}: {command.text}")
                case Note():
                    self._know(command)
                    self._missed |= (
                        command.event == "unverified"
                        or "when it was verified" in command.text
                    )
        if not self.dispatch.servers.standing().slots:
            self.unserved_at = world.now
        if self.dispatch.batches.checks.verified > self._verified:
            self._verified, self.progressed_at = (
                self.dispatch.batches.checks.verified,
                world.now,
            )
        if commands or not isinstance(event, events.TimePassed):
            self._check()
        self._set_alarm()

    def _know(self, note: Note) -> None:
        """Record the machines of servers, and which of them compute wrong."""
        if note.event == RunEvent.SERVER_JOINED:
            machine = self.links[note.server].server.machine
            self.journal.machines[note.server] = machine
        elif note.event == RunEvent.SERVER_WRONG:
            # It may be found out by its probe before it joins, or end before a resume.
            if note.server not in self.journal.machines:
                if note.server not in self.links:
                    self.world.fail(f"{note.server!r} is banned, and is no server")
                machine = self.links[note.server].server.machine
                self.journal.machines[note.server] = machine
            self.journal.banned[self.journal.machines[note.server]] = note.server

    def _set_alarm(self) -> None:
        wanted = self.dispatch.next_time()
        if wanted < self._wake_at:
            self._wake_at = wanted
            delay = max(0.0, wanted - self.clock())
            self.world.at(delay, lambda: self._tick(wanted))

    def _tick(self, wanted: float) -> None:
        if wanted == self._wake_at:  # or it was woken before
            self._wake_at = float("inf")
            self.handle(events.TimePassed())

    def _record(self, counted: events.Counted) -> None:
        rows = [row[1] for row in self.journal.counted]
        if rows and np.isin(counted.trials, np.concatenate(rows)).any():
            self.world.fail("a trial was counted twice")
        if (
            counted.server
            and (machine := self.links[counted.server].server.machine)
            in self.journal.banned
        ):
            was = self.journal.banned[machine]
            self.world.fail(f"{counted.server} was counted for, banned as {was}")
        load, trials = self.workload, counted.trials
        row = (
            load.fitness[trials].copy(),
            load.metrics[trials].copy(),
            load.faulted[trials].copy(),
        )
        self.journal.counted.append((self.world.now, trials, *row, counted.server))
        self.progressed_at = self.world.now

    def _finish(self) -> None:
        """End a generation, which must equal that of an undisturbed run."""
        world, load = self.world, self.workload
        fitness, poison = self.experiment.expected(load)
        if not load.counted.all():
            world.fail("a trial is not counted")
        if sum(len(row[1]) for row in self.journal.counted) != len(fitness):
            world.fail("the record does not have every trial once")
        wrong = {server for server in set(load.source) if server.endswith(WRONG)}
        if self.dispatch.bans.arbitrated and any(
            server.probe
            for server in self.dispatch.servers.by_id.values()
            if server.id in wrong
        ):
            world.fail(f"{wrong}: computes wrong, is known to, and was counted for")
        lied = self._missed and any(server.endswith(LIAR) for server in load.source)
        self.journal.doubtful |= bool(wrong) or lied
        if not self.journal.doubtful:
            for name, array in (("fitness", load.fitness), ("metric", load.metrics)):
                if not np.array_equal(array[:, 0], fitness, equal_nan=True):
                    world.fail(f"a {name} is wrong")
        if not np.array_equal(load.faulted, poison):
            world.fail("a trial is blamed for another's fault, or not for its own")
        self.journal.finished.append(
            (load.genomes, self.experiment.fitness(load.fitness[:, 0]))
        )
        self.journal.ended.append((world.now, self.journal.counted))
        self.journal.counted = []
        world.at(self.breeds_s, lambda: self.when_awake(self._next_generation))

    def _leave(self) -> None:
        self.handle(events.Leave())
        self.left = True
        self.world.at(0.1, self.end)

    def end(self) -> None:
        """End or crash; the token vanishes."""
        self.ended, self.frozen = True, False
        for link in self.links.values():
            link.set("down")

    def pause(self, seconds: float) -> None:
        """Let the run hold no slots for a while."""

        def pauses(paused: bool) -> None:
            self.paused = paused and not self.left
            self.progressed_at = self.world.now
            self.handle(events.Pause(self.paused))

        self.when_awake(lambda: pauses(True))
        self.world.at(seconds, lambda: self.when_awake(lambda: pauses(False)))

    def stop(self) -> None:
        """End as after Ctrl-C: release all leases first."""
        self.handle(events.Leave())
        self.end()

    def resume(self) -> "Optimizer":
        """Start another program that resumes from the record, even if this one still runs."""
        self.superseded = True
        journal = self.journal.survives(self.world.now)
        return Optimizer(
            self.world,
            self.experiment,
            verify=self.verify,
            second_starts=self.second_starts,
            user=self.user,
            breeds_s=self.breeds_s,
            epoch=self.epoch + 1,
            journal=journal,
        )

    def _check(self) -> None:
        """Check that every trial is in one place, or in the two that are known to have it."""
        servers, batches = self.dispatch.servers.by_id.values(), self.dispatch.batches
        self._check_pairs()
        if forgotten := self.awaited.forgotten(self.dispatch):
            self.world.fail(f"{self.name}: {forgotten}")
        if batches.workload is not None:
            places = [entry.trials for entry in batches.queue.entries]
            places += [
                batch.rest()
                for server in servers
                for batch in server.batches.values()
                if not batch.check
            ]
            places.append(np.flatnonzero(batches.workload.counted))
            found = np.bincount(np.concatenate(places), minlength=len(self._once))
            once = self._once.copy()
            once[list(batches.second.pairs)] += 1
            if not np.array_equal(found, once):
                self.world.fail(f"{self.name}: a trial is lost, or in two places")
        for server in servers:
            if server.batches and server.phase not in (Phase.LEASED, Phase.LEAVING):
                self.world.fail(f"{server.id} has batches")

    def _check_second(self, ask: events.Ask) -> None:
        """Check that no outcome is verified by the machine that it is of."""
        if not isinstance(ask.message, messages.Evaluate):
            return
        batch = self.dispatch.servers.by_id[ask.server].batches[ask.message.batch]
        if not batch.check:
            return
        machine = self.links[ask.server].server.machine
        for source in set(self.workload.source[batch.rest()]) - {""}:
            if self.journal.machines.get(source, source) == machine:
                self.world.fail(f"{ask.server} verifies {source}, of its own machine")

    def _check_pairs(self) -> None:
        """Check that a trial that was started twice is awaited from two servers."""
        for trial, pair in self.dispatch.batches.second.pairs.items():
            there = [
                batch.server.batches.get(batch.id) is batch and trial in batch.rest()
                for batch in pair
            ]
            if not all(there) or pair[0].server is pair[1].server:
                self.world.fail(f"{self.name}: a second start of trial {trial} is lost")
