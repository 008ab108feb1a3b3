"""Options of ``zswarm-keys``, and the files that its commands hand out."""

import functools
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from zswarm.errors import KeysError
from zswarm.security.members import Holder
from zswarm.security.report import say, say_json

if TYPE_CHECKING:
    from zswarm.security.authority import Authority
    from zswarm.security.certificates import Bundle

_folder = click.Path(file_okay=False, path_type=Path)
_out_help = "Where the files are written.  [default: this folder]"
_authority_help = "The authority's folder.  [default: ~/.local/share/zswarm/authority]"
_days_help = "How long the certificates are valid."
_keys = (
    "Where keys are installed.  [default: /etc/zswarm/keys for root, else "
    "~/.config/zswarm/keys]"
)
out = click.option("--out", type=_folder, default=Path(), help=_out_help)
authority = click.option("--authority", "folder", type=_folder, help=_authority_help)
as_json = click.option("--json", "as_json", is_flag=True, help="JSON on stdout.")
days = click.option(
    "--days",
    type=click.IntRange(1, 1825),
    default=365,
    show_default=True,
    help=_days_help,
)
force = click.option("--force", is_flag=True, help="Replace existing files or keys.")
keys = click.option("--keys", "given", metavar="DIR", default="", help=_keys)
yes = click.option("--yes", is_flag=True, help="Do not ask.")
names = click.argument("names", nargs=-1, required=True, metavar="NAME...")


def repeated(name: str, to: str, metavar: str, text: str) -> Callable[[Any], Any]:
    """Return an option that may be repeated."""
    text = f"{text}; may be repeated."
    return click.option(name, to, multiple=True, metavar=metavar, help=text)


def file(metavar: str) -> Callable[[Any], Any]:
    """Return the argument of a command that reads a file."""
    return click.argument("file", type=click.Path(path_type=Path), metavar=metavar)


class AuthorityOptions(NamedTuple):
    """The options of commands that use the authority and hand out files."""

    out: Path
    folder: Path | None
    as_json: bool
    days: int = 0
    force: bool = False

    def open(self) -> "Authority":
        """Open the authority."""
        from zswarm.security.authority import Authority

        return Authority(self.folder or default_folder())

    def check_out(self, names: Sequence[str]) -> None:
        """Check, before anything is issued, that bundles of these names can be written."""
        check_folder(self.out)
        for path in (self.out / f"{name}.zkeys" for name in names):
            if path.exists() and not self.force:
                raise KeysError(f"{path} exists already; --force replaces it")

    def hand_out(
        self,
        authority: "Authority",
        holders: Sequence[Holder],
        bundles: Sequence["Bundle"],
        *,
        with_members: bool = True,
    ) -> None:
        """Write the holders' bundles and the list of members, and say where to bring them.

        Args:
            authority: whose list it is.
            holders: of the bundles; or, without bundles, those that were removed.
            bundles: one for each holder, or none.
            with_members: whether the list changed.
        """
        from zswarm.security import bundle

        files = [
            self.out / f"{holder.name}{bundle.SUFFIX}"
            for holder in holders[: len(bundles)]
        ]
        for path, content in zip(files, bundles, strict=True):
            bundle.write(path, content)
        members = self.out / bundle.MEMBERS_FILE if with_members else None
        if members:
            bundle.write(members, authority.list_of_members())
        if self.as_json:
            say_json(
                {
                    "holders": [holder.common_name for holder in holders],
                    "files": files,
                    "members": members,
                    "number": authority.ledger.number,
                    "fingerprint": authority.fingerprint,
                }
            )
            return
        for holder, path in zip(holders, files, strict=False):
            sudo = "" if holder.role == "ot" else "sudo "
            say(f"{path}: {holder}. There: {sudo}zswarm-keys join {path.name}")
        if any(content.key for content in bundles):
            say(
                "Each of these files holds a key, which no one else may read: bring it there by"
            )
            say("scp or a USB stick.")
        if files:
            say(f"Fingerprint, to be compared there: {authority.fingerprint}")
        if members:
            say(f"{members}: list {authority.ledger.number} of members.")
            say(
                f"Every machine that has keys needs it: zswarm-keys join {members.name}, reload."
            )


def at_authority(*further: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Add options to a command, which gets them as ``AuthorityOptions``."""

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(command)
        def call(**given: Any) -> None:
            fields = {
                key: given.pop(key) for key in AuthorityOptions._fields if key in given
            }
            command(at=AuthorityOptions(**fields), **given)

        for option in reversed((*further, out, authority, as_json)):
            call = option(call)
        return call

    return decorate


def default_folder() -> Path:
    """Return the folder of the authority by default."""
    data = os.environ.get("XDG_DATA_HOME") or os.path.expanduser("~/.local/share")
    return Path(data, "zswarm", "authority")


def check_folder(out: Path) -> None:
    """Check that files can be written to a folder."""
    if not out.is_dir():
        raise KeysError(f"--out {out}: no such folder")


def addresses_of(
    holders: Sequence[Holder], addresses: Sequence[str]
) -> dict[Holder, list[str]]:
    """Return the addresses of each holder.

    Args:
        holders: to issue keys to.
        addresses: as ``NAME=ADDRESS``.
    """
    if not holders:
        raise KeysError(
            "whose keys? expected names of servers, --optimizer USER or --router NAME"
        )
    by_name: dict[str, list[str]] = {}
    for holder in holders:
        if holder.name in by_name:
            raise KeysError(f"{holder.name} was given twice")
        by_name[holder.name] = []
    for text in addresses:
        name, equals, address = text.partition("=")
        if not equals or name not in by_name:
            raise KeysError(
                f"--address {text[:100]!r}: expected NAME=ADDRESS with one of the names given"
            )
        by_name[name].append(address)
    return {holder: by_name[holder.name] for holder in holders}
