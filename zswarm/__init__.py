"""zswarm: evolve swarm-robot controllers on the machines you already have."""

__version__ = "0.1.0"
