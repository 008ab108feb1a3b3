"""The fields of ``emergency-exit``: drawn from a seed with Java's generator, or FREVO's stadium."""

from typing import NamedTuple

import numpy as np

from zswarm.kernels.jit import float32, int64, kernel, void
from zswarm.kernels.random import draw_java, start_java
from zswarm.kernels.signatures import Float32Rows, Int32Rows, UInt64s

FREE, BLOCKED = np.float32(1), np.float32(0)
MAX_CACHED = 100_000  # cells of fields that are cached for later trials

STADIUM = """
####################
#..................#
#..................#
#..................#
#.......####.......#
#.....##....##.....#
#....#........#....#
#....#........#....#
#...#..........#...#
E...#..........#...E
E...#..........#...E
#...#..........#...#
#....#........#....#
#....#........#....#
#.....##....##.....#
#.......####.......#
#..................#
#..................#
#..................#
####################
""".split()
STADIUM_AGENTS = """
 1,1 2,2 3,3 4,4 5,3 6,2 7,1 4,2 3,1 5,1 1,3 2,4 1,5 2,6 3,5 1,7 1,12 2,13 1,14 2,15 1,16 2,17 1,18
3,14 4,15 3,16 4,17 3,18 5,16 6,17 5,18 7,18 12,18 13,17 14,16 15,15 16,14 17,13 18,12 18,14 17,15
16,16 15,17 16,18 17,17 18,16 18,18 14,18 12,1 13,2 14,3 15,4 16,5 17,6 18,7 18,5 17,4 16,3 15,2
14,1 16,1 17,2 18,3 18,1 8,2 11,2 10,1 9,1 8,17 10,18 11,17 9,18
""".split()


class Fields(NamedTuple):
    """Fields as kernels read them, one row per field. A ring of blocked cells lies around each."""

    free: Float32Rows  # (fields, cells), FREE or BLOCKED
    # (fields, 2 cells + 2): dx and dy from each cell to its nearest exit, and padding.
    to_exit: Float32Rows
    starts: Int32Rows  # (fields, agents), cells


class RandomFields:
    """Lays out fields by seed, and caches them.

    Args:
        counts: agents, exits and blockades.
    """

    def __init__(self, width: int, height: int, counts: tuple[int, int, int]) -> None:
        self.width = width
        self.height = height
        self.agents = counts[0]
        self.stride = width + 2
        self.cells = self.stride * (height + 2)
        self.row_of: dict[int, int] = {}  # by seed, in ``cached``
        self.cached: Fields
        self._counts = counts

    def cell(self, x: int, y: int) -> int:
        """Return the index of a cell."""
        return (y + 1) * self.stride + x + 1

    def place(self, seeds: np.ndarray) -> list[np.ndarray]:
        """Draw the cells of agents, exits and blockades: arrays (seeds, count) int32."""
        placed = np.empty((len(seeds), int(sum(self._counts))), np.int32)
        draw_cells(seeds.astype(np.uint64), self.width, self.stride, self.cells, placed)
        parts = np.split(placed, np.cumsum(self._counts)[:-1], axis=1)
        return [np.ascontiguousarray(part) for part in parts]

    def lay_out(self, seeds: np.ndarray) -> Fields:
        """Lay out the field of each seed."""
        agents, exits, blockades = self.place(seeds)
        free = np.full((len(seeds), self.cells), BLOCKED)
        to_exit = np.zeros((len(seeds), 2 * self.cells + 2), np.float32)
        mark(exits, blockades, self.width, self.height, free, to_exit)
        return Fields(free, to_exit, agents)

    def rows(self, seeds: np.ndarray) -> np.ndarray:
        """Return the row of each seed's field in ``cached``, after laying out new ones."""
        wanted = seeds.tolist()
        new = [seed for seed in dict.fromkeys(wanted) if seed not in self.row_of]
        if new and len(self.row_of) * self.cells > MAX_CACHED:
            self.row_of.clear()
            new = list(dict.fromkeys(wanted))
        if new:
            added = self.lay_out(np.array(new, np.uint64))
            if self.row_of:
                pairs = zip(self.cached, added, strict=True)
                added = Fields(*(np.concatenate(pair) for pair in pairs))
            self.cached = added
            first = len(self.row_of)
            self.row_of |= {seed: first + row for row, seed in enumerate(new)}
        return np.array([self.row_of[seed] for seed in wanted], np.int64)


class Stadium(RandomFields):
    """FREVO's stadium, which is the same for every seed."""

    def __init__(self) -> None:
        super().__init__(len(STADIUM[0]), len(STADIUM), (len(STADIUM_AGENTS), 0, 0))

    def place(self, seeds: np.ndarray) -> list[np.ndarray]:
        """Return the stadium's cells once for each seed."""
        pairs = (pair.split(",") for pair in STADIUM_AGENTS)
        agents = [(int(x), int(y)) for x, y in pairs]
        marked = [
            [
                (x, y)
                for y, row in enumerate(STADIUM)
                for x, sign in enumerate(row)
                if sign == mark
            ]
            for mark in "E#"
        ]
        return [
            np.tile(
                np.array([self.cell(x, y) for x, y in places], np.int32), (len(seeds), 1)
            )
            for places in (agents, *marked)
        ]

    def rows(self, seeds: np.ndarray) -> np.ndarray:
        """Return the row of the only field for all seeds."""
        super().rows(np.zeros(1, np.uint64))
        return np.zeros(len(seeds), np.int64)


@kernel(void(UInt64s, int64, int64, int64, Int32Rows))
def draw_cells(seeds, width, stride, cells, placed):  # type: ignore[no-untyped-def]  # compiled
    """Put everything of each field, in order, on free cells; the width bounds both coordinates."""
    state = np.empty(1, np.uint64)
    for row in range(seeds.shape[0]):
        taken = np.zeros(cells, np.uint8)
        start_java(state, seeds[row])
        for item in range(placed.shape[1]):
            cell = 0
            while cell == 0 or taken[cell]:
                x = draw_java(state, width)
                y = draw_java(state, width)
                cell = (y + 1) * stride + x + 1
            taken[cell] = 1
            placed[row, item] = cell


@kernel(void(Int32Rows, Int32Rows, int64, int64, Float32Rows, Float32Rows))
def mark(exits, blockades, width, height, free, to_exit):  # type: ignore[no-untyped-def]  # compiled
    """Mark the free cells, and write the offset from each to its nearest exit."""
    stride = width + 2
    for row in range(free.shape[0]):
        for y in range(1, height + 1):
            for x in range(1, width + 1):
                cell = y * stride + x
                free[row, cell] = FREE
                best = np.int64(1 << 62)
                for i in range(exits.shape[1]):
                    dx = exits[row, i] % stride - x
                    dy = exits[row, i] // stride - y
                    if dx * dx + dy * dy < best:
                        best = dx * dx + dy * dy
                        to_exit[row, 2 * cell] = float32(dx)
                        to_exit[row, 2 * cell + 1] = float32(dy)
        for i in range(blockades.shape[1]):
            free[row, blockades[row, i]] = BLOCKED
