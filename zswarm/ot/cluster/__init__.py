"""Dispatching trials to servers.

Read ``remote_server`` (the phases of a server), ``servers``, ``batches`` and ``dispatch``: they are
the state machine, without input or output. Then ``shell`` (threads around it), ``links`` (zenoh)
and ``connection`` (how a program's runs share servers). ``discovery`` and ``diagnosis`` serve
commands that ask which servers are there, and runs that find none.
"""
