"""``python -m zswarm.ot`` is ``zswarm-ot``."""

from zswarm.ot.cli import main

main()
