"""The command ``zswarm-keys``: parses, calls, and says what to do next."""

import os
import platform
import stat
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from zswarm.errors import ConfigError, KeysError
from zswarm.protocol import keys
from zswarm.security import keyring, options, report
from zswarm.security.members import Holder, Role, new_holder
from zswarm.security.options import AuthorityOptions, at_authority, repeated
from zswarm.security.report import say
from zswarm.system import extras, program
from zswarm.system.groups import Group
from zswarm.system.version import VERSION

if TYPE_CHECKING:
    from zswarm.security.certificates import Verified

# Modules that need cryptography, an extra, are imported where they are used.

EXIT_FAILED, EXIT_MISTAKE = 1, 2


class _Group(Group):
    """Report errors that the user can fix in one line."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except ConfigError as error:
            self._exit(EXIT_MISTAKE, str(error))
        except ModuleNotFoundError as error:
            if (error.name or "").split(".")[0] != "cryptography":
                raise
            self._exit(
                EXIT_MISTAKE, f"this needs the package cryptography: {extras.how('keys')}"
            )
        except OSError as error:
            text = f"{error.filename}: {error.strerror}" if error.filename else str(error)
            self._exit(EXIT_FAILED, text)

    def _exit(self, code: int, text: str) -> None:
        say(f"zswarm-keys: {text}", err=True)
        sys.exit(code)


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(VERSION, prog_name="zswarm-keys")
def command() -> None:
    """Let only the lab's own people and machines in.

    \b
    once, on the administrator's machine
      zswarm-keys init
      zswarm-keys issue lab-01 lab-02 --optimizer alice
    on each machine, with its file
      sudo zswarm-keys join lab-01.zkeys
    """


@command.command()
@click.option(
    "--name", "lab", help="A name of the lab, for people.  [default: this host's name]"
)
@options.authority
@options.as_json
def init(lab: str | None, folder: Path | None, as_json: bool) -> None:
    """Make the lab's authority: once, on a machine that only administrators use."""
    from zswarm.security.authority import Authority

    name = keys.fold(_host()) if lab is None else lab
    with Authority.create(folder or options.default_folder(), name) as made:
        if as_json:
            report.say_json({"authority": made.folder, "fingerprint": made.fingerprint})
            return
        until = f"{made.certificate.not_valid_after_utc:%Y-%m-%d}"
        say(f"The authority of {name}, valid until {until}: {made.folder}")
        say(f"Fingerprint: {made.fingerprint}")
        say("")
        say(
            "Tell it to those who set up machines: zswarm-keys join shows it there, to compare."
        )
        say("Keep a copy of that folder in a safe place: its holder can admit anyone.")
        say("Next: zswarm-keys issue lab-01 lab-02 --optimizer alice")


@command.command()
@click.argument("names", nargs=-1, metavar="[SERVER]...")
@repeated("--optimizer", "users", "USER", "A person who runs zswarm-ot")
@repeated("--router", "routers", "NAME", "A machine that runs zswarm-router")
@repeated(
    "--address",
    "addresses",
    "NAME=ADDRESS",
    "IP address or host name by which a machine is dialled, such as lab-01=10.0.0.5",
)
@at_authority(options.days, options.force)
def issue(
    names: Sequence[str],
    users: Sequence[str],
    routers: Sequence[str],
    addresses: Sequence[str],
    at: AuthorityOptions,
) -> None:
    """Make keys: one file for each server, user and router."""
    by_role: dict[Role, Sequence[str]] = {"ss": names, "ot": users, "router": routers}
    holders = [new_holder(role, name) for role, each in by_role.items() for name in each]
    wanted = options.addresses_of(holders, addresses)
    with at.open() as authority:
        # Before files: --force is no remedy for a name that is taken.
        authority.check_new(holders)
        at.check_out([holder.name for holder in holders])
        at.hand_out(authority, holders, authority.issue(wanted, at.days))


@command.command()
@options.file("BUNDLE")
@click.option(
    "--name", help="This machine's name among the servers.  [default: the host's name]"
)
@options.keys
@options.yes
@options.force
def join(file: Path, name: str | None, given: str, yes: bool, force: bool) -> None:
    """Install keys, or a newer members.zkeys, on this machine."""
    from zswarm.security import bundle, install

    bundled = bundle.read(file)
    holder = bundled.holder
    if holder is None:
        _join_members(bundled, file, given)
        return
    _check_machine(holder, file, name)
    folder = install.folder_for(holder.role, given)
    if bundled.key is not None and stat.S_IMODE(file.stat().st_mode) & 0o077:
        hint = "bring it with scp -p, which keeps it private"
        say(f"warning: others on this machine could read {file}: {hint}", err=True)
    say(f"{file} holds the keys of {holder}.")
    say(f"Authority: {bundled.authority}")
    question = f"Is that the fingerprint you were given, and shall they be installed in {folder}?"
    if not yes and not click.confirm(question):
        raise KeysError("nothing was installed")
    members = install.install(bundled, folder, force=force)
    say(f"Installed in {folder}, with list {members.number} of members.")
    try:
        file.unlink()
        say(f"{file} was removed.")
    except OSError as error:
        text = f"cannot be removed ({error.strerror}): do it yourself, for it may hold the key"
        say(f"warning: {file} {text}", err=True)
    say(f"Next: {_reload(holder.role)}")


