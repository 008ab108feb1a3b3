"""Evolved controllers for robots: as C99, and as what robots' programs are made of."""
