"""Ask servers for offers, reserve and renew leases, and release them (phases: ``remote_server``).

A lease that was dropped for silence may still be valid at the server. It is resumed, with the
batches that are stranded there, if the server grants it again.
"""

import heapq
import math

import msgspec
from msgspec import structs

from zswarm.errors import LocalProtocolError
from zswarm.ot.cluster.allotment import Allotment
from zswarm.ot.cluster.events import OpenQuery, Outbox, Superseded
from zswarm.ot.cluster.machines import THIS, Machines, name_of
from zswarm.ot.cluster.matching import Terms
from zswarm.ot.cluster.remote_server import MOVES, Phase, RemoteServer, Standing
from zswarm.ot.cluster.roster import Roster
from zswarm.ot.notes import RunEvent
from zswarm.protocol import messages
from zswarm.protocol.messages import Lease, Offer, Refused, Release, Renew, Reply, Verb
from zswarm.system.format import plural

# A third of the lease time; only replies to Reserve and Renew have the number of slots.
RENEW_S = 20.0
RETRY_S = (0.05, 0.2, 1.0)  # before a query that was not answered is sent again
PAUSE_S = 1.0  # before a server that had no room, or that ended the lease, is asked again
# Before a server that did not answer is asked again, unless it is seen before.
BACK_OFF_S = 30.0


