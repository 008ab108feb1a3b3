"""Logs of robots as the paper's package writes them: one file per robot, a line ``step TAB m to the nearest exit`` now and then.

Lines that begin with ``#`` or have one character at most are none; of two lines of a step the later one holds. Formats after
github.com/aau-ros/cpswarm and github.com/cpswarm/StageSimulationManager.
"""

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from zswarm.protocol.codec import clean
from zswarm.sims.exit_fitness import FARTHEST, LONGEST, cpswarm_log, last_distance

MAX_BYTES = 64 << 20  # of a log
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
LINE = re.compile(rf"\s*(?P<step>[-+]?\d+)\s*\t\s*(?P<distance>{NUMBER})\s*")
GIVEN = re.compile(rf"^\s*fitness\s*=\s*(?P<number>{NUMBER})\s*$", re.M)


class LogError(Exception):
    """A log is missing, or says something else than expected; the text says where."""


class Last(NamedTuple):
    """What a robot's log comes to."""

    distance: float | None  # m, of its last line; None: it has none
    steps: int  # that are in it


def read(folder: Path, robots: int) -> list[Last]:
    """The logs of a folder, by their names.

    Raises:
        LogError: there is not one for each robot, or one is malformed.
    """
    files = sorted(folder.glob("*.log"))
    if len(files) != robots:
        names = f" ({', '.join(clean(file.name) for file in files[:5])}{', ...' if len(files) > 5 else ''})" if files else ""
        raise LogError(f"{folder.name}/ has {len(files)} logs{names}; expected {robots}, one of each robot")
    return [last(read_log(file)) for file in files]


def read_log(file: Path) -> dict[int, float]:
    """Distances, m, by step, in the order of the steps' first lines.

    Raises:
        LogError: a line is something else, or the file cannot be read.
    """
    try:
        if file.stat().st_size > MAX_BYTES:
            raise LogError(f"{clean(file.name)}: {file.stat().st_size} bytes; expected {MAX_BYTES} at most")
        text = file.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise LogError(f"{clean(file.name)}: cannot be read: {error.strerror}") from None
    found: dict[int, float] = {}
    for number, line in enumerate(text.split("\n"), 1):
        if line.startswith("#") or len(line.strip("\r")) <= 1:
            continue
        match = LINE.fullmatch(line)
        if match is None or not math.isfinite(float(match["distance"])):
            raise LogError(f"{clean(file.name)}, line {number}: expected a step, a tab and a distance, not {clean(line)[:60]!r}")
        found[int(match["step"])] = float(match["distance"])
    return found


def last(log: Mapping[int, float]) -> Last:
    """What a log comes to; its last line is that of the highest step."""
    return Last(log[max(log)] if log else None, len(log))


def fitness(rule: str, robots: list[Last]) -> float:
    """What a trial is worth, by one of the published rules (``exit_fitness``).

    A log without lines is one of ``FARTHEST`` m and ``LONGEST`` lines for cpswarm-log, as its authors have it.

    Raises:
        LogError: a log without lines has no last distance.
    """
    if rule == "cpswarm-log":
        return cpswarm_log(
            [FARTHEST if robot.distance is None else robot.distance for robot in robots],
            [robot.steps or LONGEST for robot in robots],
        )
    distances = [robot.distance for robot in robots if robot.distance is not None]
    if len(distances) < len(robots):
        raise LogError(f"{len(robots) - len(distances)} of {len(robots)} logs have no lines; last-distance needs one in each")
    return last_distance(distances)


def given(said: str) -> float:
    """The last ``fitness=<number>`` in what a user's program printed.

    Raises:
        LogError: there is none.
    """
    found = GIVEN.findall(said)
    if not found:
        raise LogError("its output has no line fitness=<number>")
    return float(found[-1])
