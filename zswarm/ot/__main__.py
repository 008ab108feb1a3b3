"""The program ``zswarm-ot``, also as ``python -m zswarm.ot``."""

import os
import signal
import sys

from zswarm.ot.exits import EXIT_INTERRUPTED


def main() -> None:
    """Entry point: Ctrl-C ends it in silence also while it still loads its parts, which takes a third of a second."""
    heard = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # not in the background of a shell
    try:
        if heard:
            signal.signal(signal.SIGINT, lambda *_: os._exit(EXIT_INTERRUPTED))  # no import can take it for an error of its own
        from zswarm.ot import cli

        if heard:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        cli.main()
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)


if __name__ == "__main__":
    main()
