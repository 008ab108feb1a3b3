"""zswarm runs with a read-only installation and home folder."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

import zswarm
from tests.integration.programs import Optimizer, Server, query

pytestmark = pytest.mark.long

INSTALLED = [Path(zswarm.__file__).parents[1], Path(sys.prefix)]
# A program sees these mounts alone; they end with it.
READ_ONLY = """
for folder in $READ_ONLY; do
    mount --bind "$folder" "$folder" && mount -o remount,bind,ro "$folder" || exit 99
    ! touch "$folder/written" 2> /dev/null || exit 99
done
cd "$PWD"
exec "$@"
"""
INSIDE = ["unshare", "--mount", "bash", "-c", READ_ONLY, "--"]


@pytest.fixture
def temporary() -> Iterator[Path]:
    """Return a folder with a short path, for sockets."""
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


@pytest.mark.parametrize("home", ["read-only", "missing"])
def test_kernels_are_compiled_before_a_server_is_used_where_little_can_be_written(
    home: str, tmp_path: Path, temporary: Path
) -> None:
    """Kernels are cached in the temporary folder; a ready server compiles nothing more."""
    closed = tmp_path / "closed"
    (closed / "home" if home == "read-only" else closed).mkdir(parents=True)
    environment = {
        "HOME": str(closed / "home"),
        "TMPDIR": str(temporary),
        "READ_ONLY": " ".join(map(str, [*INSTALLED, closed])),
        "XDG_CACHE_HOME": "",
        "ZSWARM_CACHE": "",
        "CACHE_DIRECTORY": "",
    }
    if subprocess.run(
        [*INSIDE, "true"],
        env={"PATH": "/usr/bin:/bin"} | environment,
        capture_output=True,
        check=False,
    ).returncode:
        pytest.skip("no mounts: this needs root and the program unshare")
    server = Server(tmp_path, "ss", inside=INSIDE, **environment)
    optimizer = None
    try:
        server.ready()
        optimizer = Optimizer(
            tmp_path,
            "ot",
            [
                "run",
                "xor",
                "--generations",
                "1",
                "--json",
                "--no-multicast",
                "--servers",
                "1",
                f"--connect={server.endpoint}",
            ],
            INSIDE,
            **environment,
        )
        done = optimizer.done()
    finally:
        for program in filter(None, (server, optimizer)):
            program.close()
    compiled = [path.stat().st_mtime for path in temporary.rglob("*.nbc")]
    [(joined,)] = query(
        tmp_path / "runs" / "xor",
        "SELECT at FROM events WHERE event = 'server_joined'",
    )
    assert done["event"] == "done"
    assert compiled
    assert max(compiled) < joined
    assert not list(closed.rglob("*.nbc"))


@pytest.mark.parametrize(
    "command", [["--no-multicast"], ["status"]], ids=["serving", "status"]
)
def test_a_server_without_a_temporary_folder_reports_it_in_one_line(
    command: list[str], tmp_path: Path
) -> None:
    """Python tries the folder that the program is in last."""
    everywhere = READ_ONLY.replace('"$PWD"', "/; mount -o remount,bind,ro /")
    inside = ["unshare", "--mount", "bash", "-c", everywhere, "--"]
    folders = ("/tmp", "/var/tmp", "/usr/tmp")  # noqa: S108
    temporary = " ".join(folder for folder in folders if Path(folder).exists())
    environment = os.environ | {
        "READ_ONLY": temporary,
        "TMPDIR": "",
        "RUNTIME_DIRECTORY": "",
    }
    if subprocess.run(
        [*inside, "true"], env=environment, capture_output=True, check=False
    ).returncode:
        pytest.skip("no mounts: this needs root and the program unshare")
    done = subprocess.run(
        [*inside, sys.executable, "-m", "zswarm.ss", *command],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 1
    assert done.stderr.startswith(
        "zswarm-ss: [Errno 2] No usable temporary directory found"
    ), done.stderr
    assert done.stderr.count("\n") == 1
