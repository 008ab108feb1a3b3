"""The commands of ``zswarm-ot``: one module for each, which ``zswarm.ot.cli`` finds by its name.

A module defines ``command`` and ``MENU``, its section and place in ``zswarm-ot --help``. What a
command needs to do its work is imported when it is called: a shell waits for every completion.
"""
