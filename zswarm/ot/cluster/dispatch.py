"""Which server evaluates what: a pure state machine. Events and the time go in, commands come out.

``servers`` is the life of a server, from its first sign to the release of its lease; ``batches``
is the workload, from waiting trials to counted ones. What follows from their state is derived once
at the end of each event.

No server is trusted to end: each query has a deadline, and each batch. What follows from the answer
to a query for a batch, and first of all its outcomes are counted:

==========================  ================================  ====================================
answer                      the batch                         the server
==========================  ================================  ====================================
none, three times at most   is asked for again in a moment    stays
none, then                  waits for any server (stranded)   is backed off
none, its token vanished    waits for any server (stranded)   is lost
running, with outcomes      is asked for again at once        stays
running, with none          is asked for again, a second      stays
                            after it was asked for at least
running, for too long       waits for any server              is backed off, longer each time
outcomes                    its rest waits for any server     stays
fault                       the same; one trial is blamed     stays, or is backed off as faulty
unknown-batch               is sent whole                     stays
malformed                   its first trial is blamed         stays, or is backed off as faulty
lease-lost                  waits for any server              reserves again after a second
draining                    waits for any server              is expected to leave
mismatch                    waits for any server              is not used
another refusal             waits for any server              is sent no batch for a second
what is no answer           waits for any server              is not used
what cannot be handled      waits for any server              is backed off, longer each time
==========================  ================================  ====================================

"Too long": ``recovery.patience_s``.
"""

import traceback
from pathlib import Path

from zswarm.errors import LocalProtocolError, RemoteProtocolError
from zswarm.ot.cluster import events
from zswarm.ot.cluster.bans import Bans
from zswarm.ot.cluster.batches import Batches
from zswarm.ot.cluster.events import Answered, Command, Event, OpenQuery, Outbox
from zswarm.ot.cluster.matching import Terms
from zswarm.ot.cluster.queue import QueuedTrials
from zswarm.ot.cluster.recovery import misplaced
from zswarm.ot.cluster.remote_server import AGAIN_S, Phase, RemoteServer, SentBatch
from zswarm.ot.cluster.servers import RETRY_S, Servers
from zswarm.ot.notes import RunEvent
from zswarm.protocol.messages import Cancel, Fault, Outcomes, Refused, Reply, Running
from zswarm.system.format import duration, plural


