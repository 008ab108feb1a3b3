"""docs/paper.md shows the results; a claim agrees only if the results do."""

import copy
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.docs.documents import REPOSITORY
from zswarm.ot.build import build

BENCHMARKS = REPOSITORY / "benchmarks"
RESULTS = BENCHMARKS / "paper" / "results.json"
DOCUMENT = REPOSITORY / "docs" / "paper.md"


def load(name: str) -> Any:
    sys.path.insert(0, str(BENCHMARKS))
    try:
        return importlib.import_module(f"paper.{name}")
    finally:
        sys.path.remove(str(BENCHMARKS))


@pytest.fixture
def results() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8"))
    return copy.deepcopy(found)


def agrees(results: dict[str, Any], says: str) -> bool:
    """Return the verdict of the claim that begins so."""
    (found,) = [
        claim for claim in load("claims").claims(results) if claim.says.startswith(says)
    ]
    verdict: bool = found.agrees
    line = next(
        line
        for line in load("page").document(results).splitlines()
        if line.startswith(f"| {says}")
    )
    assert ("does not agree" in line) == (not verdict)
    return verdict


def test_the_page_shows_the_results(results: dict[str, Any]) -> None:
    assert DOCUMENT.read_text(encoding="utf-8") == load("page").document(results), (
        "run: make paper ARGS=--page"
    )


@pytest.mark.benchmarks
def test_all_charts_are_drawn(results: dict[str, Any], tmp_path: Path) -> None:
    charts = load("charts")
    charts.draw(results, tmp_path)
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted(
        f"paper-{name}.png" for name in charts.CHARTS
    )
    assert all(file.read_bytes().startswith(b"\x89PNG") for file in tmp_path.iterdir())
    assert {file.name for file in tmp_path.iterdir()} <= {
        file.name for file in (REPOSITORY / "docs" / "pictures").iterdir()
    }


def test_all_four_designs_were_measured_in_one_run_with_one_history(
    results: dict[str, Any],
) -> None:
    designs = load("findings").designs(results)
    for design in (
        "broker",
        "files, gcc",
        "parameters over Zenoh",
        "optimizer over Zenoh, by turn",
        "optimizer over Zenoh, by agent",
    ):
        assert design in designs
    assert agrees(results, "The place of the controller") is True


def change(
    results: dict[str, Any], what: str, how: Callable[[dict[str, Any]], Any], **of: object
) -> None:
    """Change a key of all rows with these values."""
    changed = [
        row
        for row in results["rows"]
        if all(row.get(key) == value for key, value in of.items())
    ]
    assert changed, f"no row has {of}"
    for row in changed:
        row[what] = how(row)


def test_a_different_history_is_reported(results: dict[str, Any]) -> None:
    change(
        results,
        "history",
        lambda _row: "another",
        part="designs",
        design="files, gcc",
        world="emergency-exit",
    )
    assert agrees(results, "The place of the controller") is False


def test_one_message_more_than_the_equation_predicts_is_reported(
    results: dict[str, Any],
) -> None:
    assert agrees(results, "Messages of a simulation") is True
    change(
        results,
        "messages",
        lambda row: row["messages"] + 1,
        part="messages",
        design="broker",
        world="minisim",
        agents=8,
    )
    assert agrees(results, "Messages of a simulation") is False


def test_the_benefit_of_a_second_server_is_measured(results: dict[str, Any]) -> None:
    for seconds, verdict in ((10.0, False), (5.0, True)):
        change(
            results, "s", lambda _row: 10.0, part="scaling", design="broker", servers=1
        )
        change(
            results,
            "s",
            lambda _row, seconds=seconds: seconds,
            part="scaling",
            design="broker",
            servers=2,
        )
        assert agrees(results, "Two servers are much faster than one (broker)") is verdict


def test_the_benefit_of_more_than_two_servers_is_measured(
    results: dict[str, Any],
) -> None:
    change(results, "s", lambda _row: 5.0, part="scaling", design="broker")
    assert agrees(results, "More than two servers are not useful (broker)") is True
    change(results, "s", lambda _row: 4.0, part="scaling", design="broker", servers=4)
    assert agrees(results, "More than two servers are not useful (broker)") is False


