"""The program ``zswarm-ot``, also as ``python -m zswarm.ot``."""

import os
import signal
import sys

from zswarm.ot.commands.shared.exits import EXIT_INTERRUPTED
from zswarm.system import start


def main() -> None:
    """Run ``zswarm-ot``; Ctrl-C ends it silently, even while its modules are being imported."""
    # A shell starts programs in the background with SIGINT ignored.
    foreground = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    start.prepare("zswarm-ot")
    try:
        if foreground:
            # Not an exception, which an import could catch.
            signal.signal(signal.SIGINT, lambda *_: os._exit(EXIT_INTERRUPTED))
        from zswarm.ot import cli

        if foreground:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        cli.main()
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)


if __name__ == "__main__":
    main()
