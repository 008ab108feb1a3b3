"""The wire: messages, keys and codec; no input or output happens here. Described for any language in docs/protocol.md."""
