"""CSV that holds texts as texts."""

import csv
import io
import os
from pathlib import Path

import pytest

from zswarm.errors import ConfigError
from zswarm.ot.analysis import csv as spreadsheet


@pytest.mark.parametrize(
    "text",
    # The last is a fullwidth =.
    ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1", "\n=1", "\uff1d1"],
)
def test_no_text_can_become_a_formula(text: str) -> None:
    """It begins with a quote, or with what a control character is shown as."""
    (row,) = csv.reader(
        io.StringIO(spreadsheet.to_csv(["a"], [[text]]).partition("\n")[2])
    )
    assert row[0][0] in "'\\"


def test_texts_are_quoted_numbers_are_not_and_nonfinite_numbers_are_empty() -> None:
    rows = [
        ['x,"y"', 1, -2.5],
        ["", None, float("nan")],
        ["\x1b[31m", True, float("inf")],
    ]
    assert spreadsheet.to_csv(["a", "b", "c"], rows) == (
        '"a","b","c"\n"x,""y""",1,-2.5\n"",,\n"\\x1b[31m",1,\n'
    )


def test_a_link_or_device_is_not_replaced_by_a_file(tmp_path: Path) -> None:
    """Such as /dev/stdout, which is a link to one."""
    file, link, pipe = tmp_path / "table.csv", tmp_path / "link", tmp_path / "pipe"
    link.symlink_to(file)
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        for path in (link, pipe, Path("/dev/null")):
            spreadsheet.save(str(path), ["a"], [[1]])
        assert os.read(reader, 100) == file.read_bytes() == b'"a"\n1\n'
    finally:
        os.close(reader)
    assert link.is_symlink()
    assert pipe.is_fifo()
    assert Path("/dev/null").is_char_device()


def test_a_file_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be written: No such file or directory"):
        spreadsheet.save(str(tmp_path / "none" / "a.csv"), ["a"], [])
