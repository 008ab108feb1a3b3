"""Simulators that are launch files."""
