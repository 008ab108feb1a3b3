"""Leases: which run may use which slots, and for how long.

A run sends ``Reserve`` and holds one lease from then on (its states: ``state``). How slots are
shared among leases: ``sharing``.

A lease ends, from every state, when

- its run releases it,
- its run reserves again with a higher epoch: the new lease replaces it and keeps its place in the
  order of leases,
- no message of its run came for ``state.LEASE_S``, or
- the liveliness token of its run vanished, and neither it nor a message came for
  ``state.GRACE_S``.

Then its queries are answered with ``lease-lost``, its cached replies are dropped, and its slots
become free: an idle one at once, a working one when it has stopped.

A program draws a ``nonce`` for each cluster that it opens, and sends it with every ``Reserve``: the
same nonce gets the same lease, which is how a program resumes a lease after its link was cut.
``epoch`` is how often the run was resumed: ``zswarm-ot resume`` raises it in the record. So the
slots of a run that another program resumes are taken over, and the first program is refused with
``superseded`` when it reserves again. It ends if this is a server of its own machine, and otherwise
if its record confirms the resume (docs/protocol.md, "Life of a lease").

``proof`` shows that a program has the run's secret, which its record holds. Only who shows the
proof of a lease takes it over, or ends the program that holds it; a lease of an older program,
which has no proof, is taken over by the epoch alone.
"""

from collections import Counter, OrderedDict
from collections.abc import Callable
from typing import NamedTuple

from zswarm.protocol.messages import MAX_TEXT, PROBE_DIGEST, Refusal, Reserve
from zswarm.ss.slots.events import (
    CommandList,
    PlayProbe,
    Prepared,
    PrepareSlot,
    StopSlot,
)
from zswarm.ss.slots.jobs import JobQueue
from zswarm.ss.slots.reply_cache import ReplyCache
from zswarm.ss.slots.sharing import Sharing
from zswarm.ss.slots.state import HeldLease, KnownProbe, Slot, problem_key

MAX_ENDED = 10_000  # runs whose last lease is remembered
REMEMBER_S = 600.0  # after a run's last lease ended
MAX_JUMP = (
    1_000  # of an epoch: more resumes than there can be while a server remembers a run
)
MAX_LEASES = 1_000
MAX_LEASES_OF_USER = 64
MAX_PROBES = 1_000  # problems whose probe is remembered


class Ended(NamedTuple):
    """The last lease of a run that has none now."""

    proof: bytes
    epoch: int
    at: float


