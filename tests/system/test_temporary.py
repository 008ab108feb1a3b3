"""Temporary folders that killed programs have left."""

import fcntl
import os
from pathlib import Path

from zswarm.system.temporary import PREFIX, LockedFolder, remove_orphans


def left(parent: Path, name: str, age_s: float = 3600.0) -> Path:
    folder = parent / f"{PREFIX}{name}"
    folder.mkdir()
    (folder / "log").write_text("words")
    before = folder.stat().st_mtime - age_s
    os.utime(folder, (before, before))
    return folder


def test_folders_of_killed_programs_are_removed_and_those_of_others_stay(
    tmp_path: Path,
) -> None:
    killed, living = left(tmp_path, "killed"), left(tmp_path, "living")
    young = left(tmp_path, "young", 0.0)
    other = tmp_path / "zswarm-other"
    other.mkdir()
    linked = tmp_path / f"{PREFIX}link"
    linked.symlink_to(other)
    lock = os.open(living, os.O_RDONLY)
    fcntl.flock(lock, fcntl.LOCK_EX)
    remove_orphans(tmp_path)
    os.close(lock)
    assert not killed.exists()
    assert all(folder.exists() for folder in (living, young, other, linked))
    remove_orphans(tmp_path)
    assert not living.exists(), "its program has ended"


def test_a_folder_is_removed_at_its_end_and_locked_until_then() -> None:
    with LockedFolder() as folder:
        (folder.path / "inside").write_text("words")
        before = folder.path.stat().st_mtime - 3600.0
        os.utime(folder.path, (before, before))
        remove_orphans(folder.path.parent)
        assert (folder.path / "inside").exists()
    assert not folder.path.exists()
