"""The functions that ``import zswarm`` offers on recorded runs: figures, tables and tests."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from zswarm.errors import ConfigError
from zswarm.ot.analysis import grouping
from zswarm.ot.analysis.grouping import flat
from zswarm.ot.record.reader import Run
from zswarm.ot.record.runs import runs_below
from zswarm.system.extras import need
from zswarm.system.format import plural

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

    from zswarm.ot.analysis.comparison import By
    from zswarm.ot.analysis.curves import Axis
    from zswarm.ot.analysis.drawing import Size

Folder = str | os.PathLike[str]


class Compared:
    """The result of ``compare``, as data frames.

    Attributes:
        groups: a row for each group: runs, median, quartiles, best, worst, held-out, effort.
        pairs: a row for each pair of a problem: U, p, Holm's p, A12 with its 95 % interval,
            Cliff's delta, the size of the effect. Empty if there are too few runs for a test.
        families: a row for each problem: p of Kruskal-Wallis, why no pair was tested, and where
            runs were compared.
        notes: what a reader of the numbers has to know.
        of: what is compared.
        latex: tables for a paper.
    """

    groups: "pandas.DataFrame"
    pairs: "pandas.DataFrame"
    families: "pandas.DataFrame"
    notes: list[str]
    of: str
    latex: str

    def __repr__(self) -> str:
        runs = [
            f"{group}: {plural(count, 'run')}"
            for group, count in zip(
                self.groups["group"], self.groups["runs"], strict=True
            )
        ]
        return f"<Compared: {self.of}; {', '.join(runs)}; {plural(len(self.pairs), 'pair')} tested>"


def compare(
    *runs: Folder | Run,
    by: "By | None" = None,
    measure: str | None = None,
    labels: Mapping[str, str] | None = None,
) -> Compared:
    """Compare groups of runs, as ``zswarm-ot compare`` does.

    Args:
        runs: runs, their folders, or folders that contain runs.
        by: compare after equally many "generations", "evaluations" or "simulations"; None: what
            all runs have a budget of, else generations.
        measure: "search": best fitness in search; "held-out"; "fitness" or a metric, of
            ``zswarm-ot evaluate``; None: "held-out" if all runs are finished and assessed and
            ``by`` is None, else "search".
        labels: other names of groups.

    Raises:
        ConfigError: there are no runs, they do not compare, or pandas is missing.

    Example::

        found = zswarm.compare("runs/study", by="evaluations")
        print(found.pairs[["first", "second", "p_holm", "a12"]])
    """
    from zswarm.ot.analysis import compared, latex

    frame = need("pandas", "data", "compare").DataFrame
    found = compared.compare(_groups(runs, labels, "compare"), by, measure)
    made = Compared()
    made.groups = frame([row._asdict() for row in found.rows])
    made.pairs = frame([pair.as_object() for pair in found.pairs])
    made.families = frame([one._asdict() for one in found.families])
    made.notes, made.of = found.notes, found.of
    made.latex = latex.tables(found)
    return made


def tidy(
    *runs: Folder | Run,
    rows: Literal["runs", "generations", "trials"] = "runs",
    labels: Mapping[str, str] | None = None,
) -> "pandas.DataFrame":
    """Return runs as one data frame: group, run, seed, the settings that differ, and numbers.

    Fitness is the mean of a trial.

    Args:
        runs: runs, their folders, or folders that contain runs.
        rows: one row for each run, with the means of ``zswarm-ot evaluate`` if it played the
            champion (``evaluated_fitness``, ``evaluated_METRIC``); one for each generation of a
            run; or one for each trial of its champion, as ``zswarm-ot evaluate`` played it.
        labels: other names of groups.

    Raises:
        ConfigError: there are no runs, champions were not evaluated, or pandas is missing.

    Example::

        frame = zswarm.tidy("runs/study", rows="generations")
        frame.groupby(["group", "generation"])["best"].median()
    """
    groups = _groups(runs, labels, "tidy")
    flats = {
        run.folder: flat(run.experiment) for found in groups.values() for run in found
    }
    keys = dict.fromkeys(key for values in flats.values() for key in values)
    differing = [
        key
        for key in keys
        if len({repr(values.get(key)) for values in flats.values()}) > 1
    ]
    made: list[dict[str, Any]] = []
    for group, members in groups.items():
        for run in members:
            of = {"group": group, "run": run.name, "seed": run.experiment.seed}
            of |= {key: flats[run.folder].get(key) for key in differing}
            made += [{**of, **row} for row in _rows(run, rows)]
    frame: pandas.DataFrame = need("pandas", "data", "tidy").DataFrame(made)
    return frame


def plot(
    *runs: Folder | Run,
    x: "Axis | None" = None,
    size: "Size" = "column",
    title: str = "",
    lowest: float | None = None,
    kind: Literal["curves", "box", "violin", "archive"] = "curves",
    measure: str | None = None,
    labels: Mapping[str, str] | None = None,
    style: str = "",
) -> "Figure":
    """Return a matplotlib figure of learning curves; repeats are a median with a band.

    Args:
        runs: runs, their folders, or folders that contain runs.
        x: the horizontal axis: "generation", "evaluations", "simulations" or "time". None: what all
            runs have a budget of, as in ``compare``, else generations.
        size: "column" or "page" of a paper, or "slides".
        title: above the figure.
        lowest: lower limit of the fitness axis.
        kind: curves of learning, one number of each run as boxes or violins, or the archive of a
            run of ``map-elites``.
        measure: the number of each run, as for ``compare``.
        labels: other names of groups.
        style: a file of matplotlib's settings, or the name of a style.

    Raises:
        ConfigError: there are no runs, none finished a generation or reached ``lowest``, or
            matplotlib is missing.
        ValueError: another x or size.

    Example::

        seeds = [zswarm.run(zswarm.load("stadium", {"seed": seed})) for seed in range(5)]
        zswarm.plot(*seeds).savefig("stadium.pdf")
    """
    from zswarm.ot.analysis import archive, boxes, compared, curves, figures, picture
    from zswarm.ot.analysis.drawing import SIZES

    groups = _groups(runs, labels, "plot")
    members = [run for each in groups.values() for run in each]
    if kind == "curves":
        loaded, _ = curves.load(groups)
        axis = x or picture.usual_axis(members)
        made = figures.of_series(loaded, axis, size, title, lowest, style)
        return figures.for_notebooks(made)
    chosen = SIZES[size]._replace(file=style)
    if kind == "archive":
        found = archive.of_runs(members)
        return figures.for_notebooks(archive.draw(found, chosen, title))
    values, height, _ = compared.numbers(groups, measure)
    return figures.for_notebooks(boxes.draw(values, height, kind, chosen, title))


def _rows(run: Run, rows: str) -> list[dict[str, Any]]:
    """Return the rows of a run."""
    from zswarm.ot.analysis import curves, measure

    if rows not in ("runs", "generations", "trials"):
        raise ValueError(f"rows: expected runs, generations or trials, not {rows!r}")
    if rows == "trials":
        found = measure.load(run)
        return [
            {"trial": trial, "fitness": fitness}
            | {name: float(column[trial]) for name, column in found.metrics.items()}
            for trial, fitness in enumerate(found.fitness.tolist())
        ]
    series = curves.series(run)
    numbers = (series.best, series.mean, series.evaluations, series.seconds)
    names = ("best", "mean", "evaluations", "seconds")
    columns = zip(*(column.tolist() for column in numbers), strict=True)
    made: list[dict[str, Any]] = [dict(zip(names, row, strict=True)) for row in columns]
    if rows == "generations":
        return [{"generation": at, **row} for at, row in enumerate(made)]
    if not made:
        return []
    held_out = None if series.held_out is None else series.held_out[0]
    row = {"generations": len(made), **made[-1], "held_out": held_out}
    if measure.exists(run):
        evaluated = measure.load(run)
        for name in (measure.FITNESS, *evaluated.metrics):
            row[f"evaluated_{name}"] = evaluated.value(name)
    return [row]


def _groups(
    runs: tuple[Folder | Run, ...], labels: Mapping[str, str] | None, what: str
) -> dict[str, list[Run]]:
    found: list[Run] = []
    for run in runs:
        found += [run] if isinstance(run, Run) else runs_below([Path(run)])
    if not found:
        raise ConfigError(f"{what}: expected at least one run")
    chosen = [f"{group}={name}" for group, name in (labels or {}).items()]
    return grouping.renamed(grouping.groups(found), chosen)
