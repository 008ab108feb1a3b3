"""Results of FREVO become runs, bit for bit, and nothing else does."""

import json
import subprocess
import sys
import tracemalloc
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from tests.ot.importing import zre
from zswarm import evaluate
from zswarm.errors import ConfigError
from zswarm.nets.fully_meshed import FullyMeshed
from zswarm.ot.commands.import_ import command as import_command
from zswarm.ot.importing import by_content, frevo_file, imported
from zswarm.ot.importing.imported import Imported
from zswarm.ot.problem import Problem
from zswarm.ot.record.reader import Run
from zswarm.ot.record.writer import Record

ACTIVATIONS = {"LINEAR": "clamp", "SIGMOID": "sigmoid", "RELU": "relu"}
FILE, GENOMES, FITNESS = zre.trace()
ONE = zre.text([zre.net([[0.5] * 14] * 4, [0.25] * 4, -3.5)])


def write(
    folder: Path, content: str | bytes, name: str = "Emergency Exit_g004 (-27.66).zre"
) -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def import_(folder: Path, content: str) -> Imported:
    return imported.record(by_content.load(write(folder, content)), folder / "runs")


def refusal(folder: Path, content: str | bytes) -> str:
    """Why a file is not imported, in one line that is safe to show."""
    with pytest.raises(ConfigError) as caught:
        by_content.load(write(folder, content))
    assert str(caught.value).isprintable()
    return str(caught.value).partition(".zre: ")[2]


# ---- what is imported


def test_a_population_that_frevo_ranked_is_imported_with_every_bit(
    tmp_path: Path,
) -> None:
    made = import_(tmp_path, FILE)
    run = Run(made.folder)
    candidates = run.candidates(0)
    assert [candidate["genome"] for candidate in candidates] == GENOMES
    assert [candidate["fitness"] for candidate in candidates] == FITNESS
    champion = run.champion()
    assert champion is not None
    assert (champion.genome, champion.fitness, made.played) == (
        GENOMES[0],
        FITNESS[0],
        FITNESS[0],
    )
    assert (run.best(), run.generations(), run.finished, run.history_hash) == (
        FITNESS[0],
        1,
        True,
        run.meta["history_hash"],
    )
    assert (
        run.meta["imported_from"]
        == "Emergency Exit_g004 (-27.66).zre: generation 4 of FREVO's nnga.NNGA"
    )


def test_every_imported_network_has_the_fitness_that_frevo_recorded(
    tmp_path: Path,
) -> None:
    result = by_content.load(write(tmp_path, FILE))
    problem = Problem(result.experiment)
    work = problem.workload(result.genomes, 0)
    played = evaluate.evaluate(
        problem.simulator,
        problem.representation,
        work.genomes,
        work.participants,
        work.seeds,
    )
    work.fitness[:] = played.fitness
    assert problem.total(work).tobytes() == np.array(FITNESS).tobytes()


@pytest.mark.parametrize(
    "net", zre.golden_nets("fullymeshed"), ids=lambda net: str(net["id"])
)
def test_a_recorded_net_decides_after_its_import_as_in_frevo(
    tmp_path: Path, net: dict[str, Any]
) -> None:
    written = zre.net(net["weights_into"], net["bias"], -1.0, net["activation"])
    iterations = str(net["iterations"])
    result = by_content.load(
        write(
            tmp_path,
            zre.text(
                [written], representation={"iterations": iterations, "hiddenNodes": "7"}
            ),
        )
    )
    network = Problem(result.experiment).representation
    assert result.experiment.representation.settings["hidden"] == net["hidden"], (
        "of the net itself, as FREVO reads it"
    )
    assert isinstance(network, FullyMeshed)
    (parameters,), state = (
        network.parameters(result.genomes),
        np.zeros(network.state_size, np.float32),
    )
    for observation, expected in zip(net["in"], net["out"], strict=True):
        action = np.empty(2, np.float32)
        FullyMeshed.step(parameters, state, np.array(observation, np.float32), action)
        assert action.tobytes() == np.array(expected, np.float32).tobytes()


