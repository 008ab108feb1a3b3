"""YAML files of ROS parameters say what was put into them, to a YAML reader as ROS has it."""

import json
import math
import shutil
import subprocess
from typing import Any

import numpy as np
import pytest

from zswarm.ros.launch import parameters

VALUES: dict[str, Any] = {
    "steps": 50,
    "numAgents": -(2**31),
    "visual": False,
    "epsilon": 0.15,
    "small": 1e-07,
    "large": 1e16,
    "denormal": 5e-324,
    "whole": 3.0,
    "exit_0": [-2, 1.5],
    "nothing": [],
    "map": 'a "quoted"\\ text: with # and {braces}, äöü',
    "looks_like_a_number": "12e3",
    "looks_like_a_truth": "yes",
    "network": {"kind": "fully-meshed", "layers": [4, 2], "scale": 1e-9},
}


def test_the_text_has_one_value_per_line() -> None:
    assert parameters.text(
        {"steps": 50, "exit_0": [-2.0, 1], "on": True, "to": "log"}
    ) == ('steps: 50\nexit_0: [-2.0, 1]\non: true\nto: "log"\n')


@pytest.mark.parametrize(
    ("number", "text"),
    [(1e-07, "1.0e-07"), (1e22, "1.0e+22"), (0.1, "0.1"), (-2.0, "-2.0")],
)
def test_floats_have_a_decimal_point(number: float, text: str) -> None:
    """YAML 1.1, which ROS reads, takes 1e-07 for a text."""
    assert parameters.number(number) == text


def test_numbers_that_are_not_finite_are_yaml() -> None:
    assert [parameters.number(number) for number in (math.nan, math.inf, -math.inf)] == [
        ".nan",
        ".inf",
        "-.inf",
    ]


@pytest.mark.parametrize(
    "value", [2**31, -(2**31) - 1, None, {1, 2}, [1, [2**40]], {"a": None}]
)
def test_values_that_ros_parameters_lack_are_refused(value: Any) -> None:
    with pytest.raises(ValueError, match=r"^steps: "):
        parameters.text({"steps": value})


@pytest.mark.robots
def test_ros_reads_the_written_files() -> None:
    """The YAML reader of Debian's ROS reads them in its Python; float32 numbers keep their bits."""
    if not shutil.which("roslaunch"):
        pytest.skip("roslaunch is not installed: apt install ros-core")
    numbers = (
        np.random.default_rng(1)
        .integers(0, 2**31, 2000)
        .astype(np.uint32)
        .view(np.float32)
    )
    vector = numbers[np.isfinite(numbers)]
    text = parameters.text({**VALUES, "candidate": vector.tolist()})
    code = "import json, sys, yaml; print(json.dumps(yaml.safe_load(sys.stdin)))"
    read = subprocess.run(
        ["/usr/bin/python3", "-c", code],
        input=text,
        capture_output=True,
        text=True,
        check=True,
    )
    said = json.loads(read.stdout)
    assert np.array(said.pop("candidate"), np.float32).tobytes() == vector.tobytes()
    assert said == VALUES
    assert [type(value) for value in said.values()] == [
        type(value) for value in VALUES.values()
    ]
