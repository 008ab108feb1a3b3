"""A daemon reports to systemd, ``zswarm-ss status``, ``drain`` and Prometheus."""

import contextlib
import itertools
import json
import os
import re
import signal
import socket
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from tests.integration.paced import Pace, Scene, Size
from tests.integration.programs import Program, Server, free_port, wait_until
from zswarm.ss.cli import command
from zswarm.system import starting

pytestmark = pytest.mark.programs

WATCHDOG_S = 4.0


class Systemd:
    """The test's own socket in place of systemd's."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "notify"
        self.words: list[tuple[float, str]] = []
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(self.path))
        self.environment = {
            "NOTIFY_SOCKET": str(self.path),
            "WATCHDOG_USEC": str(int(WATCHDOG_S * 1e6)),
        }

    def heard(self, word: str, within_s: float = 60.0) -> bool:
        """Return whether a message with this prefix comes from now on."""
        end = time.monotonic() + within_s
        while (rest := end - time.monotonic()) > 0:
            self._socket.settimeout(rest)
            with contextlib.suppress(TimeoutError):
                self.words.append((time.monotonic(), self._socket.recv(4096).decode()))
                if self.words[-1][1].startswith(word):
                    return True
        return False

    def forget(self) -> None:
        """Drop the messages received so far."""
        self._socket.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                self._socket.recv(4096)
        self.words.clear()

    def longest_fast(self) -> float:
        """Return the longest time between watchdog messages in seconds."""
        times = [at for at, word in self.words if word == "WATCHDOG=1"]
        return max(after - before for before, after in itertools.pairwise(times))

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def systemd(tmp_path: Path) -> Iterator[Systemd]:
    with contextlib.closing(Systemd(tmp_path)) as systemd:
        yield systemd


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[Scene]:
    with Scene(tmp_path, Size()) as scene:
        yield scene


def control(folder: Path, *arguments: str, columns: int = 80) -> Result:
    """Call an administrator's command in this process, again and again."""
    environment = {
        "RUNTIME_DIRECTORY": str(folder),
        "XDG_RUNTIME_DIR": str(folder),
        "COLUMNS": str(columns),
    }
    return CliRunner().invoke(command, arguments, prog_name="zswarm-ss", env=environment)


def view(folder: Path, name: str = "") -> dict[str, Any]:
    done = control(folder, "status", "--json", f"--name={name}")
    assert done.exit_code == 0, done.stderr
    return json.loads(done.stdout)  # type: ignore[no-any-return]


def metrics(port: int) -> dict[str, float]:
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=30) as answer:
        text = answer.read().decode()
    return {
        line.rpartition(" ")[0]: float(line.rpartition(" ")[2])
        for line in text.splitlines()
        if not line.startswith("#")
    }


# ---- its start


def test_a_server_is_marked_as_starting_until_it_can_be_reached(tmp_path: Path) -> None:
    def marked() -> bool:
        return any(map(starting.is_locked, tmp_path.glob("*" + starting.SUFFIX)))

    with contextlib.closing(Server(tmp_path, "ss", capacity=1)) as server:
        wait_until(marked, "the server is starting")
        server.ready()
        assert not list(tmp_path.glob("*" + starting.SUFFIX))


# ---- systemd


