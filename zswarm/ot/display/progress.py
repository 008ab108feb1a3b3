"""Show a run as a live line on a terminal, as plain lines elsewhere, or as JSON for programs."""

import sys
import time
from typing import Any

from zswarm.champion.held_out import HeldOut
from zswarm.ot.display.tables import echo, print_json, wrapped
from zswarm.ot.logger import Generation, Logger, Result, Started
from zswarm.system.format import duration, per_trial, plural, with_trials
from zswarm.system.terminal import console, moves

BAR, WITH_BAR = 8, 60  # columns of the bar, and of the narrowest terminal that shows it
TIME = 12  # columns of the remaining time and the gaps


class PlainDisplay(Logger):
    """Print a line on stderr for each generation."""

    def __init__(self) -> None:
        self._generations = 0

    def on_start(self, run: Started) -> None:
        self._generations = run.experiment.generations

    def on_say(self, line: str) -> None:
        echo(line, sys.stderr)

    def on_wait(self, line: str) -> None:
        self.on_say(line)

    def on_generation(self, generation: Generation) -> None:
        self.on_say(progress(generation, generation.last or self._generations))

    def on_end(self, result: Result | None) -> None:
        if result is not None:
            echo(f"{summary(result)}\n{next_steps(result)}", sys.stdout)


class JsonDisplay(PlainDisplay):
    """Print a JSON object on stdout for each generation; lines for people go to stderr."""

    def on_generation(self, generation: Generation) -> None:
        print_json(generation_event(generation))

    def on_end(self, result: Result | None) -> None:
        if result is not None:
            print_json({"event": "done", **result.as_object()})


class LiveDisplay(PlainDisplay):
    """Update a line on a terminal."""

    def __init__(self) -> None:
        super().__init__()
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        made = console(stderr=True, live=True)
        bar = [BarColumn(bar_width=BAR)] if made.width >= WITH_BAR else []
        self._progress = Progress(
            TextColumn("{task.fields[done]}"),
            *bar,
            TextColumn("{task.fields[text]}"),
            TimeRemainingColumn(compact=True, elapsed_when_finished=True),
            console=made,
            refresh_per_second=8,
        )
        self._taken = TIME + BAR * len(bar)  # columns
        self._first: tuple[float, int] | None = None  # time and evaluations
        # Expected generations, and the length of the assessment in them.
        self._last, self._after = 0, 0.0

    def on_start(self, run: Started) -> None:
        super().on_start(run)
        self._last = self._generations
        self._task = self._progress.add_task(
            "run",
            completed=run.generation,
            total=self._generations,
            text="getting ready",
            done=f"{run.generation}/{self._generations}",
        )
        self._progress.start()

    def on_say(self, line: str) -> None:
        say(self._progress.console, line)

    def on_wait(self, line: str) -> None:
        what, since = line.removesuffix(")").rsplit(" (", 1)
        room = self._room()
        text = fitting([what[:room].rstrip(), f"({since})"], room)
        self._progress.update(self._task, text=text)

    def on_generation(self, generation: Generation) -> None:
        g, now = generation, time.monotonic()
        self._first = self._first or (now, g.evaluations)
        rate = (g.evaluations - self._first[1]) / max(1e-9, now - self._first[0])
        parts = [*_fitness(g, 5), f"{rate:.0f}/s", _servers(g)]
        self._last = g.last or self._generations
        self._after = self._last * g.after  # in generations
        self._progress.update(
            self._task,
            completed=g.generation + 1,
            total=self._last + self._after,
            text=fitting(parts, self._room()),
            done=f"{g.generation + 1}/{self._last}",
        )

    def on_progress(self, generation: int, counted: int, trials: int) -> None:
        if generation < self._generations or not trials:
            return
        part = counted / trials
        self._progress.update(
            self._task,
            completed=self._last + self._after * part,
            total=self._last + self._after,
            text=f"assessment {part:.0%}",
        )

    def _room(self) -> int:
        """Return how many columns a text may have."""
        numbers = 2 * len(str(self._generations))
        return int(self._progress.console.width) - numbers - self._taken

    def on_end(self, result: Result | None) -> None:
        self._progress.stop()
        super().on_end(result)


