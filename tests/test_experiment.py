"""Experiment files: valid ones round-trip, others are refused in one clear line."""

from pathlib import Path
from typing import Any

import pytest

from tests.smallest_experiment import SMALL, small
from zswarm import experiment
from zswarm.errors import ConfigError, UnknownPlugin
from zswarm.experiment import Experiment, complete, load, to_toml, with_cluster

EXAMPLES = sorted(experiment.examples_folder().glob("*.toml"))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return small(tmp_path)


def completed(path: Path, *overrides: str) -> Experiment:
    return complete(load(path, overrides), path.name)


def refusal(call: Any, *arguments: Any) -> str:
    with pytest.raises(ConfigError) as refused:
        call(*arguments)
    assert "\n" not in str(refused.value)
    return str(refused.value)


# ---- what is read


def test_a_complete_experiment_has_every_default(file: Path) -> None:
    whole = completed(file)
    assert (whole.name, whole.seed, whole.generations) == ("small", 7, 3)
    assert (whole.problem.trials, whole.problem.seeds) == (1, "fixed")
    assert whole.problem.settings["agents"] == 10
    assert whole.representation.settings["hidden"] == 2
    assert whole.optimizer.settings["population"] == 50
    assert "kind" not in whole.optimizer.settings
    assert whole.cluster.servers == "auto"


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_every_example_loads_and_is_named_after_its_file(path: Path) -> None:
    assert completed(path).name == path.stem
    assert experiment.find(path.stem) == path


def test_bundled_examples_are_found() -> None:
    assert {"emergency-exit", "minisim", "stadium"} <= {path.stem for path in EXAMPLES}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_a_written_experiment_round_trips(path: Path, tmp_path: Path) -> None:
    for number, whole in enumerate(
        (load(path), completed(path), completed(path, 'cluster.connect=["tcp/a:1"]'))
    ):
        written = tmp_path / f"{number}.toml"
        written.write_text(to_toml(whole))
        assert load(written) == whole
        assert to_toml(load(written)) == to_toml(whole)
    assert completed(written) == whole, "what is complete stays as it is"


