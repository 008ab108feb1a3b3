r"""Write a comparison as LaTeX tables, with the rules of the package booktabs."""

import re
from collections.abc import Iterable, Sequence

from zswarm.ot.analysis.comparison import Comparison, effect
from zswarm.system.text import clean

SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{letter: f"\\{letter}" for letter in "&%$#_{}"},
}


def tables(found: Comparison) -> str:
    """Return the table of groups and, if groups were tested, that of pairs."""
    best = max((row.median for row in found.rows if row.median is not None), default=None)
    groups: list[Sequence[str]] = [
        (
            escaped(row.group),
            str(row.runs),
            _bold(number(row.median), wanted=row.median == best),
            f"{number(row.q25)}--{number(row.q75)}",
            number(row.best),
            number(row.held_out),
            f"{row.evaluations:.0f}",
        )
        for row in found.rows
    ]
    heads: tuple[str, ...] = (
        "",
        "runs",
        "median",
        "quartiles",
        "best",
        "held-out",
        "evaluations",
    )
    parts = [
        f"% {clean(found.of)}; needs \\usepackage{{booktabs}}",
        tabular(heads, groups),
    ]
    if found.pairs:
        pairs: list[Sequence[str]] = [
            (
                escaped(pair.first),
                escaped(pair.second),
                f"{pair.u:.6g}",
                p_value(pair.p),
                _bold(p_value(pair.p_holm), wanted=pair.p_holm < 0.05),
                f"{pair.a12:.2f}",
                f"{pair.a12_low:.2f}--{pair.a12_high:.2f}",
                effect(pair.a12),
            )
            for pair in found.pairs
        ]
        heads = (
            "",
            "",
            "$U$",
            "$p$",
            r"$p_\mathrm{Holm}$",
            "$A_{12}$",
            r"95\,\%",
            "effect",
        )
        parts.append(tabular(heads, pairs, texts=2))
    return "\n".join(parts)


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