def test_the_stadium_of_frevo_has_the_same_fitness_here(tmp_path: Path) -> None:
    """Import nets that FREVO ranked on its stadium: one trial, whatever evaluations are set."""
    golden = json.loads((zre.GOLDEN / "emergencyexit.json").read_text())
    nets = {net["id"]: net for net in golden["nets"]}
    for run in [run for run in golden["runs"] if run["field"] == "stadium"]:
        net = nets[run["net"]]
        written = zre.net(
            net["weights_into"], net["bias"], run["fitness"], net["activation"]
        )
        content = zre.text(
            [written], representation={"iterations": str(net["iterations"])}
        )
        assert import_(tmp_path, content).played == run["fitness"]


def test_settings_are_imported(tmp_path: Path) -> None:
    content = zre.text(
        [zre.net([[0.5] * 14] * 4, [0.25] * 4, -3.5, "SIGMOID")],
        session={"CustomName": "Böse Räume! 2", "StartingSeed": "77"},
        problem={
            "fieldsource": "RANDOM_FIELD",
            "steps": "60",
            "width": "15",
            "height": "16",
            "seedforEmergencyExits": "3",
            "NumberofAgents": "4",
            "NumberofEmergencyExits": "2",
            "NumberofBlockades": "1",
            "NumberofEvaluations": "7",
        },
        method={
            "populationsize": "40",
            "populationnumber": "2",
            "percentage_random": "0.2f",
            "percentage_mutate": "0.25f",
            "percentage_renew": "0f",
            "percentage_xover": "0.125",
            "interXover_frequency": "0",
            "mutationMethod": "2",
            "mutationseverity": "0.5f",
            "mutationprobability": "0.75f",
            "generations": "9",
        },
        representation={"iterations": "3"},
    )
    read = by_content.load(write(tmp_path, content)).experiment
    assert (read.name, read.seed, read.generations, read.problem.trials) == (
        "b-se-r-ume-2",
        77,
        9,
        7,
    )
    assert read.problem.settings == {
        "field": "random",
        "steps": 60,
        "width": 15,
        "height": 16,
        "agents": 4,
        "exits": 2,
        "blockades": 1,
        "seed": 3,
    }
    assert read.representation.settings == {
        "hidden": 2,
        "iterations": 3,
        "activation": "sigmoid",
        "weight_range": 2.0,
        "bias_range": 2.0,
    }
    assert read.optimizer.settings == {
        "population": 40,
        "islands": 2,
        "random": 0.2,
        "mutation": 0.25,
        "renew": 0.0,
        "crossover": 0.125,
        "exchange_interval": 0,
        "mutation_method": 2,
        "severity": 0.5,
        "probability": 0.75,
    }


def test_a_file_of_another_method_names_it(tmp_path: Path) -> None:
    result = by_content.load(write(tmp_path, ONE.replace("nnga.NNGA", "CEA2D.CEA2D")))
    assert result.notes == [
        "zswarm does not have the method 'CEA2D.CEA2D': experiment.toml names nnga, with its "
        "default settings"
    ]
    assert result.source.endswith("generation 4 of FREVO's CEA2D.CEA2D")
    assert result.experiment.optimizer.settings["population"] == 2


def test_missing_settings_have_frevos_defaults(tmp_path: Path) -> None:
    bare = "\n".join(line for line in ONE.splitlines() if "entry" not in line)
    assert (
        by_content.load(write(tmp_path, bare)).experiment
        == by_content.load(write(tmp_path, ONE.replace("DEFAULT", "frevo"))).experiment
    )


def test_a_network_that_failed_has_no_fitness(tmp_path: Path) -> None:
    nets = [
        zre.net([[0.5] * 14] * 4, [0.25] * 4, fitness) for fitness in (float("nan"), -2.0)
    ]
    made = import_(tmp_path, zre.text(nets).replace('"nan"', '"NaN"'))
    assert [candidate["fitness"] for candidate in Run(made.folder).candidates(0)] == [
        None,
        -2.0,
    ]
    assert made.champion.fitness == -2.0