def test_a_file_wins_over_an_example_of_the_same_name(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert experiment.find(str(file)) == file
    monkeypatch.chdir(file.parent)
    Path("minisim").write_text(SMALL)
    assert experiment.find("minisim") == Path("minisim")


def test_an_unknown_name_is_refused_with_the_nearest_example(tmp_path: Path) -> None:
    text = refusal(experiment.find, "minisin")
    assert text.startswith(
        "minisin: no such file or example (did you mean 'minisim'?); examples are "
    )
    assert "stadium" in text
    text = refusal(experiment.find, "nope.toml")
    assert text == "nope.toml: no such file; zswarm-ot list names the examples"
    assert refusal(experiment.find, str(tmp_path)).startswith(
        f"{tmp_path}: a folder; expected a file, or an example: "
    )
    (tmp_path / "experiment.toml").write_text(SMALL)
    assert refusal(experiment.find, str(tmp_path)).endswith(
        f"resume it with zswarm-ot resume, or name its experiment, {tmp_path}/experiment.toml"
    )


def test_a_byte_order_mark_is_skipped(file: Path) -> None:
    whole = load(file)
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    assert load(file) == whole


# ---- --set


def test_an_override_wins_over_the_file_and_creates_tables(file: Path) -> None:
    whole = load(
        file,
        [
            "seed=7",
            "problem.settings.agents = 3",
            "cluster.servers=local",
            "optimizer.population=20",
            "seed=8",
        ],
    )
    assert whole.seed == 8, "the last one wins"
    assert whole.problem.settings == {"agents": 3}
    assert whole.cluster.servers == "local"
    assert whole.optimizer.settings == {"population": 20}


def test_an_override_that_is_not_toml_is_a_string(file: Path) -> None:
    assert load(file, ["name=other-name"]).name == "other-name"
    assert load(file, ['name="other"']).name == "other"
    assert load(file, ['cluster.connect=["tcp/host:7467"]']).cluster.connect == [
        "tcp/host:7467"
    ]


@pytest.mark.parametrize("order", [1, -1])
def test_another_kind_starts_from_its_own_defaults(tmp_path: Path, order: int) -> None:
    """The file's settings of the previous kind are dropped, those of overrides stay."""
    file = small(tmp_path, "mutation = 0.5\n[problem.settings]\nagents = 3\n")
    changed = load(file, ["optimizer.kind=pso", "optimizer.population=7"][::order])
    assert (changed.optimizer.kind, changed.optimizer.settings) == (
        "pso",
        {"population": 7},
    )
    assert load(file, ["problem.simulator=xor"]).problem.settings == {}
    assert load(
        file, ["optimizer.kind=nnga", "problem.simulator=emergency-exit"]
    ) == load(file)
    assert load(file).optimizer.settings == {"mutation": 0.5}
    assert load(file).problem.settings == {"agents": 3}


@pytest.mark.parametrize(
    ("override", "text"),
    [
        ("seed", "--set seed: expected key=value, such as optimizer.population=100"),
        ("=3", "--set =3: expected key=value, such as optimizer.population=100"),
        ("name.x=3", "--set name.x=3: name is not a table"),
        (
            "name=a=b",
            "{file}: name: expected 1 to 63 of a-z, 0-9 and -, not starting with -, not 'a=b'",
        ),
        (
            "problem.trialz=3",
            "{file}: problem: unknown key 'trialz' (did you mean 'trials'?); known are: ",
        ),
        (
            "sed=3",
            "{file}: unknown key 'sed' (did you mean 'seed'?); known are: name, seed, ",
        ),
    ],
)
def test_an_impossible_override_is_refused(file: Path, override: str, text: str) -> None:
    assert refusal(load, file, [override]).startswith(text.format(file=file))


# ---- what is refused


@pytest.mark.parametrize(
    ("override", "text"),
    [
        ("seed=-1", "seed: expected int >= 0"),
        ("seed=9223372036854775807", "seed: expected int <= 9223372036854775806"),
        ("seed=99999999999999999999999", "seed: expected int <= 9223372036854775806"),
        ("seed=1.0", "seed: expected int, got float"),
        ("seed=true", "seed: expected int, got bool"),
        ("generations=0", "generations: expected int >= 1"),
        (
            "name=../escape",
            "name: expected 1 to 63 of a-z, 0-9 and -, not starting with -, not '../escape'",
        ),
        (
            "name=",
            "name: expected 1 to 63 of a-z, 0-9 and -, not starting with -, not ''",
        ),
        (
            "cluster.realm=a/**",
            "cluster.realm: expected 1 to 63 of a-z, 0-9 and -, not starting with -, not 'a/**'",
        ),
        ("problem.trials=0", "problem.trials: expected int >= 1"),
        ("problem.seeds=random", "problem.seeds: expected fixed or fresh, not 'random'"),
        ("problem.settings=5", "problem.settings: expected object, got int"),
        ("cluster.servers=0", "cluster.servers: expected int >= 1"),
        (
            "cluster.servers=all",
            "cluster.servers: expected auto, local or a number, not 'all'",
        ),
        ("cluster.trial_timeout_s=nan", "cluster.trial_timeout_s: expected float > 0.0"),
        (
            "cluster.trial_timeout_s=inf",
            "cluster.trial_timeout_s: expected float <= 1000000000.0",
        ),
        ("cluster.connect=tcp/a:1", "cluster.connect: expected array, got str"),
        (
            "cluster.connect=['tcp/a']",
            "cluster.connect: expected endpoints such as tcp/192.168.1.5:7467, not 'tcp/a': "
            "HOST:PORT must follow the protocol, an IPv6 address in brackets",
        ),
        (
            "cluster.on_fault=ignore",
            "cluster.on_fault: expected pause or quarantine, not 'ignore'",
        ),
        (
            "representation.kind=3",
            'representation: kind: expected the name of one, such as kind = "..."',
        ),
        ("optimizer=3", "optimizer: expected object, got int"),
    ],
)
def test_an_impossible_value_is_refused_with_file_and_key(
    file: Path, override: str, text: str
) -> None:
    assert refusal(load, file, [override]) == f"{file}: {text}"


@pytest.mark.parametrize(
    ("override", "text"),
    [
        (
            "optimizer.poplation=3",
            "optimizer: unknown key 'poplation' (did you mean 'population'?); known are: ",
        ),
        ("optimizer.population=1", "optimizer: population: expected int >= 2"),
        ("optimizer.random=nan", "optimizer: random: expected float >= 0.0"),
        ("representation.hidden=two", "representation: hidden: expected int, got str"),
        (
            "representation.weight_range=inf",
            "representation: weight_range: expected float <= 1000000.0",
        ),
        (
            "problem.settings.steps=1979-05-27",
            "problem.settings: steps: expected int, got date",
        ),
        (
            "problem.settings.agent.x=3",
            "problem.settings: unknown key 'agent' (did you mean 'agents'?); known are: ",
        ),
    ],
)
def test_an_impossible_setting_of_a_part_is_refused(
    file: Path, override: str, text: str
) -> None:
    assert refusal(completed, file, override).startswith(f"small.toml: {text}")


@pytest.mark.parametrize(
    ("override", "text"),
    [
        (
            "problem.simulator=minisin",
            "unknown simulator 'minisin' (did you mean 'minisim'?); known are: ",
        ),
        (
            "representation.kind=meshed",
            "unknown representation 'meshed' (did you mean 'fully-meshed'?); known are: ",
        ),
        ("optimizer.kind=xyz", "unknown optimizer 'xyz'; known are: "),
    ],
)
def test_an_unknown_part_is_refused_with_what_is_known(
    file: Path, override: str, text: str
) -> None:
    assert refusal(completed, file, override).startswith(
        f"small.toml: {override.split('=')[0]}: {text}"
    )
    with pytest.raises(UnknownPlugin):
        completed(file, override)


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"name", ": not TOML: Expected '=' after a key"),
        (b"name = 3\nname = 4", ": not TOML: Cannot overwrite a value"),
        (b"\xff\xfe\x00", ": not TOML: 'utf-8' codec"),
        (b"", ": key name is missing"),
        (SMALL.replace("seed = 7", "").encode(), ": key seed is missing"),
        (
            SMALL.replace('kind = "nnga"', "").encode(),
            ":9: optimizer: kind: expected the name of one",
        ),
        (
            SMALL.replace("[problem]", "[[problem]]").encode(),
            ":5: problem: expected object, got array",
        ),
        (
            (SMALL + "[clustr]").encode(),
            ":11: unknown key 'clustr' (did you mean 'cluster'?); known are: name, seed, ",
        ),
        (
            (SMALL + "[cluster]\nrelm = 3").encode(),
            ":12: cluster: unknown key 'relm' (did you mean 'realm'?); known are: ",
        ),
        (
            (SMALL + '[cluster]\nrealm = "a/b"').encode(),
            ":12: cluster.realm: expected 1 to 63 of a-z",
        ),
        (
            (SMALL + '[cluster]\nconnect = ["lab"]').encode(),
            ":12: cluster.connect: expected endpoints such as",
        ),
        (
            SMALL.replace('"nnga"', '"nnga"\ngenerations = 3\nname = "a b"')
            .encode()
            .replace(b"small", b"s m"),
            ":2: name: expected",
        ),
    ],
)
def test_a_bad_file_is_refused_in_one_clear_line(
    tmp_path: Path, content: bytes, text: str
) -> None:
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    assert refusal(load, path).startswith(f"{path}{text}")


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        (
            "[problem.settings]\nagents = 5\nstep = 3",
            ":13: problem.settings: unknown key 'step' (did you mean 'steps'?)",
        ),
        (
            "[problem.settings]\nsteps = 0",
            ":12: problem.settings: steps: expected int >= 1",
        ),
        (
            "populaton = 3",
            ":11: optimizer: unknown key 'populaton' (did you mean 'population'?)",
        ),
    ],
)
def test_a_mistake_in_the_settings_of_a_part_is_reported_with_its_line(
    file: Path, wrong: str, text: str
) -> None:
    file.write_text(SMALL + wrong)
    assert refusal(complete, load(file), str(file)).startswith(f"{file}{text}")


