"""The wall clock may jump: it dates what is recorded and logged, and decides nothing."""

import ast
from pathlib import Path

import zswarm

PACKAGE = Path(zswarm.__file__).parent
MAY_DATE = {
    "ot/record/opening.py",
    "ot/record/writer.py",
    "ot/commands/list.py",  # shows dates, as does report.py
    "ot/report/report.py",
    "ot/doctor/machine.py",
    "robots/templates/zenoh/package/node.py",  # stamps of messages to a robot
    "ros/link/over_zenoh.py",  # when a message was sent, for its readers
    "kernels/cache.py",  # the age of a cache folder
    "system/temporary.py",  # the age of a folder
    "ot/dashboard/tail.py",  # the age of a record
    "ss/health.py",  # since when it serves, as does status.py
    "ss/local/status.py",
    *(
        f"security/{name}.py"
        for name in ("authority", "certificates", "keyring", "ledger")
    ),
    "security/report.py",  # how long certificates are valid
}
# Of the module time.
WALL = {"time", "time_ns", "localtime", "gmtime", "ctime", "strftime"}


def test_only_listed_modules_read_the_time_of_day() -> None:
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
