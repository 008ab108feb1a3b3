"""Controllers of ARGoS are imported, decide as there, and are exported as the same text."""

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from zswarm.champion.controller import Controller, load_controller
from zswarm.errors import ConfigError
from zswarm.kernels.jit import interpreted
from zswarm.kernels.random import Stream
from zswarm.nets.chocolate import decoded, encoded
from zswarm.ot.cli import command as cli
from zswarm.plugins import registry as plugins
from zswarm.robots.argos import genome, machine
from zswarm.robots.argos.files import files

INPUTS, BIAS, LEFT, RIGHT = range(1, 15), 15, 16, 17
MACHINE = (
    "--nstates 3 --s0 0 --rwm0 4 --n0 1 --n0x0 0 --c0x0 0 --p0x0 0.11 --s1 1 --n1 2 --n1x0 0 "
    "--c1x0 2 --p1x0 0.64 --n1x1 1 --c1x1 0 --p1x1 0.21 --s2 4 --att2 3.11 --n2 1 --n2x0 1 "
    "--c2x0 4 --p2x0 2 --w2x0 19.31"
)


def text_of(hidden: tuple[int, ...] = (), links: list[Any] | None = None) -> str:
    """Return a genome file as ARGoS3-NEAT writes it; by default with all links."""
    if links is None:
        weights = Stream(3).uniform(-5.0, 5.0, 30).tolist()
        pairs = [(source, target) for target in (LEFT, RIGHT) for source in range(1, 16)]
        links = [
            (*pair, round(weight, 6)) for pair, weight in zip(pairs, weights, strict=True)
        ]
    rows = ["/* Organism #1 Fitness: 8483.2 Time: 0 */", "genomestart 1"]
    rows += ["trait 1 0.06 0 0.4 0.1 0 0 0 0"]
    rows += [f"node {node} 1 1 1" for node in INPUTS] + [f"node {BIAS} 1 1 3"]
    rows += [f"node {node} 1 0 2" for node in (LEFT, RIGHT)]
    rows += [f"node {node} 1 0 0" for node in hidden]
    rows += [f"gene 1 {a} {b} {w} 0 {at} {w} 1" for at, (a, b, w) in enumerate(links, 1)]
    return "\n".join([*rows, "genomeend 1", ""])


DEEP = [
    *((1, 16, 1.5), (2, 17, -2.25), (15, 16, 0.5), (3, 40, 3.0), (40, 52, 2.0)),
    *((52, 16, -4.0), (16, 52, 1.0), (15, 40, -0.125), (52, 17, 0.3)),
]


def controller(built: genome.Built, **settings: Any) -> Controller:
    """Return an imported controller."""
    kind = built.representation["kind"]
    given = {key: value for key, value in built.representation.items() if key != "kind"}
    struct = msgspec.convert(given, plugins.load("representation", kind).settings_type)
    model = settings.get("reference_model", "1.2")
    inputs = {"1.1": 24, "1.2": 14, "1.2-machine": 15}[model]
    return Controller(
        simulator="epuck",
        simulator_settings=settings,
        representation=kind,
        representation_settings=msgspec.to_builtins(struct),
        inputs=inputs,
        outputs=2,
        sensors=[f"sensor {number}" for number in range(inputs)],
        actuators=["left", "right"],
        genome=built.genome,
        fitness=0.5,
        run="of-a--test",
    )


def reference(links: list[Any], seen: np.ndarray) -> list[list[float]]:
    """Decide as NEAT 1.2.1: all at once; a node that nothing reached is 0."""
    values: dict[int, float] = {}
    outputs = []
    for observation in seen.tolist():
        sensors = dict(zip(range(1, 16), [*observation, 1.0], strict=True))
        after = {}
        for target in {target for _, target, _ in links}:
            sources = [(s, w) for s, t, w in links if t == target]
            if any(source in sensors or source in values for source, _ in sources):
                total = sum(w * sensors.get(s, values.get(s, 0.0)) for s, w in sources)
                after[target] = 1.0 / (1.0 + np.exp(-4.924273 * total))
        values = after
        outputs.append([values[LEFT], values[RIGHT]])
    return outputs


