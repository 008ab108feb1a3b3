"""All checks, in order."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from zswarm.errors import ConfigError
from zswarm.ot.doctor import machine, network
from zswarm.ot.doctor.finding import Findings, broken
from zswarm.security import keyring
from zswarm.session import Reach


def examine(realm: str, out: Path, reach: Reach) -> Findings:
    """Check this machine and its network, which takes some seconds.

    Args:
        reach: without keys; the installed ones are used.
    """
    checks: dict[str, Callable[[], Findings]] = {
        "python": machine.python,
        "packages": machine.packages,
        "extras": machine.extras,
        "cores": machine.cores,
        "limits": machine.limits,
        "runs": partial(machine.runs, out),
        "temporary": machine.temporary,
        "cache": machine.cache,
        "clock": machine.clock,
        "keys": machine.keys,
        "port": network.port,
        "multicast": partial(network.multicast, reach),
        "firewall": network.firewall,
        "servers": lambda: network.servers(realm, _with_keys(reach)),
    }
    for name, check in checks.items():
        try:
            for finding in check():
                yield finding._replace(check=name)
        except (ConfigError, OSError) as error:
            # Such as a file system that was unmounted.
            fault = broken(str(error), "fix what is named, and run doctor again")
            yield fault._replace(check=name)


def _with_keys(reach: Reach) -> Reach:
    """Add the installed keys, if they can be used; ``machine.keys`` reports why not."""
    try:
        return reach._replace(keyring=keyring.installed("ot"))
    except ConfigError:
        return reach
