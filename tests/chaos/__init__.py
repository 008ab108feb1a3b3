"""Deterministic fault simulation of ``Dispatch`` and ``Slots``, with faulty networks and clocks."""
