"""Code that several commands use, or that is too long for a command's module."""
