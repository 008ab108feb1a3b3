"""The trials of a workload: which wait, which are out in batches, and which are counted.

``schedule`` knows who gets how many trials; a server hands them out to its slots itself. Every
trial is counted once. Trials that a server did not answer go to other ones, unless this server is
back first and can be asked for them again. When nothing waits, some are sent to a second server
(``second_starts``).
"""

from collections.abc import Iterable
from typing import Self

import msgspec
import numpy as np
from msgspec import structs

from zswarm.errors import LocalProtocolError, RemoteProtocolError
from zswarm.ot.cluster.events import Counted, Disputed, Outbox
from zswarm.ot.cluster.idle import IdleServers
from zswarm.ot.cluster.matching import Terms
from zswarm.ot.cluster.queue import QueuedTrials, TrialQueue
from zswarm.ot.cluster.remote_server import Phase, RemoteServer, SentBatch
from zswarm.ot.cluster.schedule import DEPTH, Schedule
from zswarm.ot.cluster.second_starts import MEASURE_ALONE_S, SecondStarts
from zswarm.ot.cluster.servers import Servers
from zswarm.ot.cluster.verification import Checks
from zswarm.ot.notes import RunEvent
from zswarm.ot.workload import Workload, one_nan
from zswarm.protocol import codec, messages
from zswarm.protocol.messages import Cancel, Evaluate, Fault, Outcomes, Running

ATTEMPTS = 3  # of a trial that ends in a fault


