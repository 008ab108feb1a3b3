"""The trials of a workload: which wait, which are out in batches, and which are counted.

Each server has two batches or, if trials are long, as many as it needs to have two trials for each
slot. It hands them out to its slots itself. A batch is about 75 ms of measured work for each of
these slots, and shrinks towards the end of a workload that several servers share. Every trial is
counted once. Trials that a server did not answer go to another one, unless this server is back
first and can be asked for them again.
"""

import msgspec
import numpy as np
from msgspec import structs

from zswarm.errors import LocalProtocolError, RemoteProtocolError
from zswarm.ot.cluster.events import Counted, Disputed, Outbox
from zswarm.ot.cluster.matching import Terms
from zswarm.ot.cluster.queue import QueuedTrials, TrialQueue
from zswarm.ot.cluster.remote_server import Phase, RemoteServer, SentBatch
from zswarm.ot.cluster.servers import Servers
from zswarm.ot.cluster.verification import Checks
from zswarm.ot.notes import RunEvent
from zswarm.ot.workload import Workload, one_nan
from zswarm.protocol import codec, messages
from zswarm.protocol.messages import Cancel, Evaluate, Fault, Outcomes, Running

ATTEMPTS = 3  # of a trial that ends in a fault
DEPTH = 2  # batches per server: one is evaluated, and one waits behind it
BATCH_BYTES = (
    4 << 20
)  # in a message; a trial whose genomes are larger is a batch of its own
BATCH_S = 0.075  # of work in a batch for each slot, by measured time
# Of work in a batch for each slot, times the number of servers that serve: if each of N servers
# ends a batch every N * 2 ms, the optimizer has one to handle every 2 ms. That takes it 0.5 ms at
# most, a quarter of its time.
SERVER_S = 0.002
# Of work for each slot: with less, the way to a server and back would take longer than a batch.
SMALLEST_BATCH_S = 0.003


