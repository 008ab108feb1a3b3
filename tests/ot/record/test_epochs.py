"""A run that several versions of the code computed says so."""

from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner

import zswarm
from zswarm.ot import evolution, run
from zswarm.ot.analysis import curves
from zswarm.ot.analysis.caveats import caveats
from zswarm.ot.commands import list as listing
from zswarm.ot.identity import change, here
from zswarm.ot.logger import Logger
from zswarm.ot.record import epochs
from zswarm.ot.record.epochs import Epoch, decoded, mark


def epoch(generation: int, digit: str = "a", **versions: str) -> Epoch:
    known = {"Python": "3.11.7", "numpy": "2.4.6", "code of zswarm": digit} | versions
    return Epoch(
        generation=generation, version_hash=digit * 32, versions=known, machine="m"
    )


def test_a_run_of_one_version_has_no_mark() -> None:
    assert mark([], 5) == ""
    assert mark([epoch(0), epoch(3), epoch(7)], 9) == ""
    # Nothing was finished by the other one.
    assert mark([epoch(0), epoch(3, "b"), epoch(3)], 9) == ""
    assert mark([epoch(0), epoch(9, "b")], 9) == ""


def test_the_mark_names_generations_and_versions_that_differ() -> None:
    old, new = epoch(0), epoch(13, "b", Python="3.12.1")
    assert mark([old, epoch(4), new], 20) == (
        "computed by 2 versions: generations 1-13 by aaaaaaaa (Python 3.11.7), "
        "14-20 by bbbbbbbb (Python 3.12.1)"
    )
    assert mark([old, epoch(2, "b"), epoch(3)], 4) == (
        "computed by 2 versions: generations 1-2 by aaaaaaaa, 3-3 by bbbbbbbb, "
        "4-4 by aaaaaaaa"
    )


def test_generations_that_a_run_went_back_from_do_not_count() -> None:
    found = [epoch(0), epoch(10, "b")]
    assert mark(found, 5) == ""
    assert mark([*found, epoch(5, "c")], 9) == (
        "computed by 2 versions: generations 1-5 by aaaaaaaa, 6-9 by cccccccc"
    )


def test_texts_from_elsewhere_are_checked_and_made_safe() -> None:
    """A record may be damaged, or made to deceive."""
    evil = epoch(1, "b", Python="\x1b[31m3")
    texts = [None, "", "{}", "[", '{"generation": "x"}', epoch(0).text, evil.text]
    found = decoded(texts)
    assert found == [epoch(0), evil]
    assert "\x1b" not in mark(found, 5)
    assert "\x1b" not in change(epoch(0), evil, portable=True)


def test_a_change_is_described_by_what_differs() -> None:
    before, now = epoch(0), epoch(3, "b", Python="3.12.1")
    text = "Python 3.12.1 here, 3.11.7 there; other code of zswarm"
    assert change(before, now, portable=True) == text
    assert change(before, epoch(3), portable=False) == ""
    packages = epoch(0, ribs="0.8.0"), epoch(3, ribs="0.12.0")
    assert change(*packages, portable=True) == ""
    assert change(*packages, portable=False) == "ribs 0.12.0 here, 0.8.0 there"


class Heard(Logger):
    """Keep what is said."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def on_say(self, text: str) -> None:
        self.lines.append(text)


def test_a_run_that_is_resumed_by_another_version_is_marked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = zswarm.load("stadium", {"generations": 4, "optimizer.population": 10})

    def older(complete: zswarm.Experiment, generation: int) -> Epoch:
        now = here(complete, generation)
        versions = now.versions | {"Python": "3.10.1"}
        return msgspec.structs.replace(now, version_hash="0" * 32, versions=versions)

    heard, (first, second) = Heard(), ("1-2 by 00000000 (Python 3.10.1)", "3-4 by ")
    with zswarm.connect(local_slots=1) as connection:
        with monkeypatch.context() as patched:
            patched.setattr(run, "here", older)
            with zswarm.start(small, connection=connection, out=tmp_path) as started:
                for generation in started:
                    if generation.generation == 1:
                        break
        with evolution.resume(started.folder, connection, heard) as resumed:
            resumed.finish()
    (line,) = [line for line in heard.lines if "was changed" in line]
    assert heard.lines.index(line) == 0, "it is said before anything is computed"
    assert "before generation 3: Python 3." in line
    assert "here, 3.10.1 there" in line
    one, other = epochs.epochs(resumed.run)
    assert (one.generation, other.generation) == (0, 2)
    assert other == here(resumed.run.experiment, 2)
    shown = [
        *caveats(resumed.run),
        *curves.load({"all": [resumed.run]})[1],
        CliRunner().invoke(listing.command, [str(tmp_path)]).output,
    ]
    assert len(shown) == 3
    for text in (" ".join(text.split()) for text in shown):
        assert f"computed by 2 versions: generations {first}, {second}" in text
