"""Checks of this machine: Python, packages, files, limits and clock."""

import contextlib
import ctypes
import os
import platform
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from datetime import UTC, datetime, timedelta
from importlib import metadata
from pathlib import Path

import psutil
from packaging.requirements import Requirement

from zswarm.errors import KeysError
from zswarm.kernels import cache as kernel_cache
from zswarm.ot.doctor.finding import Findings, broken, ok, warning
from zswarm.ot.record import database
from zswarm.security import keyring
from zswarm.system.extras import how, requirements
from zswarm.system.processes import CODE
from zswarm.system.temporary import PREFIX as FOLDER
from zswarm.system.version import VERSION

OLDEST, NEWEST = (3, 11), (3, 14)  # Python versions
IMPORTED = {  # packages with compiled code, and their modules
    "eclipse-zenoh": "zenoh",
    "numba": "numba",
    "numpy": "numpy",
    "msgspec": "msgspec",
    "pymunk": "pymunk",
}
IMPORT_S = 60.0
NOT_FOR_USERS = {"", "dev", "docs", "ot"}  # extras of other extras, or for developers
FREE_MB, LEAST_FREE_MB = 1000, 50
OPEN_FILES = 1024  # of a run with hundreds of servers
SLOT_MB = 512
SKEW_S = 2.0
KEYS_END = timedelta(days=30)
LONGEST_SOCKET = 107  # bytes of a path, Linux
TIME_ERROR = 5  # of adjtimex: not synchronised
PIP = f"{sys.executable} -m pip install"


def python() -> Findings:
    """Check the version of Python, and the system."""
    system = f"{platform.system()} {platform.machine()}"
    text = f"zswarm {VERSION}, Python {platform.python_version()}, {system}"
    if not OLDEST <= sys.version_info[:2] <= NEWEST:
        oldest, newest = (".".join(map(str, version)) for version in (OLDEST, NEWEST))
        yield warning(
            text, f"use Python {oldest} to {newest}, with which zswarm is tested"
        )
    elif sys.platform != "linux":
        yield warning(text, "use Linux: zswarm is tested on no other system")
    else:
        yield ok(text)


def packages() -> Findings:
    """Check that the required packages are installed in usable versions, and can be imported."""
    if faults := list(filter(None, map(unmet, requirements().get("", [])))):
        yield broken("; ".join(faults), f"{PIP} --upgrade zswarm")
        return
    script = "".join(
        f"print({name!r}, flush=True); import {name}\n" for name in IMPORTED.values()
    )
    command = [sys.executable, *CODE, script]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=IMPORT_S, check=False
        )
    except subprocess.TimeoutExpired:
        yield broken(
            f"importing them takes more than {IMPORT_S:g} s",
            "check the disk on which Python is installed",
        )
        return
    if done.returncode:
        last = (done.stdout.split() or ["python"])[-1]
        lines = done.stderr.strip().splitlines() or [
            f"the process ended with {done.returncode}"
        ]
        yield broken(
            f"{last} cannot be imported: {lines[-1]}", f"{PIP} --force-reinstall {last}"
        )
        return
    yield ok(", ".join(f"{name} {metadata.version(of)}" for of, name in IMPORTED.items()))


def unmet(requirement: Requirement) -> str:
    """Return why a requirement is not met; "" if it is."""
    try:
        version = metadata.version(requirement.name)
    except metadata.PackageNotFoundError:
        return f"{requirement.name} is not installed"
    if requirement.specifier.contains(version, prereleases=True):
        return ""
    return f"{requirement.name} {version} is installed; expected {requirement.specifier}"


def extras() -> Findings:
    """List which extras are installed."""
    wanted = sorted(requirements().items())
    installed = {
        extra: not any(map(unmet, needed))
        for extra, needed in wanted
        if extra not in NOT_FOR_USERS
    }
    missing = [extra for extra, there in installed.items() if not there]
    there = [extra for extra in installed if extra not in missing]
    parts = [f"installed: {', '.join(there)}"] if there else []
    if missing:
        parts.append(f"not installed: {', '.join(missing)}")
        parts.append(f"get these with: {how(*missing)}")
    yield ok("; ".join(parts))


def cores() -> Findings:
    """Check how many simulations run at the same time, and their memory."""
    count, memory_mb = os.cpu_count() or 1, psutil.virtual_memory().total >> 20
    each = memory_mb // count
    total = f"{count} cores, {memory_mb / 1024:.1f} GB of memory"
    text = f"{total}: {each} MB for each of this machine's slots"
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else count
    fewer = "use fewer slots: --set cluster.local_slots="
    if each < SLOT_MB:
        yield warning(text, f"{fewer}{max(1, memory_mb // SLOT_MB)}")
    elif usable < count:
        yield warning(f"{text}; this program may use {usable} cores", f"{fewer}{usable}")
    else:
        yield ok(text)


def limits() -> Findings:
    """Check the limit of open files."""
    hard = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    if hard == resource.RLIM_INFINITY:
        yield ok("any number of open files")
    elif hard < OPEN_FILES:
        yield warning(
            f"at most {hard} open files: not enough for hundreds of servers",
            f"ulimit -Hn {8 * OPEN_FILES}",
        )
    else:
        yield ok(f"{hard} open files")


