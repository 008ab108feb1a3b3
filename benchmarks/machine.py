"""Describe the machine and write ``build/bench/<script>.json``."""

import datetime
import importlib.metadata
import os
import platform
import re
import shutil
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import results_file

HERE = Path(__file__).resolve().parent
RESULTS = HERE.parent / "build" / "bench"
OURS = ("zswarm", "eclipse-zenoh", "numba", "numpy")
QUIET = 0.5  # the load of a machine that does nothing else


def machine() -> dict[str, Any]:
    """Return ``cores`` of this process, ``cpu``, ``gib``, ``system``, ``python`` and ``load``."""
    cpu = platform.machine()
    text = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    if named := re.search(r"^model name\s*: (.+)$", text, re.MULTILINE):
        cpu = named[1].strip()
    return {
        "cores": len(os.sched_getaffinity(0)),
        "cpu": cpu,
        "gib": round(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "load": round(os.getloadavg()[0], 2),
    }


def versions(names: Iterable[str]) -> dict[str, str]:
    """Return versions of installed distributions, ``mosquitto`` and ``gcc``."""
    found = {}
    for name in dict.fromkeys(names):
        if name in PROGRAMS:
            if program := program_of(name):
                said = subprocess.run(
                    [program, PROGRAMS[name]], capture_output=True, text=True, check=False
                ).stdout
                if number := re.search(r"\d+(\.\d+)+", said):
                    found[name] = number[0]
            continue
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


PROGRAMS = {"mosquitto": "-h", "gcc": "--version"}  # and how each says its version


def program_of(name: str) -> str | None:
    """Return a program's path, also from folders of root."""
    return shutil.which(name) or shutil.which(
        name, path="/usr/local/sbin:/usr/sbin:/sbin"
    )


def warn_if_busy() -> None:
    """Warn when the machine is busy."""
    if (load := os.getloadavg()[0]) > QUIET:
        print(
            f"the load is {load:.1f}: something else runs here, and the figures will be worse than "
            "they are",
            flush=True,
        )


def write(
    script: str,
    rows: Sequence[dict[str, Any]],
    packages: Sequence[str] = (),
    *,
    folder: Path | None = None,
    **about: Any,
) -> Path:
    """Write what a script measured, whole or not at all.

    Args:
        script: its name, without ``.py``.
        rows: one for each thing measured; one that could not be has ``missing``, the reason.
        packages: distributions and programs beside ours whose versions belong to it.
        folder: other than ``build/bench``.
        about: of the whole, such as ``rounds``.
    """
    found = {
        "script": script,
        "when": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "machine": machine(),
        "versions": versions([*OURS, *packages]),
        **about,
        "rows": list(rows),
    }
    file = (folder or RESULTS) / f"{script}.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    results_file.write(file, found)
    return file
