"""Curves, comparisons and figures of runs."""
