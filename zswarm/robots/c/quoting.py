"""Texts of others in generated files: one function for each language that makes any text harmless.

``templates.fill`` takes code of a template's language, numbers, and plain words; it refuses other
texts. So a name that was not quoted is an error of the program, never a line of a robot's code.
"""

import re
from typing import Literal
from xml.sax.saxutils import escape

Language = Literal["c", "python", "xml", "markdown"]
# Letters, digits and what never ends a string, a comment, a tag or a cell in any of the languages.
PLAIN = re.compile(r"[A-Za-z0-9_., /+-]*")


class Code(str):
    """Text in a language, made here or from what was quoted."""

    __slots__ = ("language",)

    def __new__(cls, language: Language, text: str) -> "Code":
        """Declare a text to be code of a language."""
        made = super().__new__(cls, text)
        made.language = language
        return made

    language: Language


def c_string(text: str) -> str:
    """Return a text as a string literal of C and C++, in ASCII; other bytes are octal escapes."""
    letters = text.encode("utf-8", "replace").decode("latin-1")
    special = re.compile(r"[^A-Za-z0-9 _\-.,:;/()\[\]+*=%<>!]")
    escaped = special.sub(lambda letter: f"\\{ord(letter[0]):03o}", letters)
    return f'"{escaped}"'


def c_comment(text: str) -> str:
    """Make a text safe in a C comment: one line of ASCII, without ``*/`` and trigraphs."""
    shown = re.sub("[^ -~]", " ", text.encode("ascii", "backslashreplace").decode())
    for mark in ("*/", "/*", "??", "//"):
        shown = shown.replace(mark, f"{mark[0]} {mark[1]}")
    return shown.rstrip("\\ ")


def python_literal(value: str | list[str]) -> Code:
    """Return a text, or a list of texts, as an expression of Python, in ASCII."""
    return Code("python", ascii(value))


def xml_text(text: str) -> Code:
    """Return a text as the content of an element of XML, in ASCII and on one line."""
    letters = text.encode("utf-8", "replace").decode()
    # XML 1.0 has no way to write control characters, surrogates and these two.
    possible = re.sub("[\x00-\x1f\x7f-\x9f\ufffe\uffff]", " ", letters)
    return Code("xml", escape(possible).encode("ascii", "xmlcharrefreplace").decode())


def markdown_code(text: str) -> Code:
    """Return a text so that it can be code in a cell of a Markdown table: one line."""
    shown = "".join(letter if letter.isprintable() else " " for letter in text)
    return Code("markdown", re.sub(r"[`|\\<>]", " ", shown).strip() or " ")
