"""``zswarm-ot doctor`` finds each fault on a machine that has it, and no others."""

import json
import os
import resource
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from tests.integration.lab import Lab
from tests.integration.programs import Optimizer, Server, free_port, wait_until
from zswarm.kernels import cache
from zswarm.ot.doctor import machine, network
from zswarm.ot.doctor.examination import examine
from zswarm.ot.doctor.finding import Finding
from zswarm.protocol.messages import Requirements
from zswarm.session import Reach
from zswarm.system import scouting

pytestmark = pytest.mark.programs

NOBODY = Reach([], multicast=False)


@pytest.fixture
def lab() -> Iterator[Lab]:
    with Lab() as made:
        yield made


def states(findings: Iterable[Finding]) -> list[str]:
    return [finding.state for finding in findings]


def only(findings: Iterable[Finding]) -> Finding:
    (finding,) = findings
    return finding


# ---- the machine


def test_nothing_is_broken_on_a_working_machine(tmp_path: Path) -> None:
    found = [
        *machine.python(),
        *machine.packages(),
        *machine.extras(),
        *machine.cores(),
        *machine.temporary(),
    ]
    assert "broken" not in states(
        [*found, *machine.runs(tmp_path / "runs"), *machine.cache(), *machine.clock()]
    )
    assert "installed: " in found[2].text


@pytest.mark.parametrize(
    ("requirement", "fault"),
    [
        ("numpy>=2.0", ""),
        ("numpy", ""),
        ("eclipse-zenoh<1.11,>=1.10.2", ""),
        ("numpy>=99.1", "expected >=99.1"),
        ("numpy<1", "expected <1"),
        ("no-such-package>=1", "no-such-package is not installed"),
        ("no-such-package>=1; extra == 'x'", "no-such-package is not installed"),
    ],
)
def test_a_package_of_another_version_is_named(requirement: str, fault: str) -> None:
    assert machine.unmet(Requirement(requirement)).endswith(fault)
    assert bool(machine.unmet(Requirement(requirement))) == bool(fault)


def test_a_folder_that_cannot_be_written_is_broken() -> None:
    """Nobody, root included, can create a file in the kernel's folder of processes."""
    finding = only(machine.runs(Path("/proc/none/runs")))
    assert finding.state == "broken"
    assert finding.text.startswith(
        "/proc/none/runs (to be made in /proc) cannot be written: "
    )
    assert "--out DIR" in finding.fix


def test_the_check_of_the_folder_of_runs_leaves_no_files(tmp_path: Path) -> None:
    assert states(machine.runs(tmp_path / "a" / "runs"))[0] != "broken"
    assert list(tmp_path.iterdir()) == []


def test_a_cache_that_cannot_be_written_is_a_warning(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = Path(tempfile.mkdtemp(prefix="zswarm-"))
    monkeypatch.setattr(cache, "cache_folder", lambda: made)
    finding = only(machine.cache())
    assert (finding.state, finding.fix) == (
        "warning",
        "set ZSWARM_CACHE to a folder of your own",
    )
    assert not made.exists()


def test_keys_that_cannot_be_used_are_broken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ZSWARM_KEYS", str(tmp_path))
    finding = only(machine.keys())
    assert finding.state == "broken"
    assert "no keys are installed here" in finding.text
    monkeypatch.setenv("ZSWARM_KEYS", "none")
    assert only(machine.keys()).state == "ok"


def test_a_path_too_long_for_sockets_is_broken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    long = tmp_path / ("x" * 100)
    long.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(long))
    assert only(machine.temporary()).state == "broken"


