"""The documents name every command, option, message and column of the code."""

import importlib
import json
import re
import sqlite3
import typing
from pathlib import Path

import click
import msgspec
import numpy as np
import pytest

from tests.repository import REPOSITORY
from zswarm import experiment, router
from zswarm.champion.controller import Controller
from zswarm.config import sections, settings_docs
from zswarm.errors import ConfigError
from zswarm.ot import cli as ot
from zswarm.ot.commands import new
from zswarm.ot.commands.shared import exits
from zswarm.ot.rankings.ranking import Round
from zswarm.ot.record import schema
from zswarm.plugins import registry as plugins
from zswarm.protocol import codec, messages
from zswarm.security import cli as security
from zswarm.ss import cli as ss
from zswarm.ss.local.metrics import Metrics
from zswarm.ss.local.snapshot import SLOT_STATES, View
from zswarm.ss.server import Options

DOCS = REPOSITORY / "docs"
_CONTEXT = click.Context(ot.command)
COMMANDS = {
    name: command
    for name in ot.command.list_commands(_CONTEXT)
    if (command := ot.command.get_command(_CONTEXT, name)) is not None
}
CODE_BLOCK = re.compile(r"^```.*?^```\n", re.S | re.M)
MESSAGES = [
    *typing.get_args(messages.Request),
    *typing.get_args(messages.Reply),
    messages.Sensors,
    messages.Actuators,
]
PARTS = [(kind, name) for kind in plugins.BUNDLED for name in plugins.BUNDLED[kind]]


def text(document: str) -> str:
    return (DOCS / document).read_text(encoding="utf-8")


def section(document: str, *headings: str) -> str:
    """Return the text below a heading, without code blocks, up to the next heading of its level."""
    prose = CODE_BLOCK.sub("", text(document))
    for heading in headings:
        level = heading.index(" ")
        found = re.search(
            rf"^{re.escape(heading)}$\n(.*?)(?=^#{{1,{level}}} |\Z)", prose, re.S | re.M
        )
        assert found, f"docs/{document} has no section {' / '.join(headings)!r}"
        prose = found[1]
    return prose


def rows(document: str, heading: str) -> dict[str, str]:
    """Return the rows of a section's tables by the names in their first cell."""
    table = {}
    for line in section(document, heading).splitlines():
        if line.startswith("|"):
            first, *rest = line.replace(r"\|", "/").strip("|").split("|")
            table.update(dict.fromkeys(re.findall(r"`([^`]+)`", first), " | ".join(rest)))
    return table


def fields(struct: type[msgspec.Struct]) -> list[msgspec.structs.FieldInfo]:
    return list(msgspec.structs.fields(struct))


def settings(kind: plugins.Kind, name: str) -> type[msgspec.Struct]:
    loaded: type[msgspec.Struct] = plugins.load(kind, name).settings_type
    return loaded


# ---- commands


def options(command: click.Command) -> list[click.Option]:
    return [
        option
        for option in command.params
        if isinstance(option, click.Option) and not option.hidden
    ]


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_of_the_optimizer_is_documented_with_its_options(name: str) -> None:
    """Each command has a section in commands.md that mentions every option of --help."""
    documented = section("commands.md", f"### {name}")
    for option in options(COMMANDS[name]):
        for spelling in [*option.opts, *option.secondary_opts]:
            assert f"`{spelling}`" in documented, (
                f"docs/commands.md, {name}: {spelling} is missing"
            )


@pytest.mark.parametrize("name", sorted(security.command.commands))
def test_every_command_of_keys_is_documented_with_its_options(name: str) -> None:
    """Each has a section in commands.md; what several share has its row above them."""
    documented = section("commands.md", f"### zswarm-keys {name}")
    for option in options(security.command.commands[name]):
        for spelling in [*option.opts, *option.secondary_opts]:
            assert f"`{spelling}`" in documented, (
                f"docs/commands.md, zswarm-keys {name}: {spelling} is missing"
            )


def test_every_documented_command_exists() -> None:
    """The sections below zswarm-ot and zswarm-keys are their commands."""
    assert set(
        re.findall(r"^### (.*)$", section("commands.md", "## zswarm-ot"), re.M)
    ) == set(COMMANDS)
    documented = re.findall(
        r"^### zswarm-keys (.*)$", section("commands.md", "## zswarm-keys"), re.M
    )
    assert set(documented) == set(security.command.commands)