def test_the_linearity_of_time_in_steps_is_measured(results: dict[str, Any]) -> None:
    change(
        results,
        "s",
        lambda row: row["simulations"] * row["steps"] * 0.2,
        part="grid",
        design="broker",
    )
    assert agrees(results, "Time grows linearly with steps (broker)") is True
    change(
        results,
        "s",
        lambda row: row["simulations"] * (row["steps"] - 20) ** 2 * 0.1,
        part="grid",
        design="broker",
    )
    assert agrees(results, "Time grows linearly with steps (broker)") is False


def test_the_benefit_of_parameters_is_measured(results: dict[str, Any]) -> None:
    change(
        results,
        "s",
        lambda _row: 60.0,
        part="designs",
        design="parameters over Zenoh",
        world="emergency-exit",
    )
    assert agrees(results, "Parameters in a message") is False


def test_the_benefit_of_more_servers_with_one_discovery_is_measured(
    results: dict[str, Any],
) -> None:
    for verdict, seconds in (
        (True, lambda row: 16.0 / row["servers"]),
        (False, lambda row: 8.0 if row["servers"] > 1 else 16.0),
    ):
        change(results, "s", seconds, part="crowded", design="parameters over Zenoh")
        assert agrees(results, "With one discovery, more than two servers") is verdict


def test_tcp_is_blamed_only_where_messages_of_a_crowd_are_slow_without_nodelay(
    results: dict[str, Any],
) -> None:
    for one, crowd, nodelay, blamed in (
        (1.0, 20.0, 2.0, True),
        (20.0, 20.0, 2.0, False),
        (1.0, 20.0, 20.0, False),
    ):
        slow = {"broker": crowd, "broker, TCP_NODELAY": nodelay, "no transport": 0.0}
        for row in results["rows"]:
            if row["part"] == "messages" and row["design"] in slow:
                alone = row["design"] == "broker" and row["agents"] == 1
                row["s"] = (
                    row["steps"] * row["agents"] * (one if alone else slow[row["design"]])
                )
        (claim,) = [
            claim
            for claim in load("claims").claims(results)
            if claim.says.startswith("Time of a message")
        ]
        assert ("until the previous one" in claim.why) is blamed


def test_slower_messages_over_zenoh_are_explained(
    results: dict[str, Any],
) -> None:
    for factor, told in ((1.0, False), (3.0, True)):
        for row in results["rows"]:
            slow = {
                "broker, TCP_NODELAY": 1.0,
                "optimizer over Zenoh, by agent": factor,
                "no transport": 0.0,
            }.get(row["design"])
            if row["part"] == "messages" and slow is not None:
                row["s"] = row["steps"] * row["agents"] * slow
        assert (
            "There are two reasons: the server forwards" in load("page").document(results)
        ) is told


def test_a_design_that_is_faster_than_zswarm_is_named(results: dict[str, Any]) -> None:
    for seconds, told in ((99.0, True), (0.1, False)):
        change(
            results,
            "s",
            lambda _row, seconds=seconds: seconds,
            part="crowded",
            design="parameters over Zenoh",
            servers=16,
        )
        assert ("the fastest design is: " in load("page").document(results)) is told


def test_an_extra_round_is_explained(results: dict[str, Any]) -> None:
    for rounds, told in ((4.1, False), (5.1, True)):
        for row in results["rows"]:
            if row["part"] == "scaling" and row["design"] == "parameters over Zenoh":
                row["s"] = rounds * row["steps"] * row["step_s"]
        assert (
            "rounds of simulations, although 4 are enough"
            in load("page").document(results)
        ) is told


def test_fitted_constants_are_those_of_generated_times(results: dict[str, Any]) -> None:
    """Times that follow equation 7 with 2 ms per message give t_msg = 2 ms."""
    findings = load("findings")
    for row in results["rows"]:
        if row["part"] == "grid":
            row["s"] = row["simulations"] * (
                row["steps"] * row["step_s"]
                + 0.002 * (5 + 2 * row["steps"] * row["agents"])
            )
    assert findings.constants(results, "broker").message_s == pytest.approx(0.002)
    fit = findings.fit(results, "broker")
    step_s = next(row["step_s"] for row in results["rows"] if row["part"] == "grid")
    assert (fit.a, fit.b, fit.c, fit.r2) == pytest.approx((0.01, step_s, 0.004, 1.0))


