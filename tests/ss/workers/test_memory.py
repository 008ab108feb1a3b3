"""What a slot gets of a machine's memory, and what its process sets for itself."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from zswarm.errors import ConfigError
from zswarm.ss.workers import memory

MACHINE_MB = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") >> 20
MB = 1 << 20


def groups(
    folder: Path, monkeypatch: pytest.MonkeyPatch, membership: str, limits: dict[str, str]
) -> None:
    """Control groups as the kernel shows them, in files."""
    (folder / "membership").write_text(membership)
    for path, limit in limits.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(limit + "\n")
    monkeypatch.setattr(memory, "CGROUPS", folder)
    monkeypatch.setattr(memory, "MEMBERSHIP", folder / "membership")


@pytest.mark.parametrize(
    ("membership", "limits"),
    [
        (
            "0::/system.slice/ss.service\n",
            {"system.slice/ss.service/memory.max": str(4000 * MB)},
        ),
        ("0::/a/b\n", {"a/b/memory.max": "max", "a/memory.max": str(4000 * MB)}),
        ("0::/\n", {"memory.max": str(4000 * MB)}),
        ("0::/gone/in/a/container\n", {"memory.max": str(4000 * MB)}),
        (
            "9:name=systemd:/x\n4:cpu,memory:/a\n0::/\n",
            {"memory/a/memory.limit_in_bytes": str(4000 * MB)},
        ),
        ("4:memory:/gone\n", {"memory/memory.limit_in_bytes": str(4000 * MB)}),
    ],
)
def test_a_slot_gets_its_share_of_the_control_group(
    membership: str,
    limits: dict[str, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    groups(tmp_path, monkeypatch, membership, limits)
    assert memory.per_slot_mb(2) == min(4000, MACHINE_MB) * 8 // 10 // 2
    assert memory.per_slot_mb(1000) == 512


@pytest.mark.parametrize("membership", ["0::/\n", "", "4:memory:/a\n"])
def test_a_slot_gets_its_share_of_the_machine_without_a_lower_group_limit(
    membership: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    groups(
        tmp_path,
        monkeypatch,
        membership,
        {"memory.max": "max", "memory/memory.limit_in_bytes": str(2**63 - 4096)},
    )
    assert abs(memory.per_slot_mb(1) - MACHINE_MB * 8 // 10) <= 1
    (tmp_path / "membership").unlink()
    assert abs(memory.per_slot_mb(1) - MACHINE_MB * 8 // 10) <= 1


def test_a_machine_with_too_little_memory_to_start_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise the fork server would be killed, again and again."""
    groups(tmp_path, monkeypatch, "0::/a\n", {"a/memory.max": str(100 * MB)})
    with pytest.raises(
        ConfigError, match="has 100 MB of memory; expected at least 160 MB"
    ):
        memory.check_machine()
    (tmp_path / "a/memory.max").write_text(str(200 * MB))
    memory.check_machine()


def in_a_child(what: str) -> list[str]:
    """Return the lines that code prints in a fresh process, which has no freed memory to reuse."""
    code = f"from pathlib import Path\nfrom zswarm.ss.workers import memory\nMB = {MB}\n{what}"
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout.splitlines()


def test_a_limit_holds_and_can_be_lifted() -> None:
    before, with_20, refused, limits, lifted = in_a_child(
        """
taken = memory.used()
print(taken)
memory.restrict((taken >> 20) + 50)
small = bytearray(20 * MB)
print(memory.used())
try:
    bytearray(60 * MB)
except MemoryError:
    print("refused")
print(memory.resource.getrlimit(memory.resource.RLIMIT_DATA)[0] < memory.used() + 60 * MB)
memory.lift()
print(len(bytearray(60 * MB)))
"""
    )
    assert int(before) > MB
    assert int(with_20) >= int(before) + 20 * MB
    assert (refused, limits, lifted) == ("refused", "True", str(60 * MB))


def test_a_sandbox_may_refuse_the_limits() -> None:
    tried = in_a_child(
        """
def refuse(*_):
    print("asked")
    raise PermissionError
memory.resource.setrlimit = refuse
memory.OOM_SCORE = Path("/proc/version")
memory.restrict(1)
memory.lift()
memory.go_first()
print(len(bytearray(60 * MB)))
"""
    )
    assert "asked" in tried, "nothing was refused"
    assert tried[-1] == str(60 * MB), "it goes on without a limit"


def test_the_kernel_ends_a_slot_first_without_a_core_file() -> None:
    before, after, cores = in_a_child(
        """
print(memory.OOM_SCORE.read_text().strip())
memory.go_first()
print(memory.OOM_SCORE.read_text().strip())
print(memory.resource.getrlimit(memory.resource.RLIMIT_CORE))
"""
    )
    assert int(after) == min(1000, int(before) + 500)
    assert cores == "(0, 0)"
