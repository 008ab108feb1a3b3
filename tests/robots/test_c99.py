"""A controller's C99 pair decides as the controller does, bit for bit."""

import ctypes
import subprocess
from pathlib import Path

import msgspec
import numpy as np
import pytest

from zswarm import plugins
from zswarm.controller import Controller
from zswarm.draws import Stream
from zswarm.robots.c99 import pair

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic")


def controller(kind: str, seed: int, inputs: int = 10, outputs: int = 2, **settings) -> Controller:
    """A random one."""
    network = plugins.load("representation", kind)
    made = network.settings_type(**settings)
    (genome,) = network(made, inputs, outputs).random(1, Stream(seed))
    return Controller(
        simulator="turtlebot-exit",
        simulator_settings={},
        representation=kind,
        representation_settings=msgspec.to_builtins(made),
        inputs=inputs,
        outputs=outputs,
        sensors=[f"sensor {number}" for number in range(inputs)],
        actuators=[f"actuator {number}" for number in range(outputs)],
        genome=genome,
        fitness=-1.0,
        run="night",
    )


def decisions(files: dict[str, str], folder: Path, observations: np.ndarray, outputs: int, *flags: str) -> np.ndarray:
    """What the compiled pair decides, step by step; its self-test passes."""
    for name, text in files.items():
        (folder / name).write_text(text, "ascii")
    (source,) = (name for name in files if name.endswith(".c"))
    stem = source.removesuffix(".c")
    library = folder / f"{stem}.so"
    subprocess.run(["gcc", *STRICT, *flags, "-shared", "-fPIC", "-o", library, folder / source, "-lm"], check=True)
    compiled = ctypes.CDLL(str(library))
    assert getattr(compiled, f"{stem}_selftest")() == 0
    state, action = (ctypes.c_float * 100_000)(), (ctypes.c_float * outputs)()
    getattr(compiled, f"{stem}_reset")(state)
    rows = []
    for row in observations:
        getattr(compiled, f"{stem}_step")(state, row.ctypes.data_as(ctypes.c_void_p), action)
        rows.append(list(action))
    return np.array(rows, np.float32)


@pytest.mark.parametrize("kind", plugins.BUNDLED["representation"])
def test_the_pair_decides_as_the_kernel_does(kind: str, tmp_path: Path) -> None:
    one = controller(kind, 1)
    observations = Stream(2).uniform(-2.0, 2.0, 60 * 10).astype(np.float32).reshape(60, 10)
    driver = one.driver()
    expected = np.array([driver.act(row) for row in observations])
    assert decisions(pair(one, "night"), tmp_path, observations, 2, "-O2").tobytes() == expected.tobytes()