def test_an_unknown_part_is_reported_with_its_line(file: Path) -> None:
    file.write_text(SMALL.replace('"nnga"', '"nngo"'))
    assert refusal(complete, load(file), str(file)).startswith(
        f"{file}:10: optimizer.kind: unknown optimizer 'nngo'"
    )
    with pytest.raises(UnknownPlugin):
        complete(load(file), str(file))


def test_a_mistake_in_an_override_has_no_line(file: Path) -> None:
    """The file may even set the same key to a valid value."""
    file.write_text(SMALL + "population = 50")
    text = refusal(complete, load(file, ["optimizer.population=1"]), str(file))
    assert text.startswith(f"{file}: optimizer: population: expected int >= 2")
    assert refusal(load, file, ["seed=true"]).startswith(f"{file}: seed: expected int")


def test_an_unreadable_file_is_refused_with_the_reason(tmp_path: Path) -> None:
    assert (
        refusal(load, tmp_path / "none.toml")
        == f"{tmp_path}/none.toml: cannot be read: No such file or directory"
    )
    assert refusal(load, tmp_path) == f"{tmp_path}: cannot be read: Is a directory"


# ---- the cluster


def test_with_cluster_changes_nothing_else(file: Path) -> None:
    whole = completed(file)
    changed = with_cluster(whole, {"servers": 3, "realm": "lab"})
    assert (changed.cluster.servers, changed.cluster.realm) == (3, "lab")
    assert changed.problem == whole.problem
    assert refusal(with_cluster, whole, {"realm": "a/b"}).startswith(
        "cluster.realm: expected 1 to 63 of a-z"
    )
    assert (
        refusal(with_cluster, whole, {"servers": 0})
        == "cluster: servers: expected int >= 1"
    )
    assert refusal(with_cluster, whole, {"connect": ["lab"]}).startswith(
        "cluster.connect: expected endpoints such as"
    )


def test_a_router_must_be_named_if_multicast_is_off(file: Path) -> None:
    whole = load(file, ["cluster.through_router=true"])
    assert with_cluster(whole, {}).cluster.through_router
    assert with_cluster(
        whole, {"multicast": False, "connect": ["tcp/lab:7466"]}
    ).cluster.through_router
    assert "--connect tcp/ROUTER:7466" in refusal(
        with_cluster, whole, {"multicast": False}
    )


def test_the_default_number_of_slots_is_one_per_core(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(experiment.os, "cpu_count", lambda: 6)
    assert experiment.slots_of_this_machine(load(file).cluster) == 6
    assert (
        experiment.slots_of_this_machine(load(file, ["cluster.local_slots=2"]).cluster)
        == 2
    )
