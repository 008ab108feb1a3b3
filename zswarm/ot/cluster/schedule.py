"""Who gets how many trials: what servers are expected to take, by what was measured of them.

- A batch has about 75 ms of work for each slot; more if the way to the server takes longer. It
  shrinks towards the end of a workload that several servers share.
- A server has two batches, so that it computes one while the next is on its way. Trials that are
  long compared with that way wait here instead, once there is less than one for each slot: then
  the first server that is idle gets them.
- A server gets trials only if it is expected to end them before the others would have done all
  that waits: as long as a list of trials would take that gives each to where it ends first.
"""

import heapq
import math

import msgspec

from zswarm.ot.cluster.events import Outbox
from zswarm.ot.cluster.matching import Terms
from zswarm.ot.cluster.queue import TrialQueue
from zswarm.ot.cluster.recovery import patience_s
from zswarm.ot.cluster.remote_server import RemoteServer, SentBatch
from zswarm.ot.workload import Workload
from zswarm.protocol import messages

DEPTH = 2  # batches per server: one is evaluated, and one waits behind it
# In a message; a trial whose genomes are larger is a batch of its own.
BATCH_BYTES = 4 << 20
BATCH_S = 0.075  # of work in a batch for each slot, by measured time
# Of work in a batch for each slot, times the number of servers that serve: if each of N servers
# ends a batch every N * 2 ms, the optimizer has one to handle every 2 ms. That takes it 0.5 ms at
# most, a quarter of its time.
SERVER_S = 0.002
# Of work for each slot: with less, the way to a server and back would take longer than a batch.
SMALLEST_BATCH_S = 0.003
# A trial is long that takes this many times as long as its server is idle between two trials: a
# round trip, and the time until a server with idle slots answers.
LONG, IDLE_S = 10.0, 0.01
TOLERANCE = 1.05  # of what a server may take longer than others: times are estimates
ROUNDS = 2  # of trials on all slots; the end of more is estimated by rates alone
# An estimate is made again after this share of the time until the estimated end, but not before so
# long for each server; and when this share of the slots came or left.
STALE, ESTIMATE_SERVER_S = 1 / 8, 0.00005


