"""Which server evaluates what: a pure state machine. Events and the time go in, commands come out.

``servers`` is the life of a server, from its first sign to the release of its lease; ``batches``
is the workload, from waiting trials to counted ones. What follows from their state is derived once
at the end of each event.
"""

from zswarm.errors import RemoteProtocolError
from zswarm.ot.cluster import events
from zswarm.ot.cluster.bans import Bans
from zswarm.ot.cluster.batches import Batches
from zswarm.ot.cluster.events import Answered, Command, Event, OpenQuery, Outbox
from zswarm.ot.cluster.matching import Terms
from zswarm.ot.cluster.remote_server import Phase, RemoteServer, SentBatch
from zswarm.ot.cluster.servers import RETRY_S, Servers
from zswarm.ot.notes import RunEvent
from zswarm.protocol.messages import Cancel, Fault, Outcomes, Refused, Reply, Running


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
        out, servers, batches = self.out, self.servers, self.batches
        out.now, out.commands, out.failure = now, [], ""
        self._just_answered_by = None
        match event:
            case Answered():
                self._answered(event)
            case events.Seen():
                servers.seen(event.server)
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
                self._repeat()
                servers.ask_due()
                batches.idle.look(now)
            case events.Pause():
                servers.pause_run(paused=event.paused)
            case events.Leave():
                batches.end()
                servers.leave()
        self._derive()
        return out.commands

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
        if out.failure:
            out.commands.append(events.Failed(out.failure))
        elif batches.finish_if_done():
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
        query, reply = self.out.queries.pop(event.question, None), event.reply
        if query is None:
            return
        if isinstance(reply, str):
            self.out.note(RunEvent.MALFORMED, query.server, reply)
            reply = None
        if not query.batch:
            self.servers.answered(query, reply, event.machine)
        elif (batch := self._sent(query)) is not None:
            self._just_answered_by = batch.server
            self._batch_answered(query, batch, reply)

    def _sent(self, query: OpenQuery) -> SentBatch | None:
        """Return the batch of a query, or None if another server has it or its workload ended."""
        server = self.servers.by_id.get(query.server)
        batch = server.batches.get(query.batch) if server is not None else None
        wanted = self.batches.workload is not None
        return batch if wanted and batch and batch.question == query.question else None

    def _batch_answered(
        self, query: OpenQuery, batch: SentBatch, reply: Reply | None
    ) -> None:
        if reply is None:
            self._batch_not_answered(query, batch)
            return
        batches, server = self.batches, batch.server
        del server.batches[batch.id]  # it is out no more, unless it is sent again
        try:
            match reply:
                case Running():
                    batches.count(batch, reply)
                    batch.unanswered = 0
                    batch.all_started |= reply.given
                    if batch.missing:
                        batches.send(batch)
                    else:  # other servers sent what it still computes
                        cancel = Cancel(lease=server.lease, batches=[batch.id])
                        self.out.ask(server.id, cancel)
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
            case "busy":
                self.servers.pause(server)
            case "draining":
                self.servers.gone(server.id)  # its token will vanish, too
            case "lease-lost":
                self.servers.lease_lost(server, refused.reason)
            case "mismatch":
                self.servers.drop(server, RunEvent.SERVER_REFUSED, refused.reason)
            case _:
                pass  # cancelled, in its other cases: only the batch is affected
