"""``zswarm-ot replay``: play recorded trials again."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from zswarm.errors import ConfigError
from zswarm.ot.commands.shared import options, suggestions
from zswarm.ot.display import tables
from zswarm.system import terminal
from zswarm.system.files import write_for_user
from zswarm.system.format import plural
from zswarm.system.text import clean

if TYPE_CHECKING:
    from zswarm.ot.replay.page import Side
    from zswarm.ot.replay.steps import TrialSteps
    from zswarm.ot.replay.trace import Trace

MENU = ("Results", 4)
FORMATS = {".gif": "gif", ".html": "html", ".htm": "html", ".csv": "csv"}
LARGEST = 256 << 20  # bytes of the traces of a page


@click.command("replay")
@click.argument("path", type=options.PATH, metavar="RUN", shell_complete=suggestions.runs)
@click.argument(
    "other",
    type=options.PATH,
    metavar="[RUN]",
    required=False,
    shell_complete=suggestions.runs,
)
@options.number_option(
    "--generation",
    "given",
    multiple=True,
    help="Generation, from 1; of two runs one for each may be given.  [default: the champion's]",
)
@options.candidate_option
@options.number_option(
    "--trial", default=0, show_default=True, help="Trial of the candidate, from 0."
)
@click.option(
    "--generations",
    metavar="all|rising|N,N,...",
    help="Step through the best of these generations, from 1; rising: of those in which the best "
    "rose.",
)
@click.option(
    "--trials", is_flag=True, help="Step through all trials, beginning with --trial."
)
@click.option(
    "--to",
    type=click.Choice(["gif", "html", "csv"]),
    help="Write a file, and open no browser.",
)
@options.output_option(
    "The file: .gif, .html or .csv.  [default: RUN-replay with that extension]"
)
@options.json_option
def command(
    path: Path,
    other: Path | None,
    given: tuple[int, ...],
    candidate: int | None,
    trial: int,
    generations: str | None,
    trials: bool,
    to: str | None,
    output: Path | None,
    as_json: bool,
) -> None:
    """Play recorded trials again, and watch them in the browser.

    A trial is computed from the record, bit for bit as in the run. Without --to and -o a page
    with a player, replay.html in the run's folder, is opened in the browser. Two runs are played
    side by side on one clock.

    \b
      zswarm-ot replay runs/stadium
      zswarm-ot replay runs/stadium --generations rising --trials
      zswarm-ot replay runs/stadium runs/stadium --generation 1 --generation 200
      zswarm-ot replay runs/stadium --to gif
      zswarm-ot replay runs/stadium -o champion.html
    """
    from zswarm.ot.record.reader import Run
    from zswarm.ot.replay import steps

    paths = [one for one in (path, other) if one]
    kind = to or (_format(output) if output else None)
    several = bool(other or generations or trials)
    _check(given, candidate, generations, len(paths), kind if several else None)
    names = "-".join(one.resolve().name for one in paths)
    output = output or Path(f"{names}-replay.{kind}")
    chosen = []
    for number, one in enumerate(paths):
        # One that is given alone counts for both runs.
        first = given[min(number, len(given) - 1)] - 1 if given else None
        chosen.append(
            steps.choose(Run(one), first, candidate, trial, generations, trials=trials)
        )
    if several:
        _show_several(chosen, kind, output, as_json=as_json)
    else:
        _show_one(chosen[0], kind, output, as_json=as_json)


def _check(
    given: Sequence[int],
    candidate: int | None,
    generations: str | None,
    runs: int,
    kind: str | None,
) -> None:
    """Refuse options that contradict each other.

    Args:
        kind: of the file, where there is more than one trial.
    """
    if len(given) > runs:
        raise ConfigError(
            f"--generation is given {plural(len(given), 'time')} for {plural(runs, 'run')}; "
            "--generations steps through several"
        )
    if candidate is not None and generations:
        raise ConfigError(
            "--candidate is one of a generation: --generations shows the best of each"
        )
    if kind in ("gif", "csv"):
        raise ConfigError(
            f"--to {kind} shows one trial; expected html with two runs, --generations or --trials"
        )


def _show_one(
    chosen: "TrialSteps", kind: str | None, output: Path, *, as_json: bool
) -> None:
    from zswarm.ot.replay import page

    (found,) = chosen.play()
    title = _title(found.about)
    _warn(found.about, found.note, found.error)
    folder = chosen.run.folder
    output, hint = _write(found, title, kind, output, folder)
    if as_json:
        one = page.Played(found.about, [*found.fitness], found.note, found.error, b"")
        tables.print_json({"file": str(output), **_as_object(one)})
        return
    fitness_text = ", ".join(f"{value:.6g}" for value in found.fitness)
    tables.line(f"{clean(str(output))}: {title}, fitness {fitness_text}{hint}")


def _show_several(
    chosen: "Sequence[TrialSteps]", kind: str | None, output: Path, *, as_json: bool
) -> None:
    from zswarm.ot.replay import page

    sides = _played(chosen)
    shown = [side.trials[side.start] for side in sides]
    title = " | ".join(_title(one.about) for one in shown)
    text = page.page(sides, title)
    hint = ""
    if kind:
        write_for_user(output, text.encode())
    else:
        output, opened = page.show(text, chosen[0].run.folder)
        hint = _hint(opened)
    every = [one for side in sides for one in side.trials]
    if as_json:
        trials = [_as_object(one) for one in every]
        tables.print_json({"file": str(output), "trials": trials})
        return
    tables.line(f"{clean(str(output))}: {title}; {plural(len(every), 'trial')}{hint}")


def _played(chosen: "Sequence[TrialSteps]") -> "list[Side]":
    """Play all trials, showing how far that is; a kind has one colour in all of a simulator."""
    from rich.progress import Progress

    from zswarm.ot.replay import page

    colours: dict[str, dict[str, str]] = {}  # of kinds, by simulator
    size, sides = 0, []
    total = sum(len(steps.trials) for steps in chosen)
    screen = terminal.console(stderr=True, live=True)
    with Progress(
        console=screen, transient=True, disable=not terminal.moves(sys.stderr)
    ) as shown:
        task = shown.add_task("playing trials", total=total)
        for steps in chosen:
            shared = colours.setdefault(steps.run.experiment.problem.simulator, {})
            trials = []
            for found in steps.play():
                trials.append(page.played(found, shared))
                _warn(found.about, found.note, found.error)
                size += len(trials[-1].encoded)
                if size > LARGEST:
                    raise ConfigError(
                        f"the page would have more than {LARGEST >> 20} MB; name fewer "
                        "generations, or omit --trials"
                    )
                shown.advance(task)
            sides.append(page.Side(trials, steps.start))
    return sides


def _title(about: dict[str, Any]) -> str:
    numbers = {**about, "generation": about["generation"] + 1}
    trial_of = (f"{key} {numbers[key]}" for key in ("generation", "candidate", "trial"))
    return ", ".join([about["run"], *trial_of])


def _warn(about: dict[str, Any], note: str, error: str) -> None:
    if note:
        tables.line(f"{_title(about)}: not the recorded trial: {note}", stderr=True)
    if error:
        tables.line(f"{_title(about)}: the trial failed: {error}", stderr=True)


def _as_object(one: Any) -> dict[str, Any]:
    fitness = [None if value != value else value for value in one.fitness]
    return {**one.about, "fitness": fitness, "note": one.note, "error": one.error}


def _hint(opened: bool) -> str:
    return "" if opened else " (no browser was found: open this file in one)"


def _write(
    found: "Trace", title: str, kind: str | None, output: Path, folder: Path
) -> tuple[Path, str]:
    """Write a file, or open the browser; return the file, and a hint."""
    from zswarm.ot.analysis import csv as spreadsheet
    from zswarm.ot.replay import gif, page

    match kind:
        case "csv":
            spreadsheet.save(str(output), *page.table(found))
        case "gif":
            write_for_user(output, gif.gif(found, title))
        case "html":
            write_for_user(output, _page(found, title).encode())
        case _:
            output, opened = page.show(_page(found, title), folder)
            return output, _hint(opened)
    return output, ""


def _page(found: "Trace", title: str) -> str:
    from zswarm.ot.replay import page

    return page.page([page.Side([page.played(found)])], title)


def _format(output: Path) -> str:
    try:
        return FORMATS[output.suffix.lower()]
    except KeyError:
        raise ConfigError(
            f"{output}: expected a name that ends in .gif, .html or .csv"
        ) from None
