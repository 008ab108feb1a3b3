"""Create a record's database, and check one before its run is resumed."""

import contextlib
import json
import platform
import secrets
import sqlite3
import time
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from zswarm.config.sections import ABSOLUTE
from zswarm.errors import ConfigError
from zswarm.experiment import Experiment
from zswarm.ot.record import stopping, verify
from zswarm.ot.record.database import Statement, transact
from zswarm.ot.record.digests import seal
from zswarm.ot.record.folder import DATABASE, EXPERIMENT
from zswarm.ot.record.history_hash import VERSION as HISTORY_VERSION
from zswarm.ot.record.schema import ASSESSMENT, CREATE, OF_THE_END, SCHEMA_VERSION
from zswarm.ot.record.statements import SET_META
from zswarm.system.files import sync
from zswarm.system.version import VERSION

SECRET = 16  # bytes, by which servers tell the run's programs from others
# These may change while a run is stopped.
NOT_DECISIVE = (
    "generations",
    "assessment",
    "cluster",
    "record",
    "stop",
    "study",
    "label",
)
RACING = "assessment.racing"  # may not


def new_meta(
    complete: Experiment, version_hash: str, metrics: Sequence[str] | None, **more: Any
) -> dict[str, Any]:
    """Return the rows of the table ``meta`` of a new record."""
    return {
        "schema_version": SCHEMA_VERSION,
        "history_version": HISTORY_VERSION,
        "zswarm": VERSION,
        "run_id": f"{complete.name[:54].strip('-')}-{secrets.token_hex(4)}",
        "version_hash": version_hash,
        "experiment": decisive(complete),
        "epoch": 0,
        "secret": secrets.token_bytes(SECRET),
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
        rows = [*meta.items(), seal(meta)]
        transact(connection, [(SET_META, item) for item in rows])
    finally:
        connection.close()
    part.replace(path)
    sync(path.parent)


def check(
    folder: Path, connection: sqlite3.Connection, complete: Experiment
) -> dict[str, Any]:
    """Return the table ``meta`` of a run that can be resumed with this experiment.

    Raises:
        ConfigError: it cannot.
        Damage: the record is not what was written.
    """
    path = folder / DATABASE
    meta = verify.read_meta(connection, path)
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
    verify.check_record(connection)
    verify.check_end(connection)
    if began == (now := decisive(complete)):
        return meta
    try:
        before = dict(json.loads(began))
    except (ValueError, TypeError, RecursionError):
        raise ConfigError(f"{path}: damaged: its experiment is not valid JSON") from None
    after = json.loads(now)
    keys = [key for key in sorted(before | after) if before.get(key) != after.get(key)]
    raise ConfigError(
        f"{folder / EXPERIMENT}: {', '.join(keys)} changed since the run began; "
        "only generations, label, [assessment] but racing, [cluster], [record] and [stop] may"
    )


def raise_epoch(
    connection: sqlite3.Connection, complete: Experiment, meta: Mapping[str, Any]
) -> dict[str, Any]:
    """Count a resume; a run that gets more generations loses its hash and its assessment.

    Returns:
        The new table ``meta``.
    """
    finished = connection.execute("SELECT count(*) FROM generations").fetchone()[0]
    secret = meta.get("secret")
    if not isinstance(secret, bytes) or len(secret) != SECRET:  # older records have none
        secret = secrets.token_bytes(SECRET)
    now = {**meta, "epoch": int(meta["epoch"]) + 1, "secret": secret}
    changes: list[Statement] = [
        (SET_META, ("epoch", now["epoch"])),
        (SET_META, ("secret", secret)),
    ]
    if finished < complete.generations and not stopping.ended(meta, complete):
        for key in OF_THE_END:
            now.pop(key, None)
            changes.append(("DELETE FROM meta WHERE key = ?", (key,)))
        changes.append(("DELETE FROM outcomes WHERE generation = ?", (ASSESSMENT,)))
    transact(connection, [*changes, (SET_META, seal(now))])
    return now


def decisive(complete: Experiment) -> str:
    """Return as JSON those parts of an experiment that the history depends on."""
    values = msgspec.to_builtins(complete)
    if complete.ranking.kind == ABSOLUTE:  # the default is not recorded
        del values["ranking"]
    kept = {key: value for key, value in values.items() if key not in NOT_DECISIVE}
    if complete.assessment.racing:
        kept[RACING] = True
    return json.dumps(kept, sort_keys=True)


def machine() -> str:
    """Return what can change the bits of linear algebra."""
    config: Any = np.show_config(mode="dicts")
    blas = config["Build Dependencies"]["blas"]
    library = f"{blas.get('name', 'no BLAS')} {blas.get('version', '')}"
    return f"{_processor()}, numpy {version('numpy')}, {library}".strip()


def _processor() -> str:
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
