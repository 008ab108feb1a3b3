"""What ``zswarm-ss status`` and ``zswarm-ss drain`` do: find the servers of this machine by their sockets, and ask them."""

import contextlib
import os
import socket
import tempfile
import textwrap
import time
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from rich.table import Table
from rich.text import Text

from zswarm.errors import ZswarmError
from zswarm.protocol.codec import clean
from zswarm.screen import console
from zswarm.ss import control
from zswarm.ss.view import View

T = TypeVar("T", bound=msgspec.Struct)

ANSWER_S = 5.0
MAX_ANSWER = 64 << 20  # bytes


class NoDaemonError(ZswarmError):
    """No server of this machine can be asked, or it does not do what it is asked; the text says why."""


def show(name: str, *, as_json: bool) -> None:
    """Every server of this machine, or those of a name.

    Raises:
        NoDaemonError: none is there, or one does not answer.
    """
    faults = []
    for number, path in enumerate(_sockets(name)):
        try:
            connection, view = _asked(path, control.Question("status"), View)
        except NoDaemonError as error:
            faults.append(str(error))
            continue
        connection.close()
        if as_json:
            _print(msgspec.json.encode(view).decode())
        else:
            if number:
                _print("")
            _table(view)
    if faults:
        raise NoDaemonError("; ".join(faults))


def drain(name: str, *, wait: bool) -> None:
    """Have the only server of this machine, or of a name, finish what runs and end; wait until it ended.

    Raises:
        NoDaemonError: there is none or more than one, or it refuses.
    """
    paths = _sockets(name)
    if len(paths) > 1:
        raise NoDaemonError(f"several daemons run here, choose one with --name: {', '.join(path.stem for path in paths)}")
    with _asked(paths[0], control.Question("drain", wait), control.Draining)[0] as connection:
        _print(f"{paths[0].stem} drains: it finishes what runs and ends")
        if wait:
            connection.settimeout(None)
            with contextlib.suppress(ConnectionResetError):
                connection.recv(1)  # nothing comes but the end
            _print(f"{paths[0].stem} ended")


def _sockets(name: str) -> list[Path]:
    """Of all servers that this user can reach.

    Raises:
        NoDaemonError: there is none.
    """
    folders = {control.folder(), Path("/run/zswarm"), Path(tempfile.gettempdir()) / f"zswarm-{os.geteuid()}"}
    if session := os.environ.get("XDG_RUNTIME_DIR", ""):
        folders.add(Path(session) / "zswarm")
    found = []
    for path in sorted(path for folder in folders for path in folder.glob("*" + control.SUFFIX)):
        if name not in ("", path.stem, path.stem.rpartition("-")[0]):
            continue
        try:
            _connected(path).close()
            found.append(path)
        except (FileNotFoundError, ConnectionRefusedError, PermissionError):  # what a killed server left, or not for this user
            continue
        except OSError as error:
            raise NoDaemonError(f"{path.stem} does not answer: {error.strerror or error}") from None
    if not found:
        named = f" named {name}" if name else ""
        raise NoDaemonError(f"no daemon{named} runs on this machine that this user can ask (looked in {_listed(folders)})")
    return found


def _listed(folders: set[Path]) -> str:
    return ", ".join(sorted(map(str, folders)))


def _connected(path: Path) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connection.settimeout(ANSWER_S)
    try:
        connection.connect(str(path))
    except OSError:
        connection.close()
        raise
    return connection


def _asked(path: Path, question: control.Question, kind: type[T]) -> tuple[socket.socket, T]:
    """The connection, and the answer."""
    try:
        connection = _connected(path)
        try:
            return connection, _answer(connection, question, kind)
        except BaseException:
            connection.close()
            raise
    except OSError as error:
        raise NoDaemonError(f"{path.stem} does not answer: {error.strerror or error}") from None


def _answer(connection: socket.socket, question: control.Question, kind: type[T]) -> T:
    connection.sendall(msgspec.json.encode(question) + b"\n")
    answer = b""
    while not answer.endswith(b"\n"):
        came = connection.recv(1 << 16)
        if not came or len(answer) > MAX_ANSWER:
            raise NoDaemonError("the daemon ended in the middle of its answer")
        answer += came
    try:
        got = msgspec.json.decode(answer, type=dict[str, Any])
        if "error" in got:
            raise NoDaemonError(clean(str(got["error"])))
        return msgspec.convert(got, kind)
    except msgspec.MsgspecError as error:
        raise NoDaemonError(f"the daemon is of another version of zswarm: {error}") from None


def _table(view: View) -> None:
    states = ", ".join(f"{count} {state}" for state, count in view.slots.items() if count)
    since = time.strftime("%Y-%m-%d %H:%M", time.localtime(view.since))
    faults = ", ".join(f"{count} {kind}" for kind, count in sorted(view.faults.items())) or "none"
    state = "draining" if view.draining else "serves" if view.warm else "starting"
    _pair(view.server, f"{state}, realm {view.realm}, zswarm {view.program}, process {view.pid}, since {since}")
    _pair("listens", ", ".join(view.listen) or "not yet")
    _pair("slots", f"{sum(view.slots.values())}: {states}; {view.slot_memory_mb} MB each")
    for missed in view.missed:
        _pair("", f"slot {missed.slot}: {missed.reason}")
    _pair("trials", f"{view.trials} in all, {view.trials_per_s:.1f} a second; slots were busy for {view.busy_s:.1f} s")
    _pair("faults", f"{faults}; {view.malformed} malformed messages")
    if not view.leases:
        _pair("leases", "none")
        return
    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False)
    for column in ("user", "run", "simulator", "slots", "trials", "for"):
        table.add_column(column, overflow="fold", justify="right" if column in ("slots", "trials", "for") else "left")
    for lease in view.leases:
        cells = (lease.user, lease.run, lease.simulator, lease.slots, lease.trials, _span(lease.seconds))
        table.add_row(*(Text(clean(str(cell))) for cell in cells))
    _print("")
    console().print(table)


def _span(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}"


def _pair(title: str, text: str) -> None:
    width = max(40, console().width)
    first = f"{title:10}" if len(title) < 10 else f"{title}  "
    lines = textwrap.wrap(first + clean(text), width, subsequent_indent=" " * 10, break_on_hyphens=False, break_long_words=False)
    _print("\n".join(lines))


def _print(text: str) -> None:
    console().print(Text(text), soft_wrap=True)
