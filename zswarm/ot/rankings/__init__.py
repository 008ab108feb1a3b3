"""Rankings: which candidates of a generation play each other, and their scores."""
