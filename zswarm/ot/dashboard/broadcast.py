"""Send changes to tabs: one tail per run for all its tabs, numbered messages, bounded queues."""

import asyncio
import contextlib
import secrets
from collections import deque
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import msgspec

from zswarm.ot.dashboard.run_index import RunIndex
from zswarm.ot.dashboard.tail import RecordTail

LIVE_S, IDLE_S = 0.25, 1.0  # until the next look: after one that found a change, else
TICK_S = 2.0  # between messages, at most
REPEATED = 200  # the last messages, which tabs that come back may have missed
WAITING = 32  # messages in a tab's queue
TABS = 200  # of all runs


class TooMany(Exception):
    """There are as many tabs as allowed."""


class Tab:
    """A browser tab and the messages that wait for it.

    Attributes:
        full: whether it has to connect again after these, since it missed some.
    """

    def __init__(self) -> None:
        self.full = False
        self._queue: asyncio.Queue[bytes] = asyncio.Queue(WAITING)

    def put(self, message: bytes) -> None:
        """Queue a message if there is room."""
        try:
            self._queue.put_nowait(message)
        except asyncio.QueueFull:
            self.full = True

    async def take(self) -> bytes:
        """Return the next message; an empty one is the end."""
        return await self._queue.get()


class Channel:
    """All tabs that watch one thing.

    Args:
        look: returns what changed, {} for nothing; called in a thread while a tab watches.
        hello: returns all that a new tab has to know.
    """

    def __init__(
        self, look: Callable[[], dict[str, Any]], hello: Callable[[], dict[str, Any]]
    ) -> None:
        self.tabs: set[Tab] = set()
        self._look, self._hello = look, hello
        self._boot = secrets.token_hex(4)
        self._seq = 0
        self._last: deque[tuple[int, bytes]] = deque(maxlen=REPEATED)
        self._task: asyncio.Task[None] | None = None
        self._first = asyncio.Event()  # set after the first look: ``hello`` works

    async def enter(self, tab: Tab, since: str) -> None:
        """Add a tab; send what it missed since the message it names, or else everything."""
        self.tabs.add(tab)
        if self._task is None or self._task.done():
            self._task = asyncio.create_task(self._follow())
        await self._first.wait()
        boot, _, number = since.partition(".")
        seen = int(number) if boot == self._boot and number.isdecimal() else -1
        missed = [message for seq, message in self._last if seq > seen]
        if seen < 0 or len(missed) != self._seq - seen:
            missed = [self._encoded({"hello": True, **self._hello()})]
        for message in missed:
            tab.put(message)

    def leave(self, tab: Tab) -> None:
        """Remove a tab; without tabs nothing is followed."""
        self.tabs.discard(tab)
        if not self.tabs and self._task is not None:
            self._task.cancel()
            self._task = None

    async def _follow(self) -> None:
        try:
            await self._send_changes()
        finally:  # cancelled, or an error of ours
            self._first.set()
            for tab in self.tabs:
                tab.full = True
                tab.put(b"")

    async def _send_changes(self) -> None:
        quiet = 0.0
        while True:
            new = await asyncio.to_thread(self._look)
            self._seq += bool(new)
            message = self._encoded(new)
            if new:
                self._last.append((self._seq, message))
            # Before it is set, all tabs wait for hello.
            if (new or quiet >= TICK_S) and self._first.is_set():
                quiet = 0.0
                for tab in self.tabs:
                    tab.put(message)
            self._first.set()
            pause = LIVE_S if new else IDLE_S
            quiet += pause
            await asyncio.sleep(pause)

    def _encoded(self, values: dict[str, Any]) -> bytes:
        return msgspec.json.encode({"seq": f"{self._boot}.{self._seq}", **values})


class Broadcaster:
    """The channels: one per watched run, and one for the list of runs."""

    def __init__(self, index: RunIndex) -> None:
        self._index = index
        self._channels: dict[str, Channel] = {}

    @contextlib.asynccontextmanager
    async def watching(
        self, id_: str, folder: Path | None, since: str
    ) -> AsyncIterator[Tab]:
        """Give a tab changes of a run, or without a folder of the list; raise TooMany."""
        if sum(len(channel.tabs) for channel in self._channels.values()) >= TABS:
            raise TooMany
        if id_ not in self._channels:
            self._channels[id_] = _of_run(folder) if folder else _of_list(self._index)
        channel, tab = self._channels[id_], Tab()
        try:
            await channel.enter(tab, since)
            yield tab
        finally:
            channel.leave(tab)
            if not channel.tabs and self._channels.get(id_) is channel:
                del self._channels[id_]


def _of_run(folder: Path) -> Channel:
    tail = RecordTail(folder)
    return Channel(
        tail.look,
        lambda: {
            "state": tail.state,
            "events": tail.events,
            "servers": [*tail.servers.values()],
        },
    )


def _of_list(index: RunIndex) -> Channel:
    shown: dict[str, dict[str, Any]] = {}

    def look() -> dict[str, Any]:
        rows = {row["id"]: row for row in index.rows()}
        changed = [row for id_, row in rows.items() if shown.get(id_) != row]
        gone = [id_ for id_ in shown if id_ not in rows]
        shown.clear()
        shown.update(rows)
        return {"runs": changed, "gone": gone} if changed or gone else {}

    return Channel(look, lambda: {"runs": [*shown.values()]})
