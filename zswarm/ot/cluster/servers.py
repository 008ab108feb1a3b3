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


class Servers(msgspec.Struct, eq=False):
    """All servers of a run."""

    terms: Terms
    out: Outbox
    by_id: dict[str, RemoteServer] = {}  # every server ever seen
    # Whose phase, slots or pause changed, by id: the caller revisits their batches.
    changed: dict[str, RemoteServer] = {}
    leaving: dict[str, RemoteServer] = {}  # those in the phase LEAVING
    probe: bytes = b""  # digest of the probe's outcomes, once known
    _probe_disputed: bool = False
    _probe_arbitrated: bytes = b""  # what this machine computed of it
    _ask_at: float = math.inf  # no server is due before
    _allot_at: float = math.inf  # no slots are to be allotted before

    def next_time(self) -> float:
        """Return when a server is due, or slots are to be allotted."""
        return min(self._ask_at, self._allot_at)

    def standing(self) -> Standing:
        """Return how the run stands with its servers."""
        return Standing.of(self.by_id.values(), self.probe)

    def serving(self) -> dict[str, RemoteServer]:
        """Return the servers that can be given work, those that rank first in front."""
        leased = [
            server for server in self.by_id.values() if server.phase == Phase.LEASED
        ]
        if self.terms.choice.rank:
            leased.sort(key=lambda server: server.place)
        return {
            server.id: server
            for server in leased
            if server.ready and server.paused_until is None
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
            self._ask_for_offer(server)

    def gone(self, name: str) -> None:
        """Await the end of a server's batches: with a reply if it drains, without if it died."""
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
        if query.question != server.question:
            return  # to Cancel or Release, or its server has left the phase in which it was asked
        server.question = 0
        if server.phase == Phase.LEAVING:
            return  # it is asked again when it is back
        match verb, reply:
            case "offer", Offer():
                self._offered(server, reply)
            case "reserve" | "renew", Lease():
                self._granted(server, reply)
            case _, Refused():
                self._refused(server, verb, reply)
            case _:
                if reply is not None:
                    text = query.not_answered_by(reply)
                    self.out.note(RunEvent.MALFORMED, server.id, text)
                self._not_answered(server, verb)
                return
        server.unanswered, server.silence_reported = 0, False
        server.pace.asked(self.out.now - server.asked_at, held=verb == "renew")

    def ask_due(self) -> None:
        """Ask the servers whose time has come, and end pauses."""
        now = self.out.now
        if now < self._ask_at:
            return
        self._ask_at = math.inf
        for server in self.by_id.values():
            if server.paused_until is not None and server.paused_until <= now:
                server.paused_until, server.ask_at = None, now
                self.changed[server.id] = server
            if server.ask_at <= now:
                if server.phase == Phase.BACKED_OFF:
                    self._ask_for_offer(server)
                else:
                    self._ask(server)
            due = min(server.ask_at, server.paused_until or math.inf)
            self._ask_at = min(self._ask_at, due)

    def leave(self) -> None:
        """Release all leases."""
        for server in self.by_id.values():
            if server.phase not in (Phase.IDLE, Phase.BANNED):
                self._end(server, Phase.IDLE, release=True)

    # ---- queries

    def _ask_for_offer(self, server: RemoteServer) -> None:
        self._move(server, Phase.SEEN)
        server.unanswered, server.faulty = 0, False
        self._ask(server)

    def _ask(self, server: RemoteServer) -> None:
        """Send the query that a server's phase calls for, unless it is open."""
        server.ask_at = math.inf
        if server.question:
            return
        terms = self.terms
        match server.phase:
            case Phase.SEEN:
                question = self.out.ask(server.id, terms.requirements)
            case Phase.RESERVING:
                reserve = structs.replace(terms.reserve, slots=server.wanted)
                question = self.out.ask(server.id, reserve)
            case Phase.LEASED:
                renew = Renew(lease=server.lease, known_ready=server.ready)
                question = self.out.ask(server.id, renew)
            case _:
                return
        server.question, server.asked_at = question, self.out.now

    def _ask_by(self, server: RemoteServer, time: float) -> None:
        """Ask a server at a time, or sooner, unless it leaves its phase before."""
        server.ask_at = min(server.ask_at, time)
        self._ask_at = min(self._ask_at, time)

    def _not_answered(self, server: RemoteServer, verb: Verb) -> None:
        """Ask again a server that may be too busy, or not known to the link yet."""
        if server.unanswered < len(RETRY_S):
            self._ask_by(server, self.out.now + RETRY_S[server.unanswered])
            server.unanswered += 1
        else:
            self.back_off(server, verb)

    # ---- offers and reservations

    def _offered(self, server: RemoteServer, offer: Offer) -> None:
        if mismatch := self.terms.choice.mismatch(offer):
            self._move(server, Phase.IDLE)
            if server.mismatch != mismatch:
                self.out.note(RunEvent.SERVER_MISMATCH, server.id, mismatch)
            server.mismatch = mismatch
            return
        self._move(server, Phase.SPARE)
        server.capacity, server.mismatch = offer.capacity, ""
        server.features = frozenset(offer.features)
        server.place = self.terms.choice.place(offer)
        if self.terms.choice.max_slots:
            self._allot_at = min(self._allot_at, self.out.now + ALLOT_AFTER_S)
        else:
            self._reserve(server, self.terms.reserve.slots)

    def _reserve(self, server: RemoteServer, slots: int) -> None:
        self._move(server, Phase.RESERVING)
        server.wanted = slots
        self._ask(server)

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
                self._end(server, Phase.SPARE, release=True)
                self.out.note(RunEvent.SERVER_SPARE, server.id, text)
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
            server.probe = lease.probe
            if (trial := server.differs_at(self.probe)) is not None:
                self._probe_differs(server, trial)
                return
            self.probe = max(self.probe, server.probe, key=len)
        if not server.pace.trial_s:
            server.pace.trial_s = lease.trial_s
        self._ask_by(server, server.asked_at + RENEW_S)
        if lease.ready != was_ready:
            self.changed[server.id] = server
            event = RunEvent.SERVER_SLOTS if was_ready else RunEvent.SERVER_JOINED
            self.out.note(event, server.id, count=lease.ready)
        if server.ready < min(server.wanted, server.capacity):
            self._ask(server)  # the server answers when more slots are ready

    def _refused(self, server: RemoteServer, verb: Verb, refused: Refused) -> None:
        match verb, refused.code:
            case "renew", "lease-lost":
                self.lease_lost(server, refused.reason)
            case "renew", _:
                self.drop(server, RunEvent.SERVER_REFUSED, refused.reason)
            case "reserve", "superseded":
                self._move(server, Phase.IDLE)
                self.out.failure = f"{server.id}: {refused.reason}"
            case _:
                self._move(server, Phase.IDLE)
                self.out.note(RunEvent.SERVER_REFUSED, server.id, refused.reason)

    def drop(self, server: RemoteServer, note: RunEvent, text: str) -> None:
        """Release the lease of a server; do not use it until its token appears again."""
        self._end(server, Phase.IDLE, release=True)
        self.out.note(note, server.id, text)

    def lose(self, server: RemoteServer) -> None:
        """Give up a server whose token vanished, once none of its batches is out."""
        self._end(server, Phase.IDLE, resumable=True)
        self.out.note(RunEvent.SERVER_LOST, server.id)

    def lease_lost(self, server: RemoteServer, reason: str) -> None:
        """Reserve again, after a pause, at a server that ended the lease."""
        if server.phase == Phase.LEAVING:
            self._end(server, Phase.IDLE)
        else:
            self._end(server, Phase.BACKED_OFF, again_s=PAUSE_S)
        self.out.note(RunEvent.LEASE_LOST, server.id, reason)

    def back_off(self, server: RemoteServer, verb: Verb) -> None:
        """Ask a server that did not answer repeatedly again only after a pause."""
        if server.phase == Phase.LEASED or not server.silence_reported:
            self.out.note(RunEvent.SERVER_SILENT, server.id, f"no answer to {verb}")
        server.silence_reported = True
        self._end(server, Phase.BACKED_OFF, resumable=True, again_s=BACK_OFF_S)

    def pause(self, server: RemoteServer) -> None:
        """Send no batch to a server without room for a while, then renew its lease."""
        server.paused_until = self.out.now + PAUSE_S
        self._ask_at = min(self._ask_at, server.paused_until)
        self.changed[server.id] = server

    # ---- servers that are wrong or faulty

    def _probe_differs(self, server: RemoteServer, trial: int) -> None:
        if server.differs_at(self._probe_arbitrated) is not None:
            self.ban(server, "its outcomes of the probe are wrong")
            return
        self._end(server, Phase.BACKED_OFF, release=True, again_s=BACK_OFF_S)
        text = f"trial {trial} of the probe differs; this machine plays {trial + 1} and decides"
        self.out.note(RunEvent.SERVER_DIFFERS, server.id, text)
        if not self._probe_disputed:
            self._probe_disputed = True
            self.out.commands.append(ProbeDisputed(trial + 1))

    def arbitrate_probe(self, digest: bytes) -> None:
        """Ban the servers whose outcomes of the probe differ from this machine's."""
        self.probe, self._probe_arbitrated, self._probe_disputed = digest, digest, False
        for server in self.by_id.values():
            if server.differs_at(digest) is not None:
                self.ban(server, "its outcomes of the probe are wrong")
            elif server.probe and server.phase == Phase.BACKED_OFF:
                self._ask_by(server, self.out.now)

    def ban(self, server: RemoteServer, text: str) -> None:
        """Never use a server again, and retract what was counted for it."""
        if server.phase == Phase.BANNED:
            return
        # Before the note: if the record ends between the two, a resumed run finds the server out
        # again. The other way round it would restore what was counted for the server.
        self.out.commands.append(Retracted(server.id))
        self._end(server, Phase.BANNED, release=True)
        self.out.note(RunEvent.SERVER_WRONG, server.id, text)

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
            self._end(server, Phase.BACKED_OFF, release=True, again_s=FAULTY_S)
            self.out.note(RunEvent.SERVER_FAULTY, server.id, text)
            server.blamed, server.counted, server.faulty = 0, 0, True

    def recall_faulty(self) -> None:
        """Ask faulty servers again soon: they are better than none."""
        for server in self.by_id.values():
            if server.phase == Phase.BACKED_OFF and server.faulty:
                self._ask_by(server, self.out.now + PAUSE_S)

    # ---- state

    def _server(self, name: str) -> RemoteServer:
        return self.by_id.setdefault(name, RemoteServer(name))

    def _end(
        self,
        server: RemoteServer,
        to: Phase,
        *,
        release: bool = False,
        resumable: bool = False,
        again_s: float = math.inf,
    ) -> None:
        """Drop the lease of a server, if it has one, and move the server to another phase.

        Args:
            release: the server is to free the slots.
            resumable: the server may still hold the lease, and have its batches.
            again_s: seconds until it is asked for its offer again, if no token appears before.
        """
        if release and server.lease:
            self.out.ask(server.id, Release(lease=server.lease))
        held = server.lease or server.resumable_lease
        server.resumable_lease = held if resumable else b""
        server.lease, server.slots, server.ready = b"", 0, 0
        server.paused_until = None
        self._move(server, to)
        self._ask_by(server, self.out.now + again_s)
        self.changed[server.id] = server

    def _move(self, server: RemoteServer, to: Phase) -> None:
        """Move a server to another phase: the only place that does."""
        if to not in MOVES[server.phase]:
            raise LocalProtocolError(f"{server.id} cannot go from {server.phase} to {to}")
        both = {server.phase, to}
        server.phase, server.ask_at = to, math.inf
        self.leaving.pop(server.id, None)
        if to == Phase.LEAVING:
            self.leaving[server.id] = server
        if both != {Phase.LEASED, Phase.LEAVING}:
            server.question = 0
        if Phase.LEASED in both:
            self.changed[server.id] = server
        if {Phase.RESERVING, Phase.LEASED} & both:
            self._allot_soon()

    def _allot_soon(self) -> None:
        if self.terms.choice.max_slots:
            self._allot_at = 0.0
