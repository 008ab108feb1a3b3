"""Hidden folders cannot be read, and all else can."""

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from multiprocessing import get_context
from pathlib import Path

import pytest

from zswarm.system import landlock


@pytest.fixture
def folder() -> Iterator[Path]:
    """Make a folder that is below none in which everyone writes."""
    made = Path(tempfile.mkdtemp(prefix="zs-", dir=Path.home()))
    if landlock._is_shared(made):
        pytest.skip("everyone may write in a folder above the home")
    (made / "keys").mkdir()
    (made / "keys" / "key.pem").write_text("secret")
    (made / "other").write_text("free")
    yield made
    shutil.rmtree(made)


def inside(test: Callable[[], None]) -> int | None:
    """Return the exit code of a forked process that runs a test: what is hidden is for good."""
    process = get_context("fork").Process(target=test)
    process.start()
    process.join(60.0)
    return process.exitcode


needs_landlock = pytest.mark.skipif(
    not landlock.supported(), reason="no Landlock in this kernel"
)


@needs_landlock
def test_hidden_files_cannot_be_read_by_any_name_and_all_others_can(folder: Path) -> None:
    (folder / "link").symlink_to("keys")
    key = folder / "keys" / "key.pem"

    def test() -> None:
        assert landlock.hide([folder / "keys", folder / "nowhere"])
        for path in (key, folder / "link" / "key.pem"):
            with pytest.raises(PermissionError):
                path.read_text()
        with pytest.raises(PermissionError):
            Path(f"/proc/{os.getppid()}/root{key}").read_text()
        assert os.system(f"cat {key} 2>/dev/null") != 0  # noqa: S605  a child of it
        with tempfile.TemporaryDirectory() as free:
            with pytest.raises(OSError, match="cross-device"):
                os.link(key, f"{free}/key.pem")
            Path(free, "new").write_text("new")
            assert Path(free, "new").read_text() == "new"
        (folder / "keys").rename(folder / "moved")
        with pytest.raises(PermissionError):
            (folder / "moved" / "key.pem").read_text()
        assert (folder / "other").read_text() == "free"
        assert os.listdir("/etc")

    assert inside(test) == 0
    assert (folder / "moved" / "key.pem").read_text() == "secret"


def test_nothing_is_hidden_where_everyone_makes_files(tmp_path: Path) -> None:
    """There, new files must be readable: temporary ones of simulators."""
    (tmp_path / "key.pem").write_text("secret")

    def test() -> None:
        assert landlock._is_shared(tmp_path) != landlock.hide([tmp_path])
        assert landlock._is_shared(tmp_path) == os.access(tmp_path, os.R_OK)

    if landlock._is_shared(tmp_path):
        assert inside(test) == 0


def test_what_does_not_exist_needs_no_hiding(tmp_path: Path) -> None:
    assert landlock.hide([tmp_path / "nowhere"])


@needs_landlock
def test_folders_that_can_be_hidden_have_no_reason_why_not(folder: Path) -> None:
    assert landlock.why_not([folder / "keys", folder / "nowhere"]) == ""


def test_why_folders_are_not_hidden_is_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys = folder / "keys"
    folder.chmod(0o777)
    assert landlock.why_not([keys]) == f"everyone may write in a folder above {keys}"
    monkeypatch.setattr(landlock, "_call", lambda *_: -1)  # as an old kernel answers
    assert "this kernel has no Landlock" in landlock.why_not([keys])
    assert not landlock.hide([keys])
    assert landlock.why_not([folder / "nowhere"]) == "", "there is nothing to hide"
