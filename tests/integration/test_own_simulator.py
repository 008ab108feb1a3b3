"""A simulator as docs/own-simulator.md begins it, installed by pip, on a real server."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.integration.programs import Optimizer, Server, query

pytestmark = pytest.mark.programs

FEW = ["--set", "generations=2", "--set", "optimizer.population=6"]
APART_M = 0.05


def install(folder: Path, *option: str) -> str:
    """Install by pip or uv, as this environment was made; return the PYTHONPATH to use."""
    new = Optimizer(folder, "new", ["new", "simulator", "lost-robots", *option])
    assert new.wait() == 0, new.err.read_text()
    pip = (
        [sys.executable, "-m", "pip", "--disable-pip-version-check"]
        if importlib.util.find_spec("pip")
        else ["uv", "pip"]
    )
    options = [
        "--quiet",
        "--no-deps",
        "--no-index",
        "--no-build-isolation",
        "--target",
        str(folder / "target"),
    ]
    environment = os.environ | {"VIRTUAL_ENV": sys.prefix}
    subprocess.run(
        [*pip, "install", *options, str(folder / "lost-robots")],
        check=True,
        env=environment,
    )
    assert not list((folder / "target").glob("test_*")), (
        "a test is no part of the package"
    )
    return os.pathsep.join([str(folder / "target"), os.environ.get("PYTHONPATH", "")])


@pytest.mark.parametrize("option", [[], ["--compiled"]], ids=["plain", "compiled"])
@pytest.mark.parametrize(
    "changes", [FEW, pytest.param([], marks=pytest.mark.long)], ids=["few", "whole"]
)
def test_the_example_is_installed_and_evolves_on_a_server(
    changes: list[str], option: list[str], tmp_path: Path
) -> None:
    """The whole experiment comes as far as its comment says."""
    environment = {
        "PYTHONPATH": install(tmp_path, *option),
        **({"ZSWARM_PLAIN": "1"} if changes else {}),
    }
    server = Server(tmp_path, "ss", **environment).ready()
    try:
        options = [
            "--json",
            "--no-multicast",
            "--servers",
            "1",
            "--connect",
            server.endpoint,
            *changes,
        ]
        done = Optimizer(
            tmp_path,
            "ot",
            ["run", "lost-robots/lost-robots.toml", *options],
            **environment,
        ).done()
    finally:
        server.close()
    run = tmp_path / "runs" / "lost-robots"
    assert done["evaluations"] > 6
    assert query(
        run, "SELECT count(*) FROM events WHERE event IN ('fault', 'simulator_raised')"
    ) == [(0,)]
    if not changes:
        unseen = Optimizer(
            tmp_path, "unseen", ["evaluate", str(run), "--json"], **environment
        )
        assert unseen.wait() == 0
        assert -APART_M < unseen.lines()[0]["mean"] < 0.0


def test_the_tests_of_a_compiled_simulator_compile_it_and_pass(tmp_path: Path) -> None:
    """In a folder of its own, as they are run by who made it."""
    environment = {"PYTHONPATH": install(tmp_path, "--compiled"), "ZSWARM_PLAIN": ""}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-W", "error", "-q", "-s"],
        cwd=tmp_path / "lost-robots",
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "2 passed" in done.stdout
    assert "agent-steps/s" in done.stdout
