"""Replays are computed once, in another program, within limits."""

import asyncio
from pathlib import Path

import pytest

from zswarm.errors import ConfigError
from zswarm.ot.dashboard import replay_cache


def trace_of(program: str, monkeypatch: pytest.MonkeyPatch, *more: str) -> list[bytes]:
    """Return what a page gets from programs that replace the one that computes traces."""
    programs = iter([program, *more])
    kept = replay_cache.ReplayCache()

    async def ask() -> list[bytes]:
        found = []
        for one in programs:
            monkeypatch.setattr(replay_cache, "PROGRAM", one)
            found.append(await kept.get(Path("run"), 0, 1, 2))
        return found

    return asyncio.run(ask())


def test_a_replay_is_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its program gets the run, generation, candidate and trial as arguments."""
    told = "import os, sys; print(os.path.basename(sys.argv[1]), *sys.argv[2:], end='')"
    assert trace_of(told, monkeypatch, "raise SystemExit(1)") == [b"run 0 1 2"] * 2


def test_a_missing_replay_is_explained_in_one_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.raises(ConfigError, match=r"^trial 2 is not there\\x1b$"):
        trace_of(
            "import sys; sys.stderr.write('warning\\n'); sys.exit('trial 2 is not there\\x1b')",
            monkeypatch,
        )
    with pytest.raises(ConfigError, match="the program that computes it ended"):
        trace_of("import os; os._exit(3)", monkeypatch)


def test_a_replay_that_takes_too_long_or_too_much_is_ended(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(replay_cache, "LARGEST", 100)
    with pytest.raises(
        ConfigError, match="the replay has 1,000 bytes, and 100 is the most"
    ):
        trace_of("print('x' * 1000, end='')", monkeypatch)
    monkeypatch.setattr(replay_cache, "LONGEST_S", 0.05)
    with pytest.raises(ConfigError, match="the replay takes longer than 0 s"):
        trace_of("import time; time.sleep(60)", monkeypatch)
