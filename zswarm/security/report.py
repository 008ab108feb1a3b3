"""What ``zswarm-keys status`` reports: what was issued, and what is installed."""

from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import click

from zswarm.config.decode import to_json
from zswarm.errors import KeysError
from zswarm.security import keyring
from zswarm.security.members import IN_WORDS, Holder
from zswarm.system.text import clean

if TYPE_CHECKING:
    from zswarm.security.authority import Authority

WARN_BEFORE = timedelta(days=30)


def say(text: str, *, err: bool = False) -> None:
    """Print a line; the name of a file in it may hold anything."""
    click.echo("".join(map(clean, text)), err=err)


def say_json(value: dict[str, Any]) -> None:
    """Print a JSON object."""
    click.echo(to_json(value))


def issued(authority: "Authority") -> dict[str, Any]:
    """Return what an authority issued."""
    return {
        "folder": str(authority.folder),
        "fingerprint": authority.fingerprint,
        "not_after": _text(authority.certificate.not_valid_after_utc),
        "number": authority.ledger.number,
        "issued": [
            {
                "role": entry.holder.role,
                "name": entry.holder.name,
                "names": entry.names,
                "serial": entry.serial,
                "not_after": _text(entry.not_after),
                "revoked_at": entry.revoked_at and _text(entry.revoked_at),
                "state": "revoked" if entry.revoked_at else _state(entry.not_after),
            }
            for entry in authority.ledger.last()
        ],
    }


def installed(given: str) -> dict[str, Any] | None:
    """Return what is installed; None if nothing is."""
    folder = keyring.find(given)
    if folder is None:
        return None
    try:
        loaded = keyring.load(folder)
    except KeysError as error:
        return {"folder": str(folder), "error": str(error)}
    return {
        "folder": str(folder),
        "role": loaded.role,
        "name": loaded.name,
        "fingerprint": loaded.authority,
        "not_after": _text(loaded.not_after),
        "number": loaded.members.number,
        "state": _state(loaded.not_after),
        "error": None,
    }


def say_issued(found: dict[str, Any]) -> None:
    """Print what ``issued`` returned."""
    until, number = found["not_after"][:10], found["number"]
    say(f"Authority {found['folder']}, until {until}, list {number} of members")
    say(f"Fingerprint: {found['fingerprint']}")
    rows = [("", "name", "until", "state", "names and addresses")]
    for entry in found["issued"]:
        until, names = entry["not_after"][:10], ", ".join(entry["names"])
        rows.append(
            (IN_WORDS[entry["role"]], entry["name"], until, entry["state"], names)
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        say("  ".join(map(str.ljust, row, widths)).rstrip())
    ending = [
        entry["name"]
        for entry in found["issued"]
        if entry["state"] not in ("valid", "revoked")
    ]
    if ending:
        say(f"Next: zswarm-keys renew {' '.join(ending)}")


def say_installed(found: dict[str, Any]) -> None:
    """Print what ``installed`` returned."""
    if found["error"]:
        say(f"Installed here, but not to be used: {found['error']}")
        return
    holder = Holder(found["role"], found["name"])
    state = f"until {found['not_after'][:10]} ({found['state']}), list {found['number']} of members"
    say(f"Installed here, in {found['folder']}: the keys of {holder}, {state}")
    say(f"Fingerprint: {found['fingerprint']}")
    if found["state"] != "valid":
        say(f"Next, where the authority is: zswarm-keys renew {holder.name}")


def _state(not_after: datetime) -> str:
    left = not_after - datetime.now(UTC)
    if left < timedelta(0):
        return "expired"
    return f"{left.days} days left" if left < WARN_BEFORE else "valid"


def _text(moment: datetime) -> str:
    return moment.isoformat(timespec="seconds")
