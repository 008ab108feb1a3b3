"""The command ``zswarm-keys``: parses, calls, and says what to do next."""

import contextlib
import os
import platform
import stat
import sys
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from zswarm import extras, screen
from zswarm.errors import ConfigError, KeysError
from zswarm.protocol import keys
from zswarm.protocol.codec import clean
from zswarm.security import keyring
from zswarm.security.members import IN_WORDS, Holder, Role
from zswarm.strict import to_json

if TYPE_CHECKING:
    from zswarm.security.authority import Authority, Issued
    from zswarm.security.bundle import Bundle, Checked

EXIT_FAILED, EXIT_MISTAKE = 1, 2
WARN_BEFORE = timedelta(days=30)
REQUEST_SUFFIX = ".zrequest"
authority_option = click.option(
    "--authority",
    "folder",
    type=click.Path(file_okay=False, path_type=Path),
    help="The authority's folder.  [default: ~/.local/share/zswarm/authority]",
)
keys_option = click.option(
    "--keys", "given", metavar="DIR", default="", help="Where keys are installed.  [default: /etc/zswarm/keys for root, else "
    "~/.config/zswarm/keys]",
)  # fmt: skip
out_option = click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path(),
    help="Where the files are written.  [default: this folder]",
)
days_option = click.option(
    "--days", type=click.IntRange(1, 1825), default=365, show_default=True, help="How long the certificates are valid."
)
force_option = click.option("--force", is_flag=True, help="Replace what is there.")
yes_option = click.option("--yes", is_flag=True, help="Do not ask.")
json_option = click.option("--json", "as_json", is_flag=True, help="JSON on stdout.")
names_argument = click.argument("names", nargs=-1, required=True, metavar="NAME...")


class _Group(click.Group):
    """What the user can mend is told in one line."""

    def invoke(self, context: click.Context) -> Any:
        try:
            return super().invoke(context)
        except ConfigError as error:
            _complain(str(error))
            sys.exit(EXIT_MISTAKE)
        except ModuleNotFoundError as error:
            if (error.name or "").split(".")[0] != "cryptography":
                raise
            _complain(f"this needs the package cryptography: {extras.how('keys')}")
            sys.exit(EXIT_MISTAKE)
        except OSError as error:
            _complain(f"{error.filename}: {error.strerror}" if error.filename else str(error))
            sys.exit(EXIT_FAILED)


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="zswarm", prog_name="zswarm-keys")
def command() -> None:
    """Let only the lab's own people and machines in.

    \b
    once, on the administrator's machine
      zswarm-keys init
      zswarm-keys issue lab-01 lab-02 --optimizer alice
    on each machine, with its file
      sudo zswarm-keys join lab-01.zkeys
    """  # noqa: D301  click's mark for text that is not to be wrapped


@command.command()
@click.option("--name", "lab", help="A name of the lab, for people.  [default: this host's name]")
@authority_option
@json_option
def init(lab: str | None, folder: Path | None, as_json: bool) -> None:
    """Make the lab's authority: once, on a machine that only administrators use."""
    from zswarm.security.authority import Authority

    name = keys.fold(_host()) if lab is None else lab
    with Authority.create(folder or _authority_folder(), name) as made:
        if as_json:
            _print_json({"authority": str(made.folder), "fingerprint": made.fingerprint})
            return
        _say(f"The authority of {name}, valid until {made.certificate.not_valid_after_utc:%Y-%m-%d}: {made.folder}")
        _say(f"Fingerprint: {made.fingerprint}")
        _say("")
        _say("Tell it to whoever sets up machines: zswarm-keys join shows it there, to be compared.")
        _say("Keep a copy of that folder in a safe place; whoever has it can let anyone in.")
        _say("Next: zswarm-keys issue lab-01 lab-02 --optimizer alice")


