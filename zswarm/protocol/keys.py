"""Key expressions: where each message goes (docs/protocol.md, "Keys").

Ids are checked before they become part of a key or a path, so that nothing from the network can
widen a key or leave a folder.
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
CURRENT = f"v{VERSION}"  # the version's name in keys
ROOT = f"zswarm/{CURRENT}"
# The tokens of all servers of all realms and versions.
ANY_ALIVE = "zswarm/*/*/ss/*/alive"

RunRequest = ("reserve", "renew", "evaluate", "cancel", "release")
_ID = f"({ID.pattern})"
_VERSION = "v[0-9]{1,5}"
# A request may be one that a later program has.
_SERVER_KEY = re.compile(
    rf"zswarm/({_VERSION})/{_ID}/ss/{_ID}/(?:(alive|offer)|ot/{_ID}/{_ID}/(?!(?:alive|offer)$){_ID})"
)
_RUN_KEY = re.compile(
    rf"zswarm/{_VERSION}/{ID.pattern}/ot/{_ID}/{_ID}/(?:alive|control/{_ID})"
)


class RunKey(NamedTuple):
    """Names a run in keys."""

    realm: str
    user: str
    run: str


class ServerKey(NamedTuple):
    """A key below ``.../ss/<server>``: ``alive``, ``offer``, or a run's request."""

    version: str
    realm: str
    server: str
    verb: str
    user: str = ""
    run: str = ""


def is_id(text: str) -> bool:
    """Return whether a text may be a part of a key."""
    return ID.fullmatch(text) is not None


def fold(text: str) -> str:
    """Return the nearest id to a text, such as a host or user name; ``x`` if there is none."""
    return (
        re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:MAX_NAME].strip("-") or "x"
    )


def new_server_id(name: str) -> str:
    """Return an id for this start of a server: one that is restarted is another server."""
    return f"{_checked(name)}-{secrets.token_hex(4)}"


# In the next functions, ``*`` stands for all servers, users or runs if the docstring allows it.


def alive(realm: str, server: str, version: str = CURRENT) -> str:
    """Return the liveliness token of a server (or ``*``)."""
    return f"{_server(realm, server, version, star=True)}/alive"


def any_version_alive(realm: str) -> str:
    """Return the tokens of servers of all versions, to name those that cannot be used."""
    return f"zswarm/*/{_checked(realm)}/ss/*/alive"


def offer(realm: str, server: str, version: str = CURRENT) -> str:
    """Return where a server is asked for its offer: phase 1."""
    return f"{_server(realm, server, version)}/offer"


def request(realm: str, server: str, user: str, run: str, verb: str) -> str:
    """Return where a run sends a request to a server: its offer, or phase 2."""
    if verb == "offer":
        return offer(realm, server)
    if verb not in RunRequest:
        raise LocalProtocolError(f"no such request: {verb}")
    return f"{_server(realm, server)}/ot/{_checked(user)}/{_checked(run)}/{verb}"


def requests(realm: str, server: str, version: str = CURRENT) -> str:
    """Return all requests of all runs to a server."""
    return f"{_server(realm, server, version)}/ot/**"


def run_alive(realm: str, user: str, run: str, version: str = CURRENT) -> str:
    """Return the liveliness token of a run (or ``*``) of a user (or ``*``)."""
    return f"{_run(realm, user, run, version, star=True)}/alive"


def control(realm: str, user: str, run: str, server: str, version: str = CURRENT) -> str:
    """Return where a server (or ``*``) asks a run's optimizer for actions."""
    return f"{_run(realm, user, run, version)}/control/{_checked(server, star=True)}"


def parse_server_key(key: str) -> ServerKey:
    """Return the parts of a key below a server, or raise RemoteProtocolError."""
    found = _SERVER_KEY.fullmatch(key)
    if found is None:
        raise RemoteProtocolError(f"not a key of a server ({ID_RULE})")
    version, realm, server, own, user, run, verb = found.groups("")
    return ServerKey(version, realm, server, own or verb, user, run)


def parse_run_key(key: str) -> tuple[str, str]:
    """Return user and run of a run's liveliness token, or raise RemoteProtocolError."""
    found = _RUN_KEY.fullmatch(key)
    if found is None or found[3]:
        raise RemoteProtocolError(f"not a key of a run ({ID_RULE})")
    return found[1], found[2]


def parse_control_key(key: str) -> str:
    """Return the server that asks, or raise RemoteProtocolError if it is not such a key."""
    found = _RUN_KEY.fullmatch(key)
    if found is None or not found[3]:
        raise RemoteProtocolError(f"not a key of a controller ({ID_RULE})")
    return found[3]


def _server(
    realm: str, server: str, version: str = CURRENT, *, star: bool = False
) -> str:
    return f"zswarm/{version}/{_checked(realm)}/ss/{_checked(server, star=star)}"


def _run(
    realm: str, user: str, run: str, version: str = CURRENT, *, star: bool = False
) -> str:
    holder = f"{_checked(user, star=star)}/{_checked(run, star=star)}"
    return f"zswarm/{version}/{_checked(realm)}/ot/{holder}"


def _checked(text: str, *, star: bool = False) -> str:
    if not (is_id(text) or (star and text == "*")):
        raise LocalProtocolError(f"not an id ({ID_RULE}): {text!r}")
    return text
