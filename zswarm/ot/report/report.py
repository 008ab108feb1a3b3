"""Write a run or a study as one HTML file without scripts and requests, also for print.

The template ``report.html.jinja`` escapes every text; texts of a record are cleaned before.
"""

import re
import shlex
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from zswarm import experiment
from zswarm.ot.analysis import (
    comparison,
    curves,
    drawing,
    figures,
    grouping,
    picture,
    significance,
)
from zswarm.ot.estimate.retrospect import look_back
from zswarm.ot.notes import RunEvent
from zswarm.ot.record import epochs
from zswarm.ot.record.folder import EXPERIMENT
from zswarm.ot.record.reader import Row, Run
from zswarm.ot.record.runs import runs_below
from zswarm.ot.replay import held_out
from zswarm.ot.report import champion as champions
from zswarm.ot.report import compared_by
from zswarm.ot.report.repeating import repeats
from zswarm.ot.report.settings import contrast, in_order, rows_of, study_rows
from zswarm.system.extras import need
from zswarm.system.files import write_for_user
from zswarm.system.format import duration, plural
from zswarm.system.text import clean

TEMPLATE = "report.html.jinja"
MAX_EVENTS = 1000  # that are listed
MAX_COLUMNS = 6  # groups that have a column of their settings; more have a row
TROUBLE = (
    RunEvent.SERVER_WRONG,
    RunEvent.SERVER_BANNED,
    RunEvent.SERVER_FAULTY,
    RunEvent.FAULT,
    RunEvent.SIMULATOR_RAISED,
    RunEvent.DISK_WAITED,
    RunEvent.MALFORMED,
    RunEvent.UNVERIFIED,
)
# Colours of figures, which become those of the page.
INKS = {
    "#000000": "currentColor",
    "#dddddd": "var(--line)",
    "#555555": "var(--dim)",
    "#ffffff": "none",
}


def write(path: Path, output: Path, trials: int) -> None:
    """Write the report of a run's or study's folder.

    Args:
        trials: on held-out seeds that the champion plays; 0: none.

    Raises:
        ConfigError: there is no run, it cannot be read, a package is missing, or the file cannot
            be written.
    """
    need("jinja2", "plot", "report")
    figures.plain_style()
    runs = runs_below([path])
    text = of_run(runs[0], trials) if len(runs) == 1 else of_study(path, runs)
    write_for_user(output, text.encode())


def of_run(run: Run, trials: int) -> str:
    """Return the page of a run."""
    numbers = curves.series(run)
    champion, servers = run.champion(), run.servers()
    events = [
        {**event, "text": epochs.shown(event["event"], event["text"] or "")}
        for event in run.events()
    ]
    parts: dict[str, Any] = {}
    if len(numbers.best):
        parts["curve"] = _svg(figures.of_series({run.name: [numbers]}, size="screen"))
    if not run.finished:
        (parts["state"],) = curves.unfinished([run])
    if champion:
        parts |= champions.sections(champion, trials)
        parts |= {"champion": champion, "hindsight": look_back(run, champion.genome)}
    return _page(
        run=run,
        title=run.name,
        numbers=numbers,
        settings=rows_of([run]),
        servers=servers,
        events=_events(events),
        all_events=events[:MAX_EVENTS],
        left_out=max(0, len(events) - MAX_EVENTS),
        folder=shlex.quote(run.name),
        again=shlex.quote(f"{run.name}/{EXPERIMENT}"),
        history=run.history_hash or "",
        history_version=run.history_version,
        repeats=repeats(run),
        other_code=held_out.other_code(run),
        **parts,
    )


def of_study(path: Path, runs: Sequence[Run]) -> str:
    """Return the page of several runs."""
    groups = grouping.groups(runs)
    loaded, _ = curves.load(groups)
    name = clean(path.resolve().name)
    example, study = Path(EXPERIMENT), path / EXPERIMENT
    parts: dict[str, Any] = {}
    shared, differing = contrast({each: rows_of(groups[each]) for each in groups})
    if study.is_file():
        shared = in_order([*study_rows(experiment.load(study)), *shared])
    else:
        example = runs[0].folder.relative_to(path) / EXPERIMENT
    if len(loaded) <= drawing.MAX_GROUPS:
        parts["curve"] = _svg(
            figures.of_series(loaded, picture.usual_axis(runs), size="screen")
        )
    if any(run.relative for run in runs):
        parts["state"] = f"{comparison.SCORES[0].upper()}{comparison.SCORES[1:]}."
    else:
        parts["measured"] = compared_by.compare(groups)
    return _page(
        title=name,
        groups=list(groups),
        finished=sum(run.finished for run in runs),
        comparison=comparison,
        significance=significance,
        in_problem=grouping.in_problem,
        runs=[(group, run) for group, members in groups.items() for run in members],
        settings=shared,
        differing=differing,
        max_columns=MAX_COLUMNS,
        folder=shlex.quote(name),
        again=shlex.quote(f"{name}/{clean(str(example))}"),
        one_again=str(example) != EXPERIMENT,
        **parts,
    )


def _page(**content: Any) -> str:
    jinja2 = need("jinja2", "plot", "report")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "clean": clean,
        "duration": duration,
        "number": champions.number,
        "plural": plural,
        "when": _when,
    }
    page: str = environment.get_template(TEMPLATE).render(content)
    return page


# ---- the parts of a page


def _events(events: Sequence[Row]) -> list[Row]:
    """Count the events of each kind, the gravest first."""
    counts = Counter(event["event"] for event in events)
    last = {event["event"]: event for event in events}
    grave = [
        *TROUBLE,
        *(event for event in RunEvent if event.severity != "info"),
        *sorted(counts),
    ]
    return [
        {
            "kind": kind,
            "count": counts[kind],
            "last": last[kind],
            "trouble": kind in TROUBLE,
        }
        for kind in sorted(counts, key=grave.index)
    ]


def _svg(figure: Any) -> str:
    """Return a figure as part of the page: in the page's colours, without requests."""
    _, _, text = figures.render(figure, "svg").decode().partition("<svg")
    text = re.sub(r"<metadata>.*?</metadata>\s*|<!--.*?-->\s*", "", text, flags=re.S)
    text = re.sub(r'<g id="[^"]*">', "<g>", text)
    root, rest = text.split(">", 1)
    for ink, name in INKS.items():
        rest = rest.replace(f": {ink}", f": {name}")
    (box,) = re.findall(r'viewBox="[^"]*"', root)
    return f'<svg class="figure" role="img" aria-label="Learning curve" {box}>{rest}'


def _when(at: float) -> str:
    try:
        return time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime(at))
    except (OverflowError, ValueError, OSError):  # no time that a calendar has
        return f"{at:.6g}"
