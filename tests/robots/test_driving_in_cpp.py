"""The C++ node decides and stops by the rules of the Python ones."""

import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.robots.packed import evolved, load, write
from tests.robots.test_package import compiled
from zswarm.robots.package import ros1, ros2

pytestmark = pytest.mark.robots

MAIN = """
#include <cstdio>
#include <cstdlib>
#include "driving.hpp"

int main(int, char **arguments) {
  robot self;
  robot_init(&self);
  Driving driving(&self, std::atof(arguments[1]), std::atoi(arguments[2]) != 0);
  char what;
  double now, x;
  unsigned long long stamp;
  while (std::scanf(" %c %lf %llu %lf", &what, &now, &stamp, &x) == 4) {
    bool said = false;
    const std::vector<float> ranges(90, static_cast<float>(x));
    if (what == 's') said = driving.on_scan(now, {stamp, ranges, 0.0, 0.07});
    if (what == 'p') said = driving.on_pose(now, {stamp, x, -x, 0.6, 0.8});
    if (what == 't') said = driving.on_step(now);
    if (what == 'w') said = driving.on_watch(now);
    if (said) std::printf("%a %a ", driving.velocity.linear, driving.velocity.angular);
    std::printf("%d %d\\n", driving.silent, driving.arrived);
  }
}
"""


def events(count: int) -> list[tuple[str, float, int, float]]:
    """Events of any kind; messages repeat, pause, restart, or are at a target."""
    stream = np.random.default_rng(5)
    now, stamps, told = 0.0, {"s": 0, "p": 0}, []
    for _ in range(count):
        now += float(stream.exponential(0.05)) + (1.0 if stream.random() < 0.02 else 0.0)
        what = str(stream.choice(list("ssppttw")))
        if what in stamps and stream.random() < 0.9:
            stamps[what] += 1
        if stream.random() < 0.01:
            stamps = {"s": 0, "p": 0}
        elif stream.random() < 0.3:
            stamps["s"] = stamps["p"]  # of one moment, as in lock-step
        x = (
            -1.0
            if what == "p" and stream.random() < 0.05
            else float(stream.uniform(0.1, 3.0))
        )
        told.append((what, now, stamps.get(what, 0), x))
    return told


@pytest.mark.parametrize("lock_step", [False, True])
def test_the_cpp_and_python_nodes_decide_and_stop_alike(
    tmp_path: Path, lock_step: bool
) -> None:
    if shutil.which("c++") is None:
        pytest.skip("no C++ compiler here: apt-get install g++")
    controller, watchdog_s, arrived_m = evolved(epsilon=1.5), 0.4, 1.5
    write(ros1(controller, "x", "stageros"), tmp_path / "cpp")
    write(ros2(controller, "x", "stage_ros2"), tmp_path / "python")
    compiled(tmp_path / "python", "zs_x")
    (tmp_path / "cpp/src/main.cpp").write_text(MAIN)
    source = tmp_path / "cpp/src"
    subprocess.run(
        [
            "cc",
            "-std=c99",
            "-O2",
            "-ffp-contract=off",
            "-c",
            "robot.c",
            "interface.c",
            "zs_x.c",
        ],
        cwd=source,
        check=True,
    )
    flags = ["-std=c++14", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic"]
    subprocess.run(
        [
            "c++",
            *flags,
            "main.cpp",
            "robot.o",
            "interface.o",
            "zs_x.o",
            "-lm",
            "-o",
            "main",
        ],
        cwd=source,
        check=True,
    )
    told = events(4000)
    lines = "\n".join(f"{what} {now!r} {stamp} {x!r}" for what, now, stamp, x in told)
    done = subprocess.run(
        [source / "main", str(watchdog_s), str(int(lock_step))],
        input=lines,
        capture_output=True,
        text=True,
        check=True,
    )
    robot, driving, settings = load(
        tmp_path / "python", "zs_x", "robot", "driving", "settings"
    )
    assert arrived_m == settings.ARRIVED
    drive = driving.Driving(robot.build()[0], watchdog_s, arrived_m, lock_step)

    def said(what: str, now: float, stamp: int, x: float) -> list[Any]:
        match what:
            case "s":
                velocity = drive.on_scan(
                    now, driving.Scan(stamp, np.full(90, x, np.float32), 0.0, 0.07)
                )
            case "p":
                velocity = drive.on_pose(now, driving.Pose(stamp, x, -x, 0.6, 0.8))
            case "t":
                velocity = drive.on_step(now)
            case _:
                velocity = drive.on_watch(now)
        return [*(velocity or ()), int(drive.silent), int(drive.arrived)]

    here = [said(*each) for each in told]
    there = [
        [*map(float.fromhex, line.split()[:-2]), *map(int, line.split()[-2:])]
        for line in done.stdout.splitlines()
    ]
    assert there == here
    assert len({tuple(each) for each in here if len(each) == 4}) > (
        5 if lock_step else 20
    )
    if not lock_step:
        assert {tuple(each[-2:]) for each in here} >= {(0, 0), (1, 0), (0, 1)}
