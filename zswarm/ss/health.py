"""The health of a server: find missing slots, end orphans, report to systemd and Prometheus.

It reports readiness, the watchdog and a status line to systemd, and numbers to Prometheus. The
watchdog is fed as long as the server's loop runs and no slot is missing.
"""

import math
import os
import time
from typing import TYPE_CHECKING

import msgspec

from zswarm.ss.local.snapshot import LeaseView, MissingSlot, Rate, View, slot_states
from zswarm.ss.network import Presence
from zswarm.ss.slots.table import SlotTable
from zswarm.ss.workers import orphans
from zswarm.ss.workers.parent import Worker
from zswarm.system import log
from zswarm.system.systemd import Notify
from zswarm.system.version import VERSION

if TYPE_CHECKING:
    from zswarm.ss.local.metrics import Metrics

MISSING_S = 30.0  # a slot without a process is reported; earlier if the watchdog's time is shorter
LOOK_EVERY_S, SHOW_EVERY_S = 0.1, 1.0  # at most; showing: to systemd and Prometheus


class Health(msgspec.Struct, eq=False):
    """Watches the slots of a server, and reports on it."""

    slots: SlotTable
    workers: list[Worker]
    presence: Presence
    notify: Notify  # systemd
    # When to call ``look`` if nothing happens, by the monotonic clock.
    next_look: float = 0.0
    _started_at: float = msgspec.field(default_factory=time.time)
    _rate: Rate = msgspec.field(default_factory=lambda: Rate(time.monotonic()))
    _metrics: "Metrics | None" = None
    _warm: bool = False
    _show_at: float = 0.0
    _orphans: bool = False  # there may be some
    _freed: int = 0  # how often slots became free
    _missing: dict[int, str] = {}  # slots, with the reason

    @property
    def missing_s(self) -> float:
        """After so long without a process, a slot is reported."""
        return min(MISSING_S, self.notify.watchdog_s)

    def open_metrics(self, port: int) -> "Metrics":
        """Listen for Prometheus."""
        # prometheus_client is an extra
        from zswarm.ss.local.metrics import Metrics

        self._metrics = Metrics(port, self.view(time.monotonic()))
        return self._metrics

    def expect_orphans(self) -> None:
        """Look for orphans: a process of a slot ended."""
        self._orphans = True

    def ready(self) -> None:
        """Tell systemd that the server is ready, if it is; a reload ended."""
        if self._warm and not self.slots.draining:
            self.notify.ready()

    def look(self, now: float, *, new: bool) -> None:
        """Check everything, but not too often; ``new``: something happened since the last call."""
        if new:
            self.next_look = min(self.next_look, now + LOOK_EVERY_S)
        if now < self.next_look:
            return
        freed = sum(slot.freed for slot in self.slots.slots)
        if freed > self._freed or self._orphans:
            self._end_orphans()
        self._freed = freed
        self._find_missing(now)
        if not self._missing:
            self.notify.feed()
        if self.slots.draining:
            self.notify.extend()
        self._check_warm(now)
        changing = self._show(now)
        present = [worker for worker in self.workers if worker.slot not in self._missing]
        self.next_look = min(
            self._show_at if changing else math.inf,
            math.inf if self._missing else self.notify.feed_at(),
            *(worker.missing_from(self.missing_s) for worker in present),
        )

    def _check_warm(self, now: float) -> None:
        waiting = [worker for worker in self.workers if not worker.here]
        if not self._warm and all(worker.pauses(now) for worker in waiting):
            self._warm = len(waiting) < len(self.workers)
            self.ready()

    def _show(self, now: float) -> bool:
        """Report the state if it is due; return whether to do so again soon."""
        view = self.view(now)
        changing = bool(view.trials_per_s or self.slots.draining or self._orphans)
        if now < self._show_at:
            return changing or self._metrics is not None or self.notify.listens
        self._show_at = now + SHOW_EVERY_S
        self.notify.status(view.line())
        if self._metrics is not None:
            self._metrics.view = view
        return changing

    def _end_orphans(self) -> None:
        """End orphans, and the processes of free slots whose simulators left some."""
        parents = orphans.parents()
        for slot, worker in zip(self.slots.slots, self.workers, strict=True):
            if slot.state == "free" and worker.session in parents:
                reason = "its simulator left processes behind"
                log.info("slot_renewed", slot=slot.index, reason=reason)
                worker.kill()
                slot.prepared_for = None
        sessions = {worker.session for worker in self.workers if worker.session}
        self._orphans = bool(orphans.end(sessions))

    def _find_missing(self, now: float) -> None:
        missing = {
            worker.slot: worker.missing_reason()
            for worker in self.workers
            if now >= worker.missing_from(self.missing_s)
        }
        if newly := missing.keys() - self._missing.keys():
            fields = {
                "reason": missing[min(newly)],
                "seconds": round(self.missing_s, 1),
                "watchdog": "not fed"
                if math.isfinite(self.notify.watchdog_s)
                else "none",
            }
            log.error("slots_missed", slots=sorted(newly), **fields)
        if back := self._missing.keys() - missing.keys():
            log.info("slots_back", slots=sorted(back))
        self._missing = missing

    def view(self, now: float) -> View:
        """Return what the server shows of itself."""
        slots, leases = self.slots, self.slots.leases.values()
        return View(
            server=self.presence.server,
            program=VERSION,
            pid=os.getpid(),
            realm=self.presence.realm,
            listen=self.presence.endpoints,
            since=self._started_at,
            warm=self._warm,
            draining=slots.draining,
            slots=slot_states(slots, self.workers, now),
            leases=[
                LeaseView(
                    lease.user,
                    lease.run,
                    lease.reserve.simulator.kind,
                    len(lease.slots),
                    lease.jobs.trials,
                    now - lease.since,
                )
                for lease in leases
            ],
            trials=slots.trials,
            trials_per_s=self._rate.take(slots.trials, now),
            busy_s=slots.seconds,
            faults=dict(slots.faults),
            malformed=self.presence.malformed,
            waiting_batches=sum(len(lease.jobs.waiting) for lease in leases),
            waiting_queries=len(self.presence.inbox),
            slot_memory_mb=self.workers[0].memory_mb,
            missed=[MissingSlot(slot, reason) for slot, reason in self._missing.items()],
        )
