"""A candidate's controller as a file of a ROS package, in the three forms of docs/ros-files.md."""

from collections.abc import Callable
from pathlib import PurePosixPath

import numpy as np

from zswarm.champion.controller import Controller
from zswarm.errors import ConfigError
from zswarm.robots.c.c99 import pair
from zswarm.robots.json_file import as_json
from zswarm.ros.launch import parameters

NAME = "candidate"  # in all of them


def yaml(controller: Controller) -> str:
    """Return ROS parameters: the genome as a list of numbers, and its kind of network."""
    network, _ = controller.network()
    if network.genes is None:
        raise ConfigError(
            f"genomes of {controller.representation} are not lists of numbers, which a controller "
            "in yaml needs; expected another network, or another form of the manifest's controller"
        )
    kind = {"kind": controller.representation, **controller.representation_settings}
    numbers = np.frombuffer(controller.genome, "<f4").tolist()
    return parameters.text({f"{NAME}_network": kind, NAME: numbers})


def json(controller: Controller) -> str:
    """Return the JSON of ``zswarm-ot export --to json``."""
    return "".join(as_json(controller, NAME).values())


def c99(controller: Controller) -> str:
    """Return header and source of ``zswarm-ot export --to c99`` as one file to include."""
    files = pair(controller, NAME)
    header, source = files[f"zs_{NAME}.h"], files[f"zs_{NAME}.c"]
    return header + source.replace(f'#include "zs_{NAME}.h"\n', "", 1)


def written(controller: Controller, form: str, path: str) -> dict[str, str]:
    """Return the files of a controller by their paths in a package.

    Args:
        form: one of ``FORMS``.
        path: of the file. One of C99 that ends in ``.c`` has its header next to it, as in what
            ``zswarm-ot export --name candidate`` writes.
    """
    if form == "c99" and path.endswith(".c"):
        files, header = pair(controller, NAME), f"zs_{NAME}.h"
        beside = PurePosixPath(path).with_name(header)
        return {path: files[f"zs_{NAME}.c"], str(beside): files[header]}
    return {path: FORMS[form](controller)}


FORMS: dict[str, Callable[[Controller], str]] = {"yaml": yaml, "json": json, "c99": c99}
