"""How a study shows itself: a live table on a terminal, a line per finished run elsewhere, JSON lines on stdout for programs."""

import sys
import threading
import time
from typing import TYPE_CHECKING, Any

from zswarm.ot import terminal
from zswarm.ot.comparison import SCORES
from zswarm.ot.connection import Connection
from zswarm.ot.logger import Generation
from zswarm.ot.plan import Planned
from zswarm.ot.playing import Ended, Follower
from zswarm.ot.study import Outcome, Study, Summary
from zswarm.ot.terminal import plural
from zswarm.screen import console, moves

if TYPE_CHECKING:
    from rich.console import RenderableType

MOST_SHOWN = 8  # runs that go on, on a terminal
REFRESHES = 4  # a second


class PlainFollower(Follower):
    """Plain lines: one per run that ended, and a table at the end."""

    def __init__(self) -> None:
        self._ended = self._planned = 0

    def on_start(self, study: Study, connection: Connection | None) -> None:
        """See ``Follower``."""
        self._ended, self._planned = len(study.ended), len(study.planned)
        settings = len({one.name for one in study.planned if one.seed == study.planned[0].seed})
        each = f" of {plural(settings, 'setting')}" if settings > 1 else ""
        computes = f": {connection.who_computes()}" if connection is not None and study.left else ""
        self.say(f"{study.experiment.name}, {plural(self._planned, 'run')}{each}{computes}")
        if study.ended:
            self.say(f"{self._ended} of them {'is' if self._ended == 1 else 'are'} finished already")
        if study.others:
            self.say(f"left alone, for {study.folder / 'experiment.toml'} asks for none such: {', '.join(study.others)}")

    def say(self, line: str) -> None:
        """A line for people."""
        with terminal.patience():
            print(line, file=sys.stderr, flush=True)

    def on_say(self, line: str, planned: Planned | None) -> None:
        """See ``Follower``."""
        self.say(f"{planned.name}: {line}" if planned is not None else line)

    def on_run(self, ended: Ended) -> None:
        """See ``Follower``."""
        self._ended += 1
        self.say(f"{_of(ended)}  ({self._ended} of {self._planned})")

    def on_end(self, outcome: Outcome | None) -> None:
        """See ``Follower``."""
        if outcome is not None:
            with terminal.patience():
                _show(outcome)


class JsonFollower(PlainFollower):
    """One JSON object a line on stdout; what is for people goes to stderr."""

    def on_start(self, study: Study, connection: Connection | None) -> None:
        """See ``Follower``; runs that are finished already are told again."""
        super().on_start(study, connection)
        self._folder = study.folder
        for ended in study.ended:
            self._print(ended)

    def on_generation(self, planned: Planned, generation: Generation) -> None:
        """See ``Follower``."""
        values = {key: value for key, value in generation._asdict().items() if key != "statistics"}
        terminal.print_json({"event": "generation", "run": str(self._folder / planned.name), **values})

    def on_run(self, ended: Ended) -> None:
        """See ``Follower``."""
        self._print(ended)

    def on_end(self, outcome: Outcome | None) -> None:
        """See ``Follower``."""
        if outcome is not None:
            whole = outcome.whole
            terminal.print_json(
                {
                    "event": "done", "study": outcome.study, "runs": outcome.runs, "finished": outcome.finished,
                    "failed": len(outcome.failed), "median": whole.median, "q25": whole.q25, "q75": whole.q75,
                    "best": whole.best, "evaluations": whole.evaluations, "seconds": outcome.seconds,
                    "settings": [_as_mapping(summary) for summary in outcome.settings],
                }
            )  # fmt: skip

    def _print(self, ended: Ended) -> None:
        planned, result = ended.planned, ended.result
        values: dict[str, Any] = {"run": str(self._folder / planned.name), "seed": planned.seed, "settings": planned.settings}
        if result is None:
            terminal.print_json({"event": "failed", **values, "error": ended.error})
        else:
            terminal.print_json({"event": "run", **values, **{k: v for k, v in result._asdict().items() if k != "run"}})


