"""What servers say of themselves, what experiments ask of them, and what is neither."""

import pytest

from zswarm import experiment
from zswarm.errors import ConfigError
from zswarm.protocol import labels
from zswarm.protocol.messages import MAX_LABELS

LAB = {
    "name": "lab-3",
    "gpu": "yes",
    "cores": "16",
    "room": "b12",
    "load": "0.5",
    "cpu": "AMD-EPYC-7543",
}


def refusal(reads: object, *arguments: object) -> str:
    with pytest.raises(ConfigError) as refused:
        reads(*arguments)  # type: ignore[operator]
    return str(refused.value)


def requirements(*texts: str) -> tuple[labels.Term, ...]:
    return labels.requirements(texts, "cluster.require")


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("gpu=yes", True),
        ("gpu=no", False),
        ("gpu=no|yes", True),
        ("gpu!=yes", False),
        ("gpu!=no", True),
        ("tpu=yes", False),
        ("tpu!=yes", True),
        ("name!=lab-1|lab-2", True),
        ("name!=lab-1|lab-3", False),
        ("cores>=16", True),
        ("cores>=16.5", False),
        ("cores <= 16", True),
        ("cores<=9", False),
        ("cores=16", True),
        ("cores=16.0", False),
        ("load<=0.5", True),
        ("room>=1", False),
        ("room<=1", False),
        ("tpus<=1", False),
    ],
)
def test_a_requirement_holds_of_a_server_or_not(text: str, holds: bool) -> None:
    """A missing label differs from every value; bounds need a number, and only there 16 is 16.0."""
    (term,) = requirements(text)
    assert term.holds(LAB) is holds
    assert labels.unmet([term], LAB) == ("" if holds else labels.unmet([term], LAB))


def test_unmet_requirements_are_named_with_the_servers_labels() -> None:
    terms = requirements("gpu=yes", "cores>=64", "tpu=v4|v5")
    told = (
        "the experiment requires cores>=64 (it has cores=16), tpu=v4|v5 (it has no tpu)"
    )
    assert labels.unmet(terms, LAB) == told
    assert labels.unmet(terms[:1], LAB) == ""


@pytest.mark.parametrize(
    "text",
    [
        "",
        "gpu",
        "=yes",
        "gpu=",
        "gpu==yes",
        "gpu=yes,no",
        "gpu=a||b",
        "Gpu=yes",
        "gpu~yes",
        "gpu=é",
    ],
)
def test_an_invalid_requirement_is_refused_with_the_expected_form(text: str) -> None:
    told = refusal(requirements, text)
    assert told.startswith(
        "cluster.require: expected requirements such as gpu=yes, room=b12|b13, "
    )
    assert told.endswith(f"; not {text!r}")
    for example in labels.EXAMPLES.replace(" or ", ", ").split(", "):
        assert requirements(example)


@pytest.mark.parametrize("text", ["cores>=many", "cores>=1|2", "cores<=b12"])
def test_a_bound_must_be_one_number(text: str) -> None:
    assert (
        refusal(requirements, text)
        == f"cluster.require: {text}: expected one number after {text[5:7]}"
    )


@pytest.mark.parametrize(
    "texts",
    [
        ("gpu=yes", "gpu=no"),
        ("room=a|b", "room=c|d"),
        ("room=a|b", "room!=b|a"),
        ("cores>=8", "cores<=4"),
        ("cores>=8", "cores=4"),
        ("cores=many", "cores<=4"),
    ],
)
def test_requirements_that_no_server_can_meet_are_refused(texts: tuple[str, ...]) -> None:
    assert (
        refusal(requirements, "os=linux", *texts)
        == f"cluster.require: no server can meet {' and '.join(texts)}"
    )


def test_requirements_that_a_server_can_meet_are_not_refused() -> None:
    assert (
        len(
            requirements(
                "room=a|b",
                "room!=b",
                "cores>=8",
                "cores<=8",
                "gpu!=a",
                "gpu!=b",
                "room=a",
            )
        )
        == 7
    )


