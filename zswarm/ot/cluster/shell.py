"""Threads, queues and a clock around ``Dispatch``; ``links`` has the sessions of zenoh.

The state belongs to the thread that holds its lock. The caller's thread hands in a workload and
takes what is counted, in order. An event that arrives while no other one is handled is handled in
the thread in which it arrives, because waking another thread takes longer. All other events wait in
a queue for a thread that also watches the clock.
"""

import queue
import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Self

from zswarm.errors import EvaluationError, NoServers
from zswarm.ot.cluster import diagnosis, events
from zswarm.ot.cluster.debounce import Newcomers
from zswarm.ot.cluster.dispatch import Dispatch
from zswarm.ot.cluster.events import Answered, Ask, Complete, Counted, Event, Retracted
from zswarm.ot.cluster.links import RELEASE_S, Links
from zswarm.ot.cluster.matching import Terms
from zswarm.ot.cluster.remote_server import Phase, Standing
from zswarm.ot.cluster.watch import Watch
from zswarm.ot.notes import Note, RunEvent
from zswarm.ot.workload import Workload
from zswarm.protocol.keys import RunKey
from zswarm.protocol.messages import Outcomes, Running
from zswarm.session import Reach

if TYPE_CHECKING:
    # It loads the compiler.
    from zswarm.ot.cluster.remote_controllers import RemoteControllers

FLUSH_S = 0.1  # a waiting caller gets a None this often
MAX_HELD_BACK = 100  # commands for the caller that are held back while more events wait
# From the beginning, before it is diagnosed where the servers in ``connect`` are.
DIALLED_S = 5.0

Item = Counted | Retracted | Note
Dispute = events.Disputed | events.ProbeDisputed
ForCaller = Item | Complete | events.Failed | events.Superseded | Dispute
Arbitrate = Callable[
    [Dispute, Workload | None], events.Arbitrated | events.ProbeArbitrated
]


