"""How a run shows itself: a live line on a terminal, plain lines elsewhere, JSON lines on stdout for programs."""

import contextlib
import errno
import sys
import time
from collections.abc import Iterator
from typing import Any, Self

from zswarm.ot.run import Generation, Result
from zswarm.strict import to_json


class PlainReporter:
    """Plain lines on stderr: one a generation."""

    def __init__(self, generations: int) -> None:
        self._generations = generations
        self._begin = time.monotonic()
        self._first: Generation | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def say(self, text: str) -> None:
        """See ``Reporter``."""
        with _patience():
            print(text, file=sys.stderr, flush=True)

    def progress(self, generation: int, counted: int, trials: int) -> None:
        """Too much for lines."""

    def generation(self, generation: Generation) -> None:
        """See ``Reporter``."""
        g = generation
        self.say(
            f"generation {g.generation + 1}/{self._generations}  best {g.best:.6g}  mean {g.mean:.6g}  "
            f"evaluations {g.evaluations}  servers {g.servers}  slots {g.slots}"
        )

    def done(self, result: Result) -> None:
        """The run ended."""
        with _patience():
            print(_summary(result), flush=True)


class JsonReporter(PlainReporter):
    """One JSON object a line on stdout; what is for people goes to stderr."""

    def generation(self, generation: Generation) -> None:
        """See ``Reporter``."""
        print_json({"event": "generation", **generation._asdict()})

    def done(self, result: Result) -> None:
        """The last line."""
        print_json({"event": "done", **result._asdict()})


class LiveReporter(PlainReporter):
    """A line that moves, on a terminal."""

    def __init__(self, generations: int) -> None:
        super().__init__(generations)
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        self._progress = Progress(
            TextColumn("{task.completed:.0f}/{task.total:.0f}"),
            BarColumn(bar_width=8),
            TextColumn("{task.fields[text]}"),
            TimeRemainingColumn(compact=True, elapsed_when_finished=True),
            console=Console(stderr=True),
            refresh_per_second=8,
        )
        self._task = self._progress.add_task("run", total=generations, text="looking for servers")
        self._last: tuple[float, int] | None = None

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def say(self, text: str) -> None:
        """See ``Reporter``."""
        from rich.text import Text

        self._progress.console.print(Text(text), soft_wrap=True)

    def generation(self, generation: Generation) -> None:
        """See ``Reporter``."""
        g, now = generation, time.monotonic()
        if self._last is None:
            self._last = (now, g.evaluations)
        rate = (g.evaluations - self._last[1]) / max(1e-9, now - self._last[0])
        text = f"best {g.best:.5g}  mean {g.mean:.5g}  {rate:.0f}/s  {_plural(g.slots, 'slot')} on {_plural(g.servers, 'server')}"
        self._progress.update(self._task, completed=g.generation + 1, text=text)


def reporter(generations: int, *, as_json: bool) -> PlainReporter:
    """The one that fits where the output goes."""
    if as_json:
        return JsonReporter(generations)
    return LiveReporter(generations) if sys.stderr.isatty() else PlainReporter(generations)


def print_json(value: dict[str, Any]) -> None:
    """One line on stdout."""
    with _patience():
        print(to_json(value), flush=True)


@contextlib.contextmanager
def _patience() -> Iterator[None]:
    """A full disk that output goes to stops no run: the stream writes with a later line what its buffer could keep."""
    try:
        yield
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise


def _plural(count: int, noun: str) -> str:
    return f"{count} {noun}{'s' if count != 1 else ''}"


def _summary(result: Result) -> str:
    faulted = f"faulted: {result.faulted} trials, " if result.faulted else ""
    doubtful = f"doubtful: {result.doubtful} trials of a server that computes wrong, " if result.doubtful else ""
    return (
        f"best fitness {result.best:.6g} after {result.generations} generations, {result.evaluations} evaluations "
        f"({result.requeued} trials sent again), {result.seconds:.1f} s\n"
        f"history {faulted}{doubtful}{result.history_hash}\n"
        f"run     {result.run}"
    )
