"""Show a study as a live table on a terminal, as plain lines elsewhere, or as JSON for programs."""

import sys
import time
from typing import Any

from zswarm.ot.analysis.comparison import SCORES
from zswarm.ot.display import tables
from zswarm.ot.display.progress import flaws, generation_event, say
from zswarm.ot.logger import Generation, Logger, Started
from zswarm.ot.study.outcome import RunEnded, StudyLogger, StudyOutcome
from zswarm.ot.study.plan import Planned
from zswarm.ot.study.study import Study
from zswarm.system.format import duration, per_trial, plural, with_trials
from zswarm.system.terminal import console, moves

REFRESHES = 4  # a second
WAITING_S = 1.5  # between two lines about the same wait, which all runs report


class _RunLogger(Logger):
    """Print the lines of a run with its name."""

    def __init__(self, display: Any, planned: Planned) -> None:
        self._display, self._planned = display, planned

    def on_say(self, line: str) -> None:
        self._display.on_say(f"{self._planned.name}: {line}")

    def on_wait(self, line: str) -> None:
        self._display.on_wait(line)


class _JsonRunLogger(_RunLogger):
    """Print the generations of a run."""

    def on_generation(self, generation: Generation) -> None:
        run = str(self._display.folder / self._planned.name)
        tables.print_json(generation_event(generation, run=run))


class _LiveRunLogger(_RunLogger):
    """Show a run as a row of the table."""

    _evaluations: int | None = None

    def on_start(self, run: Started) -> None:
        self._display.skip(run.generation)
        self._task = self._display.progress.add_task(
            f"  {self._planned.name}",
            completed=run.generation,
            total=self._planned.experiment.generations,
            text="waiting for a slot",
        )

    def on_wait(self, line: str) -> None:
        self._display.progress.update(self._task, text=line)

    def on_generation(self, generation: Generation) -> None:
        best = per_trial(generation.best, generation.trials, 5)
        done, text = generation.generation + 1, f"best {best}"
        self._display.progress.update(self._task, completed=done, text=text)
        evaluations = generation.evaluations
        self._display.advance(evaluations - (self._evaluations or evaluations))
        self._evaluations = evaluations


class PlainStudyDisplay(StudyLogger):
    """Print a line for each run that ended, and a table at the end."""

    logs_runs: type[_RunLogger] = _RunLogger

    def __init__(self, study: Study) -> None:
        self._ended, self._planned = 0, len(study.planned)
        self._waiting = "", 0.0  # for what, and when it was printed

    def run_logger(self, planned: Planned) -> Logger:
        return self.logs_runs(self, planned)

    def on_say(self, line: str) -> None:
        tables.echo(line, sys.stderr)

    def on_wait(self, line: str) -> None:
        """Print what a run waits for, unless another run reported it a moment ago."""
        what, now = line.split(" (")[0], time.monotonic()
        if what != self._waiting[0] or now >= self._waiting[1] + WAITING_S:
            self._waiting = what, now
            self.on_say(line)

    def on_run(self, ended: RunEnded) -> None:
        self._ended += 1
        if not ended.earlier:
            self.on_say(f"{_described(ended)}  ({self._ended} of {self._planned})")

    def on_outcome(self, outcome: StudyOutcome | None) -> None:
        if outcome is not None:
            with tables.patience():
                _show(outcome)


class JsonStudyDisplay(PlainStudyDisplay):
    """Print a JSON object a line on stdout; lines for people go to stderr."""

    logs_runs = _JsonRunLogger

    def __init__(self, study: Study) -> None:
        super().__init__(study)
        self.folder = study.folder

    def on_run(self, ended: RunEnded) -> None:
        planned = ended.planned
        values: dict[str, Any] = {
            "run": str(self.folder / planned.name),
            "seed": planned.seed,
            "settings": planned.settings,
        }
        if ended.result is None:
            tables.print_json({"event": "failed", **values, "error": ended.error})
        else:
            tables.print_json({"event": "run", **values, **ended.result.as_object()})

    def on_outcome(self, outcome: StudyOutcome | None) -> None:
        if outcome is None:
            return
        tables.print_json(
            {
                "event": "done",
                **{
                    key: getattr(outcome, key)
                    for key in ("study", "runs", "finished", "seconds")
                },
                "failed": len(outcome.failed),
                **outcome.whole.numbers(),
                "settings": [
                    {
                        "settings": summary.settings,
                        "runs": summary.runs,
                        **summary.numbers(),
                    }
                    for summary in outcome.settings
                ],
            }
        )