def say(live: Any, line: str) -> None:
    """Print a line above what a live console shows."""
    from rich.text import Text

    live.print(Text(wrapped(line, live.width)), soft_wrap=True)


def fitting(parts: list[str], room: int) -> str:
    """Return the parts that fit: always the first one, and rather the last ones than the middle."""
    while len("  ".join(parts)) > room and len(parts) > 1:
        parts = [parts[0], *parts[2:]]
    return "  ".join(parts)


def display(*, as_json: bool) -> Logger:
    """Choose the display for where the output goes."""
    if as_json:
        return JsonDisplay()
    return LiveDisplay() if moves(sys.stderr) else PlainDisplay()


def progress(generation: Generation, generations: int) -> str:
    """Describe a generation in one line."""
    g = generation
    return (
        f"generation {g.generation + 1}/{generations}  {'  '.join(_fitness(g))}  "
        f"{plural(g.evaluations, 'evaluation')}  {_servers(g)}"
    )


def generation_event(generation: Generation, **more: Any) -> dict[str, Any]:
    """Return the JSON object of a generation."""
    values = {"event": "generation", **more, **generation._asdict()}
    for key in ("statistics", "last", "after"):
        del values[key]
    return values


def summary(result: Result) -> str:
    """Describe the result of a run in three lines, or four if its champion was assessed."""
    best = "the last generation's best score is" if result.relative else "best fitness"
    return (
        f"{best} {with_trials(result.best, result.trials)} "
        f"after {plural(result.generations, 'generation')}, "
        f"{plural(result.evaluations, 'evaluation')}, "
        f"{result.requeued:,} {'retry' if result.requeued == 1 else 'retries'}"
        # Unknown of a run that finished earlier.
        f"{f', {duration(result.seconds)}' if result.seconds else ''}\n"
        f"{held_out(result.champion, result.trials)}"
        f"history {', '.join([*flaws(result), result.history_hash])}\n"
        f"run     {result.run}"
    )


def next_steps(result: Result) -> str:
    """Return commands that show what a run found."""
    # A single trial that was not assessed is mostly one that is the same for every seed.
    alone = result.trials == 1 and result.champion is None
    commands = ["replay", "plot" if alone else "evaluate", "report"]
    lines = "\n        ".join(f"zswarm-ot {command} {result.run}" for command in commands)
    return f"next    {lines}"


def held_out(champion: HeldOut | None, trials: int = 1) -> str:
    """Return a line about the champion on held-out seeds and in search; "" without these."""
    if champion is None:
        return ""
    found = champion.per_trial(trials)
    return (
        f"held-out fitness {per_trial(found.mean)} of the champion "
        f"(95 %: {per_trial(found.low)} to {per_trial(found.high)}, "
        f"{plural(found.seeds, 'seed')}); in search {per_trial(found.in_search)}\n"
    )


def flaws(result: Result) -> list[str]:
    """Return why another run may have another history."""
    counts = {"faulted": result.faulted, "doubtful": result.doubtful}
    found = [] if result.repeatable else ["trials do not repeat"]
    return found + [
        f"{word}: {plural(count, 'trial')}" for word, count in counts.items() if count
    ]


def _fitness(generation: Generation, digits: int = 6) -> list[str]:
    """Return a generation's best and mean fitness, as the mean of a trial."""
    g = generation
    each = "" if g.trials == 1 else " a trial"
    best, mean = (per_trial(value, g.trials, digits) for value in (g.best, g.mean))
    return [f"best {best}{each}", f"mean {mean}"]


def _servers(generation: Generation) -> str:
    return f"{plural(generation.slots, 'slot')} on {plural(generation.servers, 'server')}"
