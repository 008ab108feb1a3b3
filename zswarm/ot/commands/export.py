"""``zswarm-ot export``: write a controller as files for robots and other programs."""

from pathlib import Path
from typing import Any

import click

from zswarm.ot.commands.shared import options, suggestions
from zswarm.ot.display import tables
from zswarm.system.text import clean

MENU = ("Results", 5)


@click.command("export")
@options.champion_argument
@click.option(
    "--to",
    "target",
    required=True,
    metavar="TARGET",
    shell_complete=suggestions.targets,
    help="What to write: one of the targets listed above.",
)
@options.generation_option(
    "--generation",
    help="A candidate of this generation, from 1, instead of the champion.",
)
@options.candidate_option
@click.option(
    "--name",
    help="Name in files, functions and packages, after the prefix zs_.  [default: the run's]",
)
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="FOLDER",
    help="Folder to write the files to.  [default: NAME-TARGET]",
)
@click.option(
    "--profile",
    metavar="NAME|FILE",
    help="The robot that a package drives: its topics and limits.",
)
@options.json_option
def command(
    path: Path,
    target: str,
    name: str | None,
    out: Path | None,
    profile: str | None,
    as_json: bool,
    **chosen: Any,
) -> None:
    """Write a run's champion as files for robots and other programs.

    Except for onnx and argos, it decides there bit for bit as in evolution; every file comes with
    reference steps to check that.

    \b
      argos   for e-pucks in ARGoS: NEAT's genome, or AutoMoDe's machine
      c99     C without malloc, for any processor
      python  one Python file that needs only numpy
      json    a documented file for third-party programs
      onnx    one step as an ONNX graph (extra onnx)
      ros1    a catkin package with a node in C++
      ros2    an ament_python package with rclpy
      zenoh   a program for a robot of ROS 2, without ROS

    \b
      zswarm-ot export runs/stadium --to python
      zswarm-ot export runs/stadium --to c99 --out firmware/
      zswarm-ot export runs/stadium --to json --generation 1 --candidate 3
      zswarm-ot export runs/turtlebot-exit --to ros1 --profile turtlebot2
    """
    from zswarm.kernels.jit import interpreted
    from zswarm.ot.record import selection
    from zswarm.robots import folder, targets
    from zswarm.robots.c.c_types import folded
    from zswarm.robots.c.reference_steps import sha256

    targets.known(target)
    controller = selection.controller(path, **chosen)
    if name is None:
        name = path.resolve().name if path.is_dir() else controller.run
    name = folded(name)
    with interpreted():  # the few steps that are played need no compiler
        files = targets.files(target, controller, name, profile)
    out = out or Path(f"{name}-{target}")
    written = folder.write(out, files)
    digest = sha256(controller.network()[1])
    if as_json:
        what = {"target": target, "name": f"zs_{name}", "folder": str(out)}
        who = {"run": controller.run, "fitness": controller.fitness, "sha256": digest}
        who["trials"] = controller.trials
        tables.print_json({**what, "files": list(files), **who})
        return
    for file in written:
        tables.line(clean(str(file)))
    about = f"of {controller.run}, fitness {controller.in_search()}, {controller.representation}"
    tables.entry("controller", about)
    tables.line(f"{'parameters':12}sha256 {digest}")
    tables.line(f"{'next':12}{targets.on(target, name, out)}")