def test_resuming_an_imported_run_fails_with_an_alternative(
    tmp_path: Path,
) -> None:
    made = import_(tmp_path, FILE)
    with pytest.raises(
        ConfigError, match=r"was imported, .* can be run again from .*experiment\.toml"
    ):
        Record.open(made.folder)


def test_a_champion_that_takes_long_is_not_played(tmp_path: Path) -> None:
    content = FILE.replace(
        'key="steps" type="STRING" value="50"',
        'key="steps" type="STRING" value="1000000"',
    )
    assert import_(tmp_path, content).played is None


@given(
    st.integers(0, 2**32 - 1)
    .map(lambda bits: np.array([bits], "<u4").view("<f4")[0])
    .filter(np.isfinite)
)
def test_a_printed_float_is_read_back_exactly(number: np.float32) -> None:
    assert (
        frevo_file._singles([str(number), f"{float(number):.20e}"]).tobytes()
        == number.tobytes() * 2
    )


# The middle of the floats 1 and 1.0000001: 64 bits hold it, and its neighbours are rounded to it.
MIDDLE = "1.00000005960464477539062500000000"


@given(st.decimals(-10, 10, allow_nan=False, places=30).map(str))
@example(MIDDLE[:-1] + "1")
@example("0" + MIDDLE)
@example("1.00000005960464477539062499999999")
@example("-" + MIDDLE[:-1] + "1")
def test_digits_become_the_nearest_float(digits: str) -> None:
    (found,) = frevo_file._singles([digits])
    beside = (
        np.nextafter(found, np.float32(-np.inf)),
        np.nextafter(found, np.float32(np.inf)),
    )
    error = abs(Fraction(digits) - Fraction(float(found)))
    assert all(
        error <= abs(Fraction(digits) - Fraction(float(other))) for other in beside
    )


