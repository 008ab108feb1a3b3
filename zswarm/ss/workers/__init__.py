"""The processes that evaluate."""