def runs(out: Path) -> Findings:
    """Check that the folder of runs can be written, has room, is local, and has our clock."""
    folder = _existing(out)
    name = "this folder" if folder == Path() else str(folder)
    where = str(out) if folder == out else f"{out} (to be made in {name})"
    try:
        skew = _write_skew(folder)
    except OSError as error:
        yield broken(
            f"{where} cannot be written: {error.strerror}", "use another: --out DIR"
        )
        return
    free = shutil.disk_usage(folder).free >> 20
    space = f"{where}: only {free} MB are free"
    if free < LEAST_FREE_MB:
        yield broken(space, "make room, or use another folder: --out DIR")
    elif free < FREE_MB:
        yield warning(
            space, "make room; zswarm-ot check estimates what an experiment needs"
        )
    else:
        yield ok(f"{where} can be written; {free / 1024:.0f} GB are free")
    if database.on_network(folder):
        yield warning(
            f"{where} is on a network file system: records are safe there, but slower",
            "evolve on a local disk (--out DIR), and copy the run afterwards",
        )
    if abs(skew) > SKEW_S:
        yield warning(
            f"the clock of this disk is {skew:+.0f} s from this machine's",
            "synchronise the file server's clock (NTP)",
        )


def cache() -> Findings:
    """Check the cache of compiled kernels."""
    folder = kernel_cache.cache_folder()
    if folder.name.startswith("zswarm-") and folder.parent == Path(tempfile.gettempdir()):
        with contextlib.suppress(OSError):  # it was created for this process only
            folder.rmdir()
        yield warning(
            "no folder for compiled kernels can be written: every program compiles them again",
            "set ZSWARM_CACHE to a folder of your own",
        )
        return
    compiled = any(folder.rglob("*.nbc"))
    state = (
        "compiled"
        if compiled
        else "not compiled yet, the first run takes some seconds longer"
    )
    text = f"{folder.parent}: kernels are {state}"
    if database.on_network(folder):
        yield warning(
            f"{text}; on a network file system, which slows starts",
            "set ZSWARM_CACHE to a local folder",
        )
    else:
        yield ok(text)


def temporary() -> Findings:
    """Check the temporary folder, in which the sockets of this machine's slots are created."""
    folder = Path(tempfile.gettempdir())
    if len(os.fsencode(folder / f"{FOLDER}12345678" / "ss.sock")) > LONGEST_SOCKET:
        yield broken(
            f"{folder}: the path is too long for a socket",
            "set TMPDIR to a shorter one, such as /tmp",
        )
        return
    try:
        _write_skew(folder)
    except OSError as error:
        yield broken(
            f"{folder} cannot be written: {error.strerror}", "set TMPDIR to another"
        )
    else:
        yield ok(f"{folder} can be written")


def keys() -> Findings:
    """Check the installed keys."""
    folder = keyring.find()
    if folder is None:
        yield ok(
            "none are installed: links are open to everybody in the network (docs/keys.md)"
        )
        return
    try:
        ring = keyring.load(folder, "ot")
    except KeysError as error:
        yield broken(
            str(error),
            "zswarm-keys status shows what is installed; ZSWARM_KEYS=none uses no keys",
        )
        return
    text = f"{folder}: keys of {ring.name}, valid until {ring.not_after:%Y-%m-%d}"
    if ring.not_after - datetime.now(UTC) < KEYS_END:
        yield warning(text, f"on the authority's machine: zswarm-keys renew {ring.name}")
    else:
        yield ok(text)


def clock() -> Findings:
    """Check that the clock is right and synchronised."""
    text = time.strftime("%Y-%m-%d %H:%M %Z")
    fix = "sudo timedatectl set-ntp true"
    if time.time() < Path(__file__).stat().st_mtime - 86_400:
        yield broken(f"{text} is before zswarm was installed", f"set the clock: {fix}")
    elif _synchronised() is False:
        yield warning(
            f"{text}, not synchronised: dates of runs and keys may be wrong", fix
        )
    else:
        yield ok(text)


def _existing(folder: Path) -> Path:
    """Return the folder, or its nearest parent that exists."""
    while not folder.exists() and folder.parent != folder:
        folder = folder.parent
    return folder


def _write_skew(folder: Path) -> float:
    """Write a file, and return its date in seconds from this machine's clock."""
    with tempfile.NamedTemporaryFile(dir=folder, prefix=".zswarm-") as probe:
        probe.write(b"x" * 4096)
        probe.flush()
        os.fsync(probe.fileno())
        return os.fstat(probe.fileno()).st_mtime - time.time()


def _synchronised() -> bool | None:
    """Return whether the kernel reports a synchronised clock, or None."""
    try:
        adjtimex = ctypes.CDLL(None).adjtimex
    except (OSError, AttributeError):
        return None
    state = adjtimex(ctypes.create_string_buffer(1024))  # all zeros: set nothing
    return None if state < 0 else state != TIME_ERROR
