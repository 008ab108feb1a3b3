"""Compiled kernels: what authors of simulators and networks import."""