@pytest.mark.parametrize(
    ("program", "command", "keys"),
    [
        ("zswarm-ss", ss.command, Options),
        ("zswarm-router", router.command, router.RouterOptions),
    ],
    ids=["zswarm-ss", "zswarm-router"],
)
def test_every_option_of_a_daemon_is_documented(
    program: str, command: click.Command, keys: type[msgspec.Struct]
) -> None:
    """Options of the command line and keys of the --config file are both checked."""
    documented = section("commands.md", f"## {program}")
    for option in options(command):
        for spelling in [*option.opts, *option.secondary_opts]:
            assert f"`{spelling}`" in documented, (
                f"docs/commands.md, {program}: {spelling} is missing"
            )
    for field in fields(keys):
        assert f"`{field.name}`" in documented, (
            f"docs/commands.md, {program}: the key {field.name} is missing"
        )


@pytest.mark.parametrize("name", sorted(ss.command.commands))
def test_every_command_of_the_server_is_documented_with_its_options(name: str) -> None:
    documented = section("commands.md", "## zswarm-ss")
    assert f"`zswarm-ss {name}`" in documented
    for option in options(ss.command.commands[name]):
        assert all(f"`{spelling}`" in documented for spelling in option.opts)


def test_every_metric_is_documented_with_its_labels() -> None:
    """Every state of a slot is documented, too."""
    documented = section("commands.md", "## zswarm-ss")
    shown = View(
        server="",
        program="",
        pid=0,
        realm="",
        listen=[],
        since=0.0,
        warm=True,
        draining=False,
        slots=dict.fromkeys(SLOT_STATES, 0),
        leases=[],
        trials=0,
        trials_per_s=0.0,
        busy_s=0.0,
        faults={"crashed": 1},
        malformed=0,
        waiting_batches=0,
        waiting_queries=0,
        slot_memory_mb=0,
        missed=[],
    )
    metrics = Metrics.__new__(Metrics)
    metrics.view = shown
    for family in metrics.collect():
        for sample in family.samples:
            assert f"`{sample.name}`" in documented
            assert all(f"`{label}`" in documented for label in sample.labels)
    for state in SLOT_STATES:
        assert f"\n| {state} | " in documented


@pytest.mark.parametrize(
    "code", [code for name, code in vars(exits).items() if name.startswith("EXIT_")]
)
def test_every_exit_code_of_the_optimizer_is_documented(code: int) -> None:
    """Each code has a row in the table of exit codes."""
    assert f"\n| {code} | " in section("commands.md", "## zswarm-ot")


# ---- the wire


@pytest.mark.parametrize(
    "message", MESSAGES, ids=lambda message: message.__struct_config__.tag
)
def test_every_field_of_every_message_is_documented(
    message: type[msgspec.Struct],
) -> None:
    """The table of a message has its fields, no others, in their order."""
    documented = list(rows("protocol.md", f"### {message.__struct_config__.tag}"))
    assert documented == [field.name for field in fields(message) if field.name != "v"]


def test_every_request_and_refusal_code_is_in_its_table() -> None:
    """The states of a lease are documented, too."""
    requests = {
        message.__struct_config__.tag for message in typing.get_args(messages.Request)
    }
    assert requests <= set(rows("protocol.md", "## Messages"))
    assert set(rows("protocol.md", "## Refusals")) == set(
        typing.get_args(messages.Refusal)
    )
    states = rows("protocol.md", "### lease")["state"]
    assert set(re.findall(r"`([a-z]+)`", states)) == set(typing.get_args(messages.State))


def test_the_limits_of_the_wire_are_stated() -> None:
    """The section on encoding states each limit as a number."""
    stated = section("protocol.md", "## Encoding")
    for limit in (
        messages.MAX_MESSAGE,
        messages.MAX_GENOMES,
        messages.MAX_GENOME,
        messages.MAX_TRIALS,
        messages.MAX_SLOTS,
        messages.MAX_TEXT,
        messages.MAX_VALUES,
        messages.MAX_SETTINGS,
        messages.MAX_EPOCH,
        *messages.MAX_REQUEST.values(),
    ):
        assert f"{limit:,}" in stated, f"docs/protocol.md: the limit {limit:,} is missing"


EXAMPLES = re.findall(r"```hex\n(.*?)```\s*```json\n(.*?)```", text("protocol.md"), re.S)


