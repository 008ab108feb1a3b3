"""Reading and checking configuration."""
