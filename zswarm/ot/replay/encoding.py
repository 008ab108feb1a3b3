"""Encode a trace in few bytes for the player; docs/replay.md has the format."""

import math
import struct
import zlib
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np

from zswarm.ot.replay.appearance import kinds
from zswarm.ot.replay.trace import Trace
from zswarm.sims.simulator import Frame
from zswarm.system.text import clean

MAGIC, VERSION = b"zswtrace", 1
MOST_NUMBERS = 150_000  # of agents, a byte each before compression
MOST_LABELS = 2_000  # changes of labels
TURN = 65_536  # steps of a heading in a full turn
STEPS = 65_535  # of a coordinate
LEVELS = 254  # of a number of agents; 0 is NaN
AS_IN_TRACE = (
    "about note error no_picture fitness metrics rounds every sensors actuators neurons"
).split()


def encode(trace: Trace, shown: dict[str, str] | None = None) -> bytes:
    """Return the bytes of a trace; ``shown`` as in ``appearance.kinds``."""
    header, tracks = _header(trace, shown), _tracks(trace)
    header["tracks"] = [track.header() for track in tracks]
    text = msgspec.json.encode(header)  # NaN becomes null
    packed = zlib.compress(b"".join(track.packed() for track in tracks), 9)
    return MAGIC + struct.pack("<II", VERSION, len(text)) + text + packed


class _Track(NamedTuple):
    """A table of whole numbers, a row per frame or round."""

    name: str
    values: np.ndarray  # (rows, columns) uint16 or uint8
    # Values of the least and the greatest number: one for all columns, or several used in turn.
    low: Sequence[float] = (0.0,)
    high: Sequence[float] = (1.0,)

    def header(self) -> dict[str, Any]:
        rows, columns = self.values.shape
        shape = {"rows": rows, "columns": columns, "bytes": self.values.itemsize}
        return {"name": self.name, **shape, "low": self.low, "high": self.high}

    def packed(self) -> bytes:
        """Return differences between rows, by column; high bytes first, which compresses well."""
        steps = np.diff(self.values, axis=0, prepend=self.values[:1] * 0).T
        halves = (
            np.ascontiguousarray(steps)
            .astype(steps.dtype.newbyteorder(">"))
            .view(np.uint8)
        )
        return np.ascontiguousarray(halves.reshape(-1, self.values.itemsize).T).tobytes()


def _header(of: Trace, shown: dict[str, str] | None) -> dict[str, Any]:
    header: dict[str, Any] = {
        **{name: getattr(of, name) for name in AS_IN_TRACE},
        "agents": len(of.owners),
        "owners": [*map(int, of.owners)],
        "numbers_every": _numbers_every(of),
    }
    if not of.frames:
        return header
    first, colours = of.frames[0], kinds(of.frames, shown=shown)
    number_of = _numbered(colours)
    return header | {
        "width": float(first.width),
        "height": float(first.height),
        "kinds": [clean(kind) for kind in colours],
        "colours": list(colours.values()),
        "places": [
            [number_of[place.kind], *map(float, place[1:])] for place in first.places
        ],
        "radii": [float(body.radius) for body in first.bodies],
        "shapes": [body.shape for body in first.bodies],
        "headed": [int(body.heading is not None) for body in first.bodies],
        "lines": [number_of[line.kind] for line in first.lines],
        "rays": [[*map(float, ray)] for ray in first.rays],
        "labels": _labels(of.frames),
    }


def _numbered(kinds: Iterable[str]) -> dict[str, int]:
    return {kind: number for number, kind in enumerate(kinds)}


def _tracks(of: Trace) -> list[_Track]:
    tracks, every = _positions(of.frames) if of.frames else [], _numbers_every(of)
    for name, numbers in (
        ("inputs", of.inputs),
        ("outputs", of.outputs),
        ("hidden", of.hidden),
    ):
        if numbers.size:
            tracks.append(_levels(name, numbers[::every]))
    return tracks


def _positions(frames: Sequence[Frame]) -> list[_Track]:
    """Return where bodies and the ends of lines are, and headings and kinds of the bodies."""
    number_of, first, count = _numbered(kinds(frames)), frames[0], len(frames)
    bodies = np.array(
        [
            [(b.x, b.y, b.heading or 0.0, number_of[b.kind]) for b in frame.bodies]
            for frame in frames
        ]
    ).reshape(count, -1, 4)
    ends = np.array([[line[1:] for line in frame.lines] for frame in frames])
    x, y = np.concatenate([bodies[:, :, :2], ends.reshape(count, -1, 2)], axis=1).T
    heading = np.rint(bodies[:, :, 2] / (2 * math.pi) * TURN).astype(np.int64) % TURN
    return [
        _coordinates("x", x.T, first.width),
        _coordinates("y", y.T, first.height),
        _Track("heading", heading.astype(np.uint16)),
        _Track("kind", bodies[:, :, 3].astype(np.uint16)),
    ]


def _coordinates(name: str, values: np.ndarray, size: float) -> _Track:
    """Return coordinates, also outside the field, whose size is given."""
    low, high = float(values.min(initial=0.0)), float(values.max(initial=size))
    scaled = np.rint((values - low) * (STEPS / (high - low))).astype(np.uint16)
    return _Track(name, scaled, [low], [high])


def _levels(name: str, numbers: np.ndarray) -> _Track:
    """Return numbers of agents; each kind of number has its own scale."""
    known, values = np.isfinite(numbers), numbers.astype(np.float64)
    low = np.where(known, values, np.inf).min(axis=(0, 1))
    high = np.where(known, values, -np.inf).max(axis=(0, 1))
    low = np.where(np.isfinite(low), low, 0.0)
    high = np.where(np.isfinite(high), high, low)
    size = np.where(high > low, high - low, 1.0)
    scaled = np.rint((np.where(known, values, low) - low) / size * LEVELS) + 1
    levels = np.where(known, scaled, 0).astype(np.uint8).reshape(len(numbers), -1)
    return _Track(name, levels, low.tolist(), high.tolist())


def _numbers_every(of: Trace) -> int:
    """Return how many frames there are for one whose numbers are encoded."""
    size = of.inputs.size + of.outputs.size + of.hidden.size
    return max(1, -(-size // MOST_NUMBERS))


def _labels(frames: Sequence[Frame]) -> list[list[Any]]:
    """Return the labels of each frame in which they change, after its number."""
    changes: list[list[Any]] = []
    shown: list[list[Any]] = []
    for number, frame in enumerate(frames):
        labels = [[clean(label.text), *map(float, label[1:])] for label in frame.labels]
        if labels != shown and len(changes) < MOST_LABELS:
            changes.append([number, labels])
            shown = labels
    return changes
