"""Jobs: batches of a run, and how they are cut into chunks for the slots of its lease.

A job is a batch that is not answered for good. It is cut into chunks, smaller ones towards the end,
so that the slots finish at the same time. A finished chunk adds a part to the job's outcomes.

**Memory.** A simulator may leak memory, or one trial may need too much. Three rules find out which:

1. A process that used more than half of its free memory is *recycled*: it still answers, and is
   then replaced (``Finished.recycle``). So every chunk starts with half of the memory free.
2. A chunk of several trials that runs out of memory is *exhausted*, and no trial is to blame yet.
   Its process is replaced, and the chunk is split into the trials before the one that it was at,
   that trial alone, and those after it.
3. A chunk of one trial that runs out of memory blames the trial: a fault of kind ``memory``.
"""

import math
from collections import deque
from typing import Any

import msgspec

from zswarm.protocol import codec, messages
from zswarm.protocol.messages import (
    MAX_TEXT,
    MAX_TRIALS,
    Evaluate,
    Fault,
    Outcomes,
    Refused,
)
from zswarm.ss.slots.events import Answer, CommandList, Died, Query
from zswarm.ss.slots.reply_cache import ReplyCache

# Least work in a chunk: some twenty times the time to hand out the next one.
CHUNK_S = 0.003
CHUNK_AT_MOST_S = (
    2.0  # so that slots can be given to others soon; one trial may be longer
)
SHARED_S = 0.00025  # least work in a chunk where idle slots share little work
HOLD_QUERY_S = 30.0  # a batch that takes longer is answered "running"


class Job(msgspec.Struct, eq=False):
    """A batch that is not answered for good."""

    work: Evaluate
    query: Query | None
    asked_at: float
    count: int  # of its trials
    cuttable: bool  # else a slot gets it whole, and refuses it as malformed
    waiting: list[range]  # trials to hand out; a chunk never spans two of these
    running: int = 0  # chunks in slots
    parts: list[tuple[range, Outcomes]] = []  # trials with their outcomes
    reported: int = 0  # parts that a running answer contained
    failure: Fault | Refused | None = None
    cancelled: bool = False

    def rest(self) -> int:
        """Return how many trials wait for a slot."""
        return sum(map(len, self.waiting))

    def unreported(self) -> bool:
        """Return whether a query is open that could report new outcomes."""
        return (
            self.query is not None
            and not self.cancelled
            and self.reported < len(self.parts)
        )

    def outcomes(self, first_part: int = 0) -> dict[str, Any]:
        """Return the fields of a message that report outcomes, ordered by trial."""
        parts = sorted(self.parts[first_part:], key=lambda part: part[0].start)
        found = [outcomes for _, outcomes in parts]
        left = [outcomes.left for outcomes in found if outcomes.left]
        return {
            "trials": codec.indices(trial for trials, _ in parts for trial in trials),
            "fitness": b"".join(outcomes.fitness for outcomes in found),
            "metrics": b"".join(outcomes.metrics for outcomes in found),
            "seconds": sum(outcomes.seconds for outcomes in found),
            "error": next((outcomes.error for outcomes in found if outcomes.error), ""),
            "left": "; ".join(dict.fromkeys(left))[:MAX_TEXT],
        }

    def reply(self) -> messages.Message | None:
        """Return the final answer; None if nothing of the job was evaluated."""
        if isinstance(self.failure, Refused):
            return self.failure
        fields = self.outcomes()
        if self.failure is not None:
            return msgspec.structs.replace(self.failure, **fields)
        if not self.parts:
            return None
        if sum(len(trials) for trials, _ in self.parts) == self.count:
            fields["trials"] = b""  # all
        return Outcomes(batch=self.work.batch, **fields)


class Chunk(msgspec.Struct, eq=False):
    """Trials of a job that a slot evaluates."""

    job: Job
    positions: range  # of its trials in the batch
    begun: float

    def work(self) -> Evaluate:
        """Return the request to evaluate these trials."""
        if not self.job.cuttable:
            return self.job.work
        return codec.cut(self.job.work, self.positions.start, self.positions.stop)