@pytest.mark.faults
def test_the_watchdog_is_fed_unless_a_slot_is_unresponsive(
    scene: Scene, systemd: Systemd
) -> None:
    """A server is ready when its slots are warm, and names what it lacks."""
    scene.environment |= systemd.environment
    server, pace = scene.server("ss", capacity=2)
    assert systemd.heard("READY=1")
    for _ in range(4):
        assert systemd.heard("WATCHDOG=1")
    assert systemd.longest_fast() < WATCHDOG_S / 2, "idle"
    pace.set(0.05)
    optimizer = scene.optimizer(server.endpoint)
    wait_until(lambda: scene.counted() > 10, "the run goes on")
    systemd.forget()
    for _ in range(3):
        assert systemd.heard("WATCHDOG=1")
    assert systemd.longest_fast() < WATCHDOG_S / 2, "busy"
    assert systemd.heard("STATUS=")
    pace.arm()
    held = pace.held()
    forking = server.fork_server()
    scene.stop(forking)
    os.kill(held, signal.SIGKILL)
    pace.let_go()
    (missed,) = wait_until(lambda: server.events("slots_missed"), "the slot is missed")
    assert missed["reason"] in (
        "its process was killed but has not exited",
        "the fork server does not start its process",
    )
    assert (len(missed["slots"]), missed["seconds"], missed["watchdog"]) == (
        1,
        WATCHDOG_S,
        "not fed",
    )
    systemd.forget()
    assert not systemd.heard("WATCHDOG=1", WATCHDOG_S), "systemd is to end it"
    assert any(
        f"slot {missed['slots'][0]}: {missed['reason']}" in word
        for _, word in systemd.words
    )
    shown = view(scene.folder)
    assert [(slot["slot"], slot["reason"]) for slot in shown["missed"]] == [
        (missed["slots"][0], missed["reason"])
    ]
    assert shown["slots"]["starting"] == 1
    assert (
        f"slot {missed['slots'][0]}: its process was killed but has not exited"
        in control(scene.folder, "status").stdout
    )
    scene.go_on(forking)
    assert systemd.heard("WATCHDOG=1")
    wait_until(lambda: server.events("slots_back"), "the slot is back")
    optimizer.done()
    assert len(server.events("slots_missed")) == 1


def test_a_daemon_with_a_stopped_fork_server_can_be_stopped(scene: Scene) -> None:
    server, _ = scene.server("ss", capacity=2)
    wait_until(lambda: len(server.workers()) == 2, "the slots are there")
    slot, _ = server.workers()
    scene.stop(server.fork_server())
    os.kill(slot, signal.SIGKILL)
    server.kill(signal.SIGTERM)
    assert server.wait() == 143


@pytest.mark.faults
def test_a_daemon_notifies_systemd_that_it_stops_and_extends_the_timeout(
    scene: Scene, systemd: Systemd
) -> None:
    scene.environment |= systemd.environment
    server, pace = scene.server("ss")
    pace.arm()
    optimizer = scene.optimizer(server.endpoint)
    pace.held()
    server.kill(signal.SIGTERM)
    assert systemd.heard("STOPPING=1")
    assert systemd.heard("EXTEND_TIMEOUT_USEC=")
    assert systemd.heard("STATUS=draining, 1 of 1 slots busy, 1 leases, ")
    assert systemd.heard("EXTEND_TIMEOUT_USEC="), (
        "again and again, for as long as it goes on"
    )
    assert server.process.poll() is None
    pace.let_go()
    assert server.wait() == 143
    optimizer.kill(signal.SIGINT)


def test_a_router_notifies_systemd_when_ready_and_stopping(
    tmp_path: Path, systemd: Systemd
) -> None:
    options = ["--no-multicast", "--listen", f"tcp/127.0.0.1:{free_port()}"]
    router = Program(
        tmp_path, "router", ["-m", "zswarm.router", *options], **systemd.environment
    )
    try:
        assert systemd.heard("READY=1")
        router.kill(signal.SIGTERM)
        assert systemd.heard("STOPPING=1")
        assert router.wait() == 143
    finally:
        router.close()


# ---- status and drain


def test_status_shows_what_a_daemon_does(scene: Scene) -> None:
    """It prints a table of 80 columns that needs no explanation, or JSON."""
    server, pace = scene.server("lab-01", capacity=3)
    pace.arm()
    optimizer = scene.optimizer(server.endpoint)
    pace.held()
    wait_until(lambda: scene.counted() > 10, "the other slots go on")
    shown = view(scene.folder)
    (ready,) = server.events("server_ready")
    assert (shown["server"], shown["realm"], shown["listen"]) == (
        ready["server"],
        "default",
        [server.endpoint],
    )
    assert (shown["pid"], shown["warm"], shown["draining"], shown["missed"]) == (
        server.process.pid,
        True,
        False,
        [],
    )
    assert sum(shown["slots"].values()) == 3
    assert shown["slots"]["busy"] >= 1
    (lease,) = shown["leases"]
    assert (lease["simulator"], lease["slots"]) == ("paced", 3)
    assert lease["trials"] == shown["trials"] > 10
    assert shown["trials_per_s"] > 0
    assert shown["busy_s"] > 0
    table = control(scene.folder, "status").stdout
    assert max(map(len, table.splitlines())) <= 80
    for word in (
        ready["server"],
        "serves",
        "slots",
        "3:",
        "busy",
        "trials",
        "faults",
        "none",
        "paced",
        lease["user"],
        lease["run"],
    ):
        assert word in table
    pace.let_go()
    optimizer.done()
    wait_until(lambda: not view(scene.folder)["leases"], "the lease is released")
    assert view(scene.folder)["slots"]["free"] == 3


