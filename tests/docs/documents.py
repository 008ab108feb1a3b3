"""Read the documents for tests: their code blocks, and the commands in these."""

import re
from pathlib import Path
from typing import NamedTuple

from tests.repository import REPOSITORY

DOCUMENTS = [
    *(path for path in sorted(REPOSITORY.glob("*.md")) if path.name != "CHANGELOG.md"),
    *sorted((REPOSITORY / "docs").glob("*.md")),
]
FENCE = re.compile(r"^```(?P<language>[^\n`]*)\n(?P<text>.*?)^```$", re.S | re.M)
FILE = re.compile(r"`([\w./-]+\.\w+)`:\s*\Z")  # the text before a block that shows a file
OF_THE_PROJECT = ("zswarm-ot", "zswarm-ss", "zswarm-router", "zswarm-keys")
PROGRAMS = (
    *OF_THE_PROJECT,
    "python",
    "python3",
    "pip",
    "pipx",
    "uv",
    "make",
    "git",
    "ssh",
    "scp",
    "sudo",
    "systemctl",
    "podman",
    "docker",
    "fleet.sh",
    "apt",
    "sbatch",
    "cp",
    "sed",
    "ls",
    "sqlite3",
)


class Block(NamedTuple):
    """Describe a code block of a document."""

    document: str  # its file's name
    section: str  # the heading of the second level above it
    line: int  # of its first line, from 1
    language: str
    text: str
    file: str  # the file whose content it is; "" for others

    @property
    def first(self) -> str:
        """Return its first line, by which tables name it."""
        return self.text.partition("\n")[0]

    @property
    def transcript(self) -> bool:
        """Return whether it shows commands after ``$`` with their output."""
        return self.language in ("console", "") and self.text.startswith("$ ")

    @property
    def has_commands(self) -> bool:
        """Return whether it holds commands to type."""
        if self.language == "sh" or self.transcript:
            return True
        return self.language in ("", "console", "bash", "shell") and any(
            line.split(maxsplit=1)[0] in PROGRAMS
            for line in self.text.splitlines()
            if line.strip()
        )


def blocks(document: Path) -> list[Block]:
    """Return a document's code blocks in order."""
    text = document.read_text(encoding="utf-8")
    found = []
    for match in FENCE.finditer(text):
        before = text[: match.start()]
        shows = FILE.search(before)
        found.append(
            Block(
                document.name,
                (re.findall(r"^## (.*)$", before, re.M) or [""])[-1],
                text.count("\n", 0, match.start()) + 2,
                match["language"].strip(),
                match["text"],
                shows[1] if shows else "",
            )
        )
    return found
