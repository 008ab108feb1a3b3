"""Say which optimizers and networks fit together, as documented."""

NETWORKS = {"mealy": {"states": 2}}  # settings: or a genome has up to a megabyte
# Optimizers that search vectors of numbers, and networks whose genomes are none.
VECTORS = {"cma-me", "cmaes", "cuckoo", "map-elites", "openai-es", "pso"}
NO_VECTORS = {"mealy", "neat"}


def evolves(optimizer: str, representation: str) -> bool:
    """Return whether an optimizer takes a network."""
    if optimizer in VECTORS:
        return representation not in NO_VECTORS
    return optimizer != "neat" or representation == "neat"
