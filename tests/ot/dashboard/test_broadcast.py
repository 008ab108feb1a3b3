"""Tabs get what changed, in bounded queues."""

import asyncio
from typing import cast

import pytest

from zswarm.ot.dashboard.broadcast import WAITING, Channel, Tab


def test_a_tab_that_reads_nothing_has_a_bounded_queue() -> None:
    tab = Tab()
    for _ in range(10 * WAITING):
        tab.put(b"x")
    assert tab.full
    assert tab._queue.qsize() == WAITING


def test_a_reconnected_tab_gets_the_missed_changes() -> None:
    """It names its last message; numbers of another dashboard are ignored."""
    changes = iter([{"n": 1}, {"n": 2}, {"n": 3}])

    async def scenario() -> None:
        channel = Channel(lambda: next(changes, {}), lambda: {"all": True})
        first, second, third = Tab(), Tab(), Tab()
        await channel.enter(first, "")
        hello = await first.take()
        assert b'"hello":true' in hello
        seq = hello.split(b'"')[3].decode()
        while b'"n":3' not in await first.take():
            pass
        await channel.enter(second, seq)
        assert [b'"n":2' in await second.take(), b'"n":3' in await second.take()] == [
            True,
            True,
        ]
        await channel.enter(third, "0badf00d.1")
        assert b'"hello":true' in await third.take()
        for tab in (first, second, third):
            channel.leave(tab)

    asyncio.run(scenario())


def test_an_error_in_the_dashboard_leaves_no_tab_waiting() -> None:
    """It is told to reconnect, and the next tab starts again."""
    looks = iter([{"n": 1}])

    async def scenario() -> None:
        def look() -> dict[str, int]:
            try:
                return next(looks)
            except StopIteration:
                raise OSError("gone") from None

        channel, tab = Channel(look, dict), Tab()
        await channel.enter(tab, "")
        while await tab.take():
            pass
        assert tab.full
        with pytest.raises(OSError, match="gone"):
            await cast("asyncio.Task[None]", channel._task)
        channel.leave(tab)

    asyncio.run(scenario())
