"""``python -m zswarm.ss`` is ``zswarm-ss``."""

from zswarm.ss.cli import main

main()
