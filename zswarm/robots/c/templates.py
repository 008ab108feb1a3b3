"""Fill the templates of exported files: each ``@{word}`` in them is replaced."""

import re
from collections.abc import Mapping
from pathlib import Path

TEMPLATES = Path(__file__).parents[1] / "templates"
WORD = re.compile(r"@\{(\w+)\}")


def fill(template: str, words: Mapping[str, object]) -> str:
    """Return the text of a template with its words replaced, once."""
    text = (TEMPLATES / template).read_text(encoding="utf-8")
    return WORD.sub(lambda word: str(words[word[1]]), text)
