"""``zswarm-ot export``: a controller as files for robots and other programs."""

from pathlib import Path

import click

from zswarm.ot.commands import suggestions
from zswarm.ot.commands.options import json_option


@click.command()
@click.argument("path", type=click.Path(path_type=Path), metavar="RUN|CHAMPION.zsc", shell_complete=suggestions.runs)
@click.option(
    "--to",
    "target",
    required=True,
    metavar="TARGET",
    shell_complete=suggestions.targets,
    help="What to make of it, as listed below.",
)
@click.option("--generation", type=int, metavar="N", help="A candidate of this generation, from 0, instead of the champion.")
@click.option("--candidate", type=int, metavar="N", help="This candidate of the generation, from 0: the best by default.")
@click.option("--name", help="Name in files, functions and packages, behind zs_; the run's by default.")
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="FOLDER",
    help="Where the files are written; NAME-TARGET by default.",
)
@click.option("--profile", metavar="NAME|FILE", help="The robot that a package drives: its topics and limits.")
@json_option
def export(
    path: Path,
    target: str,
    generation: int | None,
    candidate: int | None,
    name: str | None,
    out: Path | None,
    profile: str | None,
    as_json: bool,
) -> None:
    """Write a run's champion as files for robots and other programs.

    It decides the same bits there as in evolution, but for onnx, and every file has steps to check that by.

    \b
      c99     C without malloc, for any processor
      python  one Python file that needs numpy alone
      json    a documented file for programs of others
      onnx    one step as a graph of ONNX (extra onnx)

    \b
      zswarm-ot export runs/stadium --to python
      zswarm-ot export runs/stadium --to c99 --out firmware/
      zswarm-ot export runs/stadium --to json --generation 0 --candidate 3
    """  # noqa: D301  click's mark for text that is not to be wrapped
    import os

    os.environ["ZSWARM_PLAIN"] = "1"  # the few steps that are played need no compiler
    from zswarm.ot import exported, terminal
    from zswarm.protocol.codec import clean
    from zswarm.robots import folder, names, original, targets

    targets.known(target)
    controller = exported.controller(path, generation, candidate)
    own = path.resolve().name if path.is_dir() else controller.run
    name = names.folded(name if name is not None else own)
    files = targets.files(target, controller, name, profile)
    out = out or Path(f"{name}-{target}")
    written = folder.write(out, files)
    _, parameters = controller.network()
    if as_json:
        what = {"target": target, "name": f"zs_{name}", "folder": str(out), "files": list(files)}
        terminal.print_json({**what, "run": controller.run, "fitness": controller.fitness, "sha256": original.sha256(parameters)})
        return
    for file in written:
        terminal.line(clean(str(file)))
    terminal.entry("controller", f"of {controller.run}, fitness {controller.fitness:.6g}, {controller.representation}")
    terminal.line(f"{'parameters':12}sha256 {original.sha256(parameters)}")
    terminal.line(f"{'next':12}{targets.on(target, name, out)}")
