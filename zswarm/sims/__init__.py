"""Simulators: one problem per file; the contract is ``simulator.py``."""
