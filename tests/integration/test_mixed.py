"""On servers that differ each run uses those that match and names the others."""

import os
import shutil
import signal
import sys
import sysconfig
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh

import zswarm
from tests.integration.programs import Optimizer, Server, query, wait_until
from zswarm import evaluate, experiment, session
from zswarm.ot.build import build
from zswarm.ot.record.history_hash import History
from zswarm.plugins import registry as plugins
from zswarm.plugins.version_hash import version_hash, versions
from zswarm.protocol import codec, keys, messages
from zswarm.system import extras

pytestmark = pytest.mark.programs

EXPERIMENT = """
name = "{name}"
seed = 3
generations = {generations}
[problem]
simulator = "{name}"
trials = 2
[problem.settings]
{settings}
[representation]
kind = "fully-meshed"
[optimizer]
kind = "nnga"
population = 10
[cluster]
require = ["gpu=yes", "os={os}", "slots>=1"]
rank = ["cores", "slots"]
max_slots = 3
"""
MISMATCHES = (
    "SELECT text FROM events WHERE event = 'server_mismatch' AND server LIKE '{}-%'"
)
TRIALS = "SELECT sum(trials) FROM servers WHERE server LIKE '{}-%'"


def write(folder: Path, name: str, generations: int, settings: str) -> Path:
    folder.mkdir()
    text = EXPERIMENT.format(
        name=name,
        generations=generations,
        settings=settings,
        os=os.uname().sysname.lower(),
    )
    (folder / "experiment.toml").write_text(text)
    return folder


def alone(folder: Path) -> str:
    """Return the history hash of a plain loop in this process."""
    file = folder / "experiment.toml"
    problem, optimizer = build(experiment.complete(experiment.load(file), str(file)))
    history = History()
    for generation in range(problem.experiment.generations):
        genomes = optimizer.ask()
        work = problem.workload(genomes, generation)
        everything = work.batch(np.arange(len(work.seeds)))
        work.fitness = evaluate.evaluate(
            problem.simulator, problem.representation, *everything
        ).fitness
        fitness = problem.total(work)
        optimizer.tell(fitness, np.empty((len(genomes), 0)))
        history.add(genomes, fitness)
    return history.hex()


def altered(folder: Path) -> str:
    """Return a PYTHONPATH with this zswarm, one line of minisim changed."""
    package = folder / "zswarm"
    shutil.copytree(
        Path(zswarm.__file__).parent,
        package,
        ignore=shutil.ignore_patterns("__pycache__"),
    )
    with (package / "sims" / "minisim.py").open("a") as code:
        code.write("# a version later\n")
    return str(folder)


def python_without(folder: Path, *packages: str) -> str:
    """Return an environment's Python without some of this one's packages."""
    hidden = {
        file.parts[0] for package in packages for file in metadata.files(package) or []
    }
    site = (
        folder
        / "lib"
        / f"python{sys.version_info.major}.{sys.version_info.minor}"
        / "site-packages"
    )
    site.mkdir(parents=True)
    for path in Path(sysconfig.get_path("purelib")).iterdir():
        if path.name not in hidden:
            (site / path.name).symlink_to(path)
    program = Path(sys._base_executable)
    (folder / "pyvenv.cfg").write_text(
        f"home = {program.parent}\ninclude-system-site-packages = false\n"
    )
    (folder / "bin").mkdir()
    (folder / "bin" / "python").symlink_to(program)
    return str(folder / "bin" / "python")


def ask(
    server: Server, message: messages.Requirements | messages.Reserve
) -> messages.Reply:
    """Return a server's answer to a request."""
    opened = session.open_optimizer(session.Reach([server.endpoint], multicast=False))
    name = str(server.events("server_ready")[0]["server"])
    offered = isinstance(message, messages.Requirements)
    key = (
        keys.offer("default", name)
        if offered
        else keys.request("default", name, "ada", "bold", "reserve")
    )

    def answers() -> list[bytes]:
        got = opened.get(
            key, payload=codec.encode(message), target=zenoh.QueryTarget.ALL, timeout=5.0
        )
        return [reply.ok.payload.to_bytes() for reply in got if reply.ok is not None]

    try:
        return codec.decode_reply(wait_until(answers, f"{server.endpoint} answers")[0])
    finally:
        session.close(opened)


