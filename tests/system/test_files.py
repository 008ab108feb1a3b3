"""A file is there with all its content or as it was; a private folder is its owner's alone."""

import errno
import os
import stat
from pathlib import Path

import pytest

from zswarm.errors import ConfigError
from zswarm.system.files import make_private, write_whole


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_failed_write_leaves_the_file_unchanged(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No part of the new content remains beside it."""
    write_whole(tmp_path / "x", b"before")

    def failing(opened: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", failing)
    with pytest.raises(OSError, match="No space"):
        write_whole(tmp_path / "x", b"after")
    assert (tmp_path / "x").read_bytes() == b"before"
    assert os.listdir(tmp_path) == ["x"]


def test_a_part_file_of_an_earlier_attempt_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "x.part").write_bytes(b"cut sh")
    (tmp_path / "x.part").chmod(0o644)
    write_whole(tmp_path / "x", b"whole", 0o600)
    assert ((tmp_path / "x").read_bytes(), mode(tmp_path / "x")) == (b"whole", 0o600)
    assert os.listdir(tmp_path) == ["x"]


def test_a_secret_is_never_written_through_a_link(tmp_path: Path) -> None:
    """Whoever may write to the folder cannot have it written elsewhere."""
    (tmp_path / "x.part").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "x").symlink_to(tmp_path / "elsewhere")
    write_whole(tmp_path / "x", b"secret", 0o600)
    assert not (tmp_path / "elsewhere").exists()
    assert not (tmp_path / "x").is_symlink()


def test_a_private_folder_is_created_with_its_parents(tmp_path: Path) -> None:
    make_private(tmp_path / "a" / "b", ["key"])
    assert mode(tmp_path / "a" / "b") == 0o700
    (tmp_path / "a" / "b" / "key").touch()
    (tmp_path / "a" / "b" / "key.part").touch()
    (tmp_path / "a" / "b").chmod(0o755)
    make_private(tmp_path / "a" / "b", ["key"])
    assert mode(tmp_path / "a" / "b") == 0o700


def test_a_folder_with_other_files_is_left_unchanged(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    tmp_path.chmod(0o755)
    with pytest.raises(ConfigError, match=r"holds 'thesis\.tex'"):
        make_private(tmp_path, ["key"])
    assert mode(tmp_path) == 0o755