class Batches(msgspec.Struct, eq=False):
    """The workload of a run."""

    terms: Terms
    out: Outbox
    servers: Servers
    checks: Checks
    queue: TrialQueue = msgspec.field(default_factory=TrialQueue)
    workload: Workload | None = None  # the present one
    uncounted: int = 0  # number of its trials that are not counted
    # Servers that failed a trial, once for each; the caller takes them out.
    blamed: list[str] = []
    refill: bool = False  # any server may have room for trials that wait, not only one
    _serving: dict[str, RemoteServer] = {}  # servers that can be given work
    _slots: int = 0  # of these
    _fits: int = 1  # trials that fit into a message
    _failed_on: dict[int, list[str]] = {}  # by trial: the servers of its failed attempts
    _alone: bool = False  # the user knows that there is no second server
    _left_behind: set[str] = (
        set()
    )  # what the user knows that trials leave in their processes

    # ---- workloads

    def begin(self, workload: Workload) -> None:
        """Evaluate the trials of a workload that are not counted yet."""
        self.end()
        self.workload, self.refill = workload, True
        trials = np.flatnonzero(~workload.counted)
        self.uncounted = len(trials)
        if len(trials):
            self.queue.put(QueuedTrials(trials))
        participants = self.terms.participants
        genome = max(map(len, workload.genomes), default=0)
        sent = (genome + 16) * participants + 16
        answered = 8 * (participants + self.terms.metrics) + 4
        by_bytes = BATCH_BYTES // max(sent, answered)
        self._fits = min(
            messages.MAX_TRIALS, messages.MAX_GENOMES // participants, by_bytes
        )
        restored = np.flatnonzero(workload.source != "")  # and perhaps not verified
        self.checks.choose(restored, workload.source[restored].tolist())

    def end(self) -> None:
        """Forget all that waits, and cancel all that is out."""
        for batch in self.queue.clear():
            batch.server.unwanted.append(batch.id)
        self.workload = None
        self._failed_on.clear()
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
        self.refill = True
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
            self.checks.drop(trials.tolist())
            self.uncounted += len(trials)
            self._requeue(QueuedTrials(trials))

    def _resume(self, server: RemoteServer) -> None:
        """Ask again for the batches that no other server took meanwhile, and cancel the others."""
        for entry in self.queue.stranded(server):
            if entry.stranded is not None:
                self.queue.remove(entry)
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
        if batch.check:
            batch.server.unwanted.append(batch.id)
            self.give_back(batch)
        else:
            batch.unanswered = batch.question = 0
            self._requeue(QueuedTrials(batch.rest(), batch.avoid, batch))

    def _cancel(self, server: RemoteServer, batches: list[int]) -> None:
        self.out.ask(server.id, Cancel(lease=server.lease, batches=batches))

    # ---- out

    def fill(self, answered: RemoteServer | None) -> None:
        """Send batches that wait: first one to every server, then the second.

        Args:
            answered: the only server that may have room, unless ``refill`` is set.
        """
        if self.workload is None or not (self.queue.count or self.checks.waiting):
            return
        idle = [answered] if answered and answered.id in self._serving else []
        if self.refill:
            self.refill = False
            self._serving = self.servers.serving()
            idle = list(self._serving.values())
            self._slots = sum(server.ready for server in idle)
            if not idle:
                self.servers.recall_faulty()
        for depth in range(1, DEPTH + 1):
            for server in idle:
                while (size := self._size(server, depth)) and (
                    batch := self._take(server, size)
                ):
                    self.send(batch)
        self._drop_unverifiable()

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
            message = structs.replace(
                message,
                genomes=[b""] * len(genomes) if self.terms.reserve.asks else genomes,
                participants=participants.astype("<u4").tobytes(),
                seeds=seeds.astype("<u8").tobytes(),
            )
        batch.question = self.out.ask(batch.server.id, message, batch.trials)

    def _size(self, server: RemoteServer, depth: int) -> int:
        """Return the number of trials in the next batch for a server; 0 if it has enough.

        It has enough with ``depth`` trials for each ready slot, in ``depth`` batches that are not
        all started.
        """
        batches = server.batches.values()
        lacking = depth * server.ready - sum(batch.missing for batch in batches)
        waiting = sum(not batch.all_started for batch in batches)
        enough = lacking <= 0 and waiting >= depth
        if enough or len(batches) >= DEPTH * server.ready:  # it refuses more as busy
            return 0
        return max(1, min(max(lacking, self._size_by_time(server)), self._fits))

    def _size_by_time(self, server: RemoteServer) -> int:
        """Return the number of trials in a batch by measured time; 0 if none was measured yet.

        If several servers serve, a server's share of all that waits is cut into ``2 * DEPTH``
        batches: these shrink as less waits, and all servers end at about the same time. If it
        serves alone, nothing is held back for others.
        """
        if not server.trial_s:
            return 0
        serving = len(self._serving)
        parts = 2 * DEPTH if serving > 1 else 1
        share = self.queue.count * server.ready / (self._slots * parts)
        smallest = server.ready * SMALLEST_BATCH_S / server.trial_s
        work_s = max(server.trial_s, BATCH_S, serving * SERVER_S)
        largest = server.ready * (work_s / server.trial_s)
        return int(min(max(share, smallest), largest))

    def _take(self, server: RemoteServer, size: int) -> SentBatch | None:
        """Return a new batch, or None if all that waits is for others; checks come last."""
        queued = self.queue.take(server.id, size, self._serving)
        if queued is not None:
            trials, avoid, stranded = queued.trials, queued.avoid, queued.stranded
            if stranded is not None:
                stranded.server.unwanted.append(stranded.id)
        else:
            trials, avoid = self.checks.take(server.id, size), frozenset()
            if not len(trials):
                return None
        done = np.zeros(len(trials), bool)
        number, check = self.out.number(), queued is None
        return SentBatch(server, number, trials, done, len(trials), avoid, check)

    # ---- answered

    def count(self, batch: SentBatch, reply: Outcomes | Running | Fault) -> None:
        """Take the outcomes that are new.

        Raises:
            RemoteProtocolError: they are not outcomes of this batch.
        """
        assert self.workload is not None  # noqa: S101  batches are of one
        if reply.batch != batch.id:
            raise RemoteProtocolError(
                f"batch {batch.id} was answered with batch {reply.batch}"
            )
        server, terms = batch.server, self.terms
        rows, fitness, metrics = codec.outcomes(
            reply, len(batch.trials), terms.participants, terms.metrics
        )
        if not len(rows):
            return
        left = {text.partition(" (")[0]: text for text in reply.left.split("; ") if text}
        if new := left.keys() - self._left_behind:
            self._left_behind |= new
            text = "; ".join(left[kind] for kind in left if kind in new)
            self.out.note(RunEvent.SIMULATOR_LEFT, server.id, text)
        measured = reply.seconds / len(rows)
        server.trial_s = (
            0.7 * server.trial_s + 0.3 * measured if server.trial_s else measured
        )
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
        server.counted += len(trials)
        self.checks.choose(trials, [server.id] * len(trials))
        self.refill |= bool(self.checks.waiting)  # others may be idle
        self._count_once(trials, server.id, measured * len(trials))
        if self._failed_on:  # another server could evaluate what failed there
            for trial in trials:
                self.blamed += set(self._failed_on.get(trial, ())) - {server.id}

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
        batch.done |= batch.trials == trial
        self.give_back(batch)
        if batch.check:
            self.out.note(
                RunEvent.FAULT, server, f"{text} ({which}, when it was verified)"
            )
            self.checks.drop([trial])
            self.blamed.append(server)
            return
        servers = self._failed_on.setdefault(trial, [])
        servers.append(server)
        self.out.note(RunEvent.FAULT, server, f"{text} ({which}, attempt {len(servers)})")
        failed = rest[rest == trial]
        if len(servers) < ATTEMPTS:
            self._requeue(QueuedTrials(failed, frozenset(servers)))
        elif self.terms.quarantine:
            workload.faulted[trial] = True
            self._count_once(failed, "", 0.0)
        else:
            where = f"{ATTEMPTS} times, last on {server}"
            self.out.failure = f"a trial ended in a fault {where}: {text} ({which})"

    def give_back(self, batch: SentBatch) -> None:
        """Queue the trials of a batch again, which its server no longer has."""
        if not batch.check:
            self._requeue(QueuedTrials(batch.rest(), batch.avoid))
        elif self.workload is not None:
            self.refill = True
            self.checks.give_back(batch.rest(), self.workload)

    def _drop_unverifiable(self) -> None:
        """Leave trials unverified if there is no second server for them."""
        if self.checks.waiting and not self.uncounted:
            alone = self.checks.alone(self._serving)
            if alone:
                self.checks.drop(alone)
            if alone and not self._alone:
                self.out.note(
                    RunEvent.UNVERIFIED, text="there is no second server to verify with"
                )
            self._alone = bool(alone)

    def _requeue(self, entry: QueuedTrials) -> None:
        if count := len(entry.trials):
            self.refill = True
            self.queue.put(entry)
            self.out.note(RunEvent.REQUEUED, count=count)
