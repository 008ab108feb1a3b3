"""This machine: programs, files, limits and clock."""

import contextlib
import ctypes
import os
import platform
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime, timedelta
from importlib import metadata
from pathlib import Path

import zswarm
from zswarm import jit
from zswarm.errors import KeysError
from zswarm.extras import how
from zswarm.ot import database
from zswarm.ot.doctor.finding import Finding, broken, ok, warning
from zswarm.security import keyring

OLDEST, NEWEST = (3, 11), (3, 14)  # Pythons
IMPORTED = {"eclipse-zenoh": "zenoh", "numba": "numba", "numpy": "numpy", "msgspec": "msgspec", "pymunk": "pymunk"}
IMPORT_S = 60.0
NOT_FOR_USERS = {"dev", "docs", "ot"}  # extras that hold others, or are for those who build zswarm
FREE_MB, LEAST_FREE_MB = 1000, 50
OPEN_FILES = 1024  # a run with hundreds of servers takes as many
SLOT_MB = 512
SKEW_S = 2.0
KEYS_END = timedelta(days=30)
LONGEST_SOCKET = 107  # bytes of a path, Linux
TIME_ERROR = 5  # of adjtimex: not synchronised


def python() -> Iterator[Finding]:
    """Its version, and the system."""
    text = f"zswarm {zswarm.__version__}, Python {platform.python_version()}, {platform.system()} {platform.machine()}"
    if not OLDEST <= sys.version_info[:2] <= NEWEST:
        yield warning("python", text, f"zswarm is tested with Python {_dotted(OLDEST)} to {_dotted(NEWEST)}: use one of these")
    elif sys.platform != "linux":
        yield warning("python", text, "zswarm is tested on Linux only")
    else:
        yield ok("python", text)


def packages() -> Iterator[Finding]:
    """Those that zswarm needs are there, of a version that it can use, and can be imported."""
    wanted = [requirement for requirement in metadata.requires("zswarm") or [] if ";" not in requirement]
    faults = [fault for requirement in wanted if (fault := unmet(requirement))]
    if faults:
        yield broken("packages", "; ".join(faults), f"{sys.executable} -m pip install --upgrade zswarm")
        return
    script = "".join(f"print({name!r}, flush=True); import {name}\n" for name in IMPORTED.values())
    try:
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=IMPORT_S, check=False)
    except subprocess.TimeoutExpired:
        yield broken("packages", f"importing them takes more than {IMPORT_S:g} s", "look at the disk that Python is installed on")
        return
    if done.returncode:
        last = (done.stdout.split() or ["python"])[-1]
        why = (done.stderr.strip().splitlines() or [f"the process ended with {done.returncode}"])[-1]
        yield broken("packages", f"{last} cannot be imported: {why}", f"{sys.executable} -m pip install --force-reinstall {last}")
        return
    yield ok("packages", ", ".join(f"{name} {metadata.version(package)}" for package, name in IMPORTED.items()))


def unmet(requirement: str) -> str:
    """Why a requirement such as ``numpy>=2.0`` is not met; "" when it is."""
    name, bounds = re.fullmatch(r"([\w.-]+)(.*)", requirement.partition(";")[0].strip()).groups()  # type: ignore[union-attr]
    try:
        found = metadata.version(name)
    except metadata.PackageNotFoundError:
        return f"{name} is not installed"
    for relation, bound in re.findall(r"([<>]=?)\s*([\d.]+)", bounds):
        has, limit = _numbers(found), _numbers(bound)
        if not {">=": has >= limit, "<=": has <= limit, ">": has > limit, "<": has < limit}[relation]:
            return f"{name} {found} is installed; expected {bounds.strip()}"
    return ""


def extras() -> Iterator[Finding]:
    """Which of the optional packages are there."""
    wanted: dict[str, list[str]] = {}
    for requirement in metadata.requires("zswarm") or []:
        if found := re.search(r"extra == ['\"]([\w-]+)['\"]", requirement):
            wanted.setdefault(found[1], []).append(requirement)
    there = {extra: not any(map(unmet, needed)) for extra, needed in sorted(wanted.items()) if extra not in NOT_FOR_USERS}
    parts = [
        f"{verb} {', '.join(names)}"
        for verb, names in (
            ("installed:", [extra for extra, has in there.items() if has]),
            ("not installed:", [extra for extra, has in there.items() if not has]),
        )
        if names
    ]
    hint = "" if all(there.values()) else f"; get these with: {how(*(extra for extra, has in there.items() if not has))}"
    yield ok("extras", "; ".join(parts) + hint)


def cores() -> Iterator[Finding]:
    """How many simulations run at a time here, and what memory each has."""
    count, memory = os.cpu_count() or 1, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") >> 20
    text = f"{count} cores, {memory / 1024:.1f} GB of memory: {memory // count} MB for each of this machine's slots"
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else count
    if memory // count < SLOT_MB:
        yield warning("cores", text, f"use fewer slots: --set cluster.local_slots={max(1, memory // SLOT_MB)}")
    elif usable < count:
        yield warning("cores", f"{text}; this program may use {usable}", f"use as many slots: --set cluster.local_slots={usable}")
    else:
        yield ok("cores", text)


def limits() -> Iterator[Finding]:
    """Files that may be open."""
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    if hard != resource.RLIM_INFINITY and hard < OPEN_FILES:
        yield warning("limits", f"at most {hard} open files: not enough for hundreds of servers", f"ulimit -Hn {8 * OPEN_FILES}")
    else:
        yield ok("limits", f"{'any number of' if hard == resource.RLIM_INFINITY else hard} open files")