class JobQueue(msgspec.Struct, eq=False):
    """The jobs of a lease."""

    out: CommandList
    replies: ReplyCache
    lease: bytes
    jobs: dict[int, Job] = {}  # those that are not answered for good, by batch id
    # With trials to hand out, in order.
    waiting: deque[Job] = msgspec.field(default_factory=deque)
    trial_s: float = 0.0  # measured duration of a trial, smoothed; 0 if not known
    trials: int = 0  # number of trials with outcomes so far
    _draining: bool = False

    def ask_again(self, batch: int, query: Query) -> bool:
        """Answer a query for a batch from the cache, or attach it to its job, if there is one."""
        if reply := self.replies.use(self.lease, batch, self.out.now):
            self.out.append(Answer(query, reply))
        elif job := self.jobs.get(batch):
            self.out.refuse(job.query, "cancelled", "asked again")
            job.query, job.asked_at = query, self.out.now
        else:
            return False
        return True

    def add(self, work: Evaluate, query: Query) -> None:
        """Append a job."""
        count = len(work.seeds) // 8
        cuttable = (
            1 <= count <= MAX_TRIALS
            and len(work.seeds) % 8 == 0
            and len(work.participants) % (4 * count) == 0
        )
        count = max(1, count)
        job = Job(work, query, self.out.now, count, cuttable, [range(count)])
        self.jobs[work.batch] = job
        self.waiting.append(job)

    def next_chunk(self, slots: int, idle: int) -> Chunk:
        """Cut the next chunk for one of the idle slots of a lease.

        It is half of a slot's share of all waiting trials, but at least ``CHUNK_S`` and at most
        ``CHUNK_AT_MOST_S`` of work. If there is less work than that for each idle slot, they share
        it.
        """
        job = self.waiting[0]
        first = job.waiting[0]
        trial_s = self.trial_s
        least, shared, most = (
            (CHUNK_S / trial_s, SHARED_S / trial_s, CHUNK_AT_MOST_S / trial_s)
            if trial_s
            else (1.0, 1.0, math.inf)
        )
        rest = sum(waiting.rest() for waiting in self.waiting)
        share = min(max(rest / (2 * slots), least), rest / idle)
        size = math.ceil(max(shared, min(share, most)))
        if not job.cuttable or len(first) - size < shared / 2:
            size = len(first)
        positions, later = first[:size], first[size:]
        job.waiting[:1] = [later] if later else []
        if not job.waiting:
            self.waiting.popleft()
        job.running += 1
        return Chunk(job, positions, self.out.now)

    # ---- ends of chunks; the slot has given the chunk back

    def finished(self, chunk: Chunk, reply: Outcomes | Refused) -> int:
        """Take what a slot replied; return for how many trials it has outcomes.

        They are the first ones of the chunk if a trial left something behind in the process.
        """
        job, count = chunk.job, 0
        if isinstance(reply, Refused):
            job.failure = reply
            self._hand_out_no_more(job)
        elif not job.cancelled:
            count = len(reply.trials) // 4 or len(chunk.positions)
            job.parts.append((chunk.positions[:count], reply))
            self._hand_out_first(job, [chunk.positions[count:]])
            self.trials += count
            measured = reply.seconds / count
            self.trial_s = (
                0.7 * self.trial_s + 0.3 * measured if self.trial_s else measured
            )
        self._conclude(job)
        return count

    def exhausted(self, chunk: Chunk, trial: int) -> None:
        """Hand out an exhausted chunk again, before all else, with one trial by itself."""
        job, positions = chunk.job, chunk.positions
        if not job.cancelled:
            alone = positions[trial : trial + 1]
            parts = [positions[:trial], alone, positions[trial + 1 :]]
            self._hand_out_first(job, parts)
        self._conclude(job)

    def failed(self, chunk: Chunk, event: Died, simulator: str) -> None:
        """Blame a trial of a chunk, unless its job failed before."""
        job = chunk.job
        if event.kind != "stopped" and not job.cancelled and job.failure is None:
            reason = event.reason
            if not reason.startswith(f"simulator {simulator!r}"):
                reason = f"simulator {simulator}: {reason}"
            job.failure = Fault(
                batch=job.work.batch,
                kind=event.kind,
                trial=chunk.positions.start + event.trial,
                reason=reason[:MAX_TEXT],
            )
            self._hand_out_no_more(job)
        self._conclude(job)

    # ---- ends and answers

    def cancel(self, batches: set[int]) -> list[Job]:
        """Cancel jobs; return those whose chunks are to be stopped."""
        jobs = [self.jobs[batch] for batch in batches & self.jobs.keys()]
        jobs = [job for job in jobs if not job.cancelled]
        for job in jobs:
            job.cancelled = True
            self._hand_out_no_more(job)
            self._conclude(job)
        return jobs

    def drain(self) -> None:
        """Hand out no more trials."""
        self._draining = True
        for job in list(self.waiting):
            self._hand_out_no_more(job)
            self._conclude(job)

    def clear(self, code: messages.Refusal, reason: str) -> None:
        """Refuse all jobs."""
        for job in self.jobs.values():
            self.out.refuse(job.query, code, reason)
        self.jobs.clear()
        self.waiting.clear()

    def report(self, at: list[tuple[Chunk, int]], *, idle: bool) -> None:
        """Answer the queries that are open for long as running.

        Args:
            at: the chunks in slots, and for each the trial that its slot is at.
            idle: slots are idle: answer all queries that can report new outcomes.
        """
        for job in self.jobs.values():
            late = self.out.now - job.asked_at > HOLD_QUERY_S and not job.cancelled
            if job.query is None or not (late or (idle and job.unreported())):
                continue
            done = sum(len(trials) for trials, _ in job.parts)
            done += sum(trial for chunk, trial in at if chunk.job is job)
            running = messages.Running(
                batch=job.work.batch,
                done=done,
                given=not job.waiting,
                **job.outcomes(job.reported),
            )
            self.out.answer(job.query, running)
            job.query, job.reported = None, len(job.parts)

    def _hand_out_first(self, job: Job, parts: list[range]) -> None:
        """Hand out trials again before all others, unless none are to be handed out."""
        parts = [part for part in parts if part]
        if not parts or job.failure or self._draining:
            return
        job.waiting[:0] = parts
        if job in self.waiting:
            self.waiting.remove(job)
        self.waiting.appendleft(job)

    def _hand_out_no_more(self, job: Job) -> None:
        if job in self.waiting:
            self.waiting.remove(job)
        job.waiting = []

    def _conclude(self, job: Job) -> None:
        """Answer a job if nothing of it runs or waits any more."""
        if job.running or job.waiting:
            return
        batch = job.work.batch
        del self.jobs[batch]
        if job.cancelled:
            self.out.refuse(job.query, "cancelled", "cancelled")
        elif (reply := job.reply()) is None:
            self.out.refuse(job.query, "draining", "the server is draining")
        else:
            body = codec.encode(reply)
            self.replies.put(self.lease, batch, body, self.out.now)
            if job.query is not None:
                self.out.append(Answer(job.query, body))
