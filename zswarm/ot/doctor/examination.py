"""All checks, in the order in which they are made."""

from collections.abc import Callable, Iterator
from pathlib import Path

from zswarm.errors import ConfigError
from zswarm.ot.doctor import machine, network
from zswarm.ot.doctor.finding import Finding, broken
from zswarm.security import keyring
from zswarm.session import Reach


def examine(realm: str, out: Path, reach: Reach) -> Iterator[Finding]:
    """Everything about this machine and its network; takes some seconds.

    Args:
        reach: without keys; those that are installed are used.
    """
    checks: list[Callable[[], Iterator[Finding]]] = [
        machine.python,
        machine.packages,
        machine.extras,
        machine.cores,
        machine.limits,
        lambda: machine.runs(out),
        machine.temporary,
        machine.cache,
        machine.clock,
        machine.keys,
        network.port,
        lambda: network.multicast(reach),
        network.firewall,
        lambda: network.servers(realm, with_keys(reach)),
    ]
    for check in checks:
        try:
            yield from check()
        except (ConfigError, OSError) as error:  # such as a file system that goes away meanwhile
            name = getattr(check, "__name__", "")
            yield broken(name if name.isidentifier() else "machine", str(error), "mend what is named, and look again")


def with_keys(reach: Reach) -> Reach:
    """With the installed keys, where these can be used; ``machine.keys`` says why not."""
    try:
        return reach._replace(keyring=keyring.installed("ot"))
    except ConfigError:
        return reach
