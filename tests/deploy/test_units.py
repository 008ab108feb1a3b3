"""The files in deploy/; tests/integration/test_machines.py installs them on machines."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import msgspec
import pytest

from tests.repository import REPOSITORY
from zswarm import router
from zswarm.config.decode import convert
from zswarm.ss.server import Options

DEPLOY = REPOSITORY / "deploy"
WHEEL = "zswarm[keys] @ file:///srv/wheels/zswarm-0.1.0-py3-none-any.whl"
DOCUMENT = (REPOSITORY / "docs" / "deploy.md").read_text()


@pytest.mark.skipif(
    shutil.which("systemd-analyze") is None,
    reason="systemd-analyze is not there (Debian: apt install systemd)",
)
def test_systemd_finds_nothing_wrong_with_the_units() -> None:
    """The exposure that systemd computes for them is 1.2 at most."""
    done = subprocess.run(
        [str(DEPLOY / "check-units.sh"), str(Path(sys.executable).parent)],
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, ""), done.stdout


@pytest.mark.parametrize(
    ("file", "options"),
    [("ss.toml", Options), ("router.toml", router.RouterOptions)],
    ids=["ss", "router"],
)
def test_the_example_of_a_configuration_shows_the_defaults(
    file: str, options: type[msgspec.Struct]
) -> None:
    """Every key but for those that are set is behind a #, with its default."""
    text = (DEPLOY / "systemd" / file).read_text()
    set_here = tomllib.loads(text)
    convert(set_here, options, file)
    shown = tomllib.loads("\n".join(re.findall(r"^#? ?(\w+ = .*)$", text, re.M)))
    defaults = msgspec.to_builtins(options())
    assert shown == defaults | set_here


@pytest.mark.parametrize(
    ("what", "heading"),
    [
        ("install", "Install"),
        ("upgrade", "Upgrade"),
        ("firewall", "Limit connections"),
        ("uninstall", "Uninstall"),
    ],
)
def test_the_script_for_many_machines_does_what_the_document_says(
    what: str, heading: str
) -> None:
    script = re.search(
        rf"^{what}='\n(.*?)^'$", (DEPLOY / "fleet.sh").read_text(), re.S | re.M
    )
    assert script
    lines = script[1].replace("--quiet ", "").replace('"$PACKAGE"', f"'{WHEEL}'")
    lines = lines.replace('[ ! "$keys" ] || ', "").replace(
        'join --yes "$keys"', "join ~/lab-01.zkeys"
    )
    # Without what it does where pip fails.
    lines = re.sub(r" \|\| \{.*\}$", "", lines, flags=re.M)
    assert (
        lines
        == re.findall(
            r"^```sh\n(.*?)^```$", DOCUMENT.split(f"# {heading}\n", 1)[1], re.S | re.M
        )[0]
    )


@pytest.mark.parametrize("arguments", [[], ["install"], ["instal", "lab-01"]])
def test_the_script_for_many_machines_prints_its_usage(arguments: list[str]) -> None:
    done = subprocess.run(
        [str(DEPLOY / "fleet.sh"), *arguments], capture_output=True, text=True
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(
        "usage: fleet.sh install|upgrade|join|firewall|uninstall|status HOST..."
    )


@pytest.mark.parametrize("what", ["install", "upgrade"])
@pytest.mark.parametrize(
    "package",
    [
        None,
        "",
        "zswarm",
        "zswarm[keys]",
        "zswarm[keys]==0.1.0",
        "zswarm[keys] @ https://example.org/zswarm-0.1.0-py3-none-any.whl",
        f"zswarm @ https://example.org/z.whl#sha256={'0' * 63}g",
        "zswarm @ http://example.org/z.whl#sha256=" + "0" * 64,
        "/srv/z.whl'; touch owned; '",
        "/srv/z.whl\ntouch owned",
    ],
)
def test_no_bare_name_is_installed(
    tmp_path: Path, package: str | None, what: str
) -> None:
    """An index may have given the name to somebody else; nothing is sent to a machine."""
    sent = fleet_with_ssh(tmp_path, what, package)
    assert sent.returncode == 2
    assert sent.stderr.startswith("PACKAGE: expected 'zswarm[keys] @ file:///PATH'")
    assert not (tmp_path / "sent").exists()


@pytest.mark.parametrize(
    "package",
    ["/srv/z.whl", WHEEL, "zswarm[keys] @ https://example.org/z.whl#sha256=" + "0" * 64],
)
def test_a_path_and_a_pinned_address_are_installed(tmp_path: Path, package: str) -> None:
    assert fleet_with_ssh(tmp_path, "install", package).returncode == 0
    assert f"PACKAGE='{package}'\n" in (tmp_path / "sent").read_text()


def fleet_with_ssh(
    folder: Path, what: str, package: str | None
) -> "subprocess.CompletedProcess[str]":
    """Run the script with an ``ssh`` that writes to the file ``sent`` what it is given."""
    (folder / "ssh").write_text(f"#!/bin/sh\ncat > {folder}/sent\n")
    (folder / "ssh").chmod(0o755)
    given = {} if package is None else {"PACKAGE": package}
    path = {"PATH": f"{folder}:/usr/bin:/bin", "KEYS": "none"}
    command = [str(DEPLOY / "fleet.sh"), what, "lab-01"]
    return subprocess.run(
        command, capture_output=True, text=True, cwd=folder, env=path | given
    )


@pytest.mark.parametrize("what", ["install", "join"])
def test_the_script_for_many_machines_names_missing_keys(
    tmp_path: Path, what: str
) -> None:
    command = [str(DEPLOY / "fleet.sh"), what, "root@lab-01.example.org"]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PACKAGE": WHEEL},
    )
    assert (done.returncode, done.stdout) == (1, "")
    missing = "lab-01.zkeys is not in this folder: see docs/keys.md, or set KEYS=none"
    assert done.stderr == f"root@lab-01.example.org: {missing}\n"


def test_the_script_for_many_machines_stops_at_the_first_failure(tmp_path: Path) -> None:
    """The machines after it serve on as they are."""
    (tmp_path / "ssh").write_text('#!/bin/sh\ncat > /dev/null\n[ "$1" != lab-02 ]\n')
    (tmp_path / "ssh").chmod(0o755)
    command = [str(DEPLOY / "fleet.sh"), "upgrade", "lab-01", "lab-02", "lab-03"]
    path = {"PATH": f"{tmp_path}:/usr/bin:/bin", "PACKAGE": WHEEL}
    done = subprocess.run(command, capture_output=True, text=True, env=path)
    assert (done.returncode, done.stdout) == (1, "lab-01: upgrade\nlab-02: upgrade\n")
    assert done.stderr == "lab-02: upgrade failed; the machines after it are unchanged\n"
