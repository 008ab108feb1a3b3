"""Programs of unlike versions in one cluster: further optional fields, another major version."""

import os
import shutil
from pathlib import Path

import pytest

import zswarm
from tests.integration.paced import Scene, Size, Undisturbed, play_undisturbed

pytestmark = pytest.mark.programs

SIZE = Size()
# What a later program might add: fields that it always sends, a request, and a feature.
FIELDS = """

_encode = encode


def encode(message):
    if hasattr(message, "later"):
        message = structs.replace(message, later=7)
    return _encode(message)


def decode_request(body, _decode=decode_request):
    message = _decode(body)
    note(message)
    return message


def decode_reply(body, _decode=decode_reply):
    message = _decode(body)
    note(message)
    return message


def note(message):
    print(type(message).__name__, getattr(message, "later", ""), file=LATER, flush=True)


import os

LATER = open(os.environ["LATER_FILE"], "a")
"""
# What another version might be: a field has another name.
RENAMED = """

import msgspec


def renamed(body, old, new):
    message = msgspec.msgpack.decode(body)
    if message["type"] == "reserve":
        message[new] = message.pop(old)
    return msgspec.msgpack.encode(message)


OLDER["v1"] = VersionAdapter(
    lambda body: renamed(body, "slots", "room"), lambda body: renamed(body, "room", "slots")
)
"""


def copied(folder: Path) -> Path:
    """Return a copy of the package, to be changed."""
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(Path(zswarm.__file__).parent, folder / "zswarm", ignore=ignored)
    return folder / "zswarm" / "protocol"


def with_fields(folder: Path) -> Path:
    """Return the path of a zswarm with one field more in three messages."""
    protocol = copied(folder)
    messages = (protocol / "messages.py").read_text()
    for name in ("Reserve", "Lease", "Outcomes"):
        before, head, after = messages.partition(f"class {name}(Message")
        fields, following, rest = after.partition("\n\n\nclass")
        messages = f"{before}{head}{fields}\n    later: Count = 0{following}{rest}"
    messages = messages.replace("FEATURES = [", 'FEATURES = ["invented", ')
    (protocol / "messages.py").write_text(messages)
    with (protocol / "codec.py").open("a") as codec:
        codec.write(FIELDS)
    return folder


def with_version(folder: Path) -> Path:
    """Return the path of a zswarm that speaks version 2, and as a server version 1, too."""
    protocol = copied(folder)
    text = (protocol / "keys.py").read_text()
    assert text.count("VERSION = 1\n") == 1
    (protocol / "keys.py").write_text(text.replace("VERSION = 1\n", "VERSION = 2\n"))
    text = (protocol / "messages.py").read_text()
    head = 'class Reserve(Message, frozen=True, tag="reserve"'
    assert text.count(head) == 1
    text = text.replace(head, head + ', rename={"slots": "room"}')
    (protocol / "messages.py").write_text(text)
    with (protocol / "versions.py").open("a") as versions:
        versions.write(RENAMED)
    return folder


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Undisturbed:
    return play_undisturbed(tmp_path_factory.mktemp("undisturbed"), SIZE)


def run_in_turn(
    scene: Scene, environments: list[dict[str, str]], undisturbed: Undisturbed
) -> None:
    """Start a server in the first environment, and run the experiment in it from the others."""
    plain = scene.environment
    scene.environment = changed(plain, environments[0])
    server, _ = scene.server("lab")
    for number, environment in enumerate(environments[1:]):
        scene.environment = changed(plain, environment)
        optimizer = scene.optimizer(server.endpoint)
        scene.check(optimizer.done(), undisturbed)
        assert not scene.events("server_mismatch"), optimizer.err.read_text()
        assert "of the protocol" not in optimizer.err.read_text()
        scene.run.rename(scene.folder / f"run-{number}")
    assert not server.events("malformed")


def changed(environment: dict[str, str], changes: dict[str, str]) -> dict[str, str]:
    path = [changes.get("PYTHONPATH", ""), environment["PYTHONPATH"]]
    return environment | changes | {"PYTHONPATH": os.pathsep.join(filter(None, path))}


def test_a_program_with_further_fields_works_with_one_that_lacks_them(
    tmp_path: Path, undisturbed: Undisturbed
) -> None:
    """A newer server with both optimizers, and a newer optimizer with an older server."""
    noted = {side: tmp_path / f"{side}.txt" for side in ("server", "optimizer")}
    path = str(with_fields(tmp_path / "later"))
    newer = {
        side: {"PYTHONPATH": path, "LATER_FILE": str(file)}
        for side, file in noted.items()
    }
    for name, environments in (
        ("newer", [newer["server"], {}, newer["optimizer"]]),
        ("older", [{}, newer["optimizer"]]),
    ):
        (tmp_path / name).mkdir()
        with Scene(tmp_path / name, SIZE) as scene:
            run_in_turn(scene, environments, undisturbed)
    reserved = [
        line for line in noted["server"].read_text().splitlines() if "Res" in line
    ]
    assert reserved == ["Reserve 0", "Reserve 7"], (
        "from the older one, and from the newer"
    )
    read = set(noted["optimizer"].read_text().splitlines())
    assert {"Lease 7", "Lease 0", "Outcomes 7", "Outcomes 0"} <= read


def test_a_server_of_the_next_version_serves_both_versions(
    tmp_path: Path, undisturbed: Undisturbed
) -> None:
    """The same experiment from an optimizer of this version, and from one of the next."""
    newer = {"PYTHONPATH": str(with_version(tmp_path / "next"))}
    with Scene(tmp_path, SIZE) as scene:
        run_in_turn(scene, [newer, {}, newer], undisturbed)
