"""Key expressions: where each message goes (docs/protocol.md, "Keys").

Ids are checked before they become part of a key or a path, so that nothing from the network can widen a key or leave a
folder.
"""

import re
import secrets
from typing import NamedTuple

from zswarm.errors import LocalProtocolError, RemoteProtocolError

VERSION = 1
ID = re.compile(r"[a-z0-9][a-z0-9-]{0,62}")
MAX_ID = 63
MAX_NAME = MAX_ID - 9  # a server's id adds - and 8 hex digits
ID_RULE = "1 to 63 of a-z, 0-9 and -, not starting with -"
ROOT = f"zswarm/v{VERSION}"
ANY_ALIVE = "zswarm/*/*/ss/*/alive"  # the tokens of all servers of all realms and protocol versions

RunRequest = ("reserve", "renew", "evaluate", "cancel", "release")


class ServerKey(NamedTuple):
    """A key below ``.../ss/<ss>``: ``alive``, ``offer``, or a run's request."""

    version: str
    realm: str
    server: str
    verb: str
    user: str = ""
    run: str = ""


def is_id(text: str) -> bool:
    """Whether a text may stand in a key."""
    return ID.fullmatch(text) is not None


def fold(text: str) -> str:
    """The nearest id to any text, such as a host or user name; ``x`` where nothing is left."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:MAX_NAME].strip("-") or "x"


def new_server_id(name: str) -> str:
    """A server's id: its name and 8 hex digits of this start, so that a restarted server is another one."""
    return f"{_checked(name)}-{secrets.token_hex(4)}"


def alive(realm: str, server: str) -> str:
    """The liveliness token of a server; ``*`` as server for all."""
    return f"{ROOT}/{_checked(realm)}/ss/{_checked(server, star=True)}/alive"


def any_version_alive(realm: str) -> str:
    """The tokens of servers of every protocol version, to name those that cannot be used."""
    return f"zswarm/*/{_checked(realm)}/ss/*/alive"


def offer(realm: str, server: str) -> str:
    """Phase 1: what a server can do."""
    return f"{ROOT}/{_checked(realm)}/ss/{_checked(server)}/offer"


def request(realm: str, server: str, user: str, run: str, verb: str) -> str:
    """Phase 2 and all that follows: a run's request to one server."""
    if verb not in RunRequest:
        raise LocalProtocolError(f"no such request: {verb}")
    return f"{ROOT}/{_checked(realm)}/ss/{_checked(server)}/ot/{_checked(user)}/{_checked(run)}/{verb}"


def requests(realm: str, server: str) -> str:
    """All requests of all runs to a server."""
    return f"{ROOT}/{_checked(realm)}/ss/{_checked(server)}/ot/**"


def run_alive(realm: str, user: str, run: str) -> str:
    """The liveliness token of a run; ``*`` as user and run for all."""
    return f"{ROOT}/{_checked(realm)}/ot/{_checked(user, star=True)}/{_checked(run, star=True)}/alive"


def control(realm: str, user: str, run: str, server: str) -> str:
    """Where a server asks a run's optimizer for what controllers decide; ``*`` as server for all."""
    return f"{ROOT}/{_checked(realm)}/ot/{_checked(user)}/{_checked(run)}/control/{_checked(server, star=True)}"


def parse_control_key(key: str) -> str:
    """The server that asks.

    Raises:
        RemoteProtocolError: not such a key.
    """
    parts = key.split("/")
    if len(parts) != 8 or "/".join(parts[:2]) != ROOT or (parts[3], parts[6]) != ("ot", "control"):
        raise RemoteProtocolError("not a key of a controller")
    if not all(is_id(part) for part in (parts[2], *parts[4:6], parts[7])):
        raise RemoteProtocolError(f"a part of the key is no id ({ID_RULE})")
    return parts[7]


def parse_server_key(key: str) -> ServerKey:
    """The parts of a key below a server.

    Raises:
        RemoteProtocolError: not such a key, or a part is no id.
    """
    parts = key.split("/")
    if len(parts) < 6 or parts[0] != "zswarm" or parts[3] != "ss":
        raise RemoteProtocolError("not a key of a server")
    version, realm, server, *rest = parts[1], parts[2], *parts[4:]
    if len(rest) == 1 and rest[0] in ("alive", "offer"):
        parsed = ServerKey(version, realm, server, rest[0])
    elif len(rest) == 4 and rest[0] == "ot" and rest[3] in RunRequest:
        parsed = ServerKey(version, realm, server, rest[3], rest[1], rest[2])
    else:
        raise RemoteProtocolError("no such request")
    if not re.fullmatch(r"v[0-9]{1,5}", version):
        raise RemoteProtocolError("not a version of the protocol")
    if not all(is_id(part) for part in (realm, server, *rest)):
        raise RemoteProtocolError(f"a part of the key is no id ({ID_RULE})")
    return parsed


def parse_run_key(key: str) -> tuple[str, str]:
    """User and run of a run's liveliness token.

    Raises:
        RemoteProtocolError: not such a key.
    """
    parts = key.split("/")
    if len(parts) != 7 or "/".join(parts[:2]) != ROOT or (parts[3], parts[6]) != ("ot", "alive"):
        raise RemoteProtocolError("not a key of a run")
    if not all(is_id(part) for part in (parts[2], parts[4], parts[5])):
        raise RemoteProtocolError(f"a part of the key is no id ({ID_RULE})")
    return parts[4], parts[5]


def _checked(text: str, *, star: bool = False) -> str:
    if not (is_id(text) or (star and text == "*")):
        raise LocalProtocolError(f"not an id ({ID_RULE}): {text!r}")
    return text
