"""docs/keys.md, followed word by word: each block on the machine that its first line names."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.repository import REPOSITORY
from zswarm.security import keyring

BLOCKS = re.findall(
    r"```sh\n# on ([a-z0-9-]+)\n(.*?)```",
    (REPOSITORY / "docs/keys.md").read_text(encoding="utf-8"),
    re.S,
)
PROGRAM = """#!{python}
import platform
platform.node = lambda: {machine!r}
from zswarm.security.cli import main
main()
"""


def programs(folder: Path, machine: str) -> Path:
    """Make a machine's programs: zswarm-keys, a sudo for root, and a service to reload."""
    folder.mkdir(parents=True)
    texts = {
        "zswarm-keys": PROGRAM.format(python=sys.executable, machine=machine),
        "sudo": '#!/bin/sh\nexec "$@"\n',
        "systemctl": '#!/bin/sh\ntest "$*" = "reload zswarm-ss"\n',
    }
    for name, text in texts.items():
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)
    return folder


@pytest.mark.docs
def test_the_documented_commands_work(tmp_path: Path) -> None:
    """All files lie in one folder, as if they were brought at once."""
    files = tmp_path / "files"
    files.mkdir()
    folders: dict[str, Path] = {}
    said = ""
    for machine, commands in BLOCKS:
        home = folders.setdefault(machine, tmp_path / machine)
        tools = home / "bin"
        environment = os.environ | {
            "PATH": f"{tools if tools.is_dir() else programs(tools, machine)}:{os.environ['PATH']}",
            "HOME": str(home),
            "ZSWARM_KEYS": str(home / "keys"),
            "XDG_DATA_HOME": str(home),
            "SUDO_USER": "",
            "PYTHONPATH": os.pathsep.join(sys.path),
        }
        for command in commands.splitlines():
            done = subprocess.run(
                ["bash", "-c", command],
                cwd=files,
                env=environment,
                input="y\n",
                capture_output=True,
                text=True,
                check=False,
            )
            assert done.returncode == 0, (
                f"on {machine}: {command}\n{done.stdout}{done.stderr}"
            )
            said += done.stdout
    assert list(folders) == ["desk", "lab-01", "alice", "lab-22"]
    assert "lab-20.zkeys: the server lab-20" in said
    assert keyring.load(tmp_path / "lab-01/keys", "ss").members.users == ["alice", "bob"]
    assert keyring.load(tmp_path / "alice/keys", "ot").name == "alice"
    after = keyring.load(tmp_path / "lab-22/keys", "ss")
    assert after.members.users == ["alice-2", "bob"]
    assert after.members.servers == [f"lab-{number:02}" for number in range(1, 23)]