def test_rounds_are_counted_per_generation() -> None:
    """4, 2, 2 and 2 candidates."""
    row = {"population": 4, "trials": 1, "generations": 4, "simulations": 10}
    assert [load("findings").rounds(row, servers) for servers in (1, 2, 3, 4, 16)] == [
        10,
        5,
        5,
        4,
        4,
    ]


def test_the_table_of_the_papers_parts_names_existing_files() -> None:
    table = DOCUMENT.read_text(encoding="utf-8").partition(
        "## Where the paper's parts are"
    )[2]
    named = re.findall(
        r"`((?:zswarm|ot|ss|sims|nets|benchmarks|examples)/[\w/.]*)`", table
    )
    assert len(named) > 10
    missing = [
        name
        for name in named
        if not (REPOSITORY / name).exists()
        and not (REPOSITORY / "zswarm" / name).exists()
    ]
    assert missing == []


def have(*programs: str) -> None:
    """Skip the test if a program is missing."""
    if lacking := [
        name
        for name in programs
        if not shutil.which(name, path=os.environ["PATH"] + ":/usr/sbin")
    ]:
        pytest.skip(f"not installed: {', '.join(lacking)}")


@pytest.mark.robots
def test_the_messages_behind_the_broker_are_the_papers_seven_in_its_order() -> None:
    """Two servers; each message names its simulation, and all but the discovery their server."""
    have("mosquitto")
    world, broker = load("world"), load("broker")
    seen: list[Any] = []
    with world.installed(), broker.Broker(nodelay=True) as opened:
        loaded = world.load(world.World(agents=2, steps=3), world.Size(generations=1))
        problem = build(loaded).problem
        opened.grow(2, problem)
        subscribed, listener = (
            threading.Event(),
            broker.by_mqtt.connected(opened._port, True),
        )
        listener.on_subscribe = lambda *_: subscribed.set()
        listener.on_message = lambda _client, _data, message: seen.append(
            broker.decode(message.payload)
        )
        listener.subscribe("#")
        listener.loop_start()
        assert subscribed.wait(30.0)
        world.optimize(loaded, opened.play)
        deadline = time.monotonic() + 30.0
        while (
            sum(isinstance(message, broker.Fitness) for message in seen) < 4
            and time.monotonic() < deadline
        ):
            time.sleep(0.01)
        listener.disconnect()
        listener.loop_stop()
    simulations = {message.simulation for message in seen}
    assert len(simulations) == 4
    for simulation in simulations:
        own = [message for message in seen if message.simulation == simulation]
        (server,) = {
            message.server for message in own if isinstance(message, broker.Parameters)
        }
        assert own[0].server == ""
        order = [type(message) for message in own if message.server in ("", server)]
        begin = [broker.Discovery, broker.Server, broker.Parameters, broker.Control]
        assert order == [
            *begin,
            *[broker.Sensor, broker.Actuator] * ((len(order) - 5) // 2),
            broker.Fitness,
        ]
        assert len(order) <= 5 + 2 * 3 * 2
        assert {
            type(message) for message in own if message.server not in ("", server)
        } <= {broker.Server}


@pytest.mark.robots
def test_everything_is_measured_and_made_into_a_page(tmp_path: Path) -> None:
    """Run real brokers, compilers and daemons in small sizes: histories and messages, not times."""
    have("mosquitto", "gcc")
    done = subprocess.run(
        [sys.executable, "-m", "paper", "--quick", "--to", str(tmp_path)],
        cwd=BENCHMARKS,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
        capture_output=True,
        text=True,
        timeout=900,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "docs" / "paper.md").read_text(encoding="utf-8")
    assert "## Figure 4" in page
    results = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    for says in ("The place of the controller", "Messages of a simulation"):
        assert agrees(results, says) is True
    assert {row["design"] for row in results["rows"]} >= {
        "broker",
        "broker, TCP_NODELAY",
        "files, gcc",
        "parameters over Zenoh",
    }
