"""``zswarm-ot dashboard`` as a program."""

import re
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

from tests.ot.invented_record import written

COMMAND = [sys.executable, "-m", "zswarm.ot", "dashboard"]


def status(url: str, token: str = "") -> int:
    asked = urllib.request.Request(  # noqa: S310  http
        url, headers={"Authorization": f"Bearer {token}"} if token else {}
    )
    try:
        with urllib.request.urlopen(asked) as answer:  # noqa: S310  likewise
            return int(answer.status)
    except urllib.error.HTTPError as error:
        with error:
            return error.code


def test_a_dashboard_on_the_network_prints_that_and_reading_needs_the_token(
    tmp_path: Path,
) -> None:
    """Until its standard input closes, as with ``run --dashboard``."""
    written(tmp_path, [1.0])
    program = subprocess.Popen(
        [*COMMAND, str(tmp_path), "--host", "0.0.0.0", "--until-stdin-closes"],  # noqa: S104  that is the question
        stdin=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert program.stderr is not None
    found = re.fullmatch(
        r"dashboard: http://[^:]+:(\d+)/#token=(\S+)\n", program.stderr.readline()
    )
    assert found
    assert program.stderr.readline().startswith(
        "dashboard: anyone who reaches this address and has the token sees the runs"
    )
    url = f"http://127.0.0.1:{found[1]}"
    assert status(url) == 200
    assert status(f"{url}/api/runs") == 401
    assert status(f"{url}/api/runs/stadium/curve", "wrong") == 401
    assert status(f"{url}/api/runs/stadium/curve", found[2]) == 200
    assert status(f"{url}/api/runs/..%2f..%2fetc%2fpasswd/curve", found[2]) == 404
    assert status(f"{url}/static/..%2fserve.py") == 404
    assert status(f"{url}/static/run.js") == 200
    _, said = program.communicate()
    assert (program.returncode, said) == (0, "")


def test_a_port_in_use_and_a_missing_folder_are_reported_in_one_line(
    tmp_path: Path,
) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        done = subprocess.run(
            [*COMMAND, str(tmp_path), "--port", port],
            capture_output=True,
            text=True,
            check=False,
        )
    assert (done.returncode, done.stderr) == (
        2,
        f"zswarm-ot: 127.0.0.1:{port}: cannot be listened at: Address already in use\n",
    )
    done = subprocess.run(
        [*COMMAND, "none"], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert (done.returncode, done.stderr) == (
        2,
        "zswarm-ot: none: expected the folder of a run or of runs\n",
    )
