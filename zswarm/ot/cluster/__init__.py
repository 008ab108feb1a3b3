"""Dispatching trials to servers."""
