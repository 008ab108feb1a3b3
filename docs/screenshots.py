"""Take the documents' pictures of the dashboard: runs, a run, its servers, a candidate.

Three servers of this machine evolve the stadium twice; a browser without a window looks at it.
Needs chromium, and playwright of the extra ``dev``: python docs/screenshots.py
"""

import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

PICTURES = Path(__file__).parent / "pictures"
WIDE, NARROW = {"width": 1280, "height": 860}, {"width": 400, "height": 860}
PAUSE_S = 0.2  # between two looks whether a server listens
SETTLED_MS = 1500  # for curves, after the last answer
VIEWS = {  # by the name of the picture: address, width, light or dark
    "dashboard-runs": ("/", WIDE, "light"),
    "dashboard-run": ("/run?run=stadium", WIDE, "light"),
    "dashboard-servers": ("/cluster?run=stadium", WIDE, "light"),
    "dashboard-candidate": ("/candidate?run=stadium", WIDE, "light"),
    "dashboard-narrow": ("/run?run=stadium", NARROW, "dark"),
}


def free_port() -> int:
    """Return a free local port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def serve(number: int, port: int) -> "subprocess.Popen[bytes]":
    """Start a server with two slots."""
    options = f"--name lab-{number:02} --capacity 2 --no-multicast --listen tcp/127.0.0.1:{port}"
    program = [sys.executable, "-m", "zswarm.ss", *options.split()]
    return subprocess.Popen(program, stderr=subprocess.DEVNULL)


def wait_for(port: int) -> None:
    """Return when a server listens."""
    while True:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(PAUSE_S)


def evolve(folder: Path) -> None:
    """Make two runs of stadium on three servers, one of which is killed and returns."""
    ports = [free_port() for _ in range(3)]
    servers = [serve(number, port) for number, port in enumerate(ports, 1)]
    reach = " ".join(f"--connect tcp/127.0.0.1:{port}" for port in ports)
    try:
        for seed in (1, 2):
            for port in ports:
                wait_for(port)
            options = (
                f"--seed {seed} --set optimizer.population=400 --servers 3 --no-multicast"
            )
            words = f"{options} {reach} --out {folder}".split()
            run = subprocess.Popen(
                [sys.executable, "-m", "zswarm.ot", "run", "stadium", *words],
                stderr=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                text=True,
            )
            assert run.stderr is not None
            for line in run.stderr:
                sys.stderr.write(line)
                if line.startswith("generation 120/") and seed == 1:
                    servers[2].kill()
                    servers.append(serve(3, ports[2]))
            if run.wait():
                raise SystemExit(run.returncode)
    finally:
        for server in servers:
            server.terminate()
        for server in servers:
            server.wait()


def take(browser: Browser, url: str) -> None:
    """Take all pictures."""
    for name, (path, size, scheme) in VIEWS.items():
        page = browser.new_page(
            viewport=size, color_scheme=scheme, reduced_motion="reduce"
        )
        page.goto(url + path, wait_until="networkidle")
        page.wait_for_timeout(SETTLED_MS)
        page.screenshot(path=PICTURES / f"{name}.png")
        page.close()


def main() -> None:
    """Evolve, open the dashboard, and take its pictures."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "runs"
        evolve(folder)
        shown = subprocess.Popen(
            [sys.executable, "-m", "zswarm.ot", "dashboard", "runs"],
            cwd=temporary,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            assert shown.stderr is not None
            url = re.findall(r"http://[^/]+", shown.stderr.readline())[0]
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(
                    executable_path=shutil.which("chromium"), args=["--no-sandbox"]
                )
                take(browser, url)
                browser.close()
        finally:
            shown.terminate()
            shown.wait()


if __name__ == "__main__":
    main()
