"""Senders: calls that may block, made in order for each receiver, by a few threads for all."""

import contextlib
import queue
import threading
import time
from collections import deque
from collections.abc import Callable

MAX_WAITING = 10_000  # calls of a sender
FEW = 2  # threads, unless calls block
BLOCKED_S = 0.05  # all threads are blocked if senders wait and none was taken for so long

Call = Callable[[], None]


class Threads:
    """Threads that make the calls of all senders; more than a few only if calls block.

    Where each receiver had a thread of its own, each call would wake another one.
    """

    def __init__(self) -> None:
        self._ready: queue.SimpleQueue[Sender | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        # Of the lock:
        self._count = 0  # threads
        self._idle = 0  # threads without a sender
        self._waiting = 0  # senders without a thread
        self._taken = 0  # senders that got a thread, since the start
        self._watched = False  # a thread watches whether all others are blocked

    def serve(self, sender: "Sender") -> None:
        """Have a thread make the calls of a sender.

        Raises:
            RuntimeError: there is no thread, and none can be started.
        """
        with self._lock:
            short = self._waiting >= self._idle
            if short and self._count < FEW:
                self._start(1)
            elif short and not self._watched:
                with contextlib.suppress(
                    RuntimeError
                ):  # it cannot be started: those go on
                    threading.Thread(
                        target=self._watch, name="watch", daemon=True
                    ).start()
                    self._watched = True
            self._waiting += 1
        self._ready.put(sender)

    def close(self) -> None:
        """End the threads; each makes the calls of its sender before."""
        with self._lock:
            count, self._count = self._count, 0
        for _ in range(count):
            self._ready.put(None)

    def _start(self, count: int) -> None:
        """Start threads while the lock is held; without any, raise what prevented it."""
        for _ in range(count):
            try:
                threading.Thread(target=self._work, name="send", daemon=True).start()
            except RuntimeError:
                if not self._count:
                    raise
                return
            self._count += 1

    def _work(self) -> None:
        while True:
            with self._lock:
                self._idle += 1
            sender = self._ready.get()
            with self._lock:
                self._idle -= 1
                if sender is None:
                    return
                self._waiting -= 1
                self._taken += 1
            sender.make_calls()

    def _watch(self) -> None:
        """Double the threads as often as senders wait and none gets a thread."""
        while True:
            taken = self._taken
            time.sleep(BLOCKED_S)
            with self._lock:
                if not self._waiting:
                    self._watched = False
                    return
                if self._taken == taken:
                    self._start(self._count)


class Sender:
    """The calls for one receiver, in order. One that blocks delays those of no other receiver.

    Args:
        threads: make the calls.
        failed: takes what a call raised; the next one is made nevertheless.
    """

    def __init__(self, threads: Threads, failed: Callable[[BaseException], None]) -> None:
        self._threads, self._failed = threads, failed
        self._calls: deque[Call] = deque()
        self._lock = threading.Lock()
        self._busy = False  # a thread makes the calls, or will

    @property
    def busy(self) -> bool:
        """Return whether calls wait or one is being made."""
        return self._busy

    def send(self, call: Call, *, at_once: bool = False) -> bool:
        """Have a call made; return False if too many wait.

        Args:
            at_once: the call does not block: make it in this thread if none waits.

        Raises:
            RuntimeError: no thread can be started.
        """
        if at_once and not self._busy:
            try:
                call()
            except (KeyboardInterrupt, SystemExit):
                raise
            except BaseException as error:  # a panic in zenoh is not an Exception
                self._failed(error)
            return True
        with self._lock:
            if len(self._calls) >= MAX_WAITING:
                return False
            self._calls.append(call)
            if self._busy:
                return True
            self._busy = True
        try:
            self._threads.serve(self)
        except BaseException:
            with self._lock:
                self._calls.clear()
                self._busy = False
            raise
        return True

    def wait(self, timeout_s: float) -> None:
        """Wait until the calls so far were made, up to a timeout."""
        made = threading.Event()
        if self._busy and self.send(made.set):
            made.wait(timeout_s)

    def make_calls(self) -> None:
        """Make the calls until none waits; for ``Threads``."""
        while True:
            with self._lock:
                if not self._calls:
                    self._busy = False
                    return
                call = self._calls.popleft()
            try:
                call()
            except BaseException as error:  # as above
                with contextlib.suppress(Exception):  # it has to be reported, but once
                    self._failed(error)
