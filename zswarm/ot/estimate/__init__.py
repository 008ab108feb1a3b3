"""Estimates of how long a run takes."""
