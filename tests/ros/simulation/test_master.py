"""A ROS master that dies and returns: the run waits for it, and asks the server again."""

import json
import os
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from xmlrpc.client import ServerProxy

import pytest
import tomli_w

from tests.integration.programs import Optimizer, Server, free_port, query, wait_until
from tests.ros.ros_here import need
from zswarm.ros.link.child import command
from zswarm.ros.link.graph import RosGraph

pytestmark = pytest.mark.robots
PROGRAM = Path(__file__).parent / "stage_like.py"
OPTIONS = {"robots": 2, "interval_s": 0.1, "tick_s": 0.02, "reset_s": 0.01, "lag_s": 0.0}
EXPERIMENT = """
name = "stage"
seed = 1
generations = 3
[problem]
simulator = "turtlebot-exit-ros"
[problem.settings]
robots = 2
steps = 10
simulation = "stage"
mode = "free-running"
missed_limit = 1.0
[representation]
kind = "fully-meshed"
[optimizer]
kind = "nnga"
population = 4
"""


@contextmanager
def master(folder: Path, port: int) -> Iterator[None]:
    """A master on a port, and a simulation in it; both are killed at the end."""
    here = RosGraph(link="rospy", master=f"http://127.0.0.1:{port}")
    environment = os.environ | here.environment("noetic") | {"ROS_HOME": str(folder)}
    python = command("master", "rospy")[0]
    with ExitStack() as opened:
        for arguments in (
            ["rosmaster", "--core", "-p", str(port)],
            [python, str(PROGRAM), json.dumps(OPTIONS)],
        ):
            log = opened.enter_context((folder / "ros.log").open("ab"))
            started = subprocess.Popen(arguments, env=environment, stdout=log, stderr=log)
            opened.callback(started.wait)
            opened.callback(started.kill)
            wait_until(lambda: answers(port), "the master answers")
        yield


def answers(port: int) -> bool:
    try:
        with ServerProxy(f"http://127.0.0.1:{port}") as master:
            master.getPid("/test")
    except OSError:
        return False
    return True


def test_a_run_goes_on_when_a_master_that_died_is_back(tmp_path: Path) -> None:
    need("rospy")
    port = free_port()
    file = {
        "link": "rospy",
        "profile": "stage",
        "master": f"http://127.0.0.1:{port}",
    }
    (tmp_path / "stage.toml").write_text(tomli_w.dumps(file))
    (tmp_path / "experiment.toml").write_text(EXPERIMENT)
    server = Server(tmp_path, "ss", capacity=1, ZSWARM_ROS=str(tmp_path)).ready()
    arguments = ["run", str(tmp_path / "experiment.toml"), "--json", "--no-multicast"]
    arguments += ["--servers", "1", "--connect", server.endpoint]
    record = tmp_path / "runs" / "stage"
    try:
        with master(tmp_path, port):
            optimizer = Optimizer(tmp_path, "ot", arguments)
            wait_until(
                lambda: (
                    query(record, "SELECT 1 FROM outcomes")
                    or optimizer.process.poll() is not None
                ),
                "an outcome",
            )
        wait_until(
            lambda: unprepared(server) or optimizer.process.poll() is not None,
            "the server cannot prepare the simulation",
        )
        assert optimizer.process.poll() is None, optimizer.err.read_text()
        with master(tmp_path, port):
            optimizer.done()
    finally:
        optimizer.close()
        server.close()
    assert query(record, "SELECT count(*) FROM generations") == [(3,)]


def unprepared(server: Server) -> bool:
    """Return whether a server reported that no master answers."""
    reasons = [event["reason"] for event in server.events("prepare_failed")]
    assert all("no ROS master answers at" in reason for reason in reasons), reasons
    return bool(reasons)
