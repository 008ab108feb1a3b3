"""``python -m zswarm.security`` is ``zswarm-keys``."""

from zswarm.security.cli import main

main()
