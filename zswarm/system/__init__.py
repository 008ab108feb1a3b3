"""Files, terminals, logs, systemd and processes."""