@pytest.mark.faults
def test_status_lists_several_daemons_and_drain_needs_a_name(tmp_path: Path) -> None:
    one, other = (
        Server(tmp_path, name, capacity=1, ZSWARM_PLAIN="1").ready()
        for name in ("one", "other")
    )
    try:
        names = [
            json.loads(line)["server"]
            for line in control(tmp_path, "status", "--json").stdout.splitlines()
        ]
        assert [name.rpartition("-")[0] for name in names] == ["one", "other"]
        assert (
            view(tmp_path, "other")["server"]
            == view(tmp_path, names[1])["server"]
            == names[1]
        )
        refused = control(tmp_path, "drain")
        assert (refused.exit_code, refused.stderr) == (
            1,
            f"zswarm-ss: several daemons run here, choose one with --name: {', '.join(names)}\n",
        )
        drained = control(tmp_path, "drain", "--wait", "--name", "one")
        assert (drained.exit_code, drained.stderr) == (0, "")
        assert one.wait() == 0
        other.kill()
        other.wait()
        gone = control(tmp_path, "status")
        assert gone.exit_code == 1
        assert re.fullmatch(
            r"zswarm-ss: no daemon runs on this machine that this user can ask \(looked in .*\)\n",
            gone.stderr,
        )
    finally:
        one.close()
        other.close()


@pytest.mark.faults
def test_a_daemon_that_hangs_is_named_and_the_others_are_shown(scene: Scene) -> None:
    hanging, other = scene.server("hanging")[0], scene.server("other")[0]
    scene.stop(hanging.process.pid)
    done = control(scene.folder, "status", "--json")
    assert done.exit_code == 1
    assert re.fullmatch(
        r"zswarm-ss: hanging-\w{8} does not answer: timed out\n", done.stderr
    )
    (shown,) = done.stdout.splitlines()
    assert json.loads(shown)["pid"] == other.process.pid


def test_status_refuses_options_of_the_daemon(tmp_path: Path) -> None:
    done = control(tmp_path, "--name", "lab", "status")
    assert (done.exit_code, done.stdout) == (2, "")
    assert (
        done.stderr.splitlines()[-1]
        == "Error: expected the options of status after its name, and none of the daemon's"
    )


def test_a_drained_daemon_finishes_running_work_and_ends(scene: Scene) -> None:
    server, pace = scene.server("ss")
    other, _ = scene.server("other")
    pace.arm()
    optimizer = scene.optimizer(server.endpoint, other.endpoint)
    pace.held()
    assert control(scene.folder, "drain", "--name", "ss").exit_code == 0
    wait_until(lambda: server.events("draining"), "it drains")
    assert view(scene.folder, "ss")["draining"]
    assert server.process.poll() is None, "its trial is held"
    pace.let_go()
    assert server.wait() == 0
    optimizer.done()


def test_local_slots_of_a_run_are_not_listed_as_a_daemon(tmp_path: Path) -> None:
    """They are the run's own business."""
    options = [
        "--no-multicast",
        "--until-stdin-closes",
        "--listen",
        f"unixsock-stream/{tmp_path}/s",
    ]
    local = Program(
        tmp_path,
        "local",
        ["-m", "zswarm.ss", "--name", "local", *options],
        ZSWARM_PLAIN="1",
    )
    assert local.wait() == 0
    assert not list(tmp_path.glob("local-*.sock"))


# ---- Prometheus


