"""Print what a study is about to do: its settings, the work of each, and what is unequal."""

from collections.abc import Iterator, Sequence
from typing import Any

from zswarm.experiment import Experiment
from zswarm.ot.display import tables
from zswarm.ot.study import effort
from zswarm.ot.study.effort import Cell
from zswarm.system.format import plural

COLUMNS = 6  # settings up to which each has a column, and its differences are shown
ROWS = 40  # settings that are shown


def show(cells: Sequence[Cell], *, stderr: bool = False) -> None:
    """Print a table of settings."""
    if len(cells) <= COLUMNS:
        table = tables.table("", *(cell.label for cell in cells))
        for name, values in _rows(cells):
            tables.row(table, name, *values)
    else:
        table = tables.table("setting", *(f">{name}" for name, _ in _work(cells[:1])))
        for cell in cells[:ROWS]:
            tables.row(table, cell.label, *(values[0] for _, values in _work([cell])))
    tables.show(table, stderr=stderr)
    if len(cells) > max(ROWS, COLUMNS):
        more = plural(len(cells) - ROWS, "more setting")
        tables.line(f"and {more}", stderr=stderr)


def total(cells: Sequence[Cell], repeat: int) -> str:
    """Return the work of the whole study in words."""
    evaluations = repeat * sum(cell.effort.evaluations for cell in cells)
    simulations = repeat * sum(cell.effort.simulations for cell in cells)
    assessed = repeat * sum(cell.effort.assessment_simulations for cell in cells)
    runs = plural(repeat * len(cells), "run")
    words = f"{runs}, {plural(evaluations, 'evaluation')}, {plural(simulations, 'simulation')}"
    return f"{words}, and at most {assessed:,} to assess champions" if assessed else words


def announce(loaded: Experiment, cells: Sequence[Cell], repeat: int) -> None:
    """Print what a study begins with, on stderr."""
    if len(cells) > 1:
        show(cells, stderr=True)
    tables.line(f"in all: {total(cells, repeat)}", stderr=True)
    for warning in effort.warnings(loaded, cells):
        tables.paragraph(f"note: {warning}", stderr=True)


def as_objects(cells: Sequence[Cell]) -> list[dict[str, Any]]:
    """Return the settings for programs."""
    differing = effort.differing(cells)
    return [
        {
            "setting": cell.label,
            "genome_numbers": cell.genes,
            **cell.effort._asdict(),
            "differing": {key: row[at] for key, row in differing.items() if row[at]},
        }
        for at, cell in enumerate(cells)
    ]


def _rows(cells: Sequence[Cell]) -> Iterator[tuple[str, list[str]]]:
    yield from effort.contrasts(cells).items()
    yield from _work(cells)


def _work(cells: Sequence[Cell]) -> Iterator[tuple[str, list[str]]]:
    yield "genome", [_genome(cell) for cell in cells]
    yield "candidates", [_candidates(cell) for cell in cells]
    for name in ("generations", "evaluations", "simulations"):
        yield name, [f"{getattr(cell.effort, name):,}" for cell in cells]
    assessed = [cell.effort.assessment_simulations for cell in cells]
    if any(assessed):
        yield "assessment", [f"{count:,}" for count in assessed]


def _genome(cell: Cell) -> str:
    return "grows" if cell.genes is None else plural(cell.genes, "number")


def _candidates(cell: Cell) -> str:
    first, later = cell.effort.first, cell.effort.later
    return f"{first:,}" if first == later else f"{first:,}, then {later:,}"