def refusal(server: Server, simulator: str, settings: dict[str, Any]) -> str:
    """Return why a server refuses a lease without a previous offer."""
    message = messages.Reserve(
        nonce=bytes(16),
        epoch=0,
        slots=1,
        simulator=messages.Part(simulator, settings),
        representation=messages.Part("fully-meshed", {}),
        version_hash=version_hash(simulator, "fully-meshed"),
        trial_timeout_s=60.0,
    )
    refused = ask(server, message)
    assert isinstance(refused, messages.Refused)
    assert refused.code == "mismatch"
    return refused.reason


def test_each_of_two_runs_uses_the_servers_that_match_it_and_names_the_others_once(
    tmp_path: Path,
) -> None:
    """A server per simulator, one of another version, one with limits, one without the label.

    They refuse a lease, too, to whoever asks for one all the same; and labels and limits change
    when the file is read again.
    """
    folders = {
        "minisim": write(tmp_path / "minisim", "minisim", 10, "steps = 20\nrobots = 2"),
        "xor": write(tmp_path / "xor", "xor", 40, ""),
    }
    (tmp_path / "limited.toml").write_text(
        'simulators = ["minisim"]\n[limits]\n"minisim.robots" = { max = 1 }\n[labels]\ngpu = '
        '"yes"\n'
    )
    options = {
        "tanks": ("--simulators", "minisim", "--label", "gpu=yes"),
        "logic": ("--simulators", "xor", "--label", "gpu=yes"),
        "later": ("--simulators", "minisim", "--label", "gpu=yes"),
        "limited": ("--config", "limited.toml"),
        "bare": ("--label", "gpu=no"),
    }
    excluded = {
        "minisim": {
            "logic": "the server has no simulator 'minisim'; it has xor",
            "later": "versions differ: other code of simulator minisim; "
            "install the same, and start the server again",
            "limited": "minisim.robots is 2; this server takes at most 1",
            "bare": "the experiment requires gpu=yes (it has gpu=no)",
        },
        "xor": {
            "tanks": "the server has no simulator 'xor'; it has minisim",
            "later": "the server has no simulator 'xor'; it has minisim",
            "limited": "the server has no simulator 'xor'; it has minisim",
            "bare": "the experiment requires gpu=yes (it has gpu=no)",
        },
    }
    later = altered(tmp_path / "later")
    servers = {
        name: Server(
            tmp_path,
            name,
            capacity=1,
            options=told,
            ZSWARM_PLAIN="1",
            **({"PYTHONPATH": later} if name == "later" else {}),
        )
        for name, told in options.items()
    }
    programs: list[Optimizer] = []
    try:
        connect = [
            "--no-multicast",
            *(f"--connect={server.ready().endpoint}" for server in servers.values()),
        ]
        runs_ = {
            name: Optimizer(
                folder,
                "ot",
                ["run", "experiment.toml", "--json", "--servers", "1", *connect],
                ZSWARM_PLAIN="1",
            )
            for name, folder in folders.items()
        }
        programs += runs_.values()
        looks = Optimizer(
            tmp_path,
            "look",
            [
                "servers",
                "--wait",
                "1",
                "--json",
                "--for",
                "minisim/experiment.toml",
                *connect,
            ],
            ZSWARM_PLAIN="1",
        )
        programs.append(looks)
        refused_by_tanks = refusal(servers["tanks"], "xor", {})
        refused_by_limited = [
            refusal(servers["limited"], "minisim", settings)
            for settings in ({"robots": 2}, {})
        ]
        hashes = {name: run.done()["history_hash"] for name, run in runs_.items()}
        assert looks.wait() == 0, looks.err.read_text()
        (tmp_path / "limited.toml").write_text(
            '[limits]\n"minisim.steps" = { max = 9 }\n[labels]\nroom = "b12"\n'
        )
        servers["limited"].kill(signal.SIGHUP)
        wait_until(
            lambda: servers["limited"].events("reloaded"), "its file is read again"
        )
        refused_by_limited.append(refusal(servers["limited"], "minisim", {"steps": 10}))
        later_offer = ask(servers["limited"], messages.Requirements())
    finally:
        for program in (*servers.values(), *programs):
            program.close()
    assert refused_by_tanks == "the server has no simulator 'xor'; it has minisim"
    assert refused_by_limited == [
        *(
            f"minisim.robots is {robots}; this server takes at most 1"
            for robots in (2, 8)
        ),
        "minisim.steps is 10; this server takes at most 9",
    ]
    assert isinstance(later_offer, messages.Offer)
    assert (later_offer.labels.get("gpu"), later_offer.labels["room"]) == (None, "b12")
    assert (later_offer.simulators, later_offer.limits) == (
        ["minisim"],
        ["minisim.steps at most 9"],
    )
    assert hashes == {name: alone(folder) for name, folder in folders.items()}
    for name, run in runs_.items():
        told = run.err.read_text().splitlines()
        record = folders[name] / "runs" / name
        for server, why in excluded[name].items():
            assert [
                line.partition(" is not used: ")[2]
                for line in told
                if line.startswith(f"{server}-")
            ] == [why]
            assert query(record, TRIALS.format(server)) in ([(None,)], [(0,)])
            assert query(record, MISMATCHES.format(server)) == [(why,)]
    seen = {line["server"].rpartition("-")[0]: line for line in looks.lines()}
    assert {name: line["mismatch"] for name, line in seen.items()} == {
        "tanks": "",
        **excluded["minisim"],
    }
    assert next(iter(seen)) == "tanks", "who matches comes first"
    assert (seen["limited"]["labels"]["gpu"], seen["limited"]["limits"]) == (
        "yes",
        ["minisim.robots at most 1"],
    )
    assert {line["labels"]["name"] for line in seen.values()} == set(options)