class Schedule(msgspec.Struct, eq=False):
    """What the servers of a workload are expected to do."""

    out: Outbox
    queue: TrialQueue
    serving: dict[str, RemoteServer] = {}  # servers that can be given work
    slots: int = 0  # of these
    # Slots and rate of each, as they are summed.
    _summed: dict[str, tuple[int, float]] = {}
    fits: int = 1  # trials that fit into a message
    _genome_bytes: float = 0.0  # of a trial's candidates
    _trial_bytes: float = 1.0  # of a trial on a link beside them
    _alike: float = 1.0  # trials in a row of the same candidates
    _trial_timeout_s: float = 0.0
    _rate: float = 0.0  # trials per second of all that serve
    _end: float = 0.0  # of all that waits, as estimated last
    _stale_at: float = -math.inf
    _moved: int = 0  # slots that came or left since then

    def begin(self, workload: Workload, terms: Terms) -> None:
        """Schedule the trials of a workload."""
        participants = terms.participants
        self._trial_timeout_s = terms.reserve.trial_timeout_s
        genomes = [] if terms.reserve.asks else workload.genomes
        sent = (max(map(len, genomes), default=0) + 16) * participants + 16
        answered = 8 * (participants + terms.metrics) + 4
        by_bytes = BATCH_BYTES // max(sent, answered)
        self.fits = min(
            messages.MAX_TRIALS, messages.MAX_GENOMES // participants, by_bytes
        )
        trials = len(workload.seeds)
        candidates = max(1, len(genomes))
        self._genome_bytes = sum(map(len, genomes)) / candidates * participants
        self._trial_bytes = 16 * participants + answered
        self._alike = max(1.0, trials * participants / candidates)
        self._stale_at = -math.inf
        for server in self.serving.values():
            self._sum(server)

    def serve(self, server: RemoteServer) -> None:
        """Schedule for a server that can be given work, or has other slots than before."""
        self.serving[server.id] = server
        self._sum(server)

    def leave(self, server: RemoteServer) -> bool:
        """Schedule nothing for a server any more; return whether anything was."""
        served = self.serving.pop(server.id, None) is not None
        if served:
            self._sum(server)
        return served

    def _sum(self, server: RemoteServer) -> None:
        """Sum slots and rates with those of a server as it is now."""
        serves = server.id in self.serving
        now = (server.ready, self.rate(server)) if serves else (0, 0.0)
        slots, rate = self._summed.pop(server.id, (0, 0.0))
        if serves:
            self._summed[server.id] = now
        self.slots, self._rate = self.slots + now[0] - slots, self._rate + now[1] - rate
        self._moved += abs(now[0] - slots)
        if self._moved > STALE * self.slots:
            self._stale_at = -math.inf

    def rate(self, server: RemoteServer) -> float:
        """Return the trials per second of a server; 0.0 if none was measured."""
        if not (server.pace.trial_s and server.ready):
            return 0.0
        return 1.0 / server.pace.each_s(server.ready, self._bytes_each(server))

    def _bytes(self, trials: int) -> float:
        """Return the bytes of some trials in a row on a link, at most: some share candidates."""
        genomes = min(trials, 1 + math.ceil((trials - 1) / self._alike))
        return genomes * self._genome_bytes + trials * self._trial_bytes

    def _bytes_each(self, server: RemoteServer) -> float:
        """Return the bytes of each of as many trials as a server has slots."""
        return self._bytes(server.ready) / max(1, server.ready)

    def computed(self, server: RemoteServer, seconds: float, trials: int) -> None:
        """Take the seconds that a server computed for some trials."""
        server.pace.computed(seconds, trials)
        if server.id in self.serving:
            self._sum(server)

    # ---- what is measured

    def expect(self, batch: SentBatch, *, alone: bool) -> None:
        """Expect the answer to a batch that is sent now.

        Args:
            alone: nothing else is with its server, so that the time to the answer is the batch's.
        """
        server, now = batch.server, self.out.now
        batch.sent_at = server.pace.batch_at = now
        batch.due, batch.alone = self.due(server, batch.missing), alone
        server.pace.sent_by = self._sent_by(server, batch.missing)
        self.be_patient(batch)

    def be_patient(self, batch: SentBatch) -> None:
        """Give a server the time in which it sends an outcome of a batch if it computes."""
        batch.give_up_at = self.out.now + patience_s(batch, self._trial_timeout_s)

    def answered(self, batch: SentBatch, trial_s: float) -> None:
        """Measure by a batch that was answered, whose trials took that long."""
        server = batch.server
        if batch.alone:
            rounds = math.ceil(len(batch.trials) / max(1, server.ready))
            elapsed = self.out.now - batch.sent_at
            server.pace.batch_answered(elapsed, trial_s * rounds, batch.size)

    def overtaken(self, batch: SentBatch) -> None:
        """Measure by a batch that was not answered before another server had all its trials."""
        server = batch.server
        if batch.alone and server.ready:
            trials_s = server.pace.trials_s(len(batch.trials), server.ready)
            elapsed = self.out.now - batch.sent_at
            server.pace.batch_overtaken(elapsed, trials_s, batch.size)

    # ---- sizes of batches

    def size(self, server: RemoteServer, depth: int) -> int:
        """Return the number of trials in the next batch for a server; 0 if it has enough.

        It has enough with ``depth`` trials for each ready slot, in ``depth`` batches that are not
        all started.
        """
        batches = server.batches.values()
        missing = sum([batch.missing for batch in batches])
        lacking = depth * server.ready - missing
        waiting = sum([not batch.all_started for batch in batches])
        enough = lacking <= 0 and (waiting >= depth or self._waits_here(server))
        if enough or len(batches) >= DEPTH * server.ready:  # it refuses more as busy
            return 0
        if depth > 1 and self._waits_here(server):
            return 0
        size = max(lacking, self._size_by_time(server))
        if not server.pace.link_measured and len(self.serving) > 1:
            first = server.pace.first_trials(self._bytes(1))
            if missing >= first:
                return 0
            size = min(size, first - missing)
        return max(1, min(size, self.fits))

    def _waits_here(self, server: RemoteServer) -> bool:
        """Return whether trials wait here rather than behind others of a server."""
        if self.queue.count >= self.slots or len(self.serving) < 2:
            return False
        pace = server.pace
        return pace.trial_s > LONG * (pace.round_trip_s + IDLE_S)

    def _size_by_time(self, server: RemoteServer) -> int:
        """Return the number of trials in a batch by measured time; 0 if none was measured yet.

        If several servers serve, a server's share of all that waits is cut into ``2 * DEPTH``
        batches: these shrink as less waits, and all servers end at about the same time. If it
        serves alone, nothing is held back for others.
        """
        pace = server.pace
        if not pace.trial_s:
            return 0
        each_s = pace.each_s(server.ready, self._bytes_each(server))
        serving = len(self.serving)
        parts = 2 * DEPTH if serving > 1 else 1
        share = self.queue.count / (each_s * max(self._rate, 1e-9) * parts)
        smallest_s = max(SMALLEST_BATCH_S, pace.round_trip_s)
        work_s = max(pace.trial_s, BATCH_S, serving * SERVER_S, 2 * pace.round_trip_s)
        return int(min(max(share, smallest_s / each_s), work_s / each_s))

    # ---- expected ends

    def due(self, server: RemoteServer, trials: int) -> float:
        """Return when trials are expected to be done that are sent to a server now."""
        pace = server.pace
        begin = self._sent_by(server, trials) + pace.round_trip_s
        if batches := server.batches.values():
            missing = sum([batch.missing for batch in batches])
            if missing + trials > server.ready:
                latest = max([batch.due for batch in batches])
                begin = max(begin, self._end_of(server, latest, missing))
        return begin + pace.trials_s(trials, server.ready)

    def _sent_by(self, server: RemoteServer, trials: int) -> float:
        """Return when trials are expected to be through the link that are sent now."""
        begin = max(self.out.now, server.pace.sent_by) if server.batches else self.out.now
        return begin + self._bytes(trials) * server.pace.byte_s

    def ends(self, batch: SentBatch) -> float:
        """Return when a batch is expected to be done; one that is late, in as long again."""
        missing = sum(other.missing for other in batch.server.batches.values())
        return self._end_of(batch.server, batch.due, missing)

    def _end_of(self, server: RemoteServer, due: float, missing: int) -> float:
        """Return when what was due then is expected to be done, of all that a server misses."""
        now, pace = self.out.now, server.pace
        if due <= now:
            return 2 * now - due
        # Slots may have become ready since it was sent.
        on_link_s = self._bytes(missing) * pace.byte_s
        backlog_s = on_link_s + pace.trials_s(missing, server.ready)
        return min(due, now + pace.round_trip_s + backlog_s)

    def fitting(self, server: RemoteServer, trials: int, end: float) -> int:
        """Return how many trials, at most, are expected to be done by then; 0 if none is."""
        while trials and self.due(server, trials) > end:
            trials //= 2
        return trials

    def useful(self, server: RemoteServer, trials: int, *, checks: int = 0) -> int:
        """Return how many of some trials a server does not end later than others would.

        Args:
            checks: trials that wait for a second machine: one of the two that are first to end one.
        """
        if len(self.serving) < 2:
            return trials
        now = self.out.now
        if now >= self._stale_at:
            self._end = max(
                self._expected_end(self.queue.count + checks),
                self._first_end(machines=2 if checks else 1),
            )
            # All are looked at: not for every trial where there are many.
            least_s = ESTIMATE_SERVER_S * len(self.serving)
            self._stale_at = now + max(least_s, STALE * (self._end - now))
            self._moved = 0
        return self.fitting(server, trials, now + TOLERANCE * (self._end - now))

    def _first_end(self, machines: int) -> float:
        """Return when so many machines can have ended a trial each: nothing ends before that."""
        first: dict[str, float] = {}
        for server in self.serving.values():
            end = first.get(server.machine, math.inf)
            first[server.machine] = min(end, self.due(server, 1))
        return max(sorted(first.values())[:machines])

    def _expected_end(self, waiting: int) -> float:
        """Return when all that waits is done if each trial is done where it ends first."""
        for server in self.serving.values():
            self._sum(server)
        servers = [server for server in self.serving.values() if self.rate(server)]
        if waiting > ROUNDS * self.slots:
            return self._end_by_rates(waiting, servers)
        rounds = [one for server in servers for one in self._rounds(server)]
        if not rounds:
            return math.inf
        heapq.heapify(rounds)
        while True:
            end, step, trials = rounds[0]
            waiting -= trials
            if waiting <= 0:
                return end
            heapq.heapreplace(rounds, (end + step, step, trials))

    def _end_by_rates(self, waiting: int, servers: list[RemoteServer]) -> float:
        """Return when all that waits is done by the servers that end a trial before that."""
        found = []
        for server in servers:
            pace, each_s = server.pace, 1.0 / self.rate(server)
            missing = sum(batch.missing for batch in server.batches.values())
            ahead = missing - min(missing, server.ready) / 2  # what runs is half done
            begin_s = pace.round_trip_s + ahead * each_s
            found.append((begin_s + max(pace.trial_s, each_s), begin_s, 1.0 / each_s))
        found.sort()
        trials, rate, end_s = float(waiting), 0.0, math.inf
        for first_s, begin_s, each in found:
            if first_s >= end_s:
                break
            trials, rate = trials + begin_s * each, rate + each
            end_s = max(first_s, trials / rate)
        return self.out.now + end_s

    def _rounds(self, server: RemoteServer) -> list[tuple[float, float, int]]:
        """Return rounds of a server: when the first ends, seconds of a further one, trials."""
        pace = server.pace
        link_s, trial_s = self._bytes_each(server) * pace.byte_s, pace.trial_s
        first = self.out.now + pace.round_trip_s + link_s + trial_s
        ends = [self.ends(batch) for batch in server.batches.values()]
        if link_s * server.ready > trial_s:
            return [(max([first, *(end + link_s for end in ends)]), link_s, 1)]
        missing = sum(batch.missing for batch in server.batches.values())
        busy = min(missing, server.ready)
        rounds = [(first, trial_s, server.ready - busy)] if busy < server.ready else []
        if busy:
            free = min(ends) if missing <= server.ready else max(ends)
            rounds.append((max(first, free + trial_s), trial_s, busy))
        return rounds
