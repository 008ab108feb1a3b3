"""Print bytes and type hashes of ROS 2 as JSON; run by the Python of build/ros2."""

import importlib
import json
import pathlib
import sys

sys.path.insert(
    0, str(pathlib.Path(__file__).parents[3] / "zswarm" / "ros" / "link" / "bridges")
)

from conversion import Conversion
from rclpy.serialization import serialize_message

# Of lengths that need no padding, which ROS 2 leaves as it was.
TOPICS = {"frame": "robot_1/ray", "child_frame": "robot_1/hub"}


def new(kind):
    package, _, name = kind.partition("/")
    return getattr(importlib.import_module(f"{package}.msg"), name)()


def main():
    found = {}
    for kind, body in json.load(sys.stdin).items():
        package, _, name = kind.partition("/")
        message = Conversion(new).message({**TOPICS, "type": kind})(bytes.fromhex(body))
        described = json.loads(
            pathlib.Path(sys.prefix, "share", package, "msg", f"{name}.json").read_text()
        )
        hashes = {
            entry["type_name"]: entry["hash_string"] for entry in described["type_hashes"]
        }
        found[kind] = {
            "body": body,
            "cdr": serialize_message(message).hex(),
            "hash": hashes[f"{package}/msg/{name}"],
        }
    json.dump(found, sys.stdout, indent=1)


if __name__ == "__main__":
    main()