class Dispatch:
    """The state machine: ``handle`` takes an event, ``next_time`` is when TimePassed is due."""

    def __init__(self, terms: Terms) -> None:
        self.out = Outbox()
        self.servers = Servers(terms, self.out, probe=terms.probe)
        self.bans = Bans(self.out, self.servers, terms.known.arbitrated)
        self.batches = Batches.of(terms, self.out, self.servers)
        self._just_answered_by: RemoteServer | None = None  # a batch

    def next_time(self) -> float:
        """Return when TimePassed is due."""
        parts = (self.servers, self.batches.idle, self.out)
        return min(part.next_time() for part in parts)

    def handle(self, event: Event, now: float) -> list[Command]:
        """Take an event at a time (seconds, monotonic); return the commands, in order."""
        out = self.out
        out.now, out.commands, out.failure = now, [], ""
        self._just_answered_by = None
        if isinstance(event, Answered):
            self._answered(event)
        else:
            self._happened(event)
            self._derive()
        if out.failure:
            out.commands.append(events.Failed(out.failure))
        return out.commands

    def _happened(self, event: Event) -> None:
        servers, batches = self.servers, self.batches
        match event:
            case events.Seen():
                servers.seen(event.server, own=event.own)
            case events.Gone():
                servers.gone(event.server)
            case events.Work():
                batches.begin(event.workload)
            case events.Arbitrated():
                for name in batches.checks.arbitrate(
                    event.trial, event.fitness, event.metrics
                ):
                    self.bans.ban_wrong(name, event.trial)
            case events.ProbeArbitrated():
                self.bans.arbitrate_probe(event.digest)
            case events.TimePassed():
                for question in self.out.overdue():
                    self._answered(Answered(question, None))
                self._repeat()
                servers.ask_due()
                batches.idle.look(self.out.now)
            case events.Pause():
                servers.pause_run(paused=event.paused)
            case events.Leave():
                batches.end()
                servers.leave()

    def _derive(self) -> None:
        """Do what follows from the state."""
        out, servers, batches = self.out, self.servers, self.batches
        if out.failure:
            batches.end()
        while batches.blamed:
            self.bans.blame(batches.blamed.pop(0))
        self.bans.judge_probes()
        servers.allot()
        self._follow()
        for server in [
            server for server in servers.leaving.values() if not server.batches
        ]:
            servers.lose(server)
        self._follow()
        batches.fill(self._just_answered_by)
        if batches.workload is not None and not servers.roster.ready:
            self.bans.recall_faulty()
        if not out.failure and batches.finish_if_done():
            out.commands.append(events.Complete())

    def _follow(self) -> None:
        changed, self.servers.changed = self.servers.changed, {}
        for server in changed.values():
            self.batches.follow(server)

    def _repeat(self) -> None:
        for query in self.out.due():
            if (batch := self._sent(query)) is not None:
                self.batches.ask(batch)

    def _answered(self, event: Answered) -> None:
        """Take an answer; if it cannot be handled, put aside the server that sent it."""
        query = self.out.queries.pop(event.question, None)
        if query is None:
            return  # its time was over
        batch = self._sent(query)
        try:
            self._take(query, batch, event)
            self._derive()
        except LocalProtocolError:
            raise
        except Exception as error:
            self._not_handled(query, batch, error)

    def _take(self, query: OpenQuery, batch: SentBatch | None, event: Answered) -> None:
        reply = event.reply
        if isinstance(reply, str):
            self.out.note(RunEvent.MALFORMED, query.server, reply)
            reply = None
        if not query.batch:
            self.servers.answered(query, reply, event.machine)
        elif batch is not None:
            self._just_answered_by = batch.server
            self._batch_answered(query, batch, reply)

    def _not_handled(
        self, query: OpenQuery, batch: SentBatch | None, error: Exception
    ) -> None:
        """Back a server off, and queue what is nowhere: its answer was handled in part."""
        batches, workload = self.batches, self.batches.workload
        place = traceback.extract_tb(error.__traceback__)[-1]
        text = f"{type(error).__name__}: {error} ({Path(place.filename).name}, line {place.lineno})"
        server = self.servers.known(query.server)
        self.servers.set_back(server, RunEvent.ANSWER_FAILED, text)
        batches.idle.moved |= self.servers.by_id
        self._follow()
        if workload is None:
            self._derive()
            return
        if batch is not None and batch.check:
            batches.checks.give_back(batch.rest(), workload)
        elif batch is not None:
            batches.second.lost(batch)
        lost = misplaced(workload, batches.queue, self.servers.by_id.values())
        batches.requeue(QueuedTrials(lost))
        batches.uncounted = int((~workload.counted).sum())
        self._derive()

    def _sent(self, query: OpenQuery) -> SentBatch | None:
        """Return the batch of a query, or None if another server has it or its workload ended."""
        server = self.servers.by_id.get(query.server)
        batch = server.batches.get(query.batch) if server is not None else None
        wanted = self.batches.workload is not None
        return batch if wanted and batch and batch.question == query.question else None

    def _batch_answered(
        self, query: OpenQuery, batch: SentBatch, reply: Reply | None
    ) -> None:
        """Do what the table above says."""
        if reply is None:
            self._batch_not_answered(query, batch)
            return
        batches, server = self.batches, batch.server
        del server.batches[batch.id]  # it is out no more, unless it is sent again
        try:
            match reply:
                case Running():
                    self._batch_runs(query, batch, reply)
                case Outcomes():
                    batches.count(batch, reply)
                    batches.give_back(batch)
                case Fault():
                    batches.count(batch, reply)
                    batches.fault(batch, reply.trial, f"{reply.kind}: {reply.reason}")
                case Refused(code="unknown-batch") if batch.asked == "by-id":
                    batch.asked = ""  # it was lost on the way
                    batches.send(batch)
                case Refused(code="malformed"):
                    batches.fault(batch, 0, f"refused: {reply.reason}")
                case Refused():
                    batches.give_back(batch)
                    self._refused(server, reply)
                case _:
                    raise RemoteProtocolError(query.not_answered_by(reply))
        except RemoteProtocolError as error:
            batches.give_back(batch)
            self.servers.drop(server, RunEvent.MALFORMED, str(error))

    def _batch_runs(self, query: OpenQuery, batch: SentBatch, reply: Running) -> None:
        batches, now, heard = self.batches, self.out.now, batch.heard.sum()
        batches.count(batch, reply)
        if not batch.missing:  # other servers sent what it still computes
            cancel = Cancel(lease=batch.server.lease, batches=[batch.id])
            self.out.ask(batch.server.id, cancel)
            return
        batch.unanswered = 0
        batch.all_started |= reply.given
        again_at = now
        if batch.heard.sum() > heard:
            batches.schedule.be_patient(batch)
        elif now > batch.give_up_at:
            for stalled in (batch, *batch.server.batches.values()):
                stalled.avoid |= {batch.server.machine}
            batches.give_back(batch)
            trials = plural(batch.missing, "trial")
            time = duration(now - batch.sent_at)
            text = f"{trials} sent {time} ago still run, without an outcome"
            self.servers.set_back(batch.server, RunEvent.SERVER_STALLED, text)
            return
        else:
            again_at = query.asked_at + AGAIN_S
        batch.server.batches[batch.id] = batch
        if again_at > now:
            self.out.later(again_at - now, query)
        else:
            batches.ask(batch)

    def _batch_not_answered(self, query: OpenQuery, batch: SentBatch) -> None:
        batch.alone = False
        if batch.server.phase == Phase.LEAVING:
            self.batches.strand(batch)
        elif batch.unanswered < len(RETRY_S):
            self.out.later(RETRY_S[batch.unanswered], query)
            batch.unanswered += 1
        else:
            self.servers.back_off(batch.server, "evaluate")

    def _refused(self, server: RemoteServer, refused: Refused) -> None:
        match refused.code:
            case "draining":
                self.servers.gone(server.id)  # its token will vanish, too
            case "lease-lost":
                self.servers.lease_lost(server, refused.reason)
            case "mismatch":
                self.servers.drop(server, RunEvent.SERVER_REFUSED, refused.reason)
            case _:  # busy, or cancelled without a request: wait before sending more
                self.servers.pause_server(server)
