"""Deterministic fault simulation: the real ``Dispatch`` and the real ``Slots``, on a network and with clocks that fail."""
