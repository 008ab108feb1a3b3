"""Make a lab's authority and install its keys, by the command's parts or the command."""

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
    """A new one."""
    return Authority.create(folder, "lab", now=now)


def again(folder: Path, now: datetime) -> Authority:
    """One that is there already, at another time."""
    return Authority(folder, now=now)


def issued(
    folder: Path, *holders: Holder, days: int = 365, now: datetime | None = None
) -> list[certificates.Bundle]:
    """Keys of the authority in a folder, which is made where there is none."""
    opened = (
        Authority(folder, now=now)
        if (folder / "key.pem").exists()
        else authority(folder, now=now)
    )
    with opened:
        return opened.issue({holder: [] for holder in holders}, days)


def installed(folder: Path, content: certificates.Bundle) -> Path:
    """The folder of keys that a bundle makes."""
    file = folder.with_suffix(".zkeys")
    folder.parent.mkdir(parents=True, exist_ok=True)
    bundle.write(file, content)
    install.install(bundle.read(file), folder, force=False)
    return folder


def unpacked(folder: Path, content: certificates.Bundle) -> Path:
    """The same, without a check of what the bundle holds."""
    folder.mkdir(parents=True, mode=0o700)
    (folder / "key.pem").touch(0o600)
    (folder / "authority.pem").write_text(content.authority)
    (folder / "certificate.pem").write_text(content.certificate)
    (folder / "key.pem").write_text(content.key)
    (folder / "members.json").write_bytes(msgspec.json.encode(content.members))
    return folder


class Machine:
    """A machine of its own: where the command runs, with its own home."""

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
        """``zswarm-keys`` with these; no traceback is ever its answer."""
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
        """The one line that says why, on stderr."""
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
