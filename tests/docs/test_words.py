"""Docstrings are plain technical English: a verb first, and the words of the field."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import zswarm

PACKAGE = Path(zswarm.__file__).parent
# A docstring that begins so is a clause or a fragment: "What a run records."
FRAGMENTS = set(
    "What Whatever Whether Where How Who Whoever Why Of Its It Those These That".split()
)
DIALECT = {
    r"\b[Ww]hoever\b": "a user, a program",
    r"\b(it|which|that) is none\b": "is not a valid ...",
    r"\banew\b": "again",
    r"\bgoes? on\b": "resumes, continues",
    r"\bof before\b": "previous",
    r"\bmended\b": "fixed",
}


def docstrings() -> Iterator[tuple[str, ast.AST, str]]:
    for path in sorted(PACKAGE.rglob("*.py")):
        if "templates" in path.parts:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
                name = getattr(node, "name", "module")
                yield (
                    f"{path.relative_to(PACKAGE)}: {name}",
                    node,
                    ast.get_docstring(node) or "",
                )


def test_docstrings_of_functions_begin_with_a_verb() -> None:
    functions = [
        (at, text) for at, node, text in docstrings() if isinstance(node, ast.FunctionDef)
    ]
    assert [at for at, text in functions if text.partition(" ")[0] in FRAGMENTS] == []


def test_docstrings_are_written_in_the_words_of_the_field() -> None:
    found = {}
    for at, _, text in docstrings():
        for pattern, better in DIALECT.items():
            if re.search(pattern, text):
                found[at] = f"{pattern}: {better}"
    assert found == {}
