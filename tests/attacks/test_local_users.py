"""Other users of the machine become neither a server's slots nor the server that is shown."""

import contextlib
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from tests.attacks.peer import serving
from tests.integration.programs import wait_until

pytestmark = pytest.mark.attacks

OTHER = 65_534  # nobody
needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="root gives files away")


def test_a_server_and_its_fork_server_listen_on_no_abstract_socket(
    tmp_path: Path,
) -> None:
    """Whoever runs a program on the machine can connect to one, and have a process forked."""
    with serving(tmp_path) as server:
        wait_until(server.workers, "a slot runs")
        family = psutil.Process(server.process.pid).children(recursive=True)
        sockets = {
            os.readlink(link)
            for process in [server.process.pid, *(child.pid for child in family)]
            for link in Path(f"/proc/{process}/fd").iterdir()
            if os.path.islink(link)
        }
        lines = Path(f"/proc/{server.process.pid}/net/unix").read_text().splitlines()[1:]
        rows = [line.split() for line in lines]
        listening = [row for row in rows if row[3] == "00010000"]  # SO_ACCEPTCON
        ours = [row[7:] for row in listening if f"socket:[{row[6]}]" in sockets]
        assert ours, "the fork server and the control socket are known"
        assert not [path for path in ours if not path or path[0].startswith("@")]


def accepted(listening: socket.socket) -> bool:
    """Return whether anyone has connected, and drop all who have."""
    found = False
    with contextlib.suppress(BlockingIOError):
        while True:
            listening.accept()[0].close()
            found = True
    return found


@pytest.fixture
def shared() -> Iterator[Path]:
    """Make a folder like /tmp; tmp_path may be too long for the path of a socket."""
    with tempfile.TemporaryDirectory(prefix="zs-") as made:
        yield Path(made)


@needs_root
def test_the_folder_of_another_user_shows_no_server(shared: Path, tmp_path: Path) -> None:
    """In /tmp anyone can make the folder that a user's servers would have."""
    folder = shared / f"zswarm-{os.geteuid()}"
    folder.mkdir(parents=True)
    shared.chmod(0o1777)
    path = folder / "lab-01-00000000.sock"
    with socket.socket(socket.AF_UNIX) as false:
        false.bind(str(path))
        false.listen()
        false.setblocking(False)
        for user, asked in ((os.geteuid(), True), (OTHER, False)):
            os.chown(path, user, user)
            os.chown(folder, user, user)
            folder.chmod(0o700)
            path.chmod(0o777)
            environment = os.environ | {"TMPDIR": str(shared), "XDG_RUNTIME_DIR": ""}
            done = subprocess.Popen(
                [sys.executable, "-m", "zswarm.ss", "status"],
                env=environment,
                cwd=tmp_path,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
            out, _ = done.communicate(timeout=120.0)
            assert accepted(false) == asked, out