class Servers(msgspec.Struct, eq=False):
    """All servers of a run."""

    terms: Terms
    out: Outbox
    by_id: dict[str, RemoteServer] = {}  # those that are known
    # Whose phase, slots or pause changed, by id: the caller revisits their batches.
    changed: dict[str, RemoteServer] = {}
    leaving: dict[str, RemoteServer] = {}  # those in the phase LEAVING
    # Those that are not known any more; the caller takes them out.
    forgotten: list[str] = []
    probe: bytes = b""  # digest of the probe's outcomes, once known
    differing: list[RemoteServer] = []  # with another digest; the caller takes them out
    roster: Roster = msgspec.field(default_factory=Roster)
    machines: Machines = msgspec.UNSET  # type: ignore[assignment]
    allotment: Allotment = msgspec.UNSET  # type: ignore[assignment]
    # When servers are due; an entry counts only if its server is still due then.
    _due: list[tuple[float, str]] = []

    def __post_init__(self) -> None:
        self.allotment = Allotment(self.terms, self.roster)
        self.machines = Machines.after(self.terms.known)

    def next_time(self) -> float:
        """Return when a server is due, or slots are to be allotted."""
        while self._due and not self._is_due(*self._due[0]):
            heapq.heappop(self._due)
        return min(self._due[0][0] if self._due else math.inf, self.allotment.at)

    def standing(self) -> Standing:
        """Return how the run stands with its servers."""
        return self.roster.standing(self.probe)

    def serves(self, server: RemoteServer) -> bool:
        """Return whether a server can be given work."""
        return server.id in self.roster.ready and server.paused_until is None

    # ---- events

    def seen(self, name: str, *, own: bool = False) -> None:
        """Ask a server whose token appeared; if only its link was cut, resume its lease."""
        server = self.known(name)
        server.present, server.own = True, own
        if own:
            self.roster.own.add(name)
        self.roster.came(name)
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
        server.present = False
        if server.phase == Phase.LEASED:
            out = sum(batch.missing for batch in server.batches.values())
            self.out.note(RunEvent.SERVER_LEFT, name, plural(out, "unanswered trial"))
            self._move(server, Phase.LEAVING)
        elif server.phase == Phase.IDLE:
            self._remember(server)
        elif server.phase not in (Phase.LEAVING, Phase.BANNED):
            self._move(server, Phase.IDLE)

    def answered(self, query: OpenQuery, reply: Reply | None, machine: str = "") -> None:
        """Take the reply of a machine to any query but Evaluate."""
        server, verb = self.by_id.get(query.server), query.verb
        if server is None or query.question != server.question:
            return  # to Cancel or Release, or its server has left the phase in which it was asked
        server.question, asked_at = 0, server.asked_at  # it may be asked at once again
        if server.phase == Phase.LEAVING:
            return  # it is asked again when it is back
        match verb, reply:
            case "offer", Offer():
                self._offered(server, reply, machine)
            case "reserve" | "renew", Lease():
                server.growing &= verb == "renew"
                self._granted(server, reply, verb)
            case _, Refused():
                self._refused(server, verb, reply)
            case _:
                if reply is not None:
                    text = query.not_answered_by(reply)
                    self.out.note(RunEvent.MALFORMED, server.id, text)
                self._not_answered(server, verb)
                return
        server.unanswered, server.silence_reported = 0, False
        server.pace.asked(self.out.now - asked_at, held=verb == "renew")

    def ask_due(self) -> None:
        """Ask the servers whose time has come, and end pauses."""
        now = self.out.now
        while self._due and self._due[0][0] <= now:
            entry = heapq.heappop(self._due)
            if not self._is_due(*entry):
                continue
            server = self.by_id[entry[1]]
            if server.paused_until is not None and server.paused_until <= now:
                server.paused_until, server.ask_at = None, now
                self.changed[server.id] = server
            if server.ask_at <= now:
                if server.phase == Phase.BACKED_OFF:
                    self._ask_for_offer(server)
                else:
                    self._ask(server)

    def _is_due(self, time: float, name: str) -> bool:
        server = self.by_id.get(name)
        return server is not None and time in (server.ask_at, server.paused_until)

    def leave(self) -> None:
        """Release all leases."""
        for server in list(self.by_id.values()):
            if server.phase not in (Phase.IDLE, Phase.BANNED):
                self.end(server, Phase.IDLE, release=True)

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
            case Phase.RESERVING | Phase.LEASED if server.growing or not server.lease:
                mine = messages.proof(terms.secret, server.id)
                fields = {"slots": server.wanted, "proof": mine}
                reserve = structs.replace(terms.reserve, **fields)
                question = self.out.ask(server.id, reserve)
            case Phase.LEASED:
                renew = Renew(lease=server.lease, known_ready=server.ready)
                question = self.out.ask(server.id, renew)
            case _:
                return
        server.question, server.asked_at = question, self.out.now

    def ask_by(self, server: RemoteServer, time: float) -> None:
        """Ask a server at a time, or sooner, unless it leaves its phase before."""
        if time < server.ask_at:
            server.ask_at = time
            heapq.heappush(self._due, (time, server.id))

    def _not_answered(self, server: RemoteServer, verb: Verb) -> None:
        """Ask again a server that may be too busy, or not known to the link yet."""
        if server.unanswered < len(RETRY_S):
            self.ask_by(server, self.out.now + RETRY_S[server.unanswered])
            server.unanswered += 1
        else:
            self.back_off(server, verb)

    # ---- offers and reservations

    def _offered(self, server: RemoteServer, offer: Offer, machine: str) -> None:
        server.machine = THIS if server.own else machine or self.machines.of(server.id)
        if banned := self.machines.why_banned(server.machine):
            self._move(server, Phase.IDLE)
            self._note_once(RunEvent.SERVER_BANNED, server, banned)
            return
        if mismatch := self.terms.choice.mismatch(offer):
            self._move(server, Phase.IDLE)
            if server.mismatch != mismatch:
                self._note_once(RunEvent.SERVER_MISMATCH, server, mismatch)
            server.mismatch = mismatch
            return
        server.capacity, server.mismatch = offer.capacity, ""
        server.features = frozenset(offer.features)
        server.place = self.terms.choice.place(offer)
        self.allotment.offered(server, offer.free, self.out.now)
        self._move(server, Phase.SPARE)

    def allot(self) -> None:
        """Reserve and release servers until the run holds as many slots as it wants."""
        allotment, now = self.allotment, self.out.now
        if now < allotment.at:
            return
        while (server := allotment.surplus()) is not None:
            server.free = server.slots
            text = "as many slots as wanted are held without it"
            self.end(server, Phase.SPARE, release=True)
            self.out.note(RunEvent.SERVER_SPARE, server.id, text)
        allotment.at = math.inf
        while (choice := allotment.choose(now)) is not None:
            asked, wanted = choice
            asked.wanted = wanted
            self._move(asked, Phase.RESERVING)
            self._ask(asked)
        at = allotment.at if allotment.at > now else math.inf
        while (choice := allotment.partial()) is not None:
            grown, wanted = choice
            grown.wanted, grown.growing = wanted, True
            self.roster.update(grown)
            self._ask(grown)
        allotment.rounds(now)
        allotment.at = at

    def pause_run(self, *, paused: bool) -> None:
        """Release all leases while the run pauses; ask for slots again when it is over."""
        self.allotment.paused, self.allotment.at = paused, 0.0

    # ---- leases

    def _granted(self, server: RemoteServer, lease: Lease, verb: Verb) -> None:
        was_ready, again_s = server.ready, server.granted(lease)
        self.roster.update(server)
        self.allotment.granted(server)
        if lease.state == "failed" and lease.passing:
            self.set_back(server, RunEvent.SERVER_UNPREPARED, lease.reason)
            return
        if lease.state == "failed":
            self.drop(server, RunEvent.SERVER_REFUSED, lease.reason)
            return
        if server.phase == Phase.RESERVING:
            self._move(server, Phase.LEASED)
            self.out.note(RunEvent(f"lease_{lease.state}"), server.id, count=server.slots)
        if lease.probe:
            server.probe = lease.probe
            if server.differs_at(self.probe) is not None:
                self.differing.append(server)
                return
            self.probe = max(self.probe, server.probe, key=len)
        if not server.pace.trial_s:
            server.pace.trial_s = lease.trial_s
        self.ask_by(server, server.asked_at + RENEW_S)
        if server.ready != was_ready:
            self.changed[server.id] = server
            event = RunEvent.SERVER_SLOTS if was_ready else RunEvent.SERVER_JOINED
            joined = "" if was_ready else server.machine
            self.out.note(event, server.id, count=server.ready, machine=joined)
            self.machines.use(server.id, server.machine)
        if server.ready < min(server.wanted, server.capacity):
            # The server answers when more slots are ready, or after a while.
            again_at = server.asked_at + again_s
            if verb == "reserve" or again_at <= self.out.now:
                self._ask(server)
            else:
                self.ask_by(server, again_at)

    def _refused(self, server: RemoteServer, verb: Verb, refused: Refused) -> None:
        taken_over = (verb, refused.code) == ("reserve", "superseded")
        if (verb, refused.code) == ("renew", "lease-lost"):
            self.lease_lost(server, refused.reason)
        elif server.phase == Phase.LEASED:
            self.drop(server, RunEvent.SERVER_REFUSED, refused.reason)
        else:
            full = refused.code == "busy"  # it has as many leases as it may
            to = Phase.BACKED_OFF if full else Phase.IDLE
            self.end(server, to, again_s=BACK_OFF_S if full else math.inf)
            if not (taken_over and server.own):
                self._note_once(RunEvent.SERVER_REFUSED, server, refused.reason)
        if taken_over and server.own:
            self.out.failure = f"{server.id}: {refused.reason}"
        elif taken_over:
            self.out.commands.append(Superseded(server.id, refused.reason))

    def drop(self, server: RemoteServer, note: RunEvent, text: str) -> None:
        """Release the lease of a server; do not use it until its token appears again."""
        self.end(server, Phase.IDLE, release=True)
        self.out.note(note, server.id, text)

    def lose(self, server: RemoteServer) -> None:
        """Give up a server whose token vanished, once none of its batches is out."""
        self.end(server, Phase.IDLE, resumable=True)
        self.out.note(RunEvent.SERVER_LOST, server.id)

    def lease_lost(self, server: RemoteServer, reason: str) -> None:
        """Ask a server that ended the lease for its offer again, after a pause."""
        if server.phase == Phase.LEAVING:
            self.end(server, Phase.IDLE)
        else:
            self.end(server, Phase.BACKED_OFF, again_s=PAUSE_S)
        self.out.note(RunEvent.LEASE_LOST, server.id, reason)

    def set_back(self, server: RemoteServer, note: RunEvent, text: str) -> None:
        """Release a server that cannot serve now; ask for its offer after an increasing delay."""
        pause_s = server.next_setback_s()
        to = Phase.BACKED_OFF if Phase.BACKED_OFF in MOVES[server.phase] else Phase.IDLE
        if to in MOVES[server.phase]:
            self.end(server, to, release=True, again_s=pause_s)
        self.out.note(note, server.id, text, pause_s)

    def back_off(self, server: RemoteServer, verb: Verb) -> None:
        """Ask a server that did not answer repeatedly again only after a pause."""
        text = f"no answer to {verb}"
        if server.phase == Phase.LEASED:
            self.out.note(RunEvent.SERVER_SILENT, server.id, text)
        elif not server.silence_reported:
            self._note_once(RunEvent.SERVER_SILENT, server, text)
        server.silence_reported = True
        self.end(server, Phase.BACKED_OFF, resumable=True, again_s=BACK_OFF_S)

    def pause_server(self, server: RemoteServer) -> None:
        """Send no batch to a server without room for a while, then renew its lease."""
        server.paused_until = self.out.now + PAUSE_S
        heapq.heappush(self._due, (server.paused_until, server.id))
        self.changed[server.id] = server

    # ---- state

    def known(self, name: str) -> RemoteServer:
        """Return a server; one that was not known is IDLE."""
        if name not in self.by_id:
            self.by_id[name] = RemoteServer(name, machine=self.machines.of(name))
        return self.by_id[name]

    def _note_once(self, event: RunEvent, server: RemoteServer, text: str) -> None:
        self.out.note_once(event, server.id, text, server.machine, name_of(server.id))

    def end(
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
        server.paused_until, server.growing = None, False
        self._move(server, to)
        self.ask_by(server, self.out.now + again_s)
        self.changed[server.id] = server

    def _move(self, server: RemoteServer, to: Phase) -> None:
        """Move a server to another phase: the only place that does."""
        if to not in MOVES[server.phase]:
            raise LocalProtocolError(f"{server.id} cannot go from {server.phase} to {to}")
        was, both = server.phase, {server.phase, to}
        server.phase, server.ask_at = to, math.inf
        self.leaving.pop(server.id, None)
        if to == Phase.LEAVING:
            self.leaving[server.id] = server
        if both != {Phase.LEASED, Phase.LEAVING}:
            server.question = 0
        if Phase.LEASED in both:
            self.changed[server.id] = server
        if to == Phase.IDLE and not server.present:
            self._remember(server)
        self.roster.update(server)
        self.allotment.follow(server, was)

    def _remember(self, server: RemoteServer) -> None:
        """Remember an IDLE server without a token for a while, and forget those before it."""
        for oldest in self.roster.remember(server, self.out.now):
            del self.by_id[oldest.id]
            self.forgotten.append(oldest.id)
