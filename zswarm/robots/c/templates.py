"""Fill the templates of exported files: each ``@{word}`` in them is replaced, in one pass."""

import re
from collections.abc import Mapping
from pathlib import Path, PurePath

from zswarm.robots.c.quoting import PLAIN, Code, Language

TEMPLATES = Path(__file__).parents[1] / "templates"
WORD = re.compile(r"@\{(\w+)\}")
# By the end of a template's name; other templates take plain words only.
LANGUAGES: dict[str, Language] = {
    **dict.fromkeys((".c", ".h", ".cpp", ".hpp"), "c"),
    **dict.fromkeys((".py", ".in"), "python"),
    **dict.fromkeys((".xml", ".launch"), "xml"),
    ".md": "markdown",
}


def fill(template: str, words: Mapping[str, object]) -> Code:
    """Return the text of a template with its words replaced, once.

    Args:
        words: numbers, plain words, and code of the template's language.

    Raises:
        ValueError: a word is another text, which ``quoting`` has to quote.
    """
    language = LANGUAGES.get(PurePath(template).suffix)

    def replaced(word: re.Match[str]) -> str:
        value = words[word[1]]
        made = isinstance(value, Code) and value.language == language
        if made or isinstance(value, int | float) or PLAIN.fullmatch(str(value)):
            return str(value)
        raise ValueError(f"{template}: {word[1]} is not quoted: {value!r:.60}")

    text = (TEMPLATES / template).read_text(encoding="utf-8")
    return Code(language or "markdown", WORD.sub(replaced, text))
