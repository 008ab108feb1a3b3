"""``zswarm-ss status`` and ``zswarm-ss drain``: find this machine's servers by their sockets."""

import contextlib
import socket
import textwrap
import time
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from rich.table import Table
from rich.text import Text

from zswarm.errors import ZswarmError
from zswarm.ss.local import control
from zswarm.ss.local.control import LocalRequest
from zswarm.ss.local.snapshot import View
from zswarm.system.format import duration
from zswarm.system.locks import folders, visible_folders
from zswarm.system.terminal import console
from zswarm.system.text import clean

T = TypeVar("T", bound=msgspec.Struct)

ANSWER_S = 5.0
MAX_ANSWER = 64 << 20  # bytes


class NoDaemonError(ZswarmError):
    """No server of this machine can be asked, or it refuses; the text says why."""


def show(name: str, *, as_json: bool) -> None:
    """Print the state of every server of this machine, or of those with a name."""
    faults = []
    for number, path in enumerate(_sockets(name)):
        try:
            connection, view = _ask(path, LocalRequest("status"), View)
        except NoDaemonError as error:
            faults.append(str(error))
            continue
        connection.close()
        if as_json:
            _print(msgspec.json.encode(view).decode())
        else:
            if number:
                _print("")
            _show(view)
    if faults:
        raise NoDaemonError("; ".join(faults))


def drain(name: str, *, wait: bool) -> None:
    """Drain the only server of this machine, or of a name; wait until it ended."""
    path, *others = _sockets(name)
    if others:
        names = ", ".join(each.stem for each in (path, *others))
        raise NoDaemonError(f"several daemons run here, choose one with --name: {names}")
    with _ask(path, LocalRequest("drain", wait), control.Draining)[0] as connection:
        _print(f"{path.stem} drains: it finishes what runs and ends")
        if wait:
            connection.settimeout(None)
            with contextlib.suppress(ConnectionResetError):
                connection.recv(1)  # until the server ends
            _print(f"{path.stem} ended")


def _sockets(name: str) -> list[Path]:
    """Return the sockets of the servers that this user can reach."""
    found = []
    for path in sorted(
        path for folder in visible_folders() for path in folder.glob("*" + control.SUFFIX)
    ):
        if name not in ("", path.stem, path.stem.rpartition("-")[0]):
            continue
        # The socket of a killed server, or of another user, is skipped.
        with contextlib.suppress(
            FileNotFoundError, ConnectionRefusedError, PermissionError
        ):
            _connect(path).close()
            found.append(path)
    if not found:
        named = f" named {name}" if name else ""
        places = ", ".join(sorted(map(str, folders())))
        text = f"no daemon{named} runs on this machine that this user can ask"
        raise NoDaemonError(f"{text} (looked in {places})")
    return found


def _connect(path: Path) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connection.settimeout(ANSWER_S)
    try:
        connection.connect(str(path))
    except (FileNotFoundError, ConnectionRefusedError, PermissionError):
        connection.close()
        raise
    except OSError as error:
        connection.close()
        raise _unanswered(path, error) from None
    return connection


def _unanswered(path: Path, error: OSError) -> NoDaemonError:
    return NoDaemonError(f"{path.stem} does not answer: {error.strerror or error}")


def _ask(path: Path, request: LocalRequest, kind: type[T]) -> tuple[socket.socket, T]:
    """Return the connection, and the answer."""
    with contextlib.ExitStack() as stack:
        try:
            connection = stack.enter_context(_connect(path))
            answer = _answer(connection, request, kind)
        except OSError as error:
            raise _unanswered(path, error) from None
        stack.pop_all()
        return connection, answer


def _answer(connection: socket.socket, request: LocalRequest, kind: type[T]) -> T:
    connection.sendall(msgspec.json.encode(request) + b"\n")
    answer = b""
    while not answer.endswith(b"\n"):
        received = connection.recv(1 << 16)
        if not received or len(answer) > MAX_ANSWER:
            raise NoDaemonError("the daemon ended in the middle of its answer")
        answer += received
    try:
        fields = msgspec.json.decode(answer, type=dict[str, Any])
        if "error" in fields:
            raise NoDaemonError(clean(str(fields["error"])))
        return msgspec.convert(fields, kind)
    except msgspec.MsgspecError as error:
        raise NoDaemonError(
            f"the daemon is of another version of zswarm: {error}"
        ) from None


def _show(view: View) -> None:
    states = ", ".join(f"{count} {state}" for state, count in view.slots.items() if count)
    since = time.strftime("%Y-%m-%d %H:%M", time.localtime(view.since))
    faults = (
        ", ".join(f"{count} {kind}" for kind, count in sorted(view.faults.items()))
        or "none"
    )
    state = "draining" if view.draining else "serves" if view.warm else "starting"
    program = f"zswarm {view.program}, process {view.pid}, since {since}"
    _pair(view.server, f"{state}, realm {view.realm}, {program}")
    _pair("listens", ", ".join(view.listen) or "not yet")
    _pair("slots", f"{sum(view.slots.values())}: {states}; {view.slot_memory_mb} MB each")
    for missing in view.missed:
        _pair("", f"slot {missing.slot}: {missing.reason}")
    busy = f"slots were busy for {view.busy_s:.1f} s"
    _pair("trials", f"{view.trials} in all, {view.trials_per_s:.1f} a second; {busy}")
    _pair("faults", f"{faults}; {view.malformed} malformed messages")
    if not view.leases:
        _pair("leases", "none")
        return
    table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False)
    for column in ("user", "run", "simulator"):
        table.add_column(column, overflow="fold")
    for column in ("slots", "trials", "for"):
        table.add_column(column, overflow="fold", justify="right")
    for lease in view.leases:
        cells = (lease.user, lease.run, lease.simulator, lease.slots, lease.trials)
        table.add_row(
            *(Text(clean(str(cell))) for cell in cells), Text(duration(lease.seconds))
        )
    _print("")
    console().print(table)


def _pair(title: str, text: str) -> None:
    """Print a title and a text that is wrapped under itself."""
    first = f"{title:10}" if len(title) < 10 else f"{title}  "
    wrapper = textwrap.TextWrapper(
        max(40, console().width),
        subsequent_indent=" " * 10,
        break_on_hyphens=False,
        break_long_words=False,
    )
    _print(wrapper.fill(first + clean(text)))


def _print(text: str) -> None:
    console().print(Text(text), soft_wrap=True)
