"""Fault simulation of ``Dispatch`` and ``SlotTable``: a seed decides what fails, and when."""
