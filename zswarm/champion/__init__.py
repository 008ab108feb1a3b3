"""The champion of a run: its file, its controller and its fitness on held-out seeds."""