class LeaseTable(dict[tuple[str, str], HeldLease]):
    """The leases by user and run."""

    def __init__(
        self, out: CommandList, new_token: Callable[[], bytes], server: str
    ) -> None:
        super().__init__()
        self.sharing = Sharing(server)
        self.replies = ReplyCache()
        self._out, self._new_token = out, new_token
        # By problem, as long as the server runs; those used last at the end.
        self._probes: OrderedDict[bytes, KnownProbe] = OrderedDict()
        self._ended: OrderedDict[tuple[str, str], Ended] = (
            OrderedDict()
        )  # the oldest first

    def refusal(
        self, user: str, run: str, reserve: Reserve
    ) -> tuple[Refusal, str] | None:
        """Return why a run may not have a new lease, or None."""
        self._forget()
        lease, ended = self.get((user, run)), self._ended.get((user, run))
        if lease is None:
            if refusal := self._full(user):
                return refusal
            if ended is None or ended.proof != reserve.proof:
                return None
            return _outdated(ended.epoch, reserve.epoch, held=False)
        held = lease.reserve
        if held.proof == reserve.proof:
            return _outdated(held.epoch, reserve.epoch, held=True)
        if held.proof or _outdated(held.epoch, reserve.epoch, held=True):
            return "busy", "a program that does not know this run's secret has its name"
        return None

    def _full(self, user: str) -> tuple[Refusal, str] | None:
        own = sum(lease.user == user for lease in self.values())
        if own >= MAX_LEASES_OF_USER:
            return "busy", f"{user} has {own} leases here, as many as one user may"
        if len(self) >= MAX_LEASES:
            return "busy", f"there are {len(self)} leases here, as many as there may be"
        return None

    def _forget(self) -> None:
        """Forget the runs whose last lease ended long ago, or before too many others."""
        while self._ended:
            oldest = next(iter(self._ended.values()))
            if len(self._ended) <= MAX_ENDED and self._out.now - oldest.at <= REMEMBER_S:
                break
            self._ended.popitem(last=False)

    def grant(self, user: str, run: str, reserve: Reserve) -> HeldLease:
        """Add a lease, in the place of the previous lease of the run if there is one."""
        self._ended.pop((user, run), None)
        previous = self.get((user, run))
        now, token = self._out.now, self._new_token()
        jobs = JobQueue(self._out, self.replies, token)
        lease = HeldLease(token, user, run, reserve, reserve.slots, now, now, jobs)
        self[user, run] = lease
        if previous is not None:
            lease.used, lease.used_at_turn = previous.used, previous.used_at_turn
            self._close(previous, "taken over")
        return lease

    def end(self, lease: HeldLease, how: str) -> None:
        """End a lease, and refuse all of its queries."""
        del self[lease.user, lease.run]
        proof, epoch = lease.reserve.proof, lease.reserve.epoch
        self._ended[lease.user, lease.run] = Ended(proof, epoch, self._out.now)
        self._close(lease, how)

    def _close(self, lease: HeldLease, how: str) -> None:
        """Log the end of a lease, drop its replies, refuse its queries, and take its slots."""
        self._out.log("lease_" + how.replace(" ", "_"), user=lease.user, run=lease.run)
        self.replies.drop(lease.token)
        self._strip(lease, "lease-lost", f"the lease was {how}")
        for renewal in lease.renewals:
            self._out.refuse(renewal.query, "lease-lost", f"the lease was {how}")

    def fail(self, lease: HeldLease, reason: str, *, passing: bool) -> None:
        """Fail a lease whose problem could not be prepared."""
        self._out.log("prepare_failed", user=lease.user, run=lease.run, reason=reason)
        lease.failure, lease.passing = reason[:MAX_TEXT], passing
        self._strip(lease, lease.failure_code, reason)

    def _strip(self, lease: HeldLease, code: Refusal, reason: str) -> None:
        """Refuse the jobs of a lease and take its slots: busy ones stop, preparing ones finish."""
        lease.jobs.clear(code, reason)
        for slot in list(lease.slots):
            if slot.state == "busy":
                self._out.append(StopSlot(slot.index))
            self.give_back(slot)

    def give_back(self, slot: Slot) -> None:
        """Take a slot from its lease; one that works is free when it stopped."""
        if slot.lease is not None:
            slot.lease.slots.remove(slot)
            slot.lease = None
        working = slot.state in ("preparing", "busy")
        slot.move("stopping" if working else "free", self._out.now)

    # ---- preparing, and the probe

    def prepare(self, lease: HeldLease) -> None:
        """Prepare the slots that are assigned, and have them play the probe."""
        self._look_up_probe(lease)
        alone = lease.probe is None and not lease.trials.compiled
        for slot in lease.slots:
            if slot.state != "assigned":
                continue
            if lease.prepared(slot):
                slot.move("ready", self._out.now)
            elif not alone or not any(one.state == "preparing" for one in lease.slots):
                self._prepare(lease, slot)
        if lease.probe is None:
            self._play_probe(lease)
        if not lease.served and lease.ready() and lease.probe is not None:
            lease.served = True
            self._out.log(
                "lease_ready",
                user=lease.user,
                run=lease.run,
                trial_s=lease.probe.trial_s,
                probe_trials=len(lease.probe.digest) // PROBE_DIGEST,
            )

    def _prepare(self, lease: HeldLease, slot: Slot) -> None:
        first, most = 0, 1
        if lease.probe is None:
            first, most = lease.trials.prepare(lease.playing(), self._out.now)
        slot.move("preparing", self._out.now)
        slot.prepared_for, slot.probing = lease.reserve, range(first, first + 1)
        self._out.append(PrepareSlot(slot.index, lease.reserve, first, most))

    def _play_probe(self, lease: HeldLease) -> None:
        """Hand out trials of the probe to slots that are prepared; know it when it is over."""
        trials, now = lease.trials, self._out.now
        for slot in lease.slots:
            if slot.state != "ready":
                continue
            if some := trials.next(lease.playing(), len(lease.slots), now):
                slot.move("preparing", now)
                slot.probing = some
                self._out.append(PlayProbe(slot.index, some.start, len(some)))
        if trials.known(lease.playing(), now):
            self._know_played(lease)

    def probe_played(self, lease: HeldLease, event: Prepared) -> None:
        """Take trials of the probe that a slot of a lease played."""
        lease.trials.played(event)
        # Slots that were late may bring more of it than was awaited.
        known = lease.probe
        if known is not None and len(lease.trials.digest()) > len(known.digest):
            self._know_played(lease)

    def _know_played(self, lease: HeldLease) -> None:
        """Cache the probe of a lease's problem."""
        trial_s = 0.0 if lease.reserve.asks else lease.trials.trial_s
        probe = KnownProbe(lease.trials.digest(), trial_s)
        self._probes[problem_key(lease.reserve)] = probe
        if len(self._probes) > MAX_PROBES:
            self._probes.popitem(last=False)
        self._know(lease, probe)

    def _look_up_probe(self, lease: HeldLease) -> None:
        """Let a lease know the probe of its problem, if it was played before."""
        if lease.probe is None:
            key = problem_key(lease.reserve)
            if (probe := self._probes.get(key)) is not None:
                self._probes.move_to_end(key)
                self._know(lease, probe)

    @staticmethod
    def _know(lease: HeldLease, probe: KnownProbe) -> None:
        lease.probe = probe
        lease.jobs.trial_s = lease.jobs.trial_s or probe.trial_s

    # ---- shares

    def share_out(self, slots: list[Slot]) -> None:
        """Share the slots among the leases; prefer slots that are prepared for the problem."""
        free = [slot for slot in slots if slot.state == "free"]
        if not free and len(self) < 2:
            return
        rights, shares = self.sharing.shares(self.values(), len(slots), self._out.now)
        free += self._take_back(shares, slots, len(free))
        if free:
            self._assign(free, shares)
        for lease in shares:
            lease.lent = max(0, min(lease.lent, rights[lease] - len(lease.slots)))

    def _assign(self, free: list[Slot], shares: dict[HeldLease, int]) -> None:
        """Give free slots to the leases that have fewer than their share."""
        surplus: Counter[str] = Counter()
        for lease, share in shares.items():
            surplus[lease.user] += len(lease.slots) - share
        # Who still has slots that are to be given back when a chunk ends comes after others.
        for lease in sorted(shares, key=lambda lease: surplus[lease.user]):
            known = {slot.index for slot in free if lease.prepared(slot)}
            free.sort(key=lambda slot: (slot.index not in known, slot.index))
            while free and len(lease.slots) < shares[lease]:
                slot = free.pop(0)
                slot.move("assigned", self._out.now)
                slot.lease, slot.deaths = lease, 0
                lease.slots.append(slot)

    def _take_back(
        self, shares: dict[HeldLease, int], slots: list[Slot], free: int
    ) -> list[Slot]:
        """Take idle slots of leases that have too many, as far as others have too few."""
        missing = sum(max(0, share - len(lease.slots)) for lease, share in shares.items())
        taken: list[Slot] = []
        if missing <= 0:
            return taken
        missing -= free + sum(slot.state == "stopping" for slot in slots)
        for lease, share in shares.items():
            idle = [slot for slot in lease.slots if slot.state in ("ready", "assigned")]
            surplus = min(len(lease.slots) - share, missing - len(taken))
            for slot in idle[: max(0, surplus)]:
                self._out.log(
                    "slot_given_back", user=lease.user, run=lease.run, slot=slot.index
                )
                self.give_back(slot)
                lease.lent += lease.idle_since is not None
                taken.append(slot)
        return taken


def _outdated(highest: int, epoch: int, *, held: bool) -> tuple[Refusal, str] | None:
    """Return why a run whose highest epoch is known may not reserve with another one, or None."""
    if epoch > highest + MAX_JUMP:
        text = f"the epoch {epoch} is not one that resumes reach after {highest}"
        return "malformed", text
    if epoch > highest or (epoch == highest and not held):
        return None
    if epoch == highest:
        return "superseded", f"another program holds the lease of epoch {epoch}"
    return "superseded", (
        f"the run was taken over: its epoch is {highest}, not {epoch}; if no other program "
        "evolves it, this is an older copy of its record: resume it again"
    )