class LiveStudyDisplay(PlainStudyDisplay):
    """Update a table on a terminal: the progress of all runs, and of each run in progress."""

    logs_runs = _LiveRunLogger

    def __init__(self, study: Study) -> None:
        super().__init__(study)
        from rich.progress import Progress, TextColumn, TimeRemainingColumn

        self.progress = Progress(
            TextColumn("{task.description}"),
            TextColumn("{task.completed:.0f}/{task.total:.0f}"),
            TextColumn("{task.fields[text]}"),
            TimeRemainingColumn(compact=True),
            console=console(stderr=True, live=True),
            refresh_per_second=REFRESHES,
            transient=True,
        )
        # Those to play.
        self._generations = sum(one.experiment.generations for one in study.left)
        self._all = self.progress.add_task(
            f"0/{self._planned} runs", total=self._generations, text=""
        )
        self._evaluations, self._begin = 0, 0.0
        if study.left:
            self.progress.start()

    def on_say(self, line: str) -> None:
        say(self.progress.console, line)

    def on_run(self, ended: RunEnded) -> None:
        super().on_run(ended)
        self.progress.update(self._all, description=f"{self._ended}/{self._planned} runs")
        for task in self.progress.tasks[1:]:
            if task.description == f"  {ended.planned.name}":
                self.skip(int(task.remaining or 0))  # of one that failed
                self.progress.remove_task(task.id)

    def on_outcome(self, outcome: StudyOutcome | None) -> None:
        self.progress.stop()
        super().on_outcome(outcome)

    def skip(self, generations: int) -> None:
        """Take generations that need not be played out of the total."""
        self._generations -= generations
        self.progress.update(self._all, total=self._generations)

    def advance(self, evaluations: int) -> None:
        """Count a generation of a run, with its evaluations."""
        self._begin = self._begin or time.monotonic()
        self._evaluations += evaluations
        rate = self._evaluations / max(1.0, time.monotonic() - self._begin)
        self.progress.update(self._all, advance=1, text=f"{rate:.0f}/s")


def display(study: Study, *, as_json: bool) -> StudyLogger:
    """Choose the display for where the output goes."""
    if as_json:
        return JsonStudyDisplay(study)
    return LiveStudyDisplay(study) if moves(sys.stderr) else PlainStudyDisplay(study)


def _described(ended: RunEnded) -> str:
    name, result = ended.planned.name, ended.result
    if result is None:
        return f"{name}  failed: {ended.error}"
    work = f"{plural(result.evaluations, 'evaluation')}, {duration(result.seconds)}"
    champion, held_out = result.champion, ""
    if champion is not None and champion.mean is not None:
        held_out = f"held-out {per_trial(champion.mean, result.trials)}"
    best = with_trials(result.best, result.trials)
    parts = (name, f"best {best}", held_out, work, ", ".join(flaws(result)))
    return "  ".join(filter(None, parts))


def _show(outcome: StudyOutcome) -> None:
    """Print the table of settings, the failed runs, and what can be done next."""
    assessed = any(summary.held_out is not None for summary in outcome.settings)
    held_out = [">held-out"] if assessed else []
    columns = (">runs", ">q25", ">median", ">q75", ">best", *held_out, ">evaluated")
    table = tables.table("setting", *columns)
    for summary in outcome.settings:
        label = summary.label or (
            "unchanged" if len(outcome.settings) > 1 else "all runs"
        )
        spread = summary.fitness
        values = [spread.q25, spread.median, spread.q75, spread.best]
        values += [summary.held_out] if assessed else []
        numbers = (
            "" if value is None else per_trial(value, summary.trials, 5)
            for value in values
        )
        tables.row(table, label, summary.runs, *numbers, summary.evaluations)
    tables.show(table)
    tables.unit(summary.trials for summary in outcome.settings)
    for ended in outcome.failed:
        tables.line(f"failed  {ended.planned.name}: {ended.error}")
    _show_next(outcome)


def _show_next(outcome: StudyOutcome) -> None:
    runs = f"{outcome.finished} of {plural(outcome.runs, 'run')} finished"
    tables.line(f"{runs}, {duration(outcome.seconds)}")
    tables.line(f"study   {outcome.study}")
    if outcome.failed:
        tables.line(f"again   zswarm-ot resume {outcome.study}")
    if outcome.relative:
        tables.paragraph(f"{SCORES[0].upper()}{SCORES[1:]}.")
    if outcome.finished:
        tables.line(f"next    zswarm-ot plot {outcome.study}")
    if outcome.finished and not outcome.relative:
        tables.line(f"        zswarm-ot compare {outcome.study}")
