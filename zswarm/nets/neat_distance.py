"""How far genomes of NEAT are from each other: equation 1 of the paper, with c1 = c2 and N = 1.

N would be the size of the larger genome; the paper allows 1 for small ones, and distances would
jump between the two. Source: see ``neat``.
"""

from collections.abc import Sequence

import numpy as np

from zswarm.nets.neat_genome import Innovation

# All numbers of a genome. Keys are (source, target, which of equal links) for a weight, (0, node,
# 0) for a bias, and (0, output, 1) for its factor.
Numbers = dict[Innovation, float]


def distances(
    left: Sequence[Numbers],
    right: Sequence[Numbers],
    unmatched_coefficient: float,
    weight_coefficient: float,
) -> np.ndarray:
    """Return (left, right) float64 distances.

    Args:
        unmatched_coefficient: c1 and c2, of links that only one genome has.
        weight_coefficient: c3, of the mean difference of numbers that both have.
    """
    # Sorted, so that a sum does not depend on which other genomes there are.
    keys = sorted({key for side in (left, right) for numbers in side for key in numbers})
    columns = {key: column for column, key in enumerate(keys)}
    (a, in_a), (b, in_b) = (_tables(side, columns) for side in (left, right))
    is_link = np.array([key[0] > 0 for key in keys], bool)[:, None]
    links_a, links_b = (_count(present & is_link) for present in (in_a, in_b))
    found = np.empty((len(left), len(right)))
    for row in range(len(left)):
        both = in_a[:, row, None] & in_b
        # Along its first axis numpy adds row after row; ``_tables`` has at least two columns.
        total = np.add.reduce(np.where(both, np.abs(a[:, row, None] - b), 0.0), axis=0)
        unmatched = links_a[row] + links_b - 2 * _count(both & is_link)
        mean = total / np.maximum(_count(both), 1)
        distance = unmatched_coefficient * unmatched  # eq. 1
        distance = distance + weight_coefficient * mean
        found[row] = distance[: len(right)]
    return found


def _tables(
    side: Sequence[Numbers], columns: dict[Innovation, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return (columns, genomes) float64 numbers, and bool where a genome has them.

    There are at least two columns of genomes.
    """
    numbers = np.zeros((len(columns), max(2, len(side))))
    present = np.zeros(numbers.shape, bool)
    for genome, found in enumerate(side):
        rows = [columns[key] for key in found]
        numbers[rows, genome] = list(found.values())
        present[rows, genome] = True
    return numbers, present


def _count(present: np.ndarray) -> np.ndarray:
    counts: np.ndarray = np.add.reduce(present, axis=0, dtype=np.int64)
    return counts