def runs(out: Path) -> Iterator[Finding]:
    """The folder of runs: it can be written, has room, is on this machine, and its clock is ours."""
    folder = existing(out)
    name = "this folder" if folder == Path() else str(folder)
    where = str(out) if folder == out else f"{out} (to be made in {name})"
    try:
        skew = written_skew(folder)
    except OSError as error:
        yield broken("runs", f"{where} cannot be written: {error.strerror}", "go to another folder, or name one: --out DIR")
        return
    free = shutil.disk_usage(folder).free >> 20
    if free < LEAST_FREE_MB:
        yield broken("runs", f"{where}: only {free} MB are free", "make room, or name another folder: --out DIR")
    elif free < FREE_MB:
        yield warning("runs", f"{where}: only {free} MB are free", "make room; zswarm-ot check says what an experiment takes")
    else:
        yield ok("runs", f"{where} can be written; {free / 1024:.0f} GB are free")
    if database.on_network(folder):
        yield warning(
            "runs",
            f"{where} is on a network file system: records are kept safely, but more slowly",
            "evolve on a local disk (--out DIR), and copy the run afterwards",
        )
    if abs(skew) > SKEW_S:
        yield warning(
            "runs", f"the clock of this disk is {skew:+.0f} s from this machine's", "synchronise the file server's clock (NTP)"
        )


def existing(folder: Path) -> Path:
    """The folder itself, or the nearest above it that is there."""
    while not folder.exists() and folder.parent != folder:
        folder = folder.parent
    return folder


def written_skew(folder: Path) -> float:
    """Seconds by which the date of a file that is written there now differs from this machine's clock.

    Raises:
        OSError: it cannot be written.
    """
    with tempfile.NamedTemporaryFile(dir=folder, prefix=".zswarm-") as probe:
        probe.write(b"x" * 4096)
        probe.flush()
        os.fsync(probe.fileno())
        return os.fstat(probe.fileno()).st_mtime - time.time()


def cache() -> Iterator[Finding]:
    """The compiled kernels."""
    folder = jit.cache_folder()
    if folder.name.startswith("zswarm-") and folder.parent == Path(tempfile.gettempdir()):  # made for this program alone
        with contextlib.suppress(OSError):
            folder.rmdir()
        yield warning(
            "cache",
            "no folder for compiled kernels can be written: every program compiles them again",
            "set ZSWARM_CACHE to a folder of your own",
        )
        return
    compiled = "compiled" if any(folder.rglob("*.nbc")) else "not compiled yet, the first run takes some seconds longer"
    text = f"{folder.parent}: kernels are {compiled}"
    if database.on_network(folder):
        yield warning("cache", f"{text}; on a network file system, which makes starts slow", "set ZSWARM_CACHE to a local folder")
    else:
        yield ok("cache", text)


def temporary() -> Iterator[Finding]:
    """Sockets of this machine's slots are made in the temporary folder."""
    folder = Path(tempfile.gettempdir())
    longest = len(os.fsencode(folder / "zswarm-12345678" / "ss.sock"))
    if longest > LONGEST_SOCKET:
        yield broken("temporary", f"{folder}: the path is too long for a socket", "set TMPDIR to a shorter one, such as /tmp")
        return
    try:
        written_skew(folder)
    except OSError as error:
        yield broken("temporary", f"{folder} cannot be written: {error.strerror}", "set TMPDIR to a folder that can")
    else:
        yield ok("temporary", f"{folder} can be written")


def keys() -> Iterator[Finding]:
    """The installed keys."""
    folder = keyring.find()
    if folder is None:
        yield ok("keys", "none are installed: links are open to everybody in the network (docs/keys.md)")
        return
    try:
        ring = keyring.load(folder, "ot")
    except KeysError as error:
        yield broken("keys", str(error), "zswarm-keys status says what is installed; ZSWARM_KEYS=none goes without keys")
        return
    left = ring.not_after - datetime.now(UTC)
    text = f"{folder}: keys of {ring.name}, valid until {ring.not_after:%Y-%m-%d}"
    if left < KEYS_END:
        yield warning("keys", text, f"where the authority is: zswarm-keys renew {ring.name}")
    else:
        yield ok("keys", text)


def clock() -> Iterator[Finding]:
    """It is not far off, and kept right."""
    installed = Path(__file__).stat().st_mtime
    now = time.time()
    text = f"{time.strftime('%Y-%m-%d %H:%M %Z')}"
    if now < installed - 86_400:
        yield broken("clock", f"{text} is before zswarm was installed", "set the clock: sudo timedatectl set-ntp true")
    elif synchronised() is False:
        yield warning("clock", f"{text}, not synchronised: dates of runs and keys may be wrong", "sudo timedatectl set-ntp true")
    else:
        yield ok("clock", text)


def synchronised() -> bool | None:
    """Whether the kernel says that something keeps the clock right; None: it does not tell."""
    try:
        adjtimex = ctypes.CDLL(None).adjtimex
    except (OSError, AttributeError):
        return None
    state = adjtimex(ctypes.create_string_buffer(1024))  # of zeros: set nothing
    return None if state < 0 else state != TIME_ERROR


def _numbers(version: str) -> tuple[int, ...]:
    found = re.match(r"\d+(\.\d+)*", version)
    numbers = [int(part) for part in found[0].split(".")] if found else []
    while numbers and not numbers[-1]:
        numbers.pop()  # 2.0 is 2
    return tuple(numbers)


def _dotted(numbers: Iterable[int]) -> str:
    return ".".join(map(str, numbers))