class Batches(msgspec.Struct, eq=False):
    """The workload of a run."""

    terms: Terms
    out: Outbox
    servers: Servers
    checks: Checks
    queue: TrialQueue
    schedule: Schedule
    second: SecondStarts
    workload: Workload | None = None  # the present one
    uncounted: int = 0  # of its trials
    # Machines that failed a trial, for each; the caller takes them.
    blamed: list[str] = []
    idle: IdleServers = msgspec.field(default_factory=IdleServers)
    _alone: bool = False  # the user knows that there is no second server
    _left_behind: set[str] = set()  # by trials in their processes, as the user knows

    @classmethod
    def of(cls, terms: Terms, out: Outbox, servers: Servers) -> Self:
        """Return the batches of a run."""
        queue, checks = TrialQueue(), Checks(terms.verify, servers.machines.of)
        schedule = Schedule(out, queue)
        return cls(terms, out, servers, checks, queue, schedule, SecondStarts(schedule))

    # ---- workloads

    def begin(self, workload: Workload) -> None:
        """Evaluate the trials of a workload that are not counted yet."""
        self.end()
        self.workload = workload
        self.idle.reset(self.schedule.serving)
        trials = np.flatnonzero(~workload.counted)
        self.uncounted = len(trials)
        if len(trials):
            self.queue.put(QueuedTrials(trials))
        self.schedule.begin(workload, self.terms)
        self.checks.restored(workload)

    def end(self) -> None:
        """Forget all that waits, and cancel all that is out."""
        for batch in self.queue.clear():
            batch.server.unwanted.append(batch.id)
        self.workload = None
        self.second.failed_on.clear()
        self.second.pairs.clear()
        self.checks.clear()
        for server in self.servers.by_id.values():
            if server.batches:
                self._cancel(server, list(server.batches))
                server.batches = {}

    def finish_if_done(self) -> bool:
        """Return whether the workload is done, and forget it then."""
        done = self.workload is not None and not self.uncounted and not self.checks.open
        if done:
            self.workload = None
        return done

    # ---- what follows for a server's batches when it moves

    def follow(self, server: RemoteServer) -> None:
        """Resume, strand or forget a server's batches, as its phase requires."""
        self.idle.moved[server.id] = server
        if server.phase == Phase.LEASED:
            if server.resumable_lease not in (b"", server.lease):
                self._forget_stranded(server)
            else:
                self._resume(server)
            server.resumable_lease = b""
            return
        for batch in list(server.batches.values()):
            # A leaving server will not answer a batch that it has already failed to answer once.
            if server.phase != Phase.LEAVING or batch.unanswered:
                self.strand(batch)
        if not server.lease and not server.resumable_lease:
            self._forget_stranded(server)
        if server.phase == Phase.BANNED and self.workload is not None:
            trials = self.workload.retract(server.id)
            servers = self.servers.by_id.values()
            sent = [batch for one in servers for batch in one.batches.values()]
            for ended in self.checks.retracted(trials.tolist(), sent):
                self._overtaken(ended)
            self.uncounted += len(trials)
            self.requeue(QueuedTrials(trials))

    def _resume(self, server: RemoteServer) -> None:
        """Ask again for the batches that no other server took meanwhile, and cancel the others."""
        for entry in self.queue.stranded(server):
            if entry.stranded is not None:
                self.queue.remove(entry)
                self.schedule.expect(entry.stranded, alone=False)
                self.send(entry.stranded)
        if server.unwanted:
            self._cancel(server, server.unwanted)
            server.unwanted = []

    def _forget_stranded(self, server: RemoteServer) -> None:
        for entry in self.queue.stranded(server):
            entry.stranded = None
        server.unwanted = []

    def strand(self, batch: SentBatch) -> None:
        """Queue a batch for any server; the server that may still have it can resume it."""
        del batch.server.batches[batch.id]
        self.second.lost(batch)
        if batch.check or not batch.missing:
            batch.server.unwanted.append(batch.id)
            self.give_back(batch)
        else:
            batch.unanswered = batch.question = 0
            self.requeue(QueuedTrials(batch.rest(), batch.avoid, batch))

    def _cancel(self, server: RemoteServer, batches: list[int]) -> None:
        self.out.ask(server.id, Cancel(lease=server.lease, batches=batches))

    # ---- out

    def fill(self, answered: RemoteServer | None) -> None:
        """Send batches that wait.

        Args:
            answered: a server that may have room again.
        """
        room = self.idle.follow(self.schedule, self.servers.serves, answered)
        if self.workload is None:
            return
        if self._waits():
            ranked = bool(self.terms.choice.rank)
            self._fill_servers(self.idle.each(ranked=ranked) if self.idle.more else room)
            self._drop_unverifiable()
        if self.idle.looking:
            self.idle.looking = False
            self._start_again()
        if self.uncounted or self.checks.waiting:
            self.idle.look_later(self.out.now, len(self.servers.by_id))

    def _waits(self) -> bool:
        return bool(self.queue.count or self.checks.waiting)

    def _fill_servers(self, servers: Iterable[RemoteServer]) -> None:
        """Fill servers as long as trials wait: first one batch for each, then the second."""
        visited = []
        for server in servers:
            visited.append(server)
            self._fill_server(server, 1)
            if not self._waits():
                break
        for depth in range(2, DEPTH + 1):
            for server in visited:
                if self._waits():
                    self._fill_server(server, depth)

    def _fill_server(self, server: RemoteServer, depth: int) -> None:
        while size := self.schedule.size(server, depth):
            batch = self._take(server, size)
            if batch is None:
                if self._waits():
                    self.idle.spared(server)
                return
            self.send(batch)
        if depth == DEPTH:
            self.idle.full(server)

    def _start_again(self) -> None:
        """Send trials that are out to a second server where that is expected to help."""
        servers, waits = self.servers.by_id.values(), self._waits()
        if not self.terms.second_starts:
            return
        for server, first, trials in self.second.find(servers, self.idle, waits=waits):
            copy = self._batch(server, trials, first.avoid)
            self.second.begin(first, trials, copy)
            self.send(copy)
            self.out.note(RunEvent.SECOND_START, server.id, count=len(trials))

    def send(self, batch: SentBatch) -> None:
        """Send a batch to its server, the first time or again."""
        batch.server.batches[batch.id] = batch
        self.ask(batch)

    def ask(self, batch: SentBatch) -> None:
        """Ask for a batch, or again for one that is out: by its id if the server can have it."""
        assert self.workload is not None  # noqa: S101  batches are of one
        message = Evaluate(lease=batch.server.lease, batch=batch.id)
        if batch.asked and messages.BY_ID in batch.server.features:
            batch.asked = "by-id"
        else:
            batch.asked = "whole"
            genomes, participants, seeds = self.workload.batch(batch.trials)
            if self.terms.reserve.asks:
                genomes = [b""] * len(genomes)
            batch.size = sum(map(len, genomes)) + participants.size * 16
            message = structs.replace(
                message,
                genomes=genomes,
                participants=participants.astype("<u4").tobytes(),
                seeds=seeds.astype("<u8").tobytes(),
            )
        batch.question = self.out.ask(batch.server.id, message, batch.trials)

    def _take(self, server: RemoteServer, size: int) -> SentBatch | None:
        """Return a new batch, or None if all that waits is for others; checks come last."""
        useful = self.schedule.useful(server, size, checks=self.checks.count)
        idle_s = self.out.now - server.pace.batch_at
        if not useful and idle_s > MEASURE_ALONE_S and not self.terms.second_starts:
            useful = 1
        ready = self.servers.roster.ready
        queued = self.queue.take(server.machine, useful, ready)
        if queued is not None:
            if queued.stranded is not None:
                queued.stranded.server.unwanted.append(queued.stranded.id)
            return self._batch(server, queued.trials, queued.avoid)
        trials = self.checks.take(server.machine, useful)
        return (
            self._batch(server, trials, frozenset(), check=True) if len(trials) else None
        )

    def _batch(
        self,
        server: RemoteServer,
        trials: np.ndarray,
        avoid: frozenset[str],
        *,
        check: bool = False,
    ) -> SentBatch:
        done = np.zeros(len(trials), bool)
        number = self.out.number()
        batch = SentBatch(server, number, trials, done, len(trials), avoid, check)
        self.schedule.expect(batch, alone=not server.batches)
        return batch

    # ---- answered

    def count(self, batch: SentBatch, reply: Outcomes | Running | Fault) -> None:
        """Take the outcomes that are new.

        Raises:
            RemoteProtocolError: they are not outcomes of this batch.
        """
        assert self.workload is not None  # noqa: S101  batches are of one
        if reply.batch != batch.id:
            text = f"batch {batch.id} was answered with batch {reply.batch}"
            raise RemoteProtocolError(text)
        server, terms = batch.server, self.terms
        rows, fitness, metrics = codec.outcomes(
            reply, len(batch.trials), terms.participants, terms.metrics
        )
        if not len(rows):
            return
        batch.heard[rows], server.setbacks = True, 0
        left = {text.partition(" (")[0]: text for text in reply.left.split("; ") if text}
        if new := left.keys() - self._left_behind:
            self._left_behind |= new
            text = "; ".join(left[kind] for kind in left if kind in new)
            self.out.note(RunEvent.SIMULATOR_LEFT, server.id, text)
        measured = reply.seconds / len(rows)
        self.schedule.computed(server, reply.seconds, len(rows))
        if isinstance(reply, Outcomes):
            self.second.answered(batch)
            self.schedule.answered(batch, measured)
        if batch.done[rows].any():
            new = ~batch.done[rows]
            rows, fitness, metrics = rows[new], fitness[new], metrics[new]
            if not len(rows):
                return
        batch.done[rows] = True
        batch.missing -= len(rows)
        trials, fitness, metrics = batch.trials[rows], one_nan(fitness), one_nan(metrics)
        if reply.error and np.isnan(fitness).any():
            failed = int(np.isnan(fitness).any(axis=1).sum())
            self.out.note(RunEvent.SIMULATOR_RAISED, server.id, reply.error, failed)
        if batch.check:
            disputed = self.checks.compare(
                server.id, trials, fitness, metrics, self.workload
            )
            self.out.commands += [Disputed(trial) for trial in disputed]
            return
        self.workload.fitness[trials], self.workload.metrics[trials] = fitness, metrics
        self.servers.machines.counted[server.machine] += len(trials)
        self.checks.choose(trials, server.id)
        self.idle.more |= bool(self.checks.waiting)  # others may be idle
        self._count_once(trials, server.id, measured * len(trials))
        if self.second.pairs:
            for other in self.second.counted(batch, trials.tolist()):
                self._overtaken(other)
        if self.second.failed_on:  # another machine could evaluate what failed there
            for trial in trials:
                machines = self.second.failed_on.get(trial, ())
                self.blamed += {*machines} - {server.machine}

    def _overtaken(self, batch: SentBatch) -> None:
        """Cancel a batch of which another server was the first to answer the rest."""
        server = batch.server
        del server.batches[batch.id]
        self._cancel(server, [batch.id])
        self.schedule.overtaken(batch)
        if server.id in self.schedule.serving:
            self.idle.add(server, self.out.now)
            self.idle.more = True

    def _count_once(self, trials: np.ndarray, server: str, seconds: float) -> None:
        workload = self.workload
        assert workload is not None  # noqa: S101  callers have one
        if workload.counted[trials].any():
            raise LocalProtocolError("a trial was counted twice")
        workload.counted[trials], workload.source[trials] = True, server
        self.uncounted -= len(trials)
        self.out.commands.append(Counted(trials, server, seconds))

    def fault(self, batch: SentBatch, index: int, text: str) -> None:
        """Try a trial of a batch again on another server, and the others on any."""
        server, workload, rest = batch.server.id, self.workload, batch.rest()
        if workload is None or not len(rest):
            return  # the server sent the outcome of the trial that it blames
        trial = int(batch.trials[min(index, len(batch.trials) - 1)])
        if trial not in rest:
            trial = int(rest[0])
        which = f"trial {trial}, its seed {workload.seeds[trial]}"
        elsewhere = self.second.elsewhere(batch, trial)
        batch.done |= batch.trials == trial
        self.give_back(batch)
        if batch.check:
            said = f"{text} ({which}, when it was verified)"
            self.out.note(RunEvent.FAULT, server, said)
            self.checks.drop([trial], workload.source[trial])
            self.blamed.append(batch.server.machine)
            return
        ready = {one.machine for one in self.servers.roster.ready.values()}
        machines = self.second.failed(trial, batch.server.machine, ready - batch.avoid)
        said = f"{text} ({which}, attempt {len(machines)})"
        self.out.note(RunEvent.FAULT, server, said)
        if elsewhere:
            return
        failed = rest[rest == trial]
        if len(machines) < ATTEMPTS:
            self.requeue(QueuedTrials(failed, batch.avoid.union(machines)))
        elif self.terms.quarantine:
            workload.faulted[trial] = True
            self._count_once(failed, "", 0.0)
        else:
            where = f"{ATTEMPTS} times, last on {server}"
            self.out.failure = f"a trial ended in a fault {where}: {text} ({which})"

    def give_back(self, batch: SentBatch) -> None:
        """Queue the trials of a batch again, which its server no longer has."""
        if not batch.check:
            self.second.lost(batch)
            self.requeue(QueuedTrials(batch.rest(), batch.avoid))
        elif self.workload is not None:
            self.idle.more = True
            self.checks.give_back(batch.rest(), self.workload)

    def _drop_unverifiable(self) -> None:
        """Leave trials unverified if there is no second server for them."""
        if self.checks.waiting and not self.uncounted:
            alone = self.checks.drop_alone(self.servers.roster.computing())
            if alone and not self._alone:
                text = "there is no second machine to verify with"
                self.out.note(RunEvent.UNVERIFIED, text=text)
            self._alone = alone

    def requeue(self, entry: QueuedTrials) -> None:
        """Queue trials again, if these are any."""
        if count := len(entry.trials):
            self.idle.more = True
            self.queue.put(entry)
            self.out.note(RunEvent.REQUEUED, count=count)
