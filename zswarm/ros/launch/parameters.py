"""YAML files of ROS parameters, as ``<rosparam command="load">`` reads them: one name a line.

Values are JSON, which is YAML, too, but for floats: 1e-07 is a string in YAML 1.1. ROS keeps only
integers of 32 bits.
"""

import json
import math
from collections.abc import Mapping
from typing import Any

INTEGERS = range(-(2**31), 2**31)


def text(values: Mapping[str, Any]) -> str:
    """Return the file."""
    return "".join(f"{name}: {value(name, each)}\n" for name, each in values.items())


def value(name: str, each: Any) -> str:
    """Return the value of a parameter in YAML."""
    match each:
        case bool() | str():
            return json.dumps(each)
        case int() if each in INTEGERS:
            return str(each)
        case int():
            limits = f"{INTEGERS[0]} to {INTEGERS[-1]}"
            raise ValueError(
                f"{name}: {each} is not among the integers of ROS parameters, {limits}"
            )
        case float():
            return number(each)
        case list() | tuple():
            return f"[{', '.join(value(name, item) for item in each)}]"
        case dict():
            items = (f"{json.dumps(str(key))}: {value(name, each[key])}" for key in each)
            return "{" + ", ".join(items) + "}"
    raise ValueError(f"{name}: a {type(each).__name__} cannot be a ROS parameter")


def number(each: float) -> str:
    """Return the shortest text of a float64, with a point: without it YAML 1.1 reads a string."""
    if not math.isfinite(each):
        return ".nan" if math.isnan(each) else ".inf" if each > 0 else "-.inf"
    mantissa, mark, exponent = repr(float(each)).partition("e")
    return mantissa + ("" if "." in mantissa else ".0") + mark + exponent
