"""The clock on the wall may jump: it dates what is recorded and logged, and decides nothing."""

import ast
from pathlib import Path

import zswarm

PACKAGE = Path(zswarm.__file__).parent
MAY_DATE = {
    *("ot/record.py", "ot/commands/list.py", "ot/report.py", "ot/doctor/machine.py"),  # list.py and report.py show dates
    "robots/templates/zenoh/node.py",  # stamps of what a robot is told
    "ros/over_zenoh.py",  # when a message was sent, for those who read it
    "ot/dashboard/follower.py",  # how long ago something was recorded
    *("ss/server.py", "ss/status.py"),  # since when it serves
    *(f"security/{name}.py" for name in ("authority", "certificates", "cli", "keyring")),  # how long certificates are valid
}
WALL = {"time", "time_ns", "localtime", "gmtime", "ctime", "strftime"}  # of the module time


def test_only_what_dates_asks_what_time_it_is() -> None:
    asking = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            match node:
                case ast.Attribute(value=ast.Name(id="time"), attr=name) if name in WALL:
                    pass
                case ast.ImportFrom(module="time" | "datetime") | ast.Name(id="datetime"):
                    pass
                case _:
                    continue
            asking.add(path.relative_to(PACKAGE).as_posix())
    assert asking == MAY_DATE
