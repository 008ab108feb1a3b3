"""Zenoh's access rules: who may send what, bound to the common name of the certificate at the other end of the link.

A certificate's common name is ``<role>.<name>``. A user's requests and tokens carry its name in the key, so a rule for each
user is all that binds them; a server's carry its name in front of its id. Everything else is denied. Behind a router only the
router sees the users' certificates: it has their rules, and servers let it carry everything.
"""

from typing import Any

from zswarm.protocol import keys
from zswarm.security.members import Members

# Zenoh's words for what passes a link; those of a question go towards a server, those of an answer away from it.
ASKING = ["query", "liveliness_query", "declare_liveliness_subscriber"]
ANSWERING = ["reply", "declare_queryable", "liveliness_token"]
WATCHING = ["liveliness_query", "declare_liveliness_subscriber"]
TOKEN = ["liveliness_token"]

VERSIONED = f"{keys.ROOT}/*"  # below it: ss/..., ot/...
ANY_TOKEN = [keys.ANY_ALIVE]
RUN_TOKENS = [f"{VERSIONED}/ot/*/*/alive"]
REQUESTS = [f"{VERSIONED}/ss/*/offer", f"{VERSIONED}/ss/*/ot/**"]


def _control(user: str = "*", server: str = "*") -> list[str]:
    """Where servers ask a user's optimizers for what controllers decide."""
    return [f"{VERSIONED}/ot/{user}/*/control/{server}"]


def rules(role: str, members: Members) -> dict[str, Any]:
    """Zenoh's ``access_control`` for a program of a role: ``ss``, ``ot`` or ``router``."""
    built = _Rules()
    if role != "ot":
        for user in members.users:
            built.let(f"ot.{user}", *_user(user))
    if role != "ss":
        for server in members.servers:
            built.let(f"ss.{server}", *_server(server))
    for router in members.routers:
        if role == "ss":
            built.let(f"router.{router}", *_user("*"))
        elif role == "ot":
            built.let(f"router.{router}", *_server(""))
    return built.block()


def _user(user: str) -> tuple[tuple[str, list[str], list[str]], ...]:
    """What passes the link to a user's optimizer, ``*`` for a router that carries all users'."""
    return (
        ("ingress", ASKING, [keys.ANY_ALIVE, f"{VERSIONED}/ss/*/offer"]),
        ("ingress", ["query"], [f"{VERSIONED}/ss/*/ot/{user}/**"]),
        ("ingress", TOKEN, [f"{VERSIONED}/ot/{user}/*/alive"]),
        ("egress", ["reply"], [f"{VERSIONED}/ss/*/offer", f"{VERSIONED}/ss/*/ot/{user}/**"]),
        ("ingress", ["reply", "declare_queryable"], _control(user)),
        ("egress", ["query"], _control(user)),
        ("egress", ["declare_queryable"], [f"{VERSIONED}/ss/**"]),
        ("egress", TOKEN, ANY_TOKEN),
        ("egress", WATCHING, RUN_TOKENS),
    )


def _server(server: str) -> tuple[tuple[str, list[str], list[str]], ...]:
    """What passes the link to a server, "" for a router that carries all servers'."""
    ids = f"{server}-$*" if server else "*"
    return (
        ("egress", ASKING, [keys.ANY_ALIVE, f"{VERSIONED}/ss/*/offer"]),
        ("egress", ["query"], [f"{VERSIONED}/ss/*/ot/**"]),
        ("egress", TOKEN, RUN_TOKENS),
        ("ingress", ["reply"], [f"{VERSIONED}/ss/{ids}/offer", f"{VERSIONED}/ss/{ids}/ot/**"]),
        ("ingress", ["query"], _control(server=ids)),
        ("egress", ["reply"], _control(server=ids)),
        ("egress", ["declare_queryable"], _control()),
        ("ingress", ["declare_queryable"], [f"{VERSIONED}/ss/{ids}/**"]),
        ("ingress", TOKEN, [f"zswarm/*/*/ss/{ids}/alive"]),
        ("ingress", WATCHING, RUN_TOKENS),
    )


class _Rules:
    """Rules, subjects and policies as they are told."""

    def __init__(self) -> None:
        self._rules: list[dict[str, Any]] = []
        self._subjects: list[dict[str, Any]] = []
        self._policies: list[dict[str, Any]] = []

    def let(self, common_name: str, *flows: tuple[str, list[str], list[str]]) -> None:
        """Let a certificate's holder send (ingress) and be sent (egress) some kinds of messages on some keys."""
        names = [f"{common_name}/{number}" for number in range(len(flows))]
        self._rules += [
            {"id": name, "permission": "allow", "flows": [flow], "messages": kinds, "key_exprs": on}
            for name, (flow, kinds, on) in zip(names, flows, strict=True)
        ]
        self._subjects.append({"id": common_name, "cert_common_names": [common_name]})
        self._policies.append({"rules": names, "subjects": [common_name]})

    def block(self) -> dict[str, Any]:
        """All of them, everything else denied."""
        return {
            "enabled": True,
            "default_permission": "deny",
            "rules": self._rules,
            "subjects": self._subjects,
            "policies": self._policies,
        }
