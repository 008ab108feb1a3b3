"""The notebook in examples/python runs from top to bottom, with real kernel and servers."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.repository import REPOSITORY

NOTEBOOK = REPOSITORY / "examples" / "python" / "first_steps.ipynb"
EXECUTE = """
import sys, nbclient, nbformat
notebook = nbformat.read(sys.argv[1], as_version=4)
nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3").execute()
nbformat.write(notebook, "executed.ipynb")
"""


def code(notebook: dict[str, Any]) -> list[dict[str, Any]]:
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def processes_with(text: str) -> list[str]:
    """Return the command lines of this user's processes whose environment contains a text."""
    found = []
    for folder in Path("/proc").iterdir():
        try:
            if (
                folder.name.isdigit()
                and text.encode() in (folder / "environ").read_bytes()
            ):
                found.append((folder / "cmdline").read_text())
        except OSError:
            continue
    return found


def test_the_stored_notebook_has_no_outputs() -> None:
    """A change of the notebook can then be read."""
    for cell in code(json.loads(NOTEBOOK.read_text(encoding="utf-8"))):
        assert (cell["outputs"], cell["execution_count"], cell["metadata"]) == (
            [],
            None,
            {},
        )


@pytest.fixture(scope="module")
def executed(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """Return the cells of code with their outputs."""
    folder = tmp_path_factory.mktemp("notebook")
    private = {
        name: str(folder / name)
        for name in (
            "IPYTHONDIR",
            "JUPYTER_RUNTIME_DIR",
            "JUPYTER_CONFIG_DIR",
            "JUPYTER_DATA_DIR",
        )
    }
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", EXECUTE, str(NOTEBOOK)],
        cwd=folder,
        env=os.environ | private,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert processes_with(str(folder)) == []
    return code(json.loads((folder / "executed.ipynb").read_text(encoding="utf-8")))


@pytest.mark.docs
def test_every_cell_runs_without_a_warning(executed: list[dict[str, Any]]) -> None:
    kinds = [output["output_type"] for cell in executed for output in cell["outputs"]]
    assert "error" not in kinds
    assert [
        output["text"]
        for cell in executed
        for output in cell["outputs"]
        if output.get("name") == "stderr"
    ] == []


@pytest.mark.docs
def test_the_notebook_shows_curves_tables_and_progress(
    executed: list[dict[str, Any]],
) -> None:
    shown = [
        (number, kind, "".join(content))
        for number, cell in enumerate(executed)
        for output in cell["outputs"]
        for kind, content in output.get("data", {}).items()
    ]
    curves = [
        number
        for number, kind, content in shown
        if kind == "image/svg+xml" and "<svg" in content
    ]
    assert curves == [1, 4]
    summaries = [content for _, kind, content in shown if kind == "text/html"]
    assert "30 of 60, stopped" in summaries[0]
    assert "60 of 60, finished" in summaries[1]
    assert any(
        "best fitness" in content and "after 60 generations" in content
        for _, _, content in shown
    ), "progress"
    assert any("diversity_mean" in content for content in summaries)
