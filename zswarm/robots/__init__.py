"""Evolved controllers as files for robots, and what robots sense and do."""