@pytest.mark.faults
def test_metrics_agree_with_the_run(scene: Scene) -> None:
    server, pace, port = metered(scene)
    pace.arm()
    optimizer = scene.optimizer(server.endpoint)
    os.kill(pace.held(), signal.SIGKILL)
    pace.let_go()
    optimizer.done()
    trials = scene.counted()
    wait_until(
        lambda: metrics(port)["zswarm_ss_trials_total"] == trials,
        f"all {trials} trials are counted",
    )
    numbers = wait_until(
        lambda: (found := metrics(port))["zswarm_ss_leases"] == 0 and found,
        "the lease is released",
    )
    assert numbers['zswarm_ss_faults_total{kind="crashed"}'] == 1
    assert numbers['zswarm_ss_slots{state="free"}'] == 2
    assert numbers["zswarm_ss_warm"] == 1
    assert numbers["zswarm_ss_malformed_messages_total"] == 0
    assert (
        0
        < numbers["zswarm_ss_busy_seconds_total"]
        < 2 * (time.time() - numbers["zswarm_ss_start_time_seconds"])
    )
    (ready,) = server.events("server_ready")
    assert (
        f'zswarm_ss_info{{realm="default",server="{ready["server"]}",version="{ready["program"]}"}}'
        in numbers
    )


@pytest.mark.faults
def test_hanging_clients_of_socket_and_port_do_not_affect_runs(scene: Scene) -> None:
    server, pace, port = metered(scene)
    pace.set(0.05)
    (path,) = scene.folder.glob("ss-*.sock")
    with contextlib.ExitStack() as stack:

        def hang(family: int, address: Any, words: bytes) -> None:
            connection = stack.enter_context(socket.socket(family, socket.SOCK_STREAM))
            connection.connect(address)
            connection.settimeout(5.0)
            with contextlib.suppress(OSError):
                connection.sendall(words)

        optimizer = scene.optimizer(server.endpoint)
        wait_until(lambda: scene.counted() > 10, "the run goes on")
        for words in (
            b"",
            b'{"ask": ',
            b"x" * 100_000,
            b'{"ask": "status"}\n',
            b'{"ask": "drain"',
        ) * 10:
            hang(socket.AF_UNIX, str(path), words)
        for words in (
            b"",
            b"GET /metrics HTTP/1.1\r\n",
            b"GET /metrics HTTP/1.0\r\n\r\n",
        ) * 10:
            hang(socket.AF_INET, ("127.0.0.1", port), words)
        begin = time.monotonic()
        assert view(scene.folder)["leases"]
        assert metrics(port)["zswarm_ss_leases"] == 1
        assert time.monotonic() - begin < 20.0, "it asks for both"
        scene.wait_for_more(more=20)
        done = optimizer.done()
    assert done["requeued"] == 0
    assert not scene.events("fault")
    assert not scene.events("server_left")


def metered(scene: Scene) -> tuple[Server, Pace, int]:
    """Start a server; return it with its pace and metrics port."""
    port = free_port()
    config = scene.folder / "ss.toml"
    config.write_text(f"metrics = {port}\n")
    scene.options = ("--config", str(config))
    return *scene.server("ss", capacity=2), port


def test_a_port_in_use_is_named(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        server = Server(
            tmp_path, "ss", options=("--metrics", str(port)), ZSWARM_PLAIN="1"
        )
        assert server.wait() == 2
    assert (
        server.err.read_text()
        == f"zswarm-ss: --metrics {port}: 127.0.0.1:{port} cannot be listened on: "
        "Address already in use\n"
    )


def test_a_missing_package_is_named_with_the_command_that_installs_it(
    tmp_path: Path,
) -> None:
    (tmp_path / "prometheus_client.py").write_text(
        "raise ModuleNotFoundError(name='prometheus_client')\n"
    )
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    server = Server(
        tmp_path,
        "ss",
        options=("--metrics", str(free_port())),
        PYTHONPATH=path,
        ZSWARM_PLAIN="1",
    )
    assert server.wait() == 2
    assert server.err.read_text().startswith(
        "zswarm-ss: --metrics needs the package prometheus_client: "
    )
    assert server.err.read_text().endswith(" install prometheus-client\n")
