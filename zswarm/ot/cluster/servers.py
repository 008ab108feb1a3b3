"""Ask servers for offers, reserve and renew leases, and release them (phases: ``remote_server``).

A lease that was dropped for silence may still be valid at the server. It is resumed, with the
batches that are stranded there, if the server grants it again.
"""

import math

import msgspec
from msgspec import structs

from zswarm.errors import LocalProtocolError
from zswarm.ot.cluster.events import OpenQuery, Outbox, ProbeDisputed, Retracted
from zswarm.ot.cluster.matching import Terms
from zswarm.ot.cluster.remote_server import MOVES, Phase, RemoteServer, Standing
from zswarm.ot.notes import RunEvent
from zswarm.protocol.messages import Lease, Offer, Refused, Release, Renew, Reply, Verb

# A third of the lease time; only the reply to a renewal has the current number of slots.
RENEW_S = 20.0
RETRY_S = (0.05, 0.2, 1.0)  # before a query that was not answered is sent again
# From the first offer until slots are allotted: the best are known then.
ALLOT_AFTER_S = 1.0
PAUSE_S = 1.0  # before a server that had no room, or that ended the lease, is asked again
# Before a server that did not answer is asked again, unless it is seen before.
BACK_OFF_S = 30.0
FAULTY_S = 600.0  # the same for a server on which too many trials failed
# A query is of use only while its server is in this phase.
ASKED_IN: dict[Verb, Phase] = {
    "offer": Phase.SEEN,
    "reserve": Phase.RESERVING,
    "renew": Phase.LEASED,
}


