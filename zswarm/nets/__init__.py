"""Representations: from genome to controller, one kind per file. See ``representation.py``."""
