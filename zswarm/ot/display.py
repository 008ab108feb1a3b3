"""How a run shows itself: a live line on a terminal, plain lines elsewhere, JSON lines on stdout for programs."""

import sys
import time

from zswarm.ot.logger import Generation, Logger, Result, Started
from zswarm.ot.terminal import patience, plural, print_json, wrapped
from zswarm.screen import console, moves

BAR, WITH_BAR = 8, 60  # columns; it is shown on a terminal of so many
TIME = 12  # columns of the time that is left, with what is between


class PlainDisplay(Logger):
    """Plain lines on stderr: one a generation."""

    def __init__(self) -> None:
        self._generations = 0

    def on_start(self, run: Started) -> None:
        """See ``Logger``."""
        self._generations = run.experiment.generations

    def on_say(self, line: str) -> None:
        """See ``Logger``."""
        with patience():
            print(line, file=sys.stderr, flush=True)

    def on_generation(self, generation: Generation) -> None:
        """See ``Logger``."""
        g = generation
        self.on_say(
            f"generation {g.generation + 1}/{self._generations}  best {g.best:.6g}  mean {g.mean:.6g}  "
            f"evaluations {g.evaluations}  servers {g.servers}  slots {g.slots}"
        )

    def on_end(self, result: Result | None) -> None:
        """See ``Logger``."""
        if result is not None:
            with patience():
                print(summary(result), flush=True)


class JsonDisplay(PlainDisplay):
    """One JSON object a line on stdout; what is for people goes to stderr."""

    def on_generation(self, generation: Generation) -> None:
        """See ``Logger``."""
        print_json({"event": "generation", **{k: v for k, v in generation._asdict().items() if k != "statistics"}})

    def on_end(self, result: Result | None) -> None:
        """See ``Logger``."""
        if result is not None:
            print_json({"event": "done", **result._asdict()})


class LiveDisplay(PlainDisplay):
    """A line that moves, on a terminal."""

    def __init__(self) -> None:
        super().__init__()
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        made = console(stderr=True, live=True)
        bar = [BarColumn(bar_width=BAR)] if made.width >= WITH_BAR else []
        self._progress = Progress(
            TextColumn("{task.completed:.0f}/{task.total:.0f}"),
            *bar,
            TextColumn("{task.fields[text]}"),
            TimeRemainingColumn(compact=True, elapsed_when_finished=True),
            console=made,
            refresh_per_second=8,
        )
        self._last: tuple[float, int] | None = None

    def on_start(self, run: Started) -> None:
        """See ``Logger``."""
        self._generations = run.experiment.generations
        self._task = self._progress.add_task("run", total=run.experiment.generations, text="getting ready")
        self._progress.start()

    def on_say(self, line: str) -> None:
        """See ``Logger``."""
        from rich.text import Text

        self._progress.console.print(Text(wrapped(line, self._progress.console.width)), soft_wrap=True)

    def on_generation(self, generation: Generation) -> None:
        """See ``Logger``."""
        g, now = generation, time.monotonic()
        if self._last is None:
            self._last = (now, g.evaluations)
        rate = (g.evaluations - self._last[1]) / max(1e-9, now - self._last[0])
        on = f"{plural(g.slots, 'slot')} on {plural(g.servers, 'server')}"
        width = self._progress.console.width
        room = width - 2 * len(str(self._generations)) - TIME - (BAR if width >= WITH_BAR else 0)
        text = fitting([f"best {g.best:.5g}", f"mean {g.mean:.5g}", f"{rate:.0f}/s", on], room)
        self._progress.update(self._task, completed=g.generation + 1, text=text)

    def on_end(self, result: Result | None) -> None:
        """See ``Logger``."""
        self._progress.stop()
        super().on_end(result)


def fitting(parts: list[str], room: int) -> str:
    """The parts that there is room for: the first is shown in any case, the last ones rather than those between."""
    while len("  ".join(parts)) > room and len(parts) > 1:
        parts = [parts[0], *parts[2:]]
    return "  ".join(parts)


def display(*, as_json: bool) -> Logger:
    """The one that fits where the output goes."""
    if as_json:
        return JsonDisplay()
    return LiveDisplay() if moves(sys.stderr) else PlainDisplay()


def summary(result: Result) -> str:
    """What a run came to, in three lines."""
    best = "the last generation's best score is" if result.relative else "best fitness"
    faulted = f"faulted: {result.faulted} trials, " if result.faulted else ""
    doubtful = f"doubtful: {result.doubtful} trials of a server that computes wrong, " if result.doubtful else ""
    return (
        f"{best} {result.best:.6g} after {result.generations} generations, {result.evaluations} evaluations "
        f"({result.requeued} trials sent again), {result.seconds:.1f} s\n"
        f"history {faulted}{doubtful}{result.history_hash}\n"
        f"run     {result.run}"
    )
