"""Simulators that are third-party programs."""
