"""Keys: who is let in (docs/keys.md)."""
