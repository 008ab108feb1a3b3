"""``zswarm-ot compare``: compare groups of runs, and test differences for significance."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from zswarm.ot.commands.shared import options
from zswarm.ot.display import tables
from zswarm.system.format import duration

if TYPE_CHECKING:
    from zswarm.ot.analysis.comparison import By, Comparison
    from zswarm.ot.analysis.effect_size import Friedman
    from zswarm.ot.analysis.importance import Importance

MENU = ("Results", 8)
PAIRS = 6  # pairs that are described in words
NOT_REPEATED = " Without repeats, chance has a part in each share."
REST = 0.001  # share of higher interactions from which on they are shown


@click.command("compare")
@options.paths_argument
@click.option(
    "--by",
    type=click.Choice(["generations", "evaluations", "simulations"]),
    help="Compare runs after an equal number of these.  [default: what they have a budget of, "
    "else generations]",
)
@options.measure_option
@options.label_option
@options.csv_option
@click.option(
    "--latex", metavar="FILE", help="Also write tables for LaTeX (booktabs); - is stdout."
)
@options.json_option
def command(
    paths: tuple[Path, ...],
    by: "By | None",
    measure: str | None,
    labels: tuple[str, ...],
    csv: str | None,
    latex: str | None,
    as_json: bool,
) -> None:
    """Compare groups of runs, and test differences for significance.

    Shows median and quartiles of each group. Runs that differ only in their seed form a group.
    The tests are Mann-Whitney U with Holm's correction, and Kruskal-Wallis, within each problem;
    over several problems, Friedman.

    \b
      zswarm-ot compare runs/study --by evaluations
      zswarm-ot compare runs/study --measure held-out --latex table.tex
      zswarm-ot compare runs/study --label "kind nnga=NNGA" --csv table.csv
    """
    from zswarm.ot.analysis import compared, grouping
    from zswarm.ot.analysis import csv as spreadsheet
    from zswarm.ot.analysis import latex as latex_tables
    from zswarm.ot.record.runs import runs_below
    from zswarm.ot.study.study import not_begun
    from zswarm.system.files import write_for_user

    options.check_stdout("-" if "-" in (csv, latex) else None, as_json=as_json)
    skipped: list[str] = []
    groups = grouping.renamed(grouping.groups(runs_below(paths, skipped)), labels)
    found = compared.compare(groups, by, measure)
    absent = [note for path in paths for note in not_begun(path)]
    found = found._replace(notes=[*absent, *found.notes])
    ranked = compared.over_problems(groups, found)
    for note in skipped:
        tables.line(note, stderr=True)
    if csv:
        spreadsheet.save(csv, *_cells(found))
    if latex == "-":
        click.echo(latex_tables.tables(found), nl=False)
    elif latex:
        write_for_user(Path(latex), latex_tables.tables(found).encode())
    if as_json:
        friedman = None if ranked is None else ranked._asdict()
        tables.print_json(_as_object(found) | {"friedman": friedman})
    elif "-" not in (csv, latex):
        show(found)
        if ranked is not None:
            _show_ranks(ranked)


def _as_object(found: "Comparison") -> dict[str, Any]:
    explained = found.importance
    return {
        **found._asdict(),
        "of": found.of,
        "rows": [one._asdict() for one in found.rows],
        "pairs": [pair.as_object() for pair in found.pairs],
        "families": [one._asdict() for one in found.families],
        "importance": None if explained is None else explained.as_object(),
    }


def _cells(found: "Comparison") -> tuple[list[str], list[list[object]]]:
    """Return the rows of a CSV file: one for each group, then one for each pair."""
    from zswarm.ot.analysis.comparison import Row
    from zswarm.ot.analysis.significance import Pair

    tests = [*Pair._fields[2:-1], "delta", "effect"]
    header = ["what", *Row._fields, "second", *tests]
    rows: list[list[object]] = [["group", *row] for row in found.rows]
    for row in rows:
        row += [None] * (len(header) - len(row))
    blank = [None] * (len(Row._fields) - 2)
    for pair in found.pairs:
        cells: list[object] = ["pair", pair.first, *blank, pair.problem, pair.second]
        rows.append([*cells, *pair[2:-1], pair.delta, pair.effect])
    return header, rows


def _show_ranks(ranked: "Friedman") -> None:
    from zswarm.ot.analysis.significance import p_value

    table = tables.table("method", ">mean rank")
    for name, rank in sorted(ranked.ranks.items(), key=lambda item: item[1]):
        tables.row(table, name, f"{rank:.2f}")
    tables.show(table)
    each = "Each problem ranks the methods by their medians; 1 is the best."
    if ranked.problems < ranked.needed:
        tables.paragraph(
            f"No test over problems: with {len(ranked.ranks)} methods, Friedman's test can show a "
            f"difference over {ranked.needed} or more problems; here are {ranked.problems}. {each}"
        )
    else:
        what = f"Friedman over {ranked.problems} problems: {p_value(ranked.p)}."
        tables.paragraph(f"{what} {each}")


def show(found: "Comparison") -> None:
    """Print a comparison for people."""
    from zswarm.ot.analysis import comparison

    unit = comparison.effort_unit(found.rows)
    held_out = [">held-out"] if found.of_search else []
    numbers = (">runs", ">median", ">quartiles", ">best", ">worst")
    costs = (f">{unit}/run", ">time")
    table = tables.table("group", *numbers, *held_out, *costs, padding=(0, 1, 0, 0))
    for row in found.rows:
        several = row.runs > 1
        quartiles = f"{_number(row.q25)} / {_number(row.q75)}" if several else ""
        cells = [_number(row.median), quartiles, _number(row.best), _number(row.worst)]
        if found.of_search:
            cells.append("" if row.held_out is None else _number(row.held_out))
        spent = (f"{getattr(row, unit):.0f}", duration(row.seconds))
        tables.row(table, row.group, row.runs, *cells, *spent)
    tables.show(table)
    for note in found.notes:
        tables.paragraph(note)
    tables.paragraph(comparison.explanation(found))
    if len(found.rows) > 1:
        tables.line("")
    _show_tests(found)
    if found.importance is not None:
        _show_importance(found.importance)


def _show_tests(found: "Comparison") -> None:
    from zswarm.ot.analysis import significance
    from zswarm.ot.analysis.effect_size import LEVEL
    from zswarm.ot.analysis.grouping import in_problem

    if len(found.rows) == 1:
        tables.paragraph(
            "No test: there is one group. Runs that differ only in their seed form a group."
        )
    if len(found.families) > 1:
        tables.paragraph(
            "The groups of each problem are tested with each other: fitness of different problems "
            "does not compare."
        )
    for family in found.families:
        where = in_problem(family.problem)
        if family.kruskal_p is not None:
            tables.paragraph(
                f"Kruskal-Wallis over all groups{where}: {significance.p_value(family.kruskal_p)}; "
                f"below {LEVEL} at least one group differs from the others."
            )
        if note := significance.disagreement(family, found.pairs):
            tables.paragraph(note)
    if found.pairs:
        _show_pairs(found)
    for where, why in found.untested:
        tables.paragraph(f"No test{where}: {why}.")


def _show_importance(found: "Importance") -> None:
    tables.line("")
    if found.why:
        tables.paragraph(f"Importance of settings: not computed, because {found.why}.")
        return
    table = tables.table("explained by", ">eta2", ">beyond chance", padding=(0, 1, 0, 0))
    for effect in found.effects:
        beyond = "" if effect.epsilon2 is None else f"{effect.epsilon2:.1%}"
        tables.row(table, effect.name, f"{effect.eta2:.1%}", beyond)
    if found.rest >= REST:
        tables.row(table, "interactions of three and more", f"{found.rest:.1%}", "")
    if found.noise is not None:
        tables.row(table, "differences between repeats", f"{found.noise:.1%}", "")
    tables.show(table)
    chance = "" if found.noise is not None else NOT_REPEATED
    tables.paragraph(
        f"Share of the variance of the {found.runs} runs' fitness explained by a setting (eta "
        "squared), and the same share corrected for chance (epsilon squared). a x b: how far the "
        f"effect of a depends on b.{chance}"
    )


def _show_pairs(found: "Comparison") -> None:
    from zswarm.ot.analysis import comparison
    from zswarm.ot.analysis.effect_size import LEVEL

    table = tables.table("first", "second", ">U", ">p", ">p (Holm)", ">A12", ">95 %")
    for pair in found.pairs:
        numbers = (f"{pair.u:.6g}", _p(pair.p), _p(pair.p_holm), f"{pair.a12:.2f}")
        interval = f"{pair.a12_low:.2f} to {pair.a12_high:.2f}"
        tables.row(table, pair.first, pair.second, *numbers, interval)
    tables.show(table)
    each = " of a problem" if len(found.families) > 1 else ""
    methods = ", ".join(sorted({pair.method for pair in found.pairs}))
    tables.paragraph(
        f"Mann-Whitney U ({methods}). p: how often chance alone gives a difference at least this "
        f"large where there is none; below {LEVEL} it is significant. Holm: corrected "
        f"for the number of pairs{each}; this one decides. A12: how often a run of the first group "
        "is higher than one of the second; 0.5: equally often."
    )
    tables.line("")
    for pair in sorted(found.pairs, key=lambda pair: pair.p_holm)[:PAIRS]:
        tables.paragraph(comparison.describe(pair, found.measure))


def _number(value: float | None) -> str:
    return "failed" if value is None else f"{value:.4g}"


def _p(p: float) -> str:
    return "< 0.001" if p < 0.001 else f"{p:.3f}"
