"""The optimizer tool, ``zswarm-ot``."""
