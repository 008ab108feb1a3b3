"""How different individuals are from each other: for statistics."""

from collections.abc import Sequence

import numpy as np

from zswarm.nets.representation import Representation

MOST = 250  # individuals: pairs are many, and 1,000 of long genomes took longer to compare than to evaluate
STRIP = 24  # individuals whose distances to those after them are computed at once; with more there is less to leave out


def distances_of_pairs(representation: Representation, genomes: Sequence[bytes]) -> np.ndarray:
    """Of each individual to those that come after it, in their order; (pairs,) float64.

    Of more than 250 individuals so many, taken evenly.
    """
    if len(genomes) > MOST:
        genomes = [genomes[index * len(genomes) // MOST] for index in range(MOST)]
    pairs = []
    for begin in range(0, len(genomes), STRIP):
        strip, others = genomes[begin : begin + STRIP], genomes[begin:]
        pairs.append(representation.distances(strip, others)[~np.tri(len(strip), len(others), dtype=bool)])
    return np.concatenate(pairs)