@command.command()
@click.option(
    "--optimizer", "user", metavar="USER", help="Ask for a user's keys, not a server's."
)
@click.option("--router", is_flag=True, help="Ask for a router's keys, not a server's.")
@click.option("--name", help="Of the server or router.  [default: the host's name]")
@repeated("--address", "addresses", "ADDRESS", "By which it is dialled")
@options.keys
@options.out
@options.force
def request(
    user: str | None,
    router: bool,
    name: str | None,
    addresses: tuple[str, ...],
    given: str,
    out: Path,
    force: bool,
) -> None:
    """Make a key that never leaves this machine, and a file to have it signed."""
    from zswarm.security import install
    from zswarm.system.files import write_whole

    if user is not None and (router or name is not None):
        raise KeysError(
            "--optimizer USER gives role and name: leave --router and --name out"
        )
    role: Role = "ot" if user is not None else "router" if router else "ss"
    chosen = name if user is None else user
    holder = new_holder(role, keys.fold(_host()) if chosen is None else chosen)
    target = install.folder_for(role, given)
    file = out / f"{holder.name}.zrequest"
    options.check_folder(out)
    write_whole(file, install.request(holder, list(addresses), target, force=force))
    say(f"A key for {holder} waits in {target}. It never leaves this machine.")
    then = f"then bring {holder.name}.zkeys here and join it"
    say(f"Next, where the authority is: zswarm-keys sign {file.name}; {then}.")


@command.command()
@options.file("REQUEST")
@options.yes
@at_authority(options.days, options.force)
def sign(file: Path, yes: bool, at: AuthorityOptions) -> None:
    """Sign what zswarm-keys request made on another machine."""
    from zswarm.security.requests import read_request

    asked = read_request(file)
    at.check_out([asked.holder.name])
    with at.open() as authority:
        say(
            f"{file} asks for the keys of {asked.holder}: {', '.join(asked.names)}",
            err=True,
        )
        if not yes and not click.confirm("Let it in?", err=True):
            raise KeysError("nothing was signed")
        number = authority.ledger.number
        bundle = authority.sign(asked, at.days)
        new = authority.ledger.number != number
        at.hand_out(authority, [asked.holder], [bundle], with_members=new)


@command.command()
@options.authority
@options.keys
@options.as_json
def status(folder: Path | None, given: str, as_json: bool) -> None:
    """Show what was issued, where the authority is; and what is installed on this machine."""
    where = folder or options.default_folder()
    issued = None
    if folder or (where / "key.pem").exists():
        from zswarm.security.authority import Authority

        with Authority(where) as authority:
            issued = report.issued(authority)
    installed = report.installed(given)
    if issued is None and installed is None:
        text = f"no authority in {where}, and no keys installed on this machine"
        raise KeysError(f"{text}: zswarm-keys init, or join BUNDLE")
    if as_json:
        report.say_json({"authority": issued, "installed": installed})
        return
    if issued is not None:
        report.say_issued(issued)
    if installed is not None:
        report.say_installed(installed)


@command.command()
@options.names
@at_authority(options.days, options.force)
def renew(names: tuple[str, ...], at: AuthorityOptions) -> None:
    """Make new certificates, and keys, for holders of some."""
    names = tuple(dict.fromkeys(names))
    with at.open() as authority:
        holders = [authority.known(name).holder for name in names]
        at.check_out(names)
        bundles = authority.renew(names, at.days)
        at.hand_out(authority, holders, bundles, with_members=False)


@command.command()
@options.names
@at_authority()
def revoke(names: tuple[str, ...], at: AuthorityOptions) -> None:
    """Remove members: makes a members.zkeys without them."""
    names = tuple(dict.fromkeys(names))
    with at.open() as authority:
        holders = [authority.known(name).holder for name in names]
        at.check_out([])
        authority.revoke(names)
        if not at.as_json:
            revoked = ", ".join(map(str, holders))
            say(f"Revoked: {revoked}. Servers refuse them once they have the new list.")
        at.hand_out(authority, holders, [])


def main() -> None:
    """Entry point."""
    program.run_command(command)


# ---- where keys are used ------------------------------------------------------------------


def _join_members(bundled: "Verified", file: Path, given: str) -> None:
    from zswarm.security import install

    folder = keyring.find(given)
    if folder is None:
        text = "a list of members, and no keys are installed here"
        raise KeysError(f"{file} is {text}: join this machine's own bundle first")
    members = bundled.members
    if install.install_members(bundled, folder) == members.number:
        say(f"list {members.number} is installed in {folder} already")
        return
    say(
        f"installed list {members.number} in {folder}: {len(members.servers)} servers, "
        f"{len(members.users)} users, {len(members.routers)} routers"
    )
    say(f"Next: {_reload(keyring.load(folder).role)}")


def _check_machine(holder: Holder, file: Path, name: str | None) -> None:
    """Refuse the keys of another server than this machine."""
    names = [name] if name else [keys.fold(platform.node()), keys.fold(_host())]
    if holder.role != "ss" or holder.name in names:
        return
    here = f"this machine is {_host()!r}; if it is right, use --name {holder.name}"
    if name:
        here = f"--name is {name[:80]!r}"
    raise KeysError(f"{file} holds the keys of {holder}, and {here}")


def _reload(role: Role) -> str:
    if role == "ot":
        return "zswarm-ot uses them from its next start"
    systemctl = "systemctl" if os.geteuid() == 0 else "systemctl --user"
    return (
        f"{systemctl} reload {keyring.PROGRAMS[role]}, or SIGHUP to it, or start it again"
    )


def _host() -> str:
    return platform.node().partition(".")[0]
