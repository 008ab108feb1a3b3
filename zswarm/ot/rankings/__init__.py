"""Rankings: which candidates of a generation play which games, and what that makes of each."""
