"""Attacks that were made on the real programs, each of which must fail (make attacks)."""
