"""Optimizers: one per file; the contract is ``optimizer.py``."""