class LiveFollower(PlainFollower):
    """A table that moves, on a terminal: how far all runs are, and each that goes on."""

    def __init__(self) -> None:
        super().__init__()
        from rich.live import Live

        self._lock = threading.Lock()  # the table is drawn by a thread of its own
        self._going: dict[str, tuple[Planned, int, str]] = {}  # generations that are over, and what is known of the best
        self._generations = self._done = self._before = self._evaluations = 0
        self._counted: dict[str, int] = {}  # evaluations of the runs that go on
        self._begin = 0.0  # when the first generation ended
        made = console(stderr=True, live=True)
        self._live = Live(get_renderable=self._table, console=made, refresh_per_second=REFRESHES, transient=True)

    def on_start(self, study: Study, connection: Connection | None) -> None:
        """See ``Follower``."""
        super().on_start(study, connection)
        self._generations = sum(one.experiment.generations for one in study.planned)
        self._done = sum(ended.planned.experiment.generations for ended in study.ended)
        self._before = self._done
        if study.left:
            self._live.start()

    def say(self, line: str) -> None:
        """A line for people."""
        from rich.text import Text

        self._live.console.print(Text(terminal.wrapped(line, self._live.console.width)), soft_wrap=True)

    def on_begin(self, planned: Planned, generation: int) -> None:
        """See ``Follower``."""
        with self._lock:
            self._going[planned.name] = (planned, generation, "waiting for a slot")
            self._done += generation
            self._before += generation

    def on_generation(self, planned: Planned, generation: Generation) -> None:
        """See ``Follower``."""
        with self._lock:
            if not self._begin:
                self._begin, self._before = time.monotonic(), self._before + 1
            self._going[planned.name] = (planned, generation.generation + 1, f"best {generation.best:.5g}")
            before = self._counted.setdefault(planned.name, generation.evaluations)
            self._evaluations += generation.evaluations - before
            self._counted[planned.name] = generation.evaluations
            self._done += 1

    def on_run(self, ended: Ended) -> None:
        """See ``Follower``."""
        with self._lock:
            _, generations, _ = self._going.pop(ended.planned.name, (ended.planned, 0, ""))
            skipped = ended.planned.experiment.generations - generations  # of one that failed
            self._done += skipped
            self._before += skipped
        super().on_run(ended)

    def on_end(self, outcome: Outcome | None) -> None:
        """See ``Follower``."""
        self._live.stop()
        super().on_end(outcome)

    def _table(self) -> "RenderableType":
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        with self._lock:
            seconds = time.monotonic() - self._begin if self._begin else 0.0
            made, left = self._done - self._before, self._generations - self._done
            rest = f"  about {_duration(seconds / made * left)} left" if made > 0 else ""
            head = Table.grid(padding=(0, 1))
            head.add_row(
                Text(f"{self._ended}/{self._planned} runs"),
                ProgressBar(total=max(1, self._generations), completed=self._done, width=16),
                Text(f"{self._evaluations / max(1.0, seconds):.0f}/s{rest}", no_wrap=True, overflow="ellipsis"),
            )
            rows = Table.grid(padding=(0, 2))
            for name, (planned, generations, best) in list(self._going.items())[:MOST_SHOWN]:
                rows.add_row(
                    Text(f"  {name}", no_wrap=True, overflow="ellipsis"),
                    Text(f"{generations}/{planned.experiment.generations}", justify="right", no_wrap=True),
                    Text(best, no_wrap=True),
                )
            if len(self._going) > MOST_SHOWN:
                rows.add_row(Text(f"  and {len(self._going) - MOST_SHOWN} more"))
        both = Table.grid()
        both.add_row(head)
        both.add_row(rows)
        return both


def follower(*, as_json: bool) -> Follower:
    """The one that fits where the output goes."""
    if as_json:
        return JsonFollower()
    return LiveFollower() if moves(sys.stderr) else PlainFollower()


def _of(ended: Ended) -> str:
    name, result = ended.planned.name, ended.result
    if result is None:
        return f"{name}  failed: {ended.error}"
    blemishes = ", ".join(
        f"{word}: {plural(count, 'trial')}"
        for word, count in (("faulted", result.faulted), ("doubtful", result.doubtful))
        if count
    )
    return (
        f"{name}  best {result.best:.6g}  {plural(result.evaluations, 'evaluation')}, {result.seconds:.1f} s"
        f"{'  ' + blemishes if blemishes else ''}"
    )


def _show(outcome: Outcome) -> None:
    """What it came to."""
    table = terminal.table("setting", "runs", "q25", "median", "q75", "best", "evaluated")
    for summary in outcome.settings:
        label = summary.label or ("as it is" if len(outcome.settings) > 1 else "all runs")
        values = [_number(value) for value in (summary.q25, summary.median, summary.q75, summary.best)]
        terminal.row(table, label, summary.runs, *values, summary.evaluations)
    terminal.show(table)
    for ended in outcome.failed:
        terminal.line(f"failed  {ended.planned.name}: {ended.error}")
    terminal.line(f"{outcome.finished} of {plural(outcome.runs, 'run')} finished, {outcome.seconds:.1f} s")
    terminal.line(f"study   {outcome.study}")
    if outcome.failed:
        terminal.line(f"again   zswarm-ot resume {outcome.study}")
    if outcome.relative:
        terminal.paragraph(f"{SCORES[0].upper()}{SCORES[1:]}.")
    if outcome.finished:
        terminal.line(f"next    zswarm-ot plot {outcome.study}")
    if outcome.finished and not outcome.relative:
        terminal.line(f"        zswarm-ot compare {outcome.study}")


def _as_mapping(summary: Summary) -> dict[str, Any]:
    return {key: value for key, value in summary._asdict().items() if key != "label"}


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"


def _duration(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}"