@pytest.mark.parametrize("links", [None, DEEP], ids=["one layer", "hidden nodes"])
def test_a_genome_decides_as_in_argos(links: list[Any] | None) -> None:
    network = genome.read(text_of((40, 52) if links else (), links))
    one = controller(genome.build(network))
    driver = one.driver()
    seen = Stream(1).uniform(0.0, 1.0, 14 * 20).reshape(20, 14).astype(np.float32)
    expected = reference([gene[:3] for gene in network.genes], seen)
    decided = [driver.act(observation).tolist() for observation in seen]
    assert np.allclose(decided, expected, rtol=2e-6, atol=1e-7)


@pytest.mark.parametrize("links", [None, DEEP], ids=["one layer", "hidden nodes"])
def test_an_exported_genome_is_the_imported_one(links: list[Any] | None) -> None:
    network = genome.read(text_of((40, 52) if links else (), links))
    built = genome.build(network)
    again = genome.read(files(controller(built), "x")["zs_x.txt"])
    assert set(again.genes) == set(network.genes)
    assert again._replace(genes=[]) == network._replace(genes=[])
    assert genome.build(again).genome == built.genome or links


def test_an_exported_machine_is_the_imported_one() -> None:
    states = machine.read(MACHINE)
    built = genome.Built({"kind": "chocolate"}, encoded(states))
    one = controller(built, reference_model="1.2-machine", reality="pseudo")
    written = files(one, "x")
    assert written["zs_x.txt"].strip() == MACHINE
    (params,) = ET.fromstring(written["zs_x.argos"]).iter("params")  # noqa: S314  our own
    assert params.get("fsm-config") == MACHINE


def test_every_genome_is_a_machine_that_survives_its_text() -> None:
    kind = plugins.load("representation", "chocolate")
    for one in kind(kind.settings_type(), 15, 2).random(50, Stream(5)):
        text = machine.written(decoded(np.frombuffer(one, "<f4")))
        assert machine.written(machine.read(text)) == text


