"""Exit codes of ``zswarm-ot`` other than 0; see docs/commands.md."""

EXIT_FAILED = 1
EXIT_MISTAKE = 2
EXIT_NO_SERVERS = 4
EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143
