"""Takes the pictures of the dashboard that the documents show: runs, a run, its servers, a candidate.

Three servers of this machine evolve the stadium twice; a browser without a window looks at it. Needs chromium, and playwright
of the extra ``dev``: python docs/screenshots.py
"""

import re
import shutil
import socket
import subprocess
import sys
import tempfile
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

PICTURES = Path(__file__).parent / "pictures"
WIDE, NARROW = {"width": 1280, "height": 860}, {"width": 400, "height": 860}
SETTLED_MS = 1500  # for curves and what is asked for after them
VIEWS = {  # by the name of the picture: address, width, light or dark
    "dashboard-runs": ("/", WIDE, "light"),
    "dashboard-run": ("/run?run=stadium", WIDE, "light"),
    "dashboard-servers": ("/cluster?run=stadium", WIDE, "light"),
    "dashboard-candidate": ("/candidate?run=stadium", WIDE, "light"),
    "dashboard-narrow": ("/run?run=stadium", NARROW, "dark"),
}


def free_port() -> int:
    """One that nobody listens at now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def serve(number: int, port: int) -> "subprocess.Popen[bytes]":
    """A server with two slots."""
    return subprocess.Popen(
        [sys.executable, "-m", "zswarm.ss", "--name", f"lab-{number:02}", "--capacity", "2", "--no-multicast",
         "--listen", f"tcp/127.0.0.1:{port}"],
        stderr=subprocess.DEVNULL,
    )  # fmt: skip


def evolve(folder: Path) -> None:
    """Two runs of the stadium on three servers, one of which is killed in the first run, and comes back."""
    ports = [free_port() for _ in range(3)]
    servers = [serve(number, port) for number, port in enumerate(ports, 1)]
    reach = [word for port in ports for word in ("--connect", f"tcp/127.0.0.1:{port}")]
    try:
        for seed in ("1", "2"):
            run = subprocess.Popen(
                [sys.executable, "-m", "zswarm.ot", "run", "stadium", "--seed", seed, "--set", "optimizer.population=400",
                 "--servers", "3", "--no-multicast", *reach, "--out", str(folder)],
                stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True,
            )  # fmt: skip
            assert run.stderr is not None
            for line in run.stderr:
                sys.stderr.write(line)
                if line.startswith("generation 120/") and seed == "1":
                    servers[2].kill()
                    servers.append(serve(3, ports[2]))
            run.wait()
    finally:
        for server in servers:
            server.terminate()
        for server in servers:
            server.wait()


def take(browser: Browser, url: str) -> None:
    """All pictures."""
    for name, (path, size, scheme) in VIEWS.items():
        page = browser.new_page(viewport=size, color_scheme=scheme, reduced_motion="reduce")
        page.goto(url + path)
        page.wait_for_timeout(SETTLED_MS)
        page.screenshot(path=PICTURES / f"{name}.png")
        page.close()


def main() -> None:
    """Evolve, look, save."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "runs"
        evolve(folder)
        shown = subprocess.Popen(
            [sys.executable, "-m", "zswarm.ot", "dashboard", "runs"], cwd=temporary, stderr=subprocess.PIPE, text=True
        )
        try:
            assert shown.stderr is not None
            url = re.findall(r"http://[^/]+", shown.stderr.readline())[0]
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
                take(browser, url)
                browser.close()
        finally:
            shown.terminate()
            shown.wait()


if __name__ == "__main__":
    main()