class Servers(msgspec.Struct, eq=False):
    """All servers of a run."""

    terms: Terms
    out: Outbox
    by_id: dict[str, RemoteServer] = {}  # every server ever seen
    # Their phase or slots changed; the caller takes them out.
    moved: list[RemoteServer] = []
    leaving: dict[str, RemoteServer] = {}  # those in the phase LEAVING
    probe: bytes = b""  # digest of the probe's outcomes, once known
    _probe_disputed: bool = False
    _probe_arbitrated: bool = False
    _renew_at: float = math.inf  # no lease is to be renewed before
    _allot_at: float = math.inf  # no slots are to be allotted before

    def next_time(self) -> float:
        """Return when a lease is to be renewed, or slots to be allotted."""
        return min(self._renew_at, self._allot_at)

    def standing(self) -> Standing:
        """Return how the run stands with its servers."""
        return Standing.of(self.by_id.values(), self.probe)

    def serving(self) -> dict[str, RemoteServer]:
        """Return the servers that can be given work, those that rank first in front."""
        servers = self._leased()
        if self.terms.choice.rank:
            servers.sort(key=lambda server: server.place)
        now = self.out.now
        return {
            server.id: server
            for server in servers
            if server.ready and server.paused_until <= now
        }

    # ---- events

    def seen(self, name: str) -> None:
        """Ask a server whose token appeared; if only its link was cut, resume its lease."""
        server = self._server(name)
        if server.phase == Phase.LEAVING:
            self._move(server, Phase.LEASED)
            self.out.note(RunEvent.SERVER_BACK, name)
            self._ask(server)
        elif server.phase in (Phase.IDLE, Phase.BACKED_OFF, Phase.SPARE):
            self._look(server)

    def gone(self, name: str) -> None:
        """Await the end of a server's queries: with a reply if it drains, without if it died."""
        server = self.by_id.get(name)
        if server is None:
            return
        if server.phase == Phase.LEASED:
            out = sum(batch.missing for batch in server.batches.values())
            self.out.note(RunEvent.SERVER_LEFT, name, f"{out} trials were with it")
            self._move(server, Phase.LEAVING)
        elif server.phase not in (Phase.LEAVING, Phase.BANNED, Phase.IDLE):
            self._move(server, Phase.IDLE)

    def answered(self, query: OpenQuery, reply: Reply | None) -> None:
        """Take the reply to any query but Evaluate."""
        server, verb = self.by_id[query.server], query.verb
        if verb == "renew" and query.lease == server.lease:
            server.renewing = False
            self._renew_by(server)
        if server.phase != ASKED_IN.get(verb) or query.lease != server.lease:
            return  # a reply to Cancel or Release, or to a lease that has ended
        if reply is not None:
            server.empties, server.silent = 0, False
        match verb, reply:
            case _, None:
                self._not_answered(server, query)
            case "offer", Offer():
                self._offered(server, reply)
            case "reserve" | "renew", Lease():
                self._granted(server, reply)
            case "reserve", Refused(code="superseded"):
                self._move(server, Phase.IDLE)
                self.out.failure = f"{server.id}: {reply.reason}"
            case "renew", Refused(code="lease-lost"):
                self.lease_lost(server, reply.reason)
            case "offer" | "reserve", Refused():
                self._move(server, Phase.IDLE)
                self.out.note(RunEvent.SERVER_REFUSED, server.id, reply.reason)
            case "renew", Refused():
                self.drop(server, RunEvent.SERVER_REFUSED, reply.reason)
            case _:
                self.out.note(RunEvent.MALFORMED, server.id, query.not_answered_by(reply))
                self._not_answered(server, query)

    def repeat(self, query: OpenQuery) -> None:
        """Send a query again if its server is still in the phase for it."""
        server = self.by_id[query.server]
        self.moved.append(server)
        if server.phase == ASKED_IN[query.verb]:
            self._ask(server)
        elif query.verb == "offer" and server.phase == Phase.BACKED_OFF:
            self._look(server)

    def renew_due(self) -> None:
        """Renew the leases whose time has come."""
        now = self.out.now
        if now < self._renew_at:
            return
        leased = self._leased()
        for server in leased:
            if server.renew_at <= now:
                self._ask(server)
        waiting = (server.renew_at for server in leased if not server.renewing)
        self._renew_at = min(waiting, default=math.inf)

    def leave(self) -> None:
        """Release all leases."""
        for server in self.by_id.values():
            self._release(server)
            server.lease = b""
            if server.phase not in (Phase.IDLE, Phase.BANNED):
                self._move(server, Phase.IDLE)

    # ---- offers and reservations

    def _look(self, server: RemoteServer) -> None:
        self._move(server, Phase.SEEN)
        server.empties = 0
        self._ask(server)

    def _offered(self, server: RemoteServer, offer: Offer) -> None:
        if mismatch := self.terms.choice.mismatch(offer):
            self._move(server, Phase.IDLE)
            if server.mismatch != mismatch:
                self.out.note(RunEvent.SERVER_MISMATCH, server.id, mismatch)
            server.mismatch = mismatch
            return
        self._move(server, Phase.SPARE)
        server.capacity, server.mismatch = offer.capacity, ""
        server.place = self.terms.choice.place(offer)
        if self.terms.choice.max_slots:
            self._allot_at = min(self._allot_at, self.out.now + ALLOT_AFTER_S)
        else:
            self._reserve(server, self.terms.reserve.slots)

    def _reserve(self, server: RemoteServer, slots: int) -> None:
        self._move(server, Phase.RESERVING)
        server.wanted = slots
        self._ask(server)

    def _ask(self, server: RemoteServer) -> None:
        """Send the query that a server's phase calls for: Requirements, Reserve or Renew."""
        out, terms = self.out, self.terms
        if server.phase == Phase.SEEN:
            out.ask(server.id, terms.requirements)
        elif not server.renewing:
            server.renew_at = out.now + RENEW_S
            self._renew_by(server)
            if server.phase == Phase.RESERVING:
                out.ask(server.id, structs.replace(terms.reserve, slots=server.wanted))
            else:
                server.renewing = True
                out.ask(server.id, Renew(lease=server.lease, known_ready=server.ready))

    def allot(self) -> None:
        """Reserve and release servers until the run holds ``max_slots`` slots, if that changed.

        The servers that rank first are reserved. Held slots stay, except those beyond the limit:
        the servers that rank last are released.
        """
        if self.out.now < self._allot_at:
            return
        servers = sorted(self.by_id.values(), key=lambda server: server.place)
        # A lease may have no slot now, because other runs hold them, and get some later.
        room = self.terms.choice.max_slots - sum(server.taken() for server in servers)
        for server in reversed(servers):
            if room < 0 and server.phase == Phase.LEASED and server.slots:
                room += server.slots
                text = "as many slots as wanted are held without it"
                self.drop(server, RunEvent.SERVER_SPARE, text, Phase.SPARE)
        for server in servers:
            if room > 0 and server.phase == Phase.SPARE:
                self._reserve(
                    server, min(room, server.capacity, self.terms.reserve.slots)
                )
                room -= server.wanted
        self._allot_at = math.inf

    # ---- leases

    def _granted(self, server: RemoteServer, lease: Lease) -> None:
        was_ready = server.ready
        server.lease, server.slots, server.ready = lease.lease, lease.slots, lease.ready
        self._allot_soon()
        if lease.state == "failed":
            self.drop(server, RunEvent.SERVER_REFUSED, lease.reason)
            return
        if server.phase == Phase.RESERVING:
            self._move(server, Phase.LEASED)
            self.out.note(RunEvent(f"lease_{lease.state}"), server.id, count=lease.slots)
        if lease.probe:
            server.probe, self.probe = lease.probe, self.probe or lease.probe
            if server.probe != self.probe:
                self._probe_differs(server)
                return
        if not server.trial_s:
            server.trial_s = lease.trial_s
        self._renew_by(server)
        if lease.ready != was_ready:
            self.moved.append(server)
            event = RunEvent.SERVER_SLOTS if was_ready else RunEvent.SERVER_JOINED
            self.out.note(event, server.id, count=lease.ready)
        if server.ready < min(server.wanted, server.capacity):
            self._ask(server)  # the server answers when more slots are ready

    def _renew_by(self, server: RemoteServer) -> None:
        self._renew_at = min(self._renew_at, server.renew_at)

    def _release(self, server: RemoteServer) -> None:
        if server.lease:
            self.out.ask(server.id, Release(lease=server.lease))

    def drop(
        self, server: RemoteServer, note: RunEvent, text: str, to: Phase = Phase.IDLE
    ) -> None:
        """Use a server no more; release its lease if it has one."""
        self._release(server)
        self._end(server, to, note, text)

    def lease_lost(self, server: RemoteServer, reason: str) -> None:
        """Reserve again, after a pause, at a server that ended the lease."""
        leaving = server.phase == Phase.LEAVING
        to = Phase.IDLE if leaving else Phase.BACKED_OFF
        self._end(server, to, RunEvent.LEASE_LOST, reason)
        if not leaving:
            self._offer_in(PAUSE_S, server)

    def lose(self, server: RemoteServer) -> None:
        """Give up a server whose token vanished, once all its queries have ended."""
        self._end(server, Phase.IDLE, RunEvent.SERVER_LOST, "", resumable=True)

    def back_off(self, server: RemoteServer, verb: Verb) -> None:
        """Ask a server that did not answer repeatedly again only after a pause."""
        if server.phase == Phase.LEASED or not server.silent:
            text = f"no answer to {verb}"
            self._end(
                server, Phase.BACKED_OFF, RunEvent.SERVER_SILENT, text, resumable=True
            )
        else:
            self._move(server, Phase.BACKED_OFF)
        server.silent = True
        self._offer_in(BACK_OFF_S, server)

    def pause(self, server: RemoteServer) -> None:
        """Send no batch to a server without room for a while, then renew its lease."""
        server.paused_until = self.out.now + PAUSE_S
        self.moved.append(server)
        self.out.later(PAUSE_S, OpenQuery(server.id, "renew"))

    def _not_answered(self, server: RemoteServer, query: OpenQuery) -> None:
        """Ask again a server that may be too busy, or not known to the link yet."""
        if server.empties < len(RETRY_S):
            self.out.later(RETRY_S[server.empties], query)
            server.empties += 1
        else:
            self.back_off(server, query.verb)

    def _offer_in(self, delay_s: float, server: RemoteServer) -> None:
        self.out.later(delay_s, OpenQuery(server.id, "offer"))

    # ---- servers that are wrong or faulty

    def _probe_differs(self, server: RemoteServer) -> None:
        if self._probe_arbitrated:
            self.ban(server, "its outcomes of the probe are wrong")
            return
        text = "its outcomes of the probe differ from those of other servers; this machine decides"
        self.drop(server, RunEvent.SERVER_DIFFERS, text, Phase.BACKED_OFF)
        self._offer_in(BACK_OFF_S, server)
        if not self._probe_disputed:
            self._probe_disputed = True
            self.out.commands.append(ProbeDisputed())

    def arbitrate_probe(self, digest: bytes) -> None:
        """Ban the servers whose outcomes of the probe differ from this machine's."""
        self.probe, self._probe_arbitrated = digest, True
        for server in self.by_id.values():
            if server.probe and server.probe != digest:
                self.ban(server, "its outcomes of the probe are wrong")
            elif server.probe == digest and server.phase == Phase.BACKED_OFF:
                self._offer_in(0.0, server)

    def ban(self, server: RemoteServer, text: str) -> None:
        """Never use a server again, and retract what was counted for it."""
        if server.phase == Phase.BANNED:
            return
        # Before the note: the record may end between the two.
        self.out.commands.append(Retracted(server.id))
        self.drop(server, RunEvent.SERVER_WRONG, text, Phase.BANNED)

    def ban_wrong(self, name: str, trial: int) -> None:
        """Ban a server for its outcome of a trial; after a resume it may not be known yet."""
        self.ban(self._server(name), f"its outcome of trial {trial} is wrong")

    def blame(self, name: str) -> None:
        """Back off a server on which too many trials fail, if there is another one."""
        server = self.by_id[name]
        server.blamed += 1
        if server.phase != Phase.LEASED or not server.fails_too_much():
            return
        if set(self.standing().serving) - {name}:
            text = f"{server.blamed} trials that failed on it did not fail elsewhere"
            self.drop(server, RunEvent.SERVER_FAULTY, text, Phase.BACKED_OFF)
            server.blamed, server.counted, server.faulty = 0, 0, True
            self._offer_in(FAULTY_S, server)

    def recall_faulty(self) -> None:
        """Ask faulty servers again soon: they are better than none."""
        for server in self.by_id.values():
            if server.phase == Phase.BACKED_OFF and server.faulty:
                server.faulty = False
                self._offer_in(PAUSE_S, server)

    # ---- state

    def _server(self, name: str) -> RemoteServer:
        return self.by_id.setdefault(name, RemoteServer(name))

    def _leased(self) -> list[RemoteServer]:
        return [server for server in self.by_id.values() if server.phase == Phase.LEASED]

    def _end(
        self,
        server: RemoteServer,
        to: Phase,
        note: RunEvent,
        text: str,
        *,
        resumable: bool = False,
    ) -> None:
        """Drop a lease; it can be resumed if it may still be valid at the server."""
        server.previous = (server.lease or server.previous) if resumable else b""
        server.lease, server.slots, server.ready, server.renewing = b"", 0, 0, False
        if server.phase != to:
            self._move(server, to)
        self.moved.append(server)
        self.out.note(note, server.id, text)

    def _move(self, server: RemoteServer, to: Phase) -> None:
        """Move a server to another phase: the only place that does."""
        if to not in MOVES[server.phase]:
            raise LocalProtocolError(f"{server.id} cannot go from {server.phase} to {to}")
        both = {server.phase, to}
        server.phase = to
        self.leaving.pop(server.id, None)
        if to == Phase.LEAVING:
            self.leaving[server.id] = server
        if Phase.LEASED in both:
            self.moved.append(server)
        if {Phase.RESERVING, Phase.LEASED} & both:
            self._allot_soon()

    def _allot_soon(self) -> None:
        if self.terms.choice.max_slots:
            self._allot_at = 0.0