def test_lines_have_the_noise_of_the_experiment() -> None:
    one = controller(
        genome.build(genome.read(text_of())), reality="pseudo", mission="aac"
    )
    lines = ET.fromstring(files(one, "x")["zs_x.argos"])  # noqa: S314  our own
    (wheels,) = lines.iter("epuck_wheels")
    (light,) = lines.iter("epuck_light")
    sender, receiver = lines.iter("epuck_range_and_bearing")
    (params,) = lines.iter("params")
    assert lines[0].tag == "nn_rm_1dot2_controller"
    assert (wheels.get("noise_std_dev"), light.get("noise_level")) == ("0.15", "0.9")
    assert (sender.get("range"), receiver.get("loss_probability")) == ("0.7", "0.9")
    assert params.get("genome_file") == "zs_x.txt"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            ("gene 1 1 16", "gene 1 99 16"),
            "links node 99, which the genome does not define",
        ),
        (("gene 1 1 16", "gene 1 1 2"), "ends at node 2, which is an input"),
        (("node 14 1 1 1\n", ""), "links node 14, which the genome does not define"),
        (("node 3 1 1 1", "node 3 1 2 1"), "expected 1 1 .input., 1 3 .bias."),
        (("node 3 1 1 1", "node 2 1 1 1"), "node 2 is defined twice"),
        (("node 15 1 1 3", "node 15 1 1 1"), "its network has 15 inputs, 0 bias and 2"),
        (("node 17 1 0 2", "node 17 1 0 0"), "expected 14 inputs .reference model 1.2."),
        (("genomeend 1", ""), "expected genomestart, nodes, genes and genomeend"),
        (("genomeend 1", "genomeend 1\ngenomestart 2"), "expected one"),
        ((" 1 16 ", " x 16 "), "line 21: expected 3 whole numbers"),
        (("trait 1", "straight 1"), "expected node, gene or trait, not 'straight'"),
    ],
)
def test_a_bad_genome_is_refused_in_one_line(change: Any, message: str) -> None:
    text = text_of()
    assert change[0] in text
    with pytest.raises(ConfigError, match=message) as caught:
        genome.read(text.replace(*change, 1))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("--nstates 3", "--nstates 5"), "whole number from 1 to 4, not '5'"),
        (("--nstates 3", "--nstates 2"), "--s2: the machine has no such state"),
        (("--s2 4", "--s2 6"), "--s2: expected a whole number from 0 to 5, not '6'"),
        (("--att2 3.11", "--att2 0.5"), "--att2: expected a number from 1 to 5, not"),
        (("--p2x0 2", "--p2x0 nan"), "--p2x0: expected a whole number from 1 to 10"),
        ((" --w2x0 19.31", ""), "--w2x0: expected a number from 0 to 20; it is missing"),
        (("--s1 1", "--s1 1 --s1 2"), "--s1 is given twice"),
        (("--s1 1", "s1 1"), "expected an option of a machine, not 's1'"),
    ],
)
def test_a_bad_machine_is_refused_in_one_line(change: Any, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        machine.read(MACHINE.replace(*change, 1))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"simulator": "minisim"}, "expected a controller of epuck, not of minisim"),
        (
            {"simulator_settings": {"reference_model": "1.2-machine"}},
            "expected chocolate",
        ),
        (
            {"representation_settings": {"hidden": []}, "inputs": 14, "steepness": None},
            "",
        ),
    ],
)
def test_what_argos_cannot_read_is_refused(change: Any, message: str) -> None:
    one = controller(genome.build(genome.read(text_of())))
    if not message:  # another steepness is written as weights
        scaled = msgspec.structs.replace(one, representation_settings={"hidden": []})
        (first, *_) = genome.read(files(scaled, "x")["zs_x.txt"]).genes
        unscaled = genome.read(text_of()).genes[0].weight
        assert first.weight == pytest.approx(unscaled / genome.SLOPE)
        return
    with pytest.raises(ConfigError, match=message):
        files(msgspec.structs.replace(one, **change), "x")


def test_import_and_export_by_their_commands(tmp_path: Path) -> None:
    """A genome becomes a run that plays its mission, and the same genome again."""
    path = tmp_path / "champ.txt"
    path.write_text(text_of())
    typed = ["import", str(path), "--out", str(tmp_path), "--json"]
    typed += ["--set", "problem.settings.mission=foraging", "--set", "problem.trials=1"]
    typed += ["--set", "problem.settings.seconds=1", "--set", "problem.settings.robots=2"]
    with interpreted():  # a short trial needs no compiler
        done = CliRunner().invoke(cli, typed, catch_exceptions=False)
    run = Path(json.loads(done.stdout)["run"])
    assert load_controller(run).simulator_settings["mission"] == "foraging"
    out = str(tmp_path / "out")
    typed = ["export", str(run), "--to", "argos", "--out", out, "--name", "one"]
    CliRunner().invoke(cli, typed, catch_exceptions=False)
    text = (tmp_path / "out" / "zs_one.txt").read_text()
    assert genome.read(text) == genome.read(text_of())


@pytest.mark.parametrize(
    ("body", "setting", "message"),
    [
        ("genomestart 1\n", "name=x", "damaged: expected genomestart"),
        (text_of(), "problem.settings.mission=dance", "expected aggregation,"),
        (text_of(), "representation.hidden=[3]", "expected a setting of its mission"),
        (
            text_of(),
            'problem.settings.reference_model="1.1"',
            "expected reference_model=1.2",
        ),
        ("hello", "name=x", "--set is for controllers of ARGoS"),
    ],
)
def test_import_refuses_in_one_line(
    tmp_path: Path, body: str, setting: str, message: str
) -> None:
    path = tmp_path / "champ.txt"
    path.write_text(body)
    with pytest.raises(ConfigError, match=message):
        CliRunner().invoke(
            cli,
            ["import", str(path), "--out", str(tmp_path), "--set", setting],
            catch_exceptions=False,
            standalone_mode=False,
        )
    assert not (tmp_path / "champ").exists()
