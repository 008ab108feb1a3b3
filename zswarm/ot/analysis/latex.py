r"""Write a comparison as LaTeX tables, with the rules of the package booktabs."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence

from zswarm.ot.analysis.comparison import LEVEL, Comparison, Pair, Row, effect
from zswarm.system.text import clean

SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{letter: f"\\{letter}" for letter in "&%$#_{}"},
}
GROUPS = ("", "runs", "median", "quartiles", "best", "held-out", "evaluations")
PAIRS = ("", "", "$U$", "$p$", r"$p_\mathrm{Holm}$", "$A_{12}$", r"95\,\%", "effect")


def tables(found: Comparison) -> str:
    """Return the table of groups and, if groups were tested, that of pairs.

    A group that is significantly better than each other one is bold. The notes of the comparison
    are comments.
    """
    best = _best(found)
    comments = [
        f"{found.of}; needs \\usepackage{{booktabs}}",
        *found.notes,
        *([f"no test: {found.untested}"] if found.untested else []),
        *(["bold: significantly better than each other group"] if best else []),
    ]
    groups = [_group(row, bold=row.group == best) for row in found.rows]
    parts = [*(f"% {clean(text)}" for text in comments), tabular(GROUPS, groups)]
    if found.pairs:
        parts.append(tabular(PAIRS, map(_pair, found.pairs), texts=2))
    return "\n".join(parts)


def _group(row: Row, *, bold: bool) -> Sequence[str]:
    return (
        escaped(row.group),
        str(row.runs),
        _bold(number(row.median), wanted=bold),
        f"{number(row.q25)}--{number(row.q75)}",
        number(row.best),
        number(row.held_out),
        f"{row.evaluations:.0f}",
    )


def _pair(pair: Pair) -> Sequence[str]:
    return (
        escaped(pair.first),
        escaped(pair.second),
        f"{pair.u:.6g}",
        p_value(pair.p),
        _bold(p_value(pair.p_holm), wanted=pair.p_holm < LEVEL),
        f"{pair.a12:.2f}",
        f"{pair.a12_low:.2f}--{pair.a12_high:.2f}",
        effect(pair.a12),
    )


def _best(found: Comparison) -> str | None:
    """Return the group that is significantly better than each other one, if there is one."""
    won: Counter[str] = Counter()
    for pair in found.pairs:
        if pair.p_holm < LEVEL:
            won[pair.first if pair.a12 > 0.5 else pair.second] += 1
    others = len(found.rows) - 1
    return next((group for group, wins in won.items() if wins == others), None)


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


def number(value: float | None) -> str:
    """Return a number of four digits."""
    if value is None:
        return "--"
    text = f"{value:.4g}"
    if "e" in text:
        digits, _, power = text.partition("e")
        return rf"${digits}\cdot 10^{{{int(power)}}}$"
    return f"${text}$" if value < 0 else text


def p_value(p: float) -> str:
    """Return a probability as papers print it."""
    return "$<0.001$" if p < 0.001 else f"{p:.3f}"


def _bold(text: str, *, wanted: bool) -> str:
    return rf"\textbf{{{text}}}" if wanted else text
