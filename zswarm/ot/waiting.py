"""The trials of a workload that wait for a server, in the order in which they are to be given out."""

from collections import deque
from collections.abc import Iterable

import msgspec
import numpy as np


class Piece(msgspec.Struct, eq=False):
    """Trials that wait."""

    trials: np.ndarray
    avoid: frozenset[str] = frozenset()  # servers on which one of them ended in a fault
    left: tuple[str, int] | None = None  # the server that was left with them, and their batch there; it stays in one piece


class Waiting:
    """The line of trials; what comes back is put in front."""

    def __init__(self) -> None:
        self.trials = 0  # in all pieces
        self.pieces: deque[Piece] = deque()

    def put(self, trials: np.ndarray, avoid: frozenset[str] = frozenset(), left: tuple[str, int] | None = None) -> None:
        """Have trials wait, at least one."""
        self.trials += len(trials)
        self.pieces.appendleft(Piece(trials, avoid, left))

    def take(self, server: str, size: int, serving: Iterable[str]) -> Piece | None:
        """Up to ``size`` trials for a server, or a piece that another one was left with, whole.

        Trials that are to avoid it come only when they are to avoid all that serve.

        Returns:
            None: nothing waits for this server.
        """
        fitting = (piece for piece in self.pieces if server not in piece.avoid or piece.avoid.issuperset(serving))
        piece = next(fitting, None)
        if piece is None:
            return None
        if piece.left or size >= len(piece.trials):
            self.pieces.remove(piece)
        else:
            piece, rest = Piece(piece.trials[:size], piece.avoid), piece
            rest.trials = rest.trials[size:]
        self.trials -= len(piece.trials)
        return piece

    def take_left(self, server: str) -> list[tuple[int, Piece]]:
        """What a server was left with and nobody took since, by its number of the batch."""
        found = [(piece.left[1], piece) for piece in self.pieces if piece.left and piece.left[0] == server]
        for _, piece in found:
            self.pieces.remove(piece)
            self.trials -= len(piece.trials)
        return found

    def forget_left(self, server: str) -> None:
        """A server does not have any more what it was left with."""
        for piece in self.pieces:
            if piece.left and piece.left[0] == server:
                piece.left = None

    def clear(self) -> list[tuple[str, int]]:
        """Nothing waits any more; the servers that were left with something, and their batches."""
        left = [piece.left for piece in self.pieces if piece.left]
        self.pieces.clear()
        self.trials = 0
        return left
