"""The wire: messages, keys and codec, without input or output (docs/protocol.md)."""