def test_missing_packages_are_reported_with_the_install_command(
    tmp_path: Path,
) -> None:
    """A server without the packages is not used for this run but serves others."""
    here, common = (
        versions("pettingzoo", "fully-meshed"),
        versions("minisim", "fully-meshed"),
    )
    named = plugins.libraries(plugins.source_files("simulator", "pettingzoo"))
    packages = {
        name: here[name] for name in named if name not in common and here[name] != "none"
    }

    class Bare:
        python = python_without(tmp_path / "bare", *packages)

    server = type("BareServer", (Bare, Server), {})(tmp_path, "bare-server", capacity=1)
    optimizer = type("BareOptimizer", (Bare, Optimizer), {})(
        tmp_path,
        "ot",
        ["run", "pettingzoo", "--no-multicast", "--connect", server.endpoint],
    )
    try:
        server.ready()
        offers = []
        for simulator in ("pettingzoo", "minisim"):
            asked = messages.Requirements(
                simulator=simulator,
                representation="fully-meshed",
                versions=versions(simulator, "fully-meshed"),
                version_hash=version_hash(simulator, "fully-meshed"),
            )
            offers.append(ask(server, asked).mismatch)
        refused = refusal(server, "pettingzoo", {})
        assert optimizer.wait() == 2
    finally:
        server.close()
        optimizer.close()
    needed = " ".join(f"{name}=={said}" for name, said in packages.items())
    assert offers[0].startswith("the server lacks packages that 'pettingzoo' needs: ")
    assert offers[0].endswith(f"install {needed}")
    assert offers[1] == ""
    assert "another version" in refused
    said = optimizer.err.read_text().splitlines()
    assert len(said) == 1
    assert "simulator pettingzoo needs pettingzoo: " in said[0]
    assert said[0].endswith(extras.how("gym").partition(" install ")[2])
