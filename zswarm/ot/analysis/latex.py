r"""Write a comparison as LaTeX tables, with the rules of the package booktabs."""

import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence

from zswarm.ot.analysis.comparison import Comparison, Row, effort_unit, ordered
from zswarm.ot.analysis.effect_size import LEVEL
from zswarm.ot.analysis.significance import Pair
from zswarm.system.text import clean

SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{letter: f"\\{letter}" for letter in "&%$#_{}"},
}
GROUPS = ("", "runs", "median", "quartiles", "best")
PLAIN = (
    1e-3,
    1e6,
)  # sizes of the largest number of a table that is written without an exponent
PAIRS = ("", "", "$U$", "$p$", r"$p_\mathrm{Holm}$", "$A_{12}$", r"95\,\%", "effect")


def tables(found: Comparison) -> str:
    """Return the table of groups and, if groups were tested, that of pairs.

    A group that is significantly better than each other one of its problem is bold. The notes of
    the comparison are comments.
    """
    best = _best(found)
    comments = [
        f"{found.of}; needs \\usepackage{{booktabs}}",
        *found.notes,
        *(f"no test{where}: {why}" for where, why in found.untested),
        *(
            ["bold: significantly higher than each other group of its problem"]
            if best
            else []
        ),
    ]
    unit = effort_unit(found.rows)
    forms = {
        problem: _form([row for row in found.rows if row.problem == problem])
        for problem in {row.problem for row in found.rows}
    }
    rows = []
    for row in found.rows:
        form = forms[row.problem]
        held_out = [number(row.held_out, form)] if found.of_search else []
        effort = f"{getattr(row, unit):.0f}"
        rows.append([*_group(row, form, bold=row.group in best), *held_out, effort])
    heads = (*GROUPS, *(["held-out"] if found.of_search else []), unit)
    parts = [*(f"% {clean(text)}" for text in comments), tabular(heads, rows)]
    if found.pairs:
        parts.append(tabular(PAIRS, map(_pair, found.pairs), texts=2))
    return "\n".join(parts)


def _group(row: Row, form: str, *, bold: bool) -> Sequence[str]:
    return (
        escaped(row.group),
        str(row.runs),
        _bold(number(row.median, form), wanted=bold),
        f"{number(row.q25, form)}--{number(row.q75, form)}",
        number(row.best, form),
    )


def _form(rows: Sequence[Row]) -> str:
    """Return a format with as many decimals as the largest number has of four digits."""
    shown = [(row.median, row.q25, row.q75, row.best, row.held_out) for row in rows]
    largest = max(
        (abs(value) for row in shown for value in row if value is not None), default=0.0
    )
    if not PLAIN[0] <= largest < PLAIN[1]:
        return ".4g"
    return f".{max(0, 3 - math.floor(math.log10(largest)))}f"


def _pair(pair: Pair) -> Sequence[str]:
    return (
        escaped(pair.first),
        escaped(pair.second),
        f"{pair.u:.6g}",
        p_value(pair.p),
        _bold(p_value(pair.p_holm), wanted=pair.p_holm < LEVEL),
        f"{pair.a12:.2f}",
        f"{pair.a12_low:.2f}--{pair.a12_high:.2f}",
        pair.effect,
    )


def _best(found: Comparison) -> set[str]:
    """Return the groups that are significantly better than each other one of their problem."""
    won = Counter(ordered(pair)[0] for pair in found.pairs if pair.p_holm < LEVEL)
    problem = {row.group: row.problem for row in found.rows}
    size = Counter(problem.values())
    return {group for group, wins in won.items() if wins == size[problem[group]] - 1}


def tabular(heads: Sequence[str], rows: Iterable[Sequence[str]], texts: int = 1) -> str:
    """Return a table; its first columns are texts, the others numbers."""
    columns = "l" * texts + "r" * (len(heads) - texts)
    body = "\n".join(f"{' & '.join(row)} \\\\" for row in rows)
    return (
        f"\\begin{{tabular}}{{{columns}}}\n\\toprule\n{' & '.join(heads)} \\\\\n\\midrule\n"
        f"{body}\n\\bottomrule\n\\end{{tabular}}\n"
    )


def escaped(text: str) -> str:
    """Return a text in which LaTeX's special letters stand for themselves."""
    return re.sub(r"[\\~^&%$#_{}]", lambda match: SPECIAL[match[0]], clean(text))


def number(value: float | None, form: str = ".4g") -> str:
    """Return a number, by default of four digits."""
    if value is None:
        return "--"
    text = f"{value:{form}}"
    if "e" in text:
        digits, _, power = text.partition("e")
        return rf"${digits}\cdot 10^{{{int(power)}}}$"
    return f"${text}$" if value < 0 else text


def p_value(p: float) -> str:
    """Return a probability as papers print it."""
    return "$<0.001$" if p < 0.001 else f"{p:.3f}"


def _bold(text: str, *, wanted: bool) -> str:
    """Return text in bold; mathematics has a command of its own for that."""
    if not wanted:
        return text
    if text.startswith("$"):
        return rf"{{\boldmath{text}}}"
    return rf"\textbf{{{text}}}"
