"""Representations: genome to controller. One kind per file; the contract is ``representation.py``."""
