"""What the daemons share, a server and a router: their keys, and what they log of their session."""

from collections.abc import Sequence

from zswarm.errors import ConfigError
from zswarm.security import keyring, refusals
from zswarm.security.members import Role
from zswarm.session import Reach, Session
from zswarm.system import log, scouting


def find_reach(
    role: Role, connect: Sequence[str] = (), *, multicast: bool, require_keys: bool
) -> Reach:
    """Return how a daemon is reached, with the keys that are installed now.

    Raises:
        ConfigError: the keys cannot be used, or are required and not installed.
    """
    ring = keyring.installed(role)
    if ring is None and require_keys:
        raise ConfigError(
            "require_keys is set, and no keys are installed: zswarm-keys join BUNDLE"
        )
    return Reach(connect, multicast, keyring=ring)


def keys_in_words(reach: Reach) -> str:
    """Return which keys are used, for a log."""
    ring = reach.keyring
    return f"{ring.authority} until {ring.not_after:%Y-%m-%d}" if ring else "none"


def watch(opened: Session, listen: Sequence[str], reach: Reach, who: str) -> None:
    """Log what limits or endangers an open daemon, and who is refused for not being a member."""
    if reach.multicast and (fault := scouting.fault()):
        log.warning("multicast_unavailable", reason=fault, listen=listen)
    if reach.keyring is not None:
        refusals.watch_members(opened, reach.keyring)
    else:
        reason = f"anyone who reaches the port can use this {who}; zswarm-keys admits members only"
        log.warning("in_the_clear", reason=reason)
