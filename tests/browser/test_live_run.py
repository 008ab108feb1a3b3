"""A real run on real servers, one of which is killed: the pages show it."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.browser.conftest import Dashboard
from tests.integration import asleep
from tests.integration.programs import free_port

pytestmark = pytest.mark.browser

SLOW_MS = 60_000  # that a program may take to start, and a server to get ready


def wait_until_somebody_listens(port: int) -> None:
    """Wait until a program listens at the port, however busy the machine is."""
    end = time.monotonic() + SLOW_MS / 1000
    while time.monotonic() < end:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.01)
    raise AssertionError(f"nobody listens at {port}")


@pytest.fixture
def experiment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Write one whose trials sleep: the machine is needed for the browser."""
    for name, value in asleep.installed(tmp_path).items():
        monkeypatch.setenv(name, value)
    return asleep.write(tmp_path, "shown")


@pytest.fixture
def program(
    tmp_path: Path,
    experiment: str,  # for its environment
) -> Iterator[Callable[..., "subprocess.Popen[Any]"]]:
    """Start programs, which end with the test."""
    begun: list[subprocess.Popen[Any]] = []

    def start(*arguments: str) -> "subprocess.Popen[Any]":
        with (tmp_path / f"program-{len(begun)}.log").open("wb") as log:
            begun.append(
                subprocess.Popen(
                    [sys.executable, "-m", *arguments],
                    stdin=subprocess.DEVNULL,
                    stderr=log,
                    stdout=log,
                    cwd=tmp_path,
                )
            )
        return begun[-1]

    yield start
    for one in begun:
        one.terminate()
    for one in begun:
        one.wait(60)


def test_a_killed_server_disappears_and_the_run_continues(
    page: Page,
    dashboard: Callable[..., Dashboard],
    program: Callable[..., "subprocess.Popen[Any]"],
    experiment: str,
    tmp_path: Path,
) -> None:
    """The run stops when the page says so, and it is shown again when it is resumed."""
    ports = [free_port(), free_port()]

    def serve(name: str, port: int) -> "subprocess.Popen[Any]":
        return program(
            "zswarm.ss",
            "--name",
            name,
            "--capacity",
            "1",
            "--no-multicast",
            "--listen",
            f"tcp/127.0.0.1:{port}",
        )

    near, far = serve("near", ports[0]), serve("far", ports[1])
    for port in ports:
        wait_until_somebody_listens(port)
    reach = [
        "--no-multicast",
        *(word for port in ports for word in ("--connect", f"tcp/127.0.0.1:{port}")),
    ]
    run = program(
        "zswarm.ot",
        "run",
        experiment,
        "--servers",
        "2",
        "--set",
        "generations=1000000",
        "--out",
        str(tmp_path / "runs"),
        *reach,
    )
    shown = dashboard(tmp_path)
    page.goto(f"{shown.url}/#token={shown.token}")
    page.get_by_role("link", name="shown").click(timeout=SLOW_MS)
    expect(page.locator(".badge")).to_contain_text("running", timeout=SLOW_MS)
    page.get_by_role("link", name="Servers").click(timeout=SLOW_MS)
    rows = {
        name: page.locator(
            "#servers tbody tr", has_text=re.compile(f"{name}-[0-9a-f]{{8}}")
        )
        for name in ("near", "far")
    }
    for row in rows.values():
        expect(row.first).to_contain_text("computing", timeout=SLOW_MS)

    far.send_signal(signal.SIGKILL)
    expect(rows["far"]).to_contain_text(re.compile("left|lost"), timeout=SLOW_MS)
    expect(rows["near"]).to_contain_text("computing")
    far = serve("far", ports[1])
    # It is another one: the old one stays in the table as lost.
    expect(rows["far"]).to_have_count(2, timeout=SLOW_MS)
    expect(page.locator("#servers tbody tr", has_text="computing")).to_have_count(
        2, timeout=SLOW_MS
    )

    page.get_by_role("link", name="Run", exact=True).click()
    expect(
        page.locator(".log li", has_text=re.compile("server lost|server left")).first
    ).to_be_visible()
    expect(page.locator(".tile", has_text="slots")).to_contain_text("2")
    page.get_by_role("button", name="Stop after this generation").click()
    expect(page.locator(".badge")).to_contain_text("stopped", timeout=SLOW_MS)
    assert run.wait(60) == 1
    page.evaluate("() => { window.same = true }")
    program("zswarm.ot", "resume", str(tmp_path / "runs" / "shown"), *reach)
    expect(page.locator(".badge")).to_contain_text("running", timeout=SLOW_MS)
    expect(page.locator(".log li", has_text="began (1)")).to_be_visible(timeout=SLOW_MS)
    assert page.evaluate("() => window.same"), "the page was not loaded anew"
    assert near.poll() is None
    assert os.listdir(tmp_path / "runs") == ["shown"]


def test_a_running_run_is_shown_live(
    page: Page,
    program: Callable[..., "subprocess.Popen[Any]"],
    experiment: str,
    tmp_path: Path,
) -> None:
    """The option ``--dashboard`` prints the address early; the dashboard ends with the run."""
    run = program(
        "zswarm.ot",
        "run",
        experiment,
        "--servers",
        "local",
        "--set",
        "generations=1000000",
        "--out",
        str(tmp_path / "runs"),
        "--dashboard",
    )
    found = None
    while found is None:
        assert run.poll() is None
        page.wait_for_timeout(50)
        found = re.search(
            r"^dashboard: (http://\S+)$", (tmp_path / "program-0.log").read_text(), re.M
        )
    page.goto(found[1])
    page.get_by_role("link", name="shown").click(timeout=SLOW_MS)
    expect(page.locator(".badge")).to_contain_text("running", timeout=SLOW_MS)
    page.get_by_role("button", name="Pause").click()
    expect(page.locator(".badge")).to_contain_text("paused")
    page.get_by_role("button", name="Resume").click()
    expect(page.locator(".badge")).to_contain_text("running")
    page.on("dialog", lambda dialog: dialog.accept())
    page.goto("about:blank")
    run.send_signal(signal.SIGINT)
    assert run.wait(60) == 130
