"""Make text from other machines and programs safe to show."""

import unicodedata

MAX_LENGTH = 500  # characters
# Unicode categories: controls, formats, surrogates, private use, unassigned, line separators.
UNSAFE = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}


def clean(text: str) -> str:
    """Escape control and format characters, and limit the length: safe in terminals and logs."""
    if text.isascii() and text.isprintable():
        return text[:MAX_LENGTH]
    return "".join(map(_escaped, text))[:MAX_LENGTH]


def _escaped(character: str) -> str:
    unsafe = unicodedata.category(character) in UNSAFE
    return f"\\x{ord(character):02x}" if unsafe else character
