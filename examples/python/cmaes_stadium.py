"""Evolve controllers for the stadium with CMA-ES, an optimizer of another library.

Install the package cmaes: ``pip install cmaes``. Any optimizer with ask and tell can replace it.
"""

import argparse
from typing import Any

import numpy as np
from cmaes import CMA

import zswarm


def evolve(generations: int, servers: Any = "auto") -> list[float]:
    """Return the best fitness so far after each generation."""
    problem = zswarm.problem("stadium")
    optimizer = CMA(mean=np.zeros(problem.genes), sigma=1.0, population_size=50, seed=1)
    history: list[float] = []
    with zswarm.connect(servers) as cluster:
        for generation in range(generations):
            candidates = [optimizer.ask() for _ in range(optimizer.population_size)]
            fitness = cluster.evaluate(problem, candidates)
            cost = np.where(np.isnan(fitness), np.inf, -fitness)  # cmaes minimizes
            optimizer.tell(list(zip(candidates, cost, strict=True)))
            history.append(max([*history[-1:], float(np.nanmax(fitness))]))
            print(f"generation {generation + 1}  best {history[-1]:.6g}")
    return history


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--generations", type=int, default=100)
    parser.add_argument("--servers", default="auto", choices=["auto", "local"])
    given = parser.parse_args()
    evolve(given.generations, given.servers)
