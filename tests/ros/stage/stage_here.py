"""Run the real Stage, which ``make stage`` built, in a private ROS graph."""

import importlib.util
import os
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import tomli_w

from tests.repository import REPOSITORY
from zswarm import evaluate
from zswarm.ros.link import graph
from zswarm.sims.turtlebot_exit import TurtlebotExitSettings

BUILT = REPOSITORY / "build" / "stage"
EXAMPLE = REPOSITORY / "examples" / "ros" / "stage"
_SPEC = importlib.util.spec_from_file_location("make_world", EXAMPLE / "make_world.py")
assert _SPEC
assert _SPEC.loader
make_world = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(make_world)


class Stage(NamedTuple):
    """A Stage at work, and how to reach it."""

    process: "subprocess.Popen[bytes]"
    room: dict[str, Any]
    mode: str

    def in_slot(self, **more: Any) -> Any:
        """Return a simulator that drives it, as a slot has."""
        settings = {**self.room, "simulation": "stage", "mode": self.mode, **more}
        return evaluate.build(
            "turtlebot-exit-ros", settings, "fully-meshed", {}, in_slot=True
        )[0]


def need() -> None:
    """Skip the test without Stage."""
    if not (BUILT / "ready").exists():
        pytest.skip(
            "no Stage here: make stage, with its sources in ../shared/third-party"
        )


@contextmanager
def running(
    folder: Path,
    patch: pytest.MonkeyPatch,
    controller: str,
    *,
    seed: int = 1,
    interval_s: float = 0.1,
    **room: Any,
) -> Iterator[Stage]:
    """Stage with the room of turtlebot-exit, and a machine's file ``stage`` for it."""
    need()
    text = make_world.world(TurtlebotExitSettings(**room), seed, controller, interval_s)
    (folder / "room.world").write_text(text)
    patch.setenv("ZSWARM_ROS", str(folder))
    patch.setenv("RUNTIME_DIRECTORY", str(folder / "locks"))
    with ExitStack() as opened:
        here = opened.enter_context(graph.private("rospy"))
        waits = controller.startswith("lockstep")
        profile = "stage-lockstep" if waits else "stage"
        file = {"link": "rospy", "profile": profile, "master": here.master}
        (folder / "stage.toml").write_text(tomli_w.dumps(file))
        output = opened.enter_context((folder / "stage.log").open("wb"))
        process = subprocess.Popen(
            [
                BUILT / "lib" / "stage_ros" / "stageros",
                "-g",
                folder / "room.world",
                "_base_watchdog_timeout:=0",
            ],
            env=os.environ
            | here.environment("noetic")
            | {"STAGEPATH": str(BUILT / "lib")},
            stdout=output,
            stderr=output,
        )
        opened.callback(process.wait)
        opened.callback(process.kill)
        yield Stage(process, room, "lock-step" if waits else "free-running")