@pytest.mark.parametrize(
    ("hex_", "meaning"),
    EXAMPLES,
    ids=[json.loads(meaning)["type"] for _, meaning in EXAMPLES],
)
def test_an_example_of_the_wire_decodes_to_what_the_text_says(
    hex_: str, meaning: str
) -> None:
    """The codec encodes it to the same bytes, whose number stands in the text before."""
    body, stated = bytes.fromhex(hex_), json.loads(meaning)
    assert plain(msgspec.msgpack.decode(body)) == stated
    requests = {
        message.__struct_config__.tag for message in typing.get_args(messages.Request)
    }
    message = (
        codec.decode_request if stated["type"] in requests else codec.decode_reply
    )(body)
    assert codec.encode(message) == body
    assert f"`{stated['type']}`, {len(body)} bytes" in section(
        "protocol.md", "## An example"
    )


def test_every_step_of_the_protocol_has_an_example() -> None:
    """One of each step from the first question to the outcomes."""
    assert [json.loads(meaning)["type"] for _, meaning in EXAMPLES] == [
        "requirements",
        "offer",
        "reserve",
        "lease",
        "evaluate",
        "outcomes",
    ]


def plain(value: object) -> object:
    """Return bytes as 0x..., as in the text."""
    match value:
        case bytes():
            return "0x" + value.hex()
        case dict():
            return {key: plain(item) for key, item in value.items()}
        case list():
            return [plain(item) for item in value]
    return value


# ---- the experiment file


