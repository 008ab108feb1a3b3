"""Logs of robots as the paper's package writes them: ``step TAB m to the nearest exit``.

Each robot has one file. Lines that begin with ``#`` or have at most one character are skipped; of
two lines of a step the later one counts. Formats after github.com/aau-ros/cpswarm and
github.com/cpswarm/StageSimulationManager.
"""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from zswarm.sims.exit_fitness import FARTHEST, LONGEST, cpswarm_log, last_distance
from zswarm.system.text import clean

MAX_BYTES = 64 << 20  # of a log
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
LINE = re.compile(rf"\s*(?P<step>[-+]?\d+)\s*\t\s*(?P<distance>{NUMBER})\s*")
GIVEN = re.compile(rf"^\s*fitness\s*=\s*(?P<number>{NUMBER})\s*$", re.M)
SHOWN = 5  # names of logs in an error message


class LogError(Exception):
    """A log is missing, or has something unexpected; the text names where."""


class RobotLog(NamedTuple):
    """The result of a robot."""

    distance: float | None  # m, in the last line; None: there is none
    steps: int


def read(folder: Path, robots: int) -> list[RobotLog]:
    """Read the logs of a folder, in the order of their names."""
    files = sorted(folder.glob("*.log"))
    if len(files) != robots:
        shown = [clean(file.name) for file in files[:SHOWN]] + ["..."] * (
            len(files) > SHOWN
        )
        names = f" ({', '.join(shown)})" if shown else ""
        raise LogError(
            f"{folder.name}/ has {len(files)} logs{names}; expected {robots}, one of each robot"
        )
    return [last(read_log(file)) for file in files]


def read_log(file: Path) -> dict[int, float]:
    """Return distances, m, by step, in the order of the steps' first lines."""
    name = clean(file.name)
    try:
        size = file.stat().st_size
        if size > MAX_BYTES:
            raise LogError(f"{name}: {size} bytes; expected {MAX_BYTES} at most")
        text = file.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise LogError(f"{name}: cannot be read: {error.strerror}") from None
    found: dict[int, float] = {}
    for number, line in enumerate(text.split("\n"), 1):
        if line.startswith("#") or len(line.strip("\r")) <= 1:
            continue
        match = LINE.fullmatch(line)
        if match is None or not math.isfinite(float(match["distance"])):
            shown = f"not {clean(line)[:60]!r}"
            raise LogError(
                f"{name}, line {number}: expected a step, a tab and a distance, {shown}"
            )
        found[int(match["step"])] = float(match["distance"])
    return found


def last(log: Mapping[int, float]) -> RobotLog:
    """Return the result of a log; its last line is that of the highest step."""
    return RobotLog(log[max(log)] if log else None, len(log))


def fitness(rule: str, robots: list[RobotLog]) -> float:
    """Return the fitness of a trial by a published rule (``exit_fitness``).

    In cpswarm-log a log without lines counts as ``FARTHEST`` m and ``LONGEST`` lines, as its
    authors have it.
    """
    distances = [robot.distance for robot in robots if robot.distance is not None]
    if rule == "cpswarm-log":
        filled = [
            FARTHEST if robot.distance is None else robot.distance for robot in robots
        ]
        return cpswarm_log(filled, [robot.steps or LONGEST for robot in robots])
    if empty := len(robots) - len(distances):
        raise LogError(
            f"{empty} of {len(robots)} logs have no lines; last-distance needs one in each"
        )
    return last_distance(distances)


def given(output: str) -> float:
    """Return the last ``fitness=<number>`` in the output of a user's program."""
    found = GIVEN.findall(output)
    if not found:
        raise LogError("its output has no line fitness=<number>")
    return float(found[-1])
