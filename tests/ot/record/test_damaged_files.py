"""Files of any content: an experiment or a champion is read, or refused in one line."""

import string
import tomllib
from pathlib import Path
from typing import Any

import msgspec
import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from zswarm import experiment
from zswarm.champion.controller import Controller, load_controller
from zswarm.errors import ConfigError
from zswarm.experiment import Experiment

FUZZ = settings(
    derandomize=True,
    max_examples=150,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
EXAMPLE = (experiment.examples_folder() / "minisim.toml").read_text(encoding="utf-8")
NAMES = st.one_of(
    st.sampled_from(
        [
            "name",
            "seed",
            "generations",
            "problem",
            "representation",
            "optimizer",
            "cluster",
            "kind",
            "simulator",
            "settings",
            "trials",
            "seeds",
            "realm",
            "servers",
            "connect",
            "local_slots",
            "trial_timeout_s",
            "trial_memory_mb",
            "verify",
        ]
    ),
    st.text(string.ascii_lowercase + " .\x1b\u202e", max_size=6),
)
VALUES = st.recursive(
    st.one_of(
        st.booleans(),
        st.integers(-(2**70), 2**70),
        st.floats(),
        st.text(max_size=8),
        st.dates(),
        st.times(),
        st.sampled_from(["minisim", "fully-meshed", "nnga", "auto", "fixed"]),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(NAMES, inner, max_size=4)
    ),
    max_leaves=12,
)


def read(path: Path, *overrides: str) -> Experiment | str:
    """Return the experiment with its defaults written out, or the refusal."""
    try:
        return experiment.complete(experiment.load(path, overrides), path.name)
    except ConfigError as error:
        return str(error)


def ends_well(path: Path, *overrides: str) -> bool:
    """Return whether it is refused in a safe line, or the same after writing and reading it."""
    found = read(path, *overrides)
    if isinstance(found, str):
        # What the user typed is shown as it is.
        return found.isprintable() or bool(overrides)
    written = experiment.to_toml(found)
    (path.parent / "again.toml").write_text(written, encoding="utf-8")
    again = read(path.parent / "again.toml")
    return isinstance(again, Experiment) and experiment.to_toml(again) == written


@FUZZ
@given(st.dictionaries(NAMES, VALUES, max_size=6))
def test_any_mapping_is_an_experiment_or_refused(
    tmp_path: Path, mapping: dict[str, Any]
) -> None:
    (tmp_path / "any.toml").write_text(
        tomli_w.dumps(mapping), encoding="utf-8", errors="replace"
    )
    assert ends_well(tmp_path / "any.toml")


@FUZZ
@given(st.data())
def test_an_experiment_with_any_value_in_it_is_read_or_refused(
    tmp_path: Path, data: st.DataObject
) -> None:
    mapping = tomllib.loads(EXAMPLE)
    table = mapping
    for name in data.draw(
        st.sampled_from(
            [
                (),
                ("problem",),
                ("problem", "settings"),
                ("representation",),
                ("optimizer",),
                ("cluster",),
            ]
        )
    ):
        table = table.setdefault(name, {})
    table[data.draw(st.one_of(st.sampled_from(sorted(table) or ["x"]), NAMES))] = (
        data.draw(VALUES)
    )
    (tmp_path / "any.toml").write_text(
        tomli_w.dumps(mapping), encoding="utf-8", errors="replace"
    )
    assert ends_well(tmp_path / "any.toml")


@FUZZ
@given(st.integers(0, len(EXAMPLE)), st.binary(max_size=8), st.integers(0, 8))
def test_a_damaged_experiment_is_read_or_refused(
    tmp_path: Path, place: int, put: bytes, lost: int
) -> None:
    body = EXAMPLE.encode()
    (tmp_path / "any.toml").write_bytes(body[:place] + put + body[place + lost :])
    assert ends_well(tmp_path / "any.toml")


@FUZZ
@given(
    st.one_of(st.text(max_size=30), st.tuples(NAMES, st.text(max_size=12)).map("=".join))
)
def test_any_override_is_taken_or_refused(tmp_path: Path, override: str) -> None:
    (tmp_path / "any.toml").write_text(EXAMPLE, encoding="utf-8")
    assert ends_well(tmp_path / "any.toml", override)


DEEP = 100_000


@pytest.mark.parametrize(
    "text",
    [
        "x = " + "[" * DEEP,
        "x = " + "{a=" * DEEP,
        "x = " + "9" * 5000,
        "x" * DEEP,
        ".".join("x" * 3000) + " = 1",
        "seed = 1e999",
    ],
    ids=lambda text: text[:10],
)
def test_extreme_toml_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "any.toml").write_text(text)
    assert isinstance(read(tmp_path / "any.toml"), str)
    (tmp_path / "any.toml").write_text(EXAMPLE)
    assert isinstance(
        read(tmp_path / "any.toml", f"problem.settings.{text.replace(' ', '')}"), str
    )


CHAMPION = msgspec.msgpack.encode(
    Controller(
        simulator="minisim",
        simulator_settings={"steps": 3, "deep": [{"x": 1.5}]},
        representation="fully-meshed",
        representation_settings={},
        inputs=9,
        outputs=2,
        sensors=["a"],
        actuators=["b"],
        genome=bytes(8),
        fitness=1.0,
        run="minisim",
    )
)


def controller(path: Path, body: bytes) -> Controller | str:
    """Return what is read from a file with these bytes, or the refusal."""
    path.write_bytes(body)
    try:
        return load_controller(path)
    except ConfigError as error:
        return str(error)


def champion_ends_well(path: Path, body: bytes) -> bool:
    """Refused in one line, or written again and read it is the same controller."""
    found = controller(path, body)
    if isinstance(found, str):
        return found.isprintable()
    written = msgspec.msgpack.encode(found)
    return msgspec.msgpack.encode(controller(path, written)) == written


@FUZZ
@given(st.binary(max_size=100))
def test_any_bytes_are_a_champion_or_refused(tmp_path: Path, body: bytes) -> None:
    assert champion_ends_well(tmp_path / "any.zsc", body)


@FUZZ
@given(st.integers(0, len(CHAMPION)), st.binary(max_size=8), st.integers(0, 8))
def test_a_damaged_champion_is_read_or_refused(
    tmp_path: Path, place: int, put: bytes, lost: int
) -> None:
    assert champion_ends_well(
        tmp_path / "any.zsc", CHAMPION[:place] + put + CHAMPION[place + lost :]
    )


# Each promises four thousand million of something.
PROMISES = [bytes([header]) + b"\xff\xff\xff\xff" for header in (0xC6, 0xDD, 0xDF)]


@pytest.mark.parametrize(
    "raw",
    [b"\x91" * DEEP, b"\x81\xa1a" * DEEP, b"\xa1\xff", *PROMISES],
    ids=lambda raw: raw[:6].hex(),
)
def test_an_extreme_champion_is_refused(tmp_path: Path, raw: bytes) -> None:
    inner = msgspec.msgpack.encode(1.5)
    assert CHAMPION.count(inner) == 1
    assert isinstance(controller(tmp_path / "any.zsc", CHAMPION), Controller)
    assert isinstance(controller(tmp_path / "any.zsc", CHAMPION.replace(inner, raw)), str)
