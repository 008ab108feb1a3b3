"""Locks and the folder for them: this user's, and through no link."""

from pathlib import Path

import pytest

from zswarm.system import locks


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(tmp_path / "z"))
    return tmp_path / "z"


def test_the_folder_depends_on_the_user_and_the_environment(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It is systemd's, root's, the session's, or one in the temporary folder."""
    found = locks.private_folder
    assert found({"RUNTIME_DIRECTORY": "/run/a:/run/b"}) == Path("/run/a")
    monkeypatch.setattr(locks.os, "geteuid", lambda: 0)
    assert found({"XDG_RUNTIME_DIR": "/run/user/0"}) == Path("/run/zswarm")
    monkeypatch.setattr(locks.os, "geteuid", lambda: 7)
    assert found({"XDG_RUNTIME_DIR": "/run/user/7"}) == Path("/run/user/7/zswarm")
    assert found({}).name == "zswarm-7"


def test_only_one_holds_a_lock(folder: Path) -> None:
    with locks.locked(b"x"):
        with pytest.raises(BlockingIOError):
            locks.locked(b"x")
        locks.locked(b"y").close()
    locks.locked(b"x").close()


def test_a_link_is_not_followed_and_its_target_is_untouched(folder: Path) -> None:
    locks.locked(b"x").close()
    (path,) = folder.iterdir()
    path.unlink()
    target = folder.parent / "victim"
    target.write_text("mine")
    path.symlink_to(target)
    with pytest.raises(OSError, match="symbolic links"):
        locks.locked(b"x")
    assert target.read_text() == "mine"


def test_a_folder_in_which_others_write_is_refused(folder: Path) -> None:
    folder.mkdir()
    folder.chmod(0o777)
    with pytest.raises(PermissionError, match="others can write in it"):
        locks.locked(b"x")
    assert not list(folder.iterdir())