@command.command()
@click.argument("names", nargs=-1, metavar="[SERVER]...")
@click.option("--optimizer", "users", multiple=True, metavar="USER", help="A person who runs zswarm-ot; may be repeated.")
@click.option("--router", "routers", multiple=True, metavar="NAME", help="A machine that runs zswarm-router; may be repeated.")
@click.option(
    "--address",
    "addresses",
    multiple=True,
    metavar="NAME=ADDRESS",
    help="IP address or host name by which a machine is dialled, such as lab-01=10.0.0.5; may be repeated.",
)
@days_option
@out_option
@authority_option
@force_option
@json_option
def issue(
    names: tuple[str, ...],
    users: tuple[str, ...],
    routers: tuple[str, ...],
    addresses: tuple[str, ...],
    days: int,
    out: Path,
    folder: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Make keys: one file for each server, user and router."""
    wanted = _wanted(names, users, routers, addresses)
    with _authority(folder) as authority:
        for whose in wanted:
            authority.check_free(whose)
        _check_out(out, [whose.name for whose in wanted], force=force)
        bundles = authority.issue(wanted, days)
        _hand_out(authority, list(wanted), bundles, out, as_json=as_json)


@command.command()
@click.argument("file", type=click.Path(path_type=Path), metavar="BUNDLE")
@click.option("--name", help="This machine's name among the servers.  [default: the host's name]")
@keys_option
@yes_option
@force_option
def join(file: Path, name: str | None, given: str, yes: bool, force: bool) -> None:
    """Install keys, or a newer members.zkeys, on this machine."""
    from zswarm.security import bundle

    checked = bundle.read(file)
    if checked.identity is None:
        _join_members(checked, file, given)
    else:
        _join(checked, checked.identity.holder, file, name, given, yes=yes, force=force)


@command.command()
@click.option("--optimizer", "user", metavar="USER", help="Ask for a user's keys, not a server's.")
@click.option("--router", is_flag=True, help="Ask for a router's keys, not a server's.")
@click.option("--name", help="Of the server or router.  [default: the host's name]")
@click.option("--address", "addresses", multiple=True, metavar="ADDRESS", help="By which it is dialled; may be repeated.")
@keys_option
@out_option
@force_option
def request(
    user: str | None, router: bool, name: str | None, addresses: tuple[str, ...], given: str, out: Path, force: bool
) -> None:
    """Make a key that never leaves this machine, and a file to have it signed."""
    from zswarm.files import write_whole
    from zswarm.security import install
    from zswarm.security.authority import new_holder

    if user is not None and (router or name is not None):
        raise KeysError("--optimizer USER says role and name: leave --router and --name out")
    role: Role = "ot" if user is not None else "router" if router else "ss"
    given_name = name if user is None else user
    whose = new_holder(role, keys.fold(_host()) if given_name is None else given_name)
    target = install.folder_for(role, given)
    file = out / f"{whose.name}{REQUEST_SUFFIX}"
    _check_out(out, [], force=force)
    asked = install.request(whose, list(addresses), target, force=force)
    write_whole(file, asked)
    _say(f"A key for {whose} waits in {target}. It never leaves this machine.")
    _say(f"Next, where the authority is: zswarm-keys sign {file.name}; then bring {whose.name}.zkeys here and join it.")


@command.command()
@click.argument("file", type=click.Path(path_type=Path), metavar="REQUEST")
@days_option
@out_option
@authority_option
@yes_option
@force_option
@json_option
def sign(file: Path, days: int, out: Path, folder: Path | None, yes: bool, force: bool, as_json: bool) -> None:
    """Sign what zswarm-keys request made on another machine."""
    from zswarm.security.authority import read_request

    asked = read_request(file)
    _check_out(out, [asked.holder.name], force=force)
    with _authority(folder) as authority:
        _say(f"{file} asks for the keys of {asked.holder}: {', '.join(asked.names)}", err=True)
        if not yes and not click.confirm("Let it in?", err=True):
            raise KeysError("nothing was signed")
        number = authority.ledger.number
        bundle = authority.sign(asked, days)
        _hand_out(authority, [asked.holder], [bundle], out, with_members=authority.ledger.number != number, as_json=as_json)


@command.command()
@authority_option
@keys_option
@json_option
def status(folder: Path | None, given: str, as_json: bool) -> None:
    """Show what was issued, where the authority is; and what is installed on this machine."""
    where = folder or _authority_folder()
    issued = _issued(where) if folder or (where / "key.pem").exists() else None
    installed = _installed(given)
    if issued is None and installed is None:
        raise KeysError(f"no authority in {where}, and no keys installed on this machine: zswarm-keys init, or join BUNDLE")
    if as_json:
        _print_json({"authority": issued, "installed": installed})
        return
    if issued is not None:
        _say_issued(issued)
    if installed is not None:
        _say_installed(installed)


@command.command()
@names_argument
@days_option
@out_option
@authority_option
@force_option
@json_option
def renew(names: tuple[str, ...], days: int, out: Path, folder: Path | None, force: bool, as_json: bool) -> None:
    """Make new certificates, and keys, for who had some."""
    names = tuple(dict.fromkeys(names))
    with _authority(folder) as authority:
        holders = [authority.known(name).holder for name in names]
        _check_out(out, names, force=force)
        bundles = authority.renew(names, days)
        _hand_out(authority, holders, bundles, out, with_members=False, as_json=as_json)


@command.command()
@names_argument
@out_option
@authority_option
@json_option
def revoke(names: tuple[str, ...], out: Path, folder: Path | None, as_json: bool) -> None:
    """Let someone in no more: makes a members.zkeys without them."""
    names = tuple(dict.fromkeys(names))
    with _authority(folder) as authority:
        holders = [authority.known(name).holder for name in names]
        _check_out(out, [], force=True)
        authority.revoke(names)
        if not as_json:
            _say(f"Revoked: {', '.join(str(whose) for whose in holders)}. Servers refuse them once they have the new list.")
        _hand_out(authority, holders, [], out, as_json=as_json)


def main() -> None:
    """Entry point."""
    screen.prepare()
    command()


# ---- where the authority is


@contextlib.contextmanager
def _authority(folder: Path | None) -> Iterator["Authority"]:
    from zswarm.security.authority import Authority

    with Authority(folder or _authority_folder()) as authority:
        yield authority


def _authority_folder() -> Path:
    return Path(os.environ.get("XDG_DATA_HOME") or os.path.expanduser("~/.local/share"), "zswarm", "authority")


def _wanted(
    servers: Sequence[str], users: Sequence[str], routers: Sequence[str], addresses: Sequence[str]
) -> dict[Holder, list[str]]:
    from zswarm.security.authority import new_holder

    given: tuple[tuple[Role, Sequence[str]], ...] = (("ss", servers), ("ot", users), ("router", routers))
    holders = [new_holder(role, name) for role, names in given for name in names]
    if not holders:
        raise KeysError("whose keys? expected names of servers, --optimizer USER or --router NAME")
    by_name: dict[str, Holder] = {}
    for whose in holders:
        if whose.name in by_name:
            raise KeysError(f"{whose.name} was given twice")
        by_name[whose.name] = whose
    wanted: dict[Holder, list[str]] = {whose: [] for whose in holders}
    for text in addresses:
        name, equals, address = text.partition("=")
        if not equals or name not in by_name:
            raise KeysError(f"--address {text[:100]!r}: expected NAME=ADDRESS with one of the names given")
        wanted[by_name[name]].append(address)
    return wanted


def _check_out(out: Path, names: Sequence[str], *, force: bool) -> None:
    """Before anything is issued: the files can be written."""
    if not out.is_dir():
        raise KeysError(f"--out {out}: no such folder")
    for name in names:
        if (out / f"{name}.zkeys").exists() and not force:
            raise KeysError(f"{out / name}.zkeys is there already; --force replaces it")


def _hand_out(
    authority: "Authority",
    holders: Sequence[Holder],
    bundles: Sequence["Bundle"],
    out: Path,
    *,
    with_members: bool = True,
    as_json: bool,
) -> None:
    """Write the holders' files and the list of members, and tell where to bring them."""
    from zswarm.security import bundle

    files = [out / f"{whose.name}{bundle.SUFFIX}" for whose in holders] if bundles else []
    for file, content in zip(files, bundles, strict=True):
        bundle.write(file, content)
    members = out / bundle.MEMBERS_FILE if with_members else None
    if members:
        bundle.write(members, authority.list_of_members())
    if as_json:
        _print_json(
            {
                "holders": [whose.common_name for whose in holders],
                "files": [str(file) for file in files],
                "members": members and str(members),
                "number": authority.ledger.number,
                "fingerprint": authority.fingerprint,
            }
        )
        return
    for whose, file in zip(holders, files, strict=False):
        _say(f"{file}: {whose}. There: {'' if whose.role == 'ot' else 'sudo '}zswarm-keys join {file.name}")
    if any(content.key for content in bundles):
        _say("Each of these files holds a key: bring it there by scp or a USB stick, and let nobody else read it.")
    if files:
        _say(f"Fingerprint, to be compared there: {authority.fingerprint}")
    if members:
        _say(
            f"{members}: list {authority.ledger.number} of who is let in. Every machine that has keys already needs it:"
            f" zswarm-keys join {members.name}, then reload."
        )


# ---- where keys are used


def _join_members(checked: "Checked", file: Path, given: str) -> None:
    from zswarm.security import install

    folder = keyring.find(given)
    if folder is None:
        raise KeysError(f"{file} is a list of members, and no keys are installed here: join this machine's own bundle first")
    before = install.install_members(checked, folder)
    if before == checked.members.number:
        _say(f"list {before} is installed in {folder} already")
        return
    members = checked.members
    _say(
        f"installed list {members.number} in {folder}: {len(members.servers)} servers, {len(members.users)} users,"
        f" {len(members.routers)} routers"
    )
    mine = keyring.load(folder)
    _say(f"Next: {_reload(mine.role)}")


def _join(checked: "Checked", whose: Holder, file: Path, name: str | None, given: str, *, yes: bool, force: bool) -> None:
    from zswarm.security import install

    mine = {keys.fold(platform.node()), keys.fold(_host())}
    if whose.role == "ss" and whose.name not in ([name] if name else mine):
        here = f"--name says {name[:80]!r}" if name else f"this machine is {_host()!r}; if it is right, say --name {whose.name}"
        raise KeysError(f"{file} holds the keys of {whose}, and {here}")
    folder = install.folder_for(whose.role, given)
    if checked.key is not None and stat.S_IMODE(file.stat().st_mode) & 0o077:
        _say(f"warning: others on this machine could read {file}: bring it with scp -p, which keeps it private", err=True)
    _say(f"{file} holds the keys of {whose}.")
    _say(f"Authority: {checked.authority}")
    if not yes and not click.confirm(f"Is that the fingerprint you were told, and shall they be installed in {folder}?"):
        raise KeysError("nothing was installed")
    members = install.install(checked, folder, force=force)
    _say(f"Installed in {folder}, with list {members.number} of members.")
    try:
        file.unlink()
    except OSError as error:
        _say(f"warning: {file} cannot be removed ({error.strerror}): do it yourself, for it may hold the key", err=True)
    else:
        _say(f"{file} was removed.")
    _say(f"Next: {_reload(whose.role)}")


def _reload(role: str) -> str:
    if role == "ot":
        return "zswarm-ot uses them from its next start"
    program = keyring.PROGRAMS[role]
    systemctl = "systemctl" if os.geteuid() == 0 else "systemctl --user"
    return f"{systemctl} reload {program}, or SIGHUP to it, or start it again"


def _host() -> str:
    return platform.node().partition(".")[0]


# ---- status


def _issued(folder: Path) -> dict[str, Any]:
    with _authority(folder) as authority:
        return {
            "folder": str(folder),
            "fingerprint": authority.fingerprint,
            "not_after": _text(authority.certificate.not_valid_after_utc),
            "number": authority.ledger.number,
            "issued": [_entry(issued) for issued in authority.last()],
        }


def _entry(issued: "Issued") -> dict[str, Any]:
    return {
        "role": issued.holder.role,
        "name": issued.holder.name,
        "names": issued.names,
        "serial": issued.serial,
        "not_after": _text(issued.not_after),
        "revoked_at": issued.revoked_at and _text(issued.revoked_at),
        "state": "revoked" if issued.revoked_at else _state(issued.not_after),
    }


def _installed(given: str) -> dict[str, Any] | None:
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


def _say_issued(issued: dict[str, Any]) -> None:
    _say(f"Authority {issued['folder']}, until {issued['not_after'][:10]}, list {issued['number']} of members")
    _say(f"Fingerprint: {issued['fingerprint']}")
    rows = [("", "name", "until", "state", "names and addresses")]
    rows += [
        (IN_WORDS[entry["role"]], entry["name"], entry["not_after"][:10], entry["state"], ", ".join(entry["names"]))
        for entry in issued["issued"]
    ]
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    for row in rows:
        _say("  ".join([*(cell.ljust(width) for cell, width in zip(row, widths, strict=False)), row[4]]).rstrip())
    if ending := [entry["name"] for entry in issued["issued"] if entry["state"] not in ("valid", "revoked")]:
        _say(f"Next: zswarm-keys renew {' '.join(ending)}")


def _say_installed(installed: dict[str, Any]) -> None:
    if installed["error"]:
        _say(f"Installed here, but not to be used: {installed['error']}")
        return
    whose = Holder(installed["role"], installed["name"])
    _say(
        f"Installed here, in {installed['folder']}: the keys of {whose}, until {installed['not_after'][:10]}"
        f" ({installed['state']}), list {installed['number']} of members"
    )
    _say(f"Fingerprint: {installed['fingerprint']}")
    if installed["state"] != "valid":
        _say(f"Next, where the authority is: zswarm-keys renew {whose.name}")


def _state(not_after: datetime) -> str:
    left = not_after - datetime.now(UTC)
    if left < timedelta(0):
        return "expired"
    return f"{left.days} days left" if left < WARN_BEFORE else "valid"


def _text(moment: datetime) -> str:
    return moment.isoformat(timespec="seconds")


# ---- output


def _say(text: str, *, err: bool = False) -> None:
    click.echo("".join(clean(character) for character in text), err=err)  # a file's name may hold anything


def _complain(text: str) -> None:
    _say(f"zswarm-keys: {text}", err=True)


def _print_json(value: dict[str, Any]) -> None:
    click.echo(to_json(value))