@pytest.mark.parametrize(
    ("headings", "struct"),
    [
        (("## `[problem]`",), sections.ProblemConfig),
        (("## `[assessment]`",), sections.AssessmentConfig),
        (("## `[cluster]`",), sections.ClusterConfig),
        (("## `[record]`",), sections.RecordConfig),
        (("## `[stop]`",), sections.StopConfig),
        (("## `[study]`",), sections.StudyConfig),
        *(
            ((f"## Settings of the {kind}s", f"### {name}"), settings(kind, name))
            for kind, name in PARTS
        ),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_every_key_of_an_experiment_is_documented(
    headings: tuple[str, ...], struct: type[msgspec.Struct]
) -> None:
    """The table in experiment.md is what the struct says: type and range, default, meaning."""
    keys = settings_docs.keys(struct)
    assert (settings_docs.markdown(keys) if keys else "") in section(
        "experiment.md", *headings
    )


@pytest.mark.parametrize(
    "struct",
    [
        sections.ProblemConfig,
        sections.AssessmentConfig,
        sections.ClusterConfig,
        sections.RecordConfig,
        sections.StopConfig,
        sections.StudyConfig,
        *(settings(kind, name) for kind, name in PARTS),
    ],
)
def test_every_key_of_an_experiment_has_a_description(
    struct: type[msgspec.Struct],
) -> None:
    assert [key.name for key in settings_docs.keys(struct) if not key.meaning] == []


def test_the_top_level_keys_of_an_experiment_are_documented() -> None:
    """The plain ones in a table, the tables each in a section."""
    tables = {*experiment.TABLES}
    plain_keys = [
        field.name for field in fields(experiment.Experiment) if field.name not in tables
    ]
    assert [key.name for key in experiment.top_level()] == plain_keys
    assert settings_docs.markdown(experiment.top_level()) in section(
        "experiment.md", "## Top level"
    )
    assert set(re.findall(r"^## `\[(.*)\]`$", text("experiment.md"), re.M)) == tables


# ---- the record


def empty_record() -> sqlite3.Connection:
    database = sqlite3.connect(":memory:")
    database.executescript(schema.CREATE)
    return database


def tables() -> dict[str, list[str]]:
    database = empty_record()
    names = [
        row[0]
        for row in database.execute(
            "SELECT name FROM sqlite_master WHERE type IN ('table', 'view')"
        )
    ]
    found = {
        name: [row[1] for row in database.execute(f"PRAGMA table_info({name})")]
        for name in names
    }
    database.close()
    return found


@pytest.mark.parametrize("table", sorted(tables()))
def test_every_column_of_the_record_is_documented(table: str) -> None:
    """The section of a table names its columns first, in their order."""
    columns = tables()[table]
    assert list(rows("record.md", f"### {table}"))[: len(columns)] == columns


def test_the_queries_of_the_record_fit_its_schema() -> None:
    """SQLite compiles each query."""
    database = empty_record()
    found = re.search(r"## Queries\n\n```sql\n(.*?)```", text("record.md"), re.S)
    assert found
    queries = [query for query in found[1].split(";") if query.strip()]
    assert len(queries) >= 5
    for query in queries:
        database.execute(query)
    database.close()


def test_every_field_of_a_champion_is_documented() -> None:
    """The fields are listed in the order in which they are written, with the format first."""
    names = [field.name for field in fields(Controller)]
    assert list(rows("record.md", "## champion.zsc")) == ["format", *names]


# ---- all documents


@pytest.mark.parametrize("document", sorted(path.name for path in DOCS.glob("*.md")))
def test_links_between_documents_exist(document: str) -> None:
    """Every link to another document names a file that is there."""
    for target in re.findall(r"\]\(([^)#:]+)\)", text(document)):
        assert (DOCS / target).is_file(), f"docs/{document}: {target} is not there"


def test_the_simulator_that_is_shown_is_the_one_that_new_writes() -> None:
    """The whole module; its tests are in test_new.py."""
    blocks = dict(
        re.findall(r"`([\w.]+)`:\n\n```\w+\n(.*?)```", text("own-simulator.md"), re.S)
    )
    assert blocks == {"lost_robots.py": new.skeleton("lost-robots")["lost_robots.py"]}


def test_the_example_optimizer_keeps_the_contract(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The code in optimizers.md is a whole optimizer."""
    blocks = dict(
        re.findall(
            r"`(\w+climber\.py)`:\n\n```python\n(.*?)```", text("optimizers.md"), re.S
        )
    )
    assert set(blocks) == {"zswarm_climber.py", "test_climber.py"}
    for name, content in blocks.items():
        (tmp_path / name).write_text(content, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    namespace: dict[str, typing.Any] = {}
    exec(compile(blocks["test_climber.py"], "test_climber.py", "exec"), namespace)  # noqa: S102  our own text
    namespace["test_climber_keeps_the_contract"]()


def test_the_example_ranking_ranks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The code in co-evolution.md is a complete ranking."""
    blocks = dict(
        re.findall(
            r"`(\w+rivals\.py)`:\n\n```python\n(.*?)```", text("co-evolution.md"), re.S
        )
    )
    (tmp_path / "zswarm_rivals.py").write_text(
        blocks["zswarm_rivals.py"], encoding="utf-8"
    )
    monkeypatch.syspath_prepend(tmp_path)
    rivals = importlib.import_module("zswarm_rivals")
    ranking = rivals.Rivals(rivals.Settings(games=2), 2)
    games = ranking.next_games(5, [])
    assert np.bincount(games.ravel()).tolist() == [4] * 5
    # The higher number is better, but the highest fails.
    results = np.where(games == 4, np.nan, games.astype(float))
    played = [Round(games, results)]
    assert ranking.next_games(5, played) is None
    np.testing.assert_array_equal(ranking.scores(5, played), [1, 2, 3, 4, np.nan])
    with pytest.raises(ConfigError, match="2 candidates are too few"):
        ranking.next_games(2, [])


@pytest.mark.parametrize("name", plugins.BUNDLED["optimizer"])
def test_every_optimizer_and_its_statistics_are_documented(name: str) -> None:
    """A row says what it is for, and what it takes; every statistic has its meaning."""
    loaded = plugins.load("optimizer", name)
    given = {
        "measures": ["one", "other"],
        "lows": [0, 0],
        "highs": [1, 1],
        "cells": [3, 3],
    }
    wanted = {
        key: value
        for key, value in given.items()
        if key in loaded.settings_type.__struct_fields__
    }
    network_class = plugins.load(
        "representation",
        name if name in plugins.BUNDLED["representation"] else "fully-meshed",
    )
    network = network_class(network_class.settings_type(), 2, 1)
    optimizer = loaded(msgspec.convert(wanted, loaded.settings_type), network, 1)
    genomes = optimizer.ask()
    optimizer.tell(
        np.arange(float(len(genomes))),
        np.arange(float(len(genomes) * len(optimizer.measures))).reshape(
            len(genomes), -1
        ),
    )
    row = rows("optimizers.md", "## Which one")[name]
    assert [cell.strip() for cell in row.strip(" |").split("|")][2:] == [
        "yes" if loaded.competes else "no",
        "yes" if optimizer.measures else "no",
    ]
    page = text("optimizers.md")
    assert [
        statistic for statistic in optimizer.statistics() if f"`{statistic}`" not in page
    ] == []


def faults() -> list[list[str]]:
    """Return the cells of every fault."""
    lines = [line for line in text("faults.md").splitlines() if line.startswith("| ")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [row for row in cells if row[0] not in ("fault", "---")]


@pytest.mark.parametrize("row", faults(), ids=lambda row: row[0])
def test_every_fault_has_its_test(row: list[str]) -> None:
    assert len(row) == 5
    files = [DOCS / path for path in re.findall(r"\]\(([^)]+)\)", row[4])]
    names = re.findall(r"`(test_\w+)`", row[4])
    source = "".join(file.read_text() for file in files)
    assert names
    for name in names:
        assert f"\ndef {name}(" in source