def test_few_open_files_and_a_small_disk_are_reported(tmp_path: Path) -> None:
    """The program says so itself, with the exit code of what is broken."""
    mount = "mount -t tmpfs -o size=20m none ."
    if subprocess.run(
        ["unshare", "--mount", "sh", "-c", mount], cwd=tmp_path, check=False
    ).returncode:
        pytest.skip("no file system can be mounted here")
    doctor = f"{sys.executable} -m zswarm.ot doctor --out . --no-multicast --json"
    done = subprocess.run(
        ["unshare", "--mount", "sh", "-c", f'{mount} && cd "$PWD" && exec {doctor}'],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (512, 512)),
    )
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert all(list(line) == ["check", "state", "text", "fix"] for line in found)
    by_check = {line["check"]: line for line in found}
    assert (by_check["limits"]["state"], by_check["runs"]["state"]) == (
        "warning",
        "broken",
    )
    assert "only " in by_check["runs"]["text"]
    assert all(line["fix"] for line in found if line["state"] != "ok")
    assert done.returncode == 1, done.stderr


# ---- the network


class Unheard(bytes):
    """Describe a word that does not come back."""

    def __eq__(self, _other: object) -> bool:
        return False

    __hash__ = bytes.__hash__


def test_other_traffic_does_not_hide_a_missing_echo(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """However much they send, it ends."""
    group, port = scouting.GROUP.split(":")
    monkeypatch.setattr(network.secrets, "token_bytes", Unheard)
    monkeypatch.setattr(network, "HEARD_S", 0.3)
    index = socket.if_nametoindex("lo")
    done = threading.Event()

    def talk() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.setsockopt(
                socket.IPPROTO_IP,
                socket.IP_MULTICAST_IF,
                struct.pack("=4s4si", bytes(4), bytes(4), index),
            )
            while not done.wait(0.01):
                sender.sendto(b"of somebody else", (group, int(port)))

    talking = threading.Thread(target=talk)
    talking.start()
    try:
        assert network._echo_fault(index) == "nothing received"
    finally:
        done.set()
        talking.join()


def test_a_port_in_use_is_named_with_its_user() -> None:
    with socket.socket() as other:
        other.bind(("0.0.0.0", 0))  # noqa: S104
        other.listen()
        number = other.getsockname()[1]
        finding = only(network.port(number))
        assert finding.state == "warning"
        assert f"(process {os.getpid()})" in finding.text
    assert only(network.port(number)).state == "ok"


def test_a_server_of_this_machine_may_have_the_port(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A server with another version of the code is a warning."""
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path))
    everywhere = "0.0.0.0"  # noqa: S104
    server = Server(tmp_path, "mine", capacity=1, address=everywhere, ZSWARM_PLAIN="1")
    server.ready()
    try:
        number = int(server.endpoint.rpartition(":")[2])
        finding = only(network.port(number))
        assert finding.state == "ok"
        assert "server mine-" in finding.text
        reach = Reach([f"tcp/127.0.0.1:{number}"], multicast=False)
        assert only(network.servers("default", reach)).state == "ok"
        other = Requirements(
            simulator="minisim", representation="fully-meshed", version_hash="0" * 32
        )
        finding = only(network.servers("default", reach, other))
        assert finding.state == "warning"
        assert "is not used: " in finding.text
    finally:
        server.close()


def test_finding_no_server_is_a_warning_with_the_reason() -> None:
    first, *rest = network.servers("default", NOBODY)
    assert first.text.startswith("none found in realm default")
    assert [finding.state for finding in (first, *rest)] == ["warning", "warning"]
    assert "multicast is off" in rest[0].text


def test_missing_multicast_is_found(lab: Lab) -> None:
    script = (
        "from zswarm.ot.doctor import network; from zswarm.session import Reach; "
        "print(*network.multicast(Reach()))"
    )
    on, off = lab.host(lab.network()), lab.host()
    heard, deaf = (host.run(sys.executable, "-c", script) for host in (on, off))
    assert "'ok'" in heard
    assert f"{scouting.GROUP} is sent and received through eth0" in heard
    assert "'warning'" in deaf
    assert "--connect" in deaf


def test_a_check_that_fails_does_not_end_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails() -> Iterator[Finding]:
        raise OSError(5, "Input/output error")
        yield

    monkeypatch.setattr(machine, "packages", fails)
    monkeypatch.setattr(network, "LOOK_S", 0.1)
    found = list(examine("default", tmp_path, NOBODY))
    assert [finding.check for finding in found if finding.state == "broken"] == [
        "packages"
    ]
    assert found[-1].check == "servers"


# ---- check


def test_check_names_the_servers_that_match_and_why_others_do_not(tmp_path: Path) -> None:
    server = Server(tmp_path, "small", capacity=1, ZSWARM_PLAIN="1").ready()
    try:
        told = []
        for memory in (0, 2**39):
            options = [
                f"--set=cluster.connect=['{server.endpoint}']",
                f"--set=cluster.trial_memory_mb={memory}",
            ]
            done = Optimizer(
                tmp_path,
                "ot",
                [
                    "check",
                    "minisim",
                    "--json",
                    "--servers",
                    "--set=cluster.multicast=false",
                    *options,
                ],
            )
            assert done.wait() == 0, done.err.read_text()
            told += done.lines()[0]["servers"]
    finally:
        server.close()
    assert [(line["slots"], line["matches"]) for line in told] == [(1, True), (1, False)]
    assert told[0]["reason"] == ""
    assert "MB" in told[1]["reason"]


# ---- a run that finds nobody


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--servers", "1"], "no server found in realm lab7; "),
        (
            ["--set=cluster.local_slots=1"],
            "no server found in realm lab7; using this machine's slots only; ",
        ),
    ],
)
def test_a_run_that_finds_no_server_prints_how_to_fix_it(
    options: list[str], words: str, tmp_path: Path
) -> None:
    """The hint is printed once."""
    long = [
        "run",
        "minisim",
        "--no-multicast",
        "--realm",
        "lab7",
        "--set=generations=100000",
    ]
    started = Optimizer(tmp_path, "ot", [*long, *options])
    try:
        hint = words + "zswarm-ot doctor explains why, docs/network.md what to do\n"
        wait_until(
            lambda: started.err.read_text().partition(hint)[2].count("\n"),
            "the hint, and a line after it",
        )
        assert started.err.read_text().count("zswarm-ot doctor") == 1
    finally:
        started.kill(signal.SIGINT)
        assert started.wait() == 130


def test_a_local_run_does_not_wait_for_servers(tmp_path: Path) -> None:
    options = [
        "--servers",
        "local",
        "--set=cluster.local_slots=1",
        "--set=generations=100000",
    ]
    started = Optimizer(tmp_path, "ot", ["run", "minisim", *options])
    try:
        wait_until(
            lambda: len(started.err.read_text().splitlines()) > 20, "some generations"
        )
        assert "doctor" not in started.err.read_text()
    finally:
        started.kill(signal.SIGINT)
        assert started.wait() == 130


def test_an_endpoint_where_nothing_listens_is_named_though_a_server_is_found(
    tmp_path: Path,
) -> None:
    """By ``servers``, ``doctor`` and a run that goes on meanwhile."""
    dead = f"tcp/127.0.0.1:{free_port()}"
    server = Server(tmp_path, "ss", capacity=1)
    ends = [server.ready().endpoint, dead]
    reach = ["--no-multicast", *(word for end in ends for word in ("--connect", end))]
    line = f"{dead}: nothing listens there (connection refused)"
    try:
        asked = [sys.executable, "-m", "zswarm.ot", "servers", *reach]
        listed = subprocess.run(asked, capture_output=True, text=True, check=True)
        assert "1 server, 1 slot" in listed.stdout
        assert line in " ".join(listed.stdout.split())
        found = network.servers("default", Reach(ends, multicast=False))
        assert states(found) == ["warning", "ok"]
        optimizer = Optimizer(
            tmp_path,
            "ot",
            ["run", "stadium", "--generations", "1000000", "--servers", "1", *reach],
        )
        try:
            wait_until(lambda: line in optimizer.err.read_text(), "the run names it")
        finally:
            optimizer.close()
    finally:
        server.close()
