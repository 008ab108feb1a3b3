"""Checks of ``zswarm-ot doctor``, one function each, with a fix for each fault."""
