"""Make a lab's authority and install its keys, with the parts of the command or the command."""

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import msgspec
from click.testing import CliRunner, Result

from zswarm.security import bundle, certificates, cli, install
from zswarm.security.authority import Authority
from zswarm.security.members import Holder, Role, new_holder

NOW = datetime.now(UTC)
LONG_AGO, TOMORROW = NOW - timedelta(days=2 * 365), NOW + timedelta(days=1)
ALL: dict[Role, str] = {"ss": "lab-01", "ot": "alice", "router": "gate"}


def authority(folder: Path, *, now: datetime | None = None) -> Authority:
    """Create an authority."""
    return Authority.create(folder, "lab", now=now)


def again(folder: Path, now: datetime) -> Authority:
    """Open an existing authority at another time."""
    return Authority(folder, now=now)


def issued(
    folder: Path, *holders: Holder, days: int = 365, now: datetime | None = None
) -> list[certificates.Bundle]:
    """Issue keys of the authority in a folder, which is created if necessary."""
    opened = (
        Authority(folder, now=now)
        if (folder / "key.pem").exists()
        else authority(folder, now=now)
    )
    with opened:
        return opened.issue({holder: [] for holder in holders}, days)


def installed(folder: Path, content: certificates.Bundle) -> Path:
    """Install a bundle and return the folder of keys."""
    file = folder.with_suffix(".zkeys")
    folder.parent.mkdir(parents=True, exist_ok=True)
    bundle.write(file, content)
    install.install(bundle.read(file), folder, force=False)
    return folder


def unpacked(folder: Path, content: certificates.Bundle) -> Path:
    """Unpack a bundle into a folder without checking its contents."""
    folder.mkdir(parents=True, mode=0o700)
    (folder / "key.pem").touch(0o600)
    (folder / "authority.pem").write_text(content.authority)
    (folder / "certificate.pem").write_text(content.certificate)
    (folder / "key.pem").write_text(content.key)
    (folder / "members.json").write_bytes(msgspec.json.encode(content.members))
    return folder


class Machine:
    """A machine with its own home, where the command runs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.home = folder / "home"
        self.home.mkdir(parents=True)
        self.said = ""
        self.environment = {
            "HOME": str(self.home),
            "XDG_DATA_HOME": "",
            "XDG_CONFIG_HOME": "",
            "ZSWARM_KEYS": str(folder / "keys"),
            "SUDO_USER": "",
        }

    @property
    def keys(self) -> Path:
        return self.folder / "keys"

    @property
    def authority(self) -> Path:
        return self.home / ".local/share/zswarm/authority"

    def run(self, *arguments: str | Path, answer: str = "") -> Result:
        """Run ``zswarm-keys``; it must not print a traceback."""
        done = CliRunner().invoke(
            cli.command,
            [str(part) for part in arguments],
            input=answer,
            env=self.environment,
        )
        assert done.exception is None or isinstance(done.exception, SystemExit), (
            done.exc_info
        )
        self.said += done.output
        return done

    def works(self, *arguments: str | Path, answer: str = "") -> str:
        done = self.run(*arguments, answer=answer)
        assert done.exit_code == 0, done.output
        return str(done.output)

    def refuses(self, *arguments: str | Path, answer: str = "") -> str:
        """Run a command that is refused and return the line on stderr."""
        done = self.run(*arguments, answer=answer)
        assert done.exit_code == 2, done.output
        last = done.stderr.splitlines()[-1]
        assert last.startswith("zswarm-keys: ")
        assert last.isprintable()
        return str(last.removeprefix("zswarm-keys: "))

    def status(self, *arguments: str | Path) -> dict[str, Any]:
        read: dict[str, Any] = json.loads(self.works("status", "--json", *arguments))
        return read


def of(role: Role, name: str) -> Holder:
    return new_holder(role, name)