class Cluster:
    """All servers that evaluate for one run, from entering to leaving.

    Args:
        arbitrate: computes the outcome of a disputed trial, or the digest of the probe.
        taken_over: returns whether another program resumed the run, as its record shows.
        local: endpoint of this machine's slots; "": there are none.
        controllers: those that servers ask; None: candidates are sent.
        watch: takes what happens, and may end it.

    Attributes:
        standing: as last published by the thread that owns the state.
    """

    def __init__(
        self,
        key: RunKey,
        terms: Terms,
        *,
        reach: Reach,
        arbitrate: Arbitrate,
        taken_over: Callable[[], bool] = lambda: False,
        local: str = "",
        controllers: "RemoteControllers | None" = None,
        watch: Watch | None = None,
    ) -> None:
        self.standing = Standing(probe=terms.probe)
        self._key, self._reach, self._local = key, reach, local
        self._controllers, self._arbitrate, self._watch = controllers, arbitrate, watch
        self._taken_over = taken_over
        self._dispatch = Dispatch(terms)
        self._links = Links(
            key,
            reach,
            controllers,
            post=self._post,
            answered=lambda event: self._happened(event, may_block=False),
            failed=self._stop,
            slots=self._slots,
        )
        self._dialled = threading.Timer(DIALLED_S, self._on_dialled)
        self._dialled.daemon = True
        # Of the state: the dispatch, and all up to the outbox.
        self._owner = threading.Lock()
        self._inbox: queue.SimpleQueue[Event | None] = queue.SimpleQueue()
        # Commands for the caller, held back until the standing shows their effect.
        self._held_back: list[ForCaller] = []
        self._changed = False  # the standing
        self._awake_at = 0.0  # the thread wakes then, if nothing happens before
        self._newcomers = Newcomers()
        self._outbox: queue.SimpleQueue[ForCaller | BaseException] = queue.SimpleQueue()
        self._workload: Workload | None = None

    def __enter__(self) -> Self:
        try:
            self._links.open(self._local)
        except BaseException:  # __exit__ is not called then, not even after Ctrl-C
            self._links.close()
            raise
        if self._reach.connect:
            self._dialled.start()
        self._thread = threading.Thread(target=self._work, name="dispatch", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._inbox.put(events.Leave())
        self._inbox.put(None)
        self._thread.join(RELEASE_S)
        self._dialled.cancel()
        self._links.close()

    # ---- the caller's thread

    def evaluate(self, workload: Workload) -> Iterator[Item | None]:
        """Evaluate what is not counted yet, from now on; iterate over what happens.

        Yields None if nothing happens for 0.1 s.

        Raises:
            EvaluationError: trials cannot be evaluated.
            Stopped: the watch ends it.
        """
        if self._watch is not None:
            self._watch.begin()
        self._happened(events.Work(workload), may_block=True)
        return self._until_complete()

    def _until_complete(self) -> Iterator[Item | None]:
        while not isinstance(item := self._next(FLUSH_S), Complete):
            yield item
            if self._watch is not None and self._watch.report(item, self.standing):
                self.diagnose()

    def wait(self, servers: int, timeout_s: float) -> Iterator[Item | None]:
        """Wait until this many servers match, and have granted a lease if it is wanted.

        Servers that are busy for others count. Yields as ``evaluate`` does.

        Raises:
            NoServers: not in time.
            Stopped: the watch ends it.
        """
        deadline = time.monotonic() + timeout_s
        diagnose_at = deadline - timeout_s / 2
        while (found := self.standing.leased + self.standing.spare) < servers:
            if time.monotonic() > diagnose_at:
                diagnose_at = deadline
                self.diagnose()
            rest_s = deadline - time.monotonic()
            if rest_s <= 0:
                counts = f"{found} of {servers} matching servers were found"
                raise NoServers(f"{counts} in {timeout_s:g} s")
            item = self._next(min(rest_s, FLUSH_S))
            if not isinstance(item, Complete):
                yield item
                if self._watch is not None:
                    self._watch.hint(item, self.standing)

    def pause(self, *, paused: bool) -> None:
        """Release all leases while a run pauses, or ask for slots again."""
        if self._watch is not None:
            self._watch.begin()
        self._inbox.put(events.Pause(paused))

    def rest(self) -> Iterator[Item]:
        """Iterate over what happened and was not yielded yet."""
        while (item := self._next(0.0)) is not None:
            if not isinstance(item, Complete):
                yield item

    def banned(self) -> dict[str, str]:
        """Return the machines that computed wrong, and as which server."""
        return dict(self._dispatch.servers.machines.banned)

    def diagnose(self) -> None:
        """Find out why servers are missing; the findings come as notes, some seconds later."""

        def post_findings() -> None:
            sessions, known = list(self._links.sessions), list(self._links.home)
            realm, reach = self._key.realm, self._reach
            try:
                lines = diagnosis.diagnose(realm, sessions, reach, known=known)
            except Exception as error:  # the run does not need it
                lines = [f"it could not be found out why servers are missing: {error!r}"]
            for line in lines:
                self._post(Note(RunEvent.DIAGNOSIS, "", line))

        threading.Thread(target=post_findings, name="diagnosis", daemon=True).start()

    def _next(self, timeout_s: float) -> Item | Complete | None:
        try:
            item = self._outbox.get(timeout=timeout_s)
        except queue.Empty:
            return None
        match item:
            case BaseException():  # a thread ended by it
                raise item
            case events.Failed():
                raise EvaluationError(item.reason)
            case events.Superseded():
                if self._taken_over():
                    raise EvaluationError(f"{item.server}: {item.reason}")
                return None
            case events.Disputed() | events.ProbeDisputed():
                self._inbox.put(self._arbitrate(item, self._workload))
                return None
        return item

    # ---- any thread

    def _post(self, item: Event | Note) -> None:
        if isinstance(item, Note):
            self._outbox.put(item)
        else:
            self._inbox.put(item)

    def _stop(self, error: BaseException) -> None:
        """Have the caller's thread raise an error."""
        for last in (*self._held_back, error):
            self._outbox.put(last)

    def _slots(self, server: str) -> int:
        known = self._dispatch.servers.by_id.get(server)
        return known.slots if known is not None else 1

    def _on_dialled(self) -> None:
        if set(self._links.home) - self._links.own:
            for line in diagnosis.unreachable(self._reach):
                self._post(Note(RunEvent.DIAGNOSIS, "", line))
        elif self._local:
            self.diagnose()

    # ---- the owner of the state

    def _happened(self, event: Event, *, may_block: bool) -> None:
        """Handle an event here and now if nothing else happens, or have it handled.

        Args:
            may_block: this thread may wait for one of zenoh's locks; zenoh's own must not.
        """
        if not self._inbox.empty() or not self._owner.acquire(blocking=False):
            self._inbox.put(event)
            return
        try:
            self._handle(event, may_block=may_block)
            self._publish()
            if self._dispatch.next_time() < self._awake_at:
                # Wake the thread: it is to wait for less long.
                self._inbox.put(events.TimePassed())
        except BaseException as error:
            if may_block:  # most often Ctrl-C, which the caller is to get now
                raise
            self._stop(error)
        finally:
            self._owner.release()

    def _work(self) -> None:
        """Handle events until the end; the thread's function."""
        try:
            while True:
                # Not for every event: the caller is woken for each.
                if self._inbox.empty() or len(self._held_back) >= MAX_HELD_BACK:
                    with self._owner:
                        self._publish()
                for event in self._take():
                    if event is None:
                        return
                    with self._owner:
                        self._handle(event, may_block=True)
        except BaseException as error:
            # A bug, or a panic in zenoh, which is not an Exception.
            self._stop(error)

    def _publish(self) -> None:
        if self._changed:
            self.standing, self._changed = self._dispatch.servers.standing(), False
        for item in self._held_back:
            self._outbox.put(item)
        self._held_back.clear()

    def _handle(self, event: Event, *, may_block: bool) -> None:
        batch_answered = False
        match event:
            case events.Work():
                self._workload = event.workload
                if self._controllers is not None:
                    self._controllers.begin(event.workload)
            case Answered():
                batch_answered = isinstance(event.reply, Outcomes | Running)
                self._links.was_answered(event.question)
        commands = self._dispatch.handle(event, time.monotonic())
        self._changed |= not batch_answered
        lost = isinstance(event, events.Gone)
        for command in commands:
            if isinstance(command, Ask):
                self._links.ask(command, may_block=may_block)
            else:
                self._held_back.append(command)
                lost |= (
                    isinstance(command, Note) and command.event == RunEvent.SERVER_LOST
                )
        servers = self._dispatch.servers
        if lost:
            for name in list(self._links.senders):
                if name not in servers.by_id or servers.by_id[name].phase == Phase.IDLE:
                    self._links.hang_up(name)
        while servers.forgotten:
            self._links.forget(servers.forgotten.pop())

    def _take(self) -> list[Event | None]:
        """Wait for the next events, at most until the dispatch or newcomers are due."""
        now = time.monotonic()
        if new := self._newcomers.take(now):
            return [events.Seen(server) for server in new]
        with self._owner:
            due = self._awake_at = self._dispatch.next_time()
        wait_s = min(due, self._newcomers.due) - now
        try:
            event = self._inbox.get(timeout=max(0.0, wait_s) if wait_s < 3600 else None)
        except queue.Empty:
            return [events.TimePassed()] if time.monotonic() >= due else []
        match event:
            case events.Seen(own=False):
                self._newcomers.add(event.server, time.monotonic())
                return []
            case events.Gone():
                self._newcomers.remove(event.server)
        return [event]
