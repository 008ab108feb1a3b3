"""The simulation server, ``zswarm-ss``."""
