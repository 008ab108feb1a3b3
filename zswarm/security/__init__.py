"""Keys: mutual TLS between a lab's own people and machines.

What cannot be used or allowed raises ``KeysError`` everywhere, in one line that says what to do.
"""
