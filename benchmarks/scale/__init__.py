"""Measure how zswarm scales: many protocol-true servers and one optimizer on one machine."""
