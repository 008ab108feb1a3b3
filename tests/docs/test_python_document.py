"""The code in docs/python.md runs, from its first block to its last."""

import re
from pathlib import Path
from typing import Any

import pytest

import zswarm
from tests.repository import REPOSITORY
from zswarm import errors

TEXT = (REPOSITORY / "docs" / "python.md").read_text(encoding="utf-8")


@pytest.mark.docs
def test_the_code_of_the_document_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, Any] = {}
    blocks = re.findall(r"^```python\n(.*?)^```", TEXT, re.S | re.M)
    assert len(blocks) == 10
    for number, block in enumerate(blocks):
        exec(compile(block, f"block {number + 1}", "exec"), namespace)  # noqa: S102  our own text
    printed = capsys.readouterr().out
    assert "\nTrue\n" in printed, "the resumed run has another history"
    assert (tmp_path / "stadium.pdf").read_bytes().startswith(b"%PDF")
    assert (tmp_path / "seeds.svg").is_file()
    (log,) = (tmp_path / "runs").glob("*/log.csv")
    assert len(log.read_text().splitlines()) == 5


def test_every_public_function_logger_call_and_error_is_in_the_document() -> None:
    """Types that they take and give are in their docstrings."""
    functions = [name for name in zswarm.__all__ if name[0].islower()]
    calls = [name for name in vars(zswarm.Logger) if name.startswith("on_")]
    for name in (*functions, *calls):
        assert re.search(rf"\b{name}\b", TEXT), name
    public = {
        name for name in zswarm.__all__ if issubclass_of_error(getattr(zswarm, name))
    }
    assert public == set(re.findall(r"`(?:zswarm\.)?(\w+)`", TEXT)) & set(
        vars(errors)
    ) | {"ZswarmError"}


def issubclass_of_error(value: Any) -> bool:
    return isinstance(value, type) and issubclass(value, errors.ZswarmError)
