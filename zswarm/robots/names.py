"""Names that people gave, as names in C."""

import re
import unicodedata

LONGEST = 40  # letters of a controller's name


def folded(name: str) -> str:
    """A name of letters a to z, digits and single ``_``, a letter first: what a run is called as a part of names in C.

    Letters with marks lose these; all else becomes ``_``; a name of nothing becomes ``controller``.
    """
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().lower()
    plain = re.sub(r"[^a-z0-9]+", "_", plain)[:LONGEST].strip("_")
    if not plain:
        return "controller"
    return plain if plain[0].isalpha() else f"n{plain}"[:LONGEST].rstrip("_")


def quoted(text: str) -> str:
    """Any text as a string of C, in ASCII; bytes that are no plain letters by their number."""
    shown = [
        chr(byte) if chr(byte).isascii() and (chr(byte).isalnum() or chr(byte) in " _-.,:;/()[]+*=%<>!") else f"\\{byte:03o}"
        for byte in text.encode("utf-8", "replace")
    ]
    return f'"{"".join(shown)}"'
