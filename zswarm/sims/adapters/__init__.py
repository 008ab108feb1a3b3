"""Simulators that play environments of other packages."""
