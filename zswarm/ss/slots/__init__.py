"""The state machine of leases, chunks and slots.

Read ``events``, ``leases`` (the states of leases and slots), ``jobs`` (how batches are cut) and
``table``, which joins them.
"""