def test_servers_are_ordered_by_the_first_preference_that_distinguishes_them() -> None:
    """The higher number first, with a minus the lower; those without a number last."""
    rank = labels.preferences(["gpu=yes", "-load", "cores"], "cluster.rank")
    servers = [
        {"gpu": "yes", "load": "0.5", "cores": "16"},
        {"gpu": "yes", "load": "0.5", "cores": "8"},
        {"gpu": "yes", "load": "3", "cores": "64"},
        {"gpu": "yes", "cores": "64"},
        {"load": "0.5", "cores": "many"},
    ]
    assert (
        sorted(
            [servers[at] for at in (3, 1, 4, 0, 2)],
            key=lambda server: labels.place(rank, server),
        )
        == servers
    )
    assert labels.place((), LAB) == ()
    assert [str(preference) for preference in rank] == ["gpu=yes", "-load", "cores"]


@pytest.mark.parametrize("text", ["", "-", "--cores", "Cores", "-gpu=yes", "gpu yes"])
def test_an_invalid_preference_is_refused(text: str) -> None:
    told = refusal(labels.preferences, [text], "cluster.rank")
    assert told.startswith("cluster.rank: expected the name of a label")
    assert told.endswith(f"; not {text!r}")


def test_a_server_has_the_labels_that_it_was_given() -> None:
    assert labels.labels({"gpu": "yes", "disks": 2, "room": "b12"}, "ss.toml") == {
        "gpu": "yes",
        "disks": "2",
        "room": "b12",
    }
    assert labels.assigned(["gpu=yes", "at=10:30"], "--label") == {
        "gpu": "yes",
        "at": "10:30",
    }


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"GPU": "yes"}, f"labels: 'GPU': {labels.NAME_RULE}"),
        ({"g\x1bu": "yes"}, f"labels: 'g\\x1bu': {labels.NAME_RULE}"),
        ({"gpu": ""}, f"labels: gpu: {labels.VALUE_RULE}, or a whole number; not ''"),
        (
            {"gpu": "a|b"},
            f"labels: gpu: {labels.VALUE_RULE}, or a whole number; not 'a|b'",
        ),
        (
            {"gpu": "yes\n"},
            f"labels: gpu: {labels.VALUE_RULE}, or a whole number; not 'yes\\n'",
        ),
        ({"gpu": -1}, f"labels: gpu: {labels.VALUE_RULE}, or a whole number; not -1"),
        ({"gpu": True}, f"labels: gpu: {labels.VALUE_RULE}, or a whole number; not True"),
        (
            {"cores": 4},
            "labels: cores: a server detects that by itself, as name, cores; choose another name",
        ),
        (
            {f"l{n}": 1 for n in range(MAX_LABELS)},
            f"labels: {MAX_LABELS} labels; expected {MAX_LABELS - 2} at most",
        ),
    ],
)
def test_an_invalid_label_is_refused(values: dict[str, object], told: str) -> None:
    assert refusal(labels.labels, values, "labels", ("name", "cores")) == told


def test_labels_without_a_value_and_repeated_labels_are_refused() -> None:
    assert (
        refusal(labels.assigned, ["gpu"], "--label")
        == "--label gpu: expected NAME=VALUE, such as gpu=yes"
    )
    assert (
        refusal(labels.assigned, ["gpu=a", "gpu=b"], "--label")
        == "--label gpu=b: gpu is given twice"
    )


def test_impossible_requirements_of_an_experiment_are_refused_with_their_line(
    tmp_path: object,
) -> None:
    """The file's line and key; ``--set`` and options are told without one."""
    text = (experiment.examples_folder() / "minisim.toml").read_text()
    file = tmp_path / "x.toml"  # type: ignore[operator]
    file.write_text(text + '\n[cluster]\nrequire = ["gpu=yes"]\nrank = ["-"]\n')
    told = refusal(experiment.load, file)
    assert told.startswith(
        f"{file}:{len(file.read_text().splitlines())}: cluster.rank: expected the name of a label"
    )
    file.write_text(text)
    told = refusal(experiment.load, file, ['cluster.require=["gpu"]'])
    assert told.startswith(f"{file}: cluster.require: expected requirements such as")
    assert experiment.load(
        file, ['cluster.require=["gpu=yes"]', "cluster.max_slots=4"]
    ).cluster.require == ["gpu=yes"]
