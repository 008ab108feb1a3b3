"""Tags and notes are kept in a run's folder, and are safe to show."""

from pathlib import Path

import pytest

from zswarm.errors import ConfigError
from zswarm.ot.record import annotations
from zswarm.ot.record.annotations import Annotations


def test_tags_and_a_note_survive(tmp_path: Path) -> None:
    long = " word" * 1000
    given = Annotations(
        tags=["paper", " draft ", "paper"], note=f' "a"\n\tb\\ = 1{long}\n'
    )
    annotations.save(tmp_path, given)
    found = annotations.load(tmp_path)
    assert found == Annotations(tags=["draft", "paper"], note=f'"a"\n    b\\ = 1{long}')
    annotations.save(tmp_path, found)
    assert annotations.load(tmp_path) == found


@pytest.mark.parametrize("tag", ["", " ", "a,b", "a\nb", "\u202e", "x" * 41])
def test_an_impossible_tag_is_refused_and_nothing_is_written(
    tmp_path: Path, tag: str
) -> None:
    with pytest.raises(ConfigError, match="expected 1 to 40 printable characters"):
        annotations.save(tmp_path, Annotations(tags=[tag]))
    with pytest.raises(ConfigError, match="51 tags; expected 50 at most"):
        annotations.save(tmp_path, Annotations(tags=[str(n) for n in range(51)]))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"tags = 1", "tags: expected array"),
        (b"tag = []", "unknown key 'tag'"),
        (b"\xff", "not TOML"),
        (b"#" * ((1 << 16) + 1), "65,537 bytes; expected 65,536 at most"),
    ],
)
def test_a_file_that_cannot_be_used_says_why_where_its_note_would_be(
    tmp_path: Path, content: bytes, why: str
) -> None:
    (tmp_path / "notes.toml").write_bytes(content)
    assert why in annotations.shown(tmp_path)["note"]


def test_what_somebody_else_wrote_is_safe_to_show(tmp_path: Path) -> None:
    (tmp_path / "notes.toml").write_text('note = "a\\u001b[31m\\u202eb\\nc"')
    assert annotations.load(tmp_path).note == "a\\x1b[31m\\x202eb\nc"
