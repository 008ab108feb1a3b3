"""The state machine of leases, chunks and slots."""