# ---- what is refused


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            'class="emergencyexit.EmergencyExit"',
            'class="pong.Pong"',
            "it is of the problem 'pong.Pong'; only results of",
        ),
        (
            'class="emergencyexit.EmergencyExit"',
            'class="&#x202e;"',
            r"it is of the problem '\\x202e'",
        ),
        (
            'class="fullyMeshedNet.FullyMeshedNet"',
            'class="neat.NEAT"',
            "it is of networks of the kind 'neat.NEAT'",
        ),
        ("FullyMeshedNet input", "ThreeLayerNetwork input", "mismatched tag"),
        ("Stadium.ser", "C:\\own\\Hall.ser", "its field is the file"),
        (
            '"FIELD_FROM_FILE"',
            '"MAZE"',
            "fieldsource: expected FIELD_FROM_FILE or RANDOM_FIELD, not 'MAZE'",
        ),
        ('random_source="false"', 'random_source="true"', "random source"),
        (
            'activation_function="LINEAR"',
            'activation_function="TANH"',
            "unknown activation function 'TANH'",
        ),
        (
            '<weight from="3">0.5</weight>',
            "",
            "node 10 of a network does not have one weight from each of its 14 nodes",
        ),
        ('<weight from="3">', '<weight from="4">', "does not have one weight from each"),
        (
            '<weight from="3">0.5',
            '<weight from="3">NaN',
            "a weight or bias: expected a finite number, not 'NaN'",
        ),
        ('<weight from="3">0.5', '<weight from="3">1e39', "expected a number of 32 bits"),
        ('<weight from="3">0.5', '<weight from="3">1_0', "expected a finite number"),
        (
            '<weight from="3">0.5',
            f'<weight from="3">{"9" * 5000}',
            "expected a finite number",
        ),
        ("<bias>0.25</bias>", "", "expected a finite number, not ''"),
        ('nodes="14"', 'nodes="15"', "does not hold the nodes that it states"),
        (
            'nodes="14"',
            'nodes="99999999999999999"',
            "does not hold the nodes that it states",
        ),
        ('<node nr="0" ', '<node nr="1" ', "does not hold the nodes that it states"),
        (
            'input_nodes="10"',
            'input_nodes="-1"',
            "does not hold the nodes that it states",
        ),
        (
            'input_nodes="10"',
            'input_nodes="ten"',
            "input_nodes: expected a whole number, not 'ten'",
        ),
        ('fitness="-3.5"', 'fitness="Infinity"', "fitness: expected a finite number"),
        ('fitness="-3.5"', 'fitness="NaN"', "none of its networks has a fitness"),
        ('fitness="-3.5"', "", "fitness: expected a finite number, not ''"),
        ('count="1"', 'count="2"', "does not hold as many populations as it states"),
        ('generation="4"', 'generation="four"', "generation: expected a whole number"),
        ('value="12345"', 'value="-1"', "seed: expected int >= 0"),
        ('value="0.3f"', 'value="-1f"', "severity: expected float > 0"),
        (
            '"steps" type="STRING" value="50"',
            '"steps" type="STRING" value="0"',
            "steps: expected int >= 1",
        ),
        ("<frevo>", "<html>", "mismatched tag"),
    ],
)
def test_unsupported_contents_are_named(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    assert old in ONE
    assert words in refusal(tmp_path, ONE.replace(old, new, 1))


def test_the_element_of_an_unsupported_representation_is_named(tmp_path: Path) -> None:
    other = ONE.replace("FullyMeshedNet input", "ThreeLayerNetwork input").replace(
        "</FullyMeshedNet>", "</ThreeLayerNetwork>"
    )
    assert "it holds 'ThreeLayerNetwork'; only results of FullyMeshedNet" in refusal(
        tmp_path, other
    )


def test_networks_of_another_size_than_the_problems_are_refused(tmp_path: Path) -> None:
    net = zre.net([[0.5] * 7] * 4, [0.25] * 4, -3.5, inputs=3)
    assert (
        "its networks have 3 inputs and 2 outputs; emergency-exit has 10 and 2"
        in refusal(tmp_path, zre.text([net]))
    )


def test_networks_that_differ_are_refused(tmp_path: Path) -> None:
    nets = [
        zre.net([[0.5] * 14] * 4, [0.25] * 4, -3.5, activation)
        for activation in ("LINEAR", "RELU")
    ]
    assert "not all of one kind" in refusal(tmp_path, zre.text(nets))
    nets = [
        zre.net([[0.5] * (10 + nodes)] * nodes, [0.25] * nodes, -3.5) for nodes in (3, 4)
    ]
    assert "not all of one kind" in refusal(tmp_path, zre.text(nets))


@pytest.mark.long
def test_a_network_takes_no_more_memory_than_its_file(tmp_path: Path) -> None:
    """Very many nodes without a weight: the table that they would need is not made."""
    nodes = "".join(f'<node nr="{number}"/>' for number in range(40_000))
    attributes = 'input_nodes="10" output_nodes="2" nodes="40000"'
    net = f"<FullyMeshedNet {attributes}><nodes>{nodes}</nodes></FullyMeshedNet>"
    tracemalloc.start()
    try:
        assert (
            "node 10 of a network does not have one weight from each of its 40000 nodes"
            in refusal(tmp_path, zre.text([net]))
        )
        assert tracemalloc.get_traced_memory()[1] < 1 << 30
    finally:
        tracemalloc.stop()


ENTITIES = '<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">'
BOMB = f"<!DOCTYPE frevo [{ENTITIES}]><frevo>&b;</frevo>"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("", "damaged, or not XML: no element found"),
        ("PK\x03\x04", "damaged, or not XML: not well-formed"),
        ("<frevo/>", "it names no problem"),
        ("<html></html>", "its outermost element is 'html'"),
        (BOMB, "it declares a document type"),
        (
            '<!DOCTYPE frevo [<!ENTITY x SYSTEM "/etc/passwd">]><frevo>&x;</frevo>',
            "it declares a document type",
        ),
        (
            '<!DOCTYPE frevo SYSTEM "x.dtd" [<!ENTITY % p SYSTEM "y">%p;]><frevo/>',
            "it declares a document type",
        ),
        ('<!DOCTYPE frevo SYSTEM "ISave.dtd"><frevo>&x;</frevo>', "it names no problem"),
        ("<a>" * 100_000, "nested deeper than 32"),
        ("<frevo><populations><population><x/>", "it holds 'x'"),
        (
            '<?xml version="1.0" encoding="none"?><frevo/>',
            "damaged, or not XML: unknown encoding",
        ),
        (b"<frevo>\xff</frevo>", "not well-formed"),
        ("<frevo>\x00</frevo>", "not well-formed"),
        ("<frevo \u202e='1'/>", "not well-formed"),
    ],
)
def test_invalid_result_files_are_refused(
    tmp_path: Path, content: str | bytes, words: str
) -> None:
    assert words in refusal(tmp_path, content)


