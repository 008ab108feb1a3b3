"""Zenoh's access rules: who may send what, by the common name of the certificate of a link.

A common name is ``<role>.<name>``. A user's requests and tokens carry its name in the key, and a
server's carry its name at the beginning of its id: a rule for each binds them. Everything else is
denied. Behind a router only the router sees the users' certificates: it has their rules, and
servers let it carry everything.
"""

from typing import Any, Literal

from zswarm.protocol import keys
from zswarm.security.members import Members

Direction = Literal["ingress", "egress"]
Flow = tuple[Direction, list[str], list[str]]  # zenoh's kinds of messages on some keys

VERSIONED = "zswarm/*/*"  # of any version and realm; below it: ss/..., ot/...


def rules(role: str, members: Members) -> dict[str, Any]:
    """Return zenoh's ``access_control`` for a program of a role: ``ss``, ``ot`` or ``router``."""
    allowed: dict[str, list[Flow]] = {}
    if role != "ot":
        allowed |= {f"ot.{user}": _from_user(user) for user in members.users}
    if role != "ss":
        allowed |= {
            f"ss.{server}": _from_server(f"{server}-$*") for server in members.servers
        }
    if role != "router":
        flows = _from_user("*") if role == "ss" else _from_server("*")
        allowed |= {f"router.{router}": flows for router in members.routers}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [
            {
                "id": f"{holder}/{number}",
                "permission": "allow",
                "flows": [direction],
                "messages": messages,
                "key_exprs": expressions,
            }
            for holder, flows in allowed.items()
            for number, (direction, messages, expressions) in enumerate(flows)
        ],
        "subjects": [{"id": holder, "cert_common_names": [holder]} for holder in allowed],
        "policies": [
            {
                "rules": [f"{holder}/{number}" for number in range(len(flows))],
                "subjects": [holder],
            }
            for holder, flows in allowed.items()
        ],
    }


def _from_user(user: str) -> list[Flow]:
    """Return what may pass the link to a user's optimizer; ``*`` for a router, with all users."""
    return _flows("ingress", "egress", user, "*")


def _from_server(server: str) -> list[Flow]:
    """Return what may pass the link to a server; ``*`` for a router, with all servers."""
    return _flows("egress", "ingress", "*", server)


def _flows(
    to_server: Direction, to_user: Direction, user: str, server: str
) -> list[Flow]:
    """Return what may pass a link in the directions of requests and of answers to them."""
    served = f"{VERSIONED}/ss/{server}"
    control = f"{VERSIONED}/ot/{user}/*/control"  # by which servers ask for actions
    ask = ["liveliness_query", "declare_liveliness_subscriber"]
    return [
        (to_server, ["query", *ask], [keys.ANY_ALIVE, f"{VERSIONED}/ss/*/offer"]),
        (to_server, ["query"], [f"{VERSIONED}/ss/*/ot/{user}/**"]),
        (to_server, ["liveliness_token"], [f"{VERSIONED}/ot/{user}/*/alive"]),
        (to_server, ["reply"], [f"{control}/{server}"]),
        (to_server, ["declare_queryable"], [f"{control}/*"]),
        (to_user, ask, [f"{VERSIONED}/ot/*/*/alive"]),
        (to_user, ["query"], [f"{control}/{server}"]),
        (to_user, ["liveliness_token"], [f"zswarm/*/*/ss/{server}/alive"]),
        (to_user, ["reply"], [f"{served}/offer", f"{served}/ot/{user}/**"]),
        (to_user, ["declare_queryable"], [f"{served}/**"]),
    ]
