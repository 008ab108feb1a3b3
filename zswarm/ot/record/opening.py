"""Create a record's database, and check one before its run is resumed."""

import contextlib
import json
import platform
import secrets
import sqlite3
import time
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from zswarm.config.sections import ABSOLUTE
from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.ot.record.database import Statement, transact
from zswarm.ot.record.folder import DATABASE, EXPERIMENT
from zswarm.ot.record.schema import CREATE, SCHEMA_VERSION, check_version
from zswarm.ot.record.statements import SET_META
from zswarm.system.files import sync
from zswarm.system.text import clean
from zswarm.system.version import VERSION

# These may change while a run is stopped.
NOT_DECISIVE = ("generations", "cluster", "study")


def new_meta(
    complete: Experiment, version_hash: str, metrics: Sequence[str] | None, **more: Any
) -> dict[str, Any]:
    """Return the rows of the table ``meta`` of a new record."""
    return {
        "schema_version": SCHEMA_VERSION,
        "zswarm": VERSION,
        "run_id": f"{complete.name[:54].strip('-')}-{secrets.token_hex(4)}",
        "version_hash": version_hash,
        "experiment": decisive(complete),
        "epoch": 0,
        "created_at": time.time(),
        "machine": machine(),
        **({} if metrics is None else {"metrics": json.dumps(list(metrics))}),
        **more,
    }


def create(path: Path, meta: dict[str, Any]) -> None:
    """Create a database; a program that is killed meanwhile leaves none."""
    part = path.with_suffix(".part")
    connection = sqlite3.connect(part, isolation_level=None)
    try:
        connection.executescript(f"BEGIN; {CREATE} COMMIT")
        transact(connection, [(SET_META, item) for item in meta.items()])
    finally:
        connection.close()
    part.replace(path)
    sync(path.parent)


def check(folder: Path, connection: sqlite3.Connection, complete: Experiment) -> None:
    """Raise ConfigError unless the run can be resumed with this experiment."""
    path, meta = folder / DATABASE, _meta(connection)
    check_version(meta, path)
    began = meta.get("experiment")
    if not isinstance(began, str) or not isinstance(meta.get("epoch"), int):
        raise ConfigError(
            f"{path}: damaged: expected an experiment and an epoch in its table meta"
        )
    if "imported_from" in meta:
        raise ConfigError(
            f"{folder}: was imported, without a state of the optimizer to resume from; its "
            f"experiment can be run again from {folder / EXPERIMENT}"
        )
    state = str(connection.execute("PRAGMA quick_check").fetchone()[0])
    if state != "ok":
        first = state.removeprefix("*** in database main ***\n").partition("\n")[0]
        raise ConfigError(f"{path}: damaged: {clean(first)}")
    if began == (now := decisive(complete)):
        return
    try:
        before = dict(json.loads(began))
    except (ValueError, TypeError, RecursionError):
        raise ConfigError(f"{path}: damaged: its experiment is not valid JSON") from None
    after = json.loads(now)
    keys = [key for key in sorted(before | after) if before.get(key) != after.get(key)]
    raise ConfigError(
        f"{folder / EXPERIMENT}: {', '.join(keys)} changed since the run began; "
        "only generations and [cluster] may"
    )


def raise_epoch(connection: sqlite3.Connection, complete: Experiment) -> None:
    """Count a resume; the hash of a run that gets more generations is dropped."""
    finished = connection.execute("SELECT count(*) FROM generations").fetchone()[0]
    changes: list[Statement] = [
        (SET_META, ("epoch", int(_meta(connection)["epoch"]) + 1))
    ]
    if finished < complete.generations:
        changes.append(("DELETE FROM meta WHERE key = 'history_hash'", ()))
    transact(connection, changes)


def decisive(complete: Experiment) -> str:
    """Return as JSON those parts of an experiment that the history depends on."""
    values = msgspec.to_builtins(complete)
    if complete.ranking.kind == ABSOLUTE:  # the default is not recorded
        del values["ranking"]
    kept = {key: value for key, value in values.items() if key not in NOT_DECISIVE}
    return json.dumps(kept, sort_keys=True)


def machine() -> str:
    """Return what can change the bits of linear algebra."""
    config: Any = np.show_config(mode="dicts")
    blas = config["Build Dependencies"]["blas"]
    library = f"{blas.get('name', 'no BLAS')} {blas.get('version', '')}"
    return f"{_processor()}, numpy {version('numpy')}, {library}".strip()


def _meta(connection: sqlite3.Connection) -> dict[str, Any]:
    return dict(connection.execute("SELECT key, value FROM meta").fetchall())


def _processor() -> str:
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
