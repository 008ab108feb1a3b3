"""Fixtures with a real browser and a real dashboard; pages must not fail or request other sites."""

import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright

expect.set_options(timeout=60_000)  # on a busy machine
BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser")
CHROMIUM = next(filter(None, map(shutil.which, BROWSERS)), "chromium")


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """Start the distribution's browser without a window."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"]
        )
        yield browser
        browser.close()


class Watched(NamedTuple):
    """Collect the errors and the foreign requests of a page."""

    errors: list[str]
    requests: list[str]

    def watch(self, page: Page) -> Page:
        """Record errors and foreign requests of a page."""
        page.on(
            "console",
            lambda said: (
                self.errors.append(said.text)
                if said.type in ("error", "warning")
                else None
            ),
        )
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("request", lambda request: self.requests.append(request.url))
        return page

    def forgive(self, page: Page) -> None:
        """Drop the errors that a test provoked, once no more of them come."""
        page.goto("about:blank")
        self.errors.clear()


@pytest.fixture
def watched() -> Watched:
    """Watch all pages of a test; a test that provokes an error forgives it."""
    return Watched([], [])


@pytest.fixture
def page(browser: Browser, watched: Watched, dashboard: object) -> Iterator[Page]:
    """Open a new tab, closed before dashboards end; it must not fail or request other machines."""
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    yield watched.watch(context.new_page())
    context.close()
    assert watched.errors == []
    elsewhere = {
        urlsplit(url).hostname
        for url in watched.requests
        if urlsplit(url).scheme not in ("data", "blob", "file")
    }
    assert elsewhere <= {"127.0.0.1"}


class Dashboard:
    """``zswarm-ot dashboard`` as a program.

    Attributes:
        url: its address.
        token: for what controls runs.
    """

    def __init__(self, *folders: Path, options: Sequence[str] = ()) -> None:
        self._arguments = [*map(str, folders), *options]
        self.start()

    def start(self) -> None:
        """Start the program, or start it again."""
        self._program = subprocess.Popen(
            [sys.executable, "-m", "zswarm.ot", "dashboard", *self._arguments],
            stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self._program.stderr is not None
        line = self._program.stderr.readline()
        found = re.fullmatch(r"dashboard: (http://\S+)/#token=(\S+)\n", line)
        assert found, line + self._program.stderr.read()
        self.url, self.token = found[1], found[2]
        self._said: list[str] = []
        self._listener = threading.Thread(
            target=self._said.extend, args=(self._program.stderr,), daemon=True
        )
        self._listener.start()

    def stop(self) -> str:
        """End the program; return its output since the start."""
        self._program.terminate()
        self._program.wait(30)
        self._listener.join()
        assert self._program.stderr is not None
        self._program.stderr.close()
        return "".join(self._said)

    @property
    def port(self) -> int:
        """Return the port."""
        return int(urlsplit(self.url).port or 0)

    def memory(self) -> int:
        """Return the memory of the process in bytes."""
        status = Path(f"/proc/{self._program.pid}/status").read_text()
        return 1024 * int(re.findall(r"VmRSS:\s+(\d+)", status)[0])


@pytest.fixture
def dashboard() -> Iterator[Callable[..., Dashboard]]:
    """Start dashboards of folders; at the end none may have printed an error."""
    begun: list[Dashboard] = []

    def start(*folders: Path, options: Sequence[str] = ()) -> Dashboard:
        begun.append(Dashboard(*folders, options=options))
        return begun[-1]

    yield start
    said = [one.stop() for one in begun]
    assert said == [""] * len(begun)
