"""Measure how long commands take from return to prompt.

A run of one generation on two slots of this machine, and commands that evaluate nothing, each time
a new program; beside them one of Python that does nothing.
"""

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import machine
import tables

ROUNDS = 9
LISTED = 200  # runs
DRAWN_LATER = shutil.ignore_patterns("*fitness.png*")  # by another program
PROGRAM = Path(sys.executable).with_name("zswarm-ot")
BARE = [sys.executable, "-c", "pass"]
ONE_GENERATION = ["run", "--generations", "1"]  # of stadium, on this machine
COMPLETION = {  # as a shell asks for it
    "_ZSWARM_OT_COMPLETE": "bash_complete",
    "COMP_WORDS": "zswarm-ot re",
    "COMP_CWORD": "1",
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--quick", action="store_true", help="one round instead of nine: whether it works"
    )
    parser.add_argument(
        "--folder", type=Path, help="where the results go [default: build/bench]"
    )
    options = parser.parse_args()
    machine.warn_if_busy()
    begin, rounds = time.monotonic(), 1 if options.quick else ROUNDS
    rows = commands(rounds)
    seconds = round(time.monotonic() - begin)
    file = machine.write(
        "commands", rows, folder=options.folder, rounds=rounds, seconds=seconds
    )
    print(f"{tables.commands(json.loads(file.read_text()))}\n{file}, {seconds} s")


def commands(rounds: int) -> list[dict[str, Any]]:
    """Return how long commands take from return to prompt."""
    with tempfile.TemporaryDirectory() as folder:
        seconds_of(folder, [*ONE_GENERATION, "--out", "listed"])
        for number in range(LISTED - 1):
            listed = Path(folder) / "listed"
            copy = listed / f"copy-{number}"
            shutil.copytree(listed / "stadium", copy, ignore=DRAWN_LATER)
        asked: dict[str, tuple[list[str], dict[str, str]]] = {
            "a run of one generation": (ONE_GENERATION, {}),
            "python -c pass, for comparison": (BARE, {}),
            "--version": (["--version"], {}),
            "--help": (["--help"], {}),
            "completion of a word": ([], COMPLETION),
            f"list of {LISTED} runs": (["list", "listed"], {}),
        }
        times: dict[str, list[float]] = {}
        for _ in range(rounds):
            for name, (arguments, more) in asked.items():
                times.setdefault(name, []).append(seconds_of(folder, arguments, more))
    return [
        {
            "of": name,
            "s": statistics.median(all_),
            "s_least": min(all_),
            "s_most": max(all_),
        }
        for name, all_ in times.items()
    ]


def seconds_of(
    folder: str, arguments: list[str], more: dict[str, str] | None = None
) -> float:
    """Return the seconds of a command."""
    begin = time.perf_counter()
    subprocess.run(
        arguments if arguments == BARE else [PROGRAM, *arguments],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        check=True,
        env=os.environ | (more or {}),
    )
    return time.perf_counter() - begin


if __name__ == "__main__":
    main()
