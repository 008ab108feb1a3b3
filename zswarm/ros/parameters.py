"""YAML files of ROS parameters, as ``<rosparam command="load">`` reads them: a map of names to values, one a line.

Values are written as JSON has them, which is YAML, too, but for floats: there 1e-07 is a text, and not a number; and ROS keeps
integers of 32 bits only.
"""

import json
import math
from collections.abc import Mapping
from typing import Any

INTEGERS = range(-(2**31), 2**31)


def text(values: Mapping[str, Any]) -> str:
    """The file.

    Raises:
        ValueError: a value cannot be a ROS parameter; the text says which.
    """
    return "".join(f"{name}: {value(name, each)}\n" for name, each in values.items())


def value(name: str, each: Any) -> str:
    """A value in YAML.

    Args:
        name: of the parameter, for an error.

    Raises:
        ValueError: ROS has no such parameters.
    """
    match each:
        case bool():
            return "true" if each else "false"
        case int() if each in INTEGERS:
            return str(each)
        case int():
            raise ValueError(f"{name}: {each} is not among the integers of ROS parameters, {INTEGERS[0]} to {INTEGERS[-1]}")
        case float():
            return number(each)
        case str():
            return json.dumps(each)
        case list() | tuple():
            return f"[{', '.join(value(name, item) for item in each)}]"
        case dict():
            return "{" + ", ".join(f"{json.dumps(str(key))}: {value(name, item)}" for key, item in each.items()) + "}"
    raise ValueError(f"{name}: a {type(each).__name__} cannot be a ROS parameter")


def number(each: float) -> str:
    """The shortest text that gives the same float64; with a point, without which YAML 1.1 takes 1e-07 for a text."""
    if not math.isfinite(each):
        return ".nan" if math.isnan(each) else ".inf" if each > 0 else "-.inf"
    mantissa, mark, exponent = repr(float(each)).partition("e")
    return mantissa + ("" if "." in mantissa else ".0") + mark + exponent