@pytest.mark.parametrize("share", [0.01, 0.2, 0.5, 0.9, 0.99, 0.999])
def test_a_truncated_file_is_refused(tmp_path: Path, share: float) -> None:
    assert "damaged, or not XML" in refusal(tmp_path, FILE[: int(len(FILE) * share)])


def test_a_file_that_is_too_large_is_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(by_content, "MAX_BYTES", 1 << 20)
    path = write(tmp_path, "")
    with path.open("wb") as file:
        file.truncate(10 << 30)
    with pytest.raises(ConfigError, match="too large: expected at most 1 MiB"):
        by_content.load(path)


@pytest.mark.parametrize(
    "name", ["missing.zre", "", "file/below.zre", "nul\0.zre", "x" * 300]
)
def test_a_path_that_cannot_be_read_is_named(tmp_path: Path, name: str) -> None:
    write(tmp_path, "", "file")
    with pytest.raises(ConfigError, match="cannot be read") as caught:
        by_content.load(tmp_path / name)
    assert str(caught.value).isprintable()


@settings(
    derandomize=True,
    max_examples=150,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(st.integers(0, len(ONE)), st.binary(max_size=8), st.integers(0, 8))
def test_a_damaged_file_is_imported_or_refused(
    tmp_path: Path, place: int, put: bytes, lost: int
) -> None:
    body = ONE.encode()
    path = write(tmp_path, body[:place] + put + body[place + lost :])
    try:
        found = by_content.load(path).source
    except ConfigError as error:
        found = str(error)
    assert found.isprintable()


# ---- the command


def test_import_prints_what_it_created(tmp_path: Path) -> None:
    path, out = write(tmp_path, FILE, "best\x1b[2J.zre"), str(tmp_path / "runs")
    said = CliRunner().invoke(import_command, [str(path), "--out", out])
    assert said.stdout.splitlines() == [
        "best\\x1b[2J.zre: generation 4 of FREVO's nnga.NNGA",
        "10 candidates, best fitness -13.831 (mean of 2 trials) according to FREVO",
        "the best was played here: the same fitness",
        f"run     {out}/default",
    ]
    said = CliRunner().invoke(import_command, [str(path), "--out", out, "--json"])
    assert json.loads(said.stdout) == {
        "run": f"{out}/default-2",
        "imported_from": "best\\x1b[2J.zre: generation 4 of FREVO's nnga.NNGA",
        "generation": 4,
        "candidates": 10,
        "best": FITNESS[0],
        "trials": 2,
        "played": FITNESS[0],
    }


def test_import_fails_with_one_line(tmp_path: Path) -> None:
    path = write(tmp_path, BOMB, "x\x1b.zre")
    command = [
        sys.executable,
        "-m",
        "zswarm.ot",
        "import",
        str(path),
        "--out",
        str(tmp_path / "runs"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    (complaint,) = done.stderr.splitlines()
    assert (done.returncode, done.stdout) == (2, "")
    assert complaint.startswith("zswarm-ot: ")
    assert complaint.isprintable()
    assert not (tmp_path / "runs").exists()


def test_more_elements_than_a_result_has_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each takes some 700 bytes of memory: a small file could fill it."""
    monkeypatch.setattr(frevo_file, "MAX_ELEMENTS", 1000)
    assert frevo_file.parse(b"<frevo>" + b"<a/>" * 999 + b"</frevo>")[1] == []
    with pytest.raises(ConfigError, match="more than 1,000 elements"):
        frevo_file.parse(b"<frevo>" + b"<a/>" * 1000 + b"</frevo>")
