"""Names in a controller are data in every exported file, whatever they are.

A champion's file is something that people share: its run, sensors and actuators may have any name.
Each target gets the same file for harmless and for hostile names, except inside the strings,
comments, elements and cells that hold them.
"""

import ast
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import msgspec
import pytest
from hypothesis import HealthCheck, Phase, example, given, settings
from hypothesis import strategies as st

from tests.robots.controllers import controller
from tests.robots.packed import evolved, write
from zswarm.champion.controller import Controller
from zswarm.robots import targets
from zswarm.robots.c.c_types import folded
from zswarm.robots.c.quoting import Code
from zswarm.robots.c.templates import fill

MARK = "PWNED"
FRAGMENTS = [
    *("@SENSORS@", "@RUN@", "@{sensors}", "@{run}", "@{kernel}", "@{unit}", "{name}"),
    *('"', "'", '"""', "'''", "\\", "\\\\", "\\\n", "\n", "\r", "\t", "\0", "\x1b[31m"),
    *("*/", "/*", "//", "??/", "??'", "??/\n", "<:", "%:", "#", "\\u000a", "\\N{DIGIT}"),
    *(
        "-->",
        "<!--",
        "]]>",
        "</description>",
        "<x/>",
        "&lt;",
        "&",
        "${x}",
        "$(arg speed)",
    ),
    *("`", "|", "\n\n# title", "```", "<script>", "$(id)", "`id`", ";", "'; id #"),
    *("\u202e", "\u2028", "\ufeff", "\ud7ff", "ü", "☃", "𝄞", "\ufffe", "\x85", "..", "/"),
    '+__import__("os")._exit(3)+',
    "\n__import__('os')._exit(3)\n",
    "\n#error\n",
    "; message(FATAL_ERROR)",
    "{{}}",
    "%s%n",
]
# Code points without surrogates: a champion's file is UTF-8.
LETTERS = st.characters(exclude_categories=["Cs"])
PARTS = st.sampled_from(FRAGMENTS) | st.text(LETTERS, max_size=4)
HOSTILE = st.lists(PARTS, min_size=1, max_size=5).map("".join)
# A name is found as it is: shorter ones would take minutes.
PHASES = [Phase.explicit, Phase.reuse, Phase.generate]
EACH = settings(max_examples=6, phases=PHASES, suppress_health_check=list(HealthCheck))
FEW = settings(EACH, max_examples=2)


@cache
def harmless(target: str) -> Controller:
    if targets.TARGETS[target].simulator == "epuck":
        one = controller("feed-forward", {"hidden": []}, inputs=14, outputs=2)
        return msgspec.structs.replace(one, simulator="epuck", simulator_settings={})
    return evolved(robots=2, steps=10, map="open")


def renamed(controller: Controller, name: str) -> Controller:
    """Return a controller with such names; those of its parts must be installed ones."""
    sensors, actuators = [name] * controller.inputs, [name] * controller.outputs
    return msgspec.structs.replace(
        controller, run=name, sensors=sensors, actuators=actuators
    )


def exported(target: str, name: str) -> Mapping[str, str | bytes]:
    """Return the exported files; ``name`` also names them."""
    found = targets.files(target, renamed(harmless(target), name), name)
    return {path.replace(only(name), "zs_N"): each for path, each in found.items()}


@cache
def shapes(target: str) -> dict[str, Any]:
    """Return the shapes of files with harmless names."""
    return {
        path: shape(path, content, "plain") if isinstance(content, str) else None
        for path, content in exported(target, "plain").items()
    }


def only(name: str) -> str:
    return f"zs_{folded(name)}"


def shape(path: str, text: str, name: str) -> Any:
    """Return what of a file must not depend on names, and check its strings."""
    unit = only(name)
    text = text.replace(unit, "zs_N").replace(unit.upper(), "ZS_N")
    match Path(path).suffix:
        case ".py":
            return python_shape(text)
        case ".c" | ".h" | ".cpp" | ".hpp":
            return c_shape(text)
        case ".xml" | ".launch":
            return [
                (each.tag, sorted(each.attrib))
                for each in ElementTree.fromstring(text).iter()  # noqa: S314  our own
            ]
        case ".md":
            return [re.sub("`[^`]*`", "``", line) for line in text.splitlines()]
        case ".json":
            return sorted(json.loads(text))
        case ".txt" | ".argos":
            return re.sub(r"/\*.*?\*/|<!--.*?-->", "", text, flags=re.S)
    return text


def python_shape(text: str) -> str:
    tree = ast.parse(text, feature_version=(3, 8))
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            node.value = ""
    return ast.dump(tree)


def c_shape(text: str) -> str:
    """Return C as a compiler that takes trigraphs reads it, without comments and strings."""
    for third, letter in zip("=/'()!<>-", "#\\^[]|{}~", strict=True):
        text = text.replace(f"??{third}", letter)
    text = text.replace("\\\n", "")
    pieces = r'/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\\n])*"'
    return re.sub(pieces, "", text, flags=re.S)


@pytest.mark.parametrize("target", targets.TARGETS)
@EACH
@example(name=" ".join(FRAGMENTS))
@given(name=HOSTILE)
def test_files_differ_from_those_of_harmless_names_inside_of_texts_only(
    target: str, name: str
) -> None:
    files, plain = exported(target, name), shapes(target)
    assert files.keys() == plain.keys()
    for path, content in files.items():
        if path.endswith(".onnx"):
            continue  # a message of protobuf: its texts have lengths
        assert isinstance(content, str)
        assert shape(path, content, name) == plain[path], path


@EACH
@example(name=" ".join(FRAGMENTS))
@given(name=HOSTILE)
def test_readers_find_the_names_that_were_given(name: str) -> None:
    (text,) = exported("python", name).values()
    found: dict[str, Any] = {"__name__": "zs_x"}
    exec(compile(text, "zs_x.py", "exec"), found)  # noqa: S102  what the test is about
    assert (found["RUN"], found["SENSORS"][0]) == (name, name)
    assert found["selftest"]() == 0
    (text,) = exported("json", name).values()
    assert json.loads(text)["run"] == name
    onnx = pytest.importorskip("onnx")
    (content,) = exported("onnx", name).values()
    properties = onnx.load_model_from_string(content).metadata_props
    assert {each.key: each.value for each in properties}["run"] == name


@pytest.mark.parametrize(
    "template", ["python/controller.py.in", "c/robot.h", "README.md"]
)
def test_a_text_that_was_not_quoted_is_refused(template: str) -> None:
    words = dict.fromkeys(WORDS, "1")
    fill(template, words)
    for word in ("run", "name", "unit"):
        hostile = words | {word: f'"{MARK}'}
        if f"@{{{word}}}" in (TEMPLATE_FOLDER / template).read_text():
            with pytest.raises(ValueError, match=f"{word} is not quoted"):
                fill(template, hostile)
            with pytest.raises(ValueError, match=f"{word} is not quoted"):
                fill(template, words | {word: Code("xml", f'"{MARK}')})


TEMPLATE_FOLDER = Path(targets.__file__).parent / "templates"
WORDS = {
    word
    for path in TEMPLATE_FOLDER.rglob("*.*")
    if path.is_file() and "__pycache__" not in path.parts
    for word in re.findall(r"@\{(\w+)\}", path.read_text())
}


@pytest.mark.robots
@pytest.mark.parametrize("target", targets.TARGETS)
@FEW
@example(name=" ".join(FRAGMENTS))
@given(name=HOSTILE)
def test_what_compilers_and_interpreters_make_of_it_passes_its_self_test(
    target: str, name: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Compiled with trigraphs, imported, run; and the command that the export proposes."""
    folder, unit = tmp_path_factory.mktemp("x"), only(name)
    write(targets.files(target, renamed(harmless(target), name), name), folder)
    if target in ("c99", "python", "json"):
        done = run("sh", "-c", targets.on(target, unit.removeprefix("zs_"), folder))
        assert done.returncode == 0, done.stdout + done.stderr
    for language in ("c", "c++") if (folder / "src").is_dir() else ():
        sources = sorted((folder / "src").glob("*.c"))
        checked = ["-trigraphs", "-fsyntax-only", "-x", language]
        done = run("gcc", *checked, *map(str, sources))
        assert done.returncode == 0, done.stderr
    if (folder / unit).is_dir():
        driven = "import sys; sys.path.insert(0, '.'); import importlib; "
        driven += f"importlib.import_module('{unit}.robot').build()"
        done = run(sys.executable, "-I", "-c", driven, cwd=folder)
        assert done.returncode == 0, done.stderr
    names = {path.name for path in folder.rglob("*")}
    assert MARK not in names


def run(*command: str, cwd: Path | None = None) -> "subprocess.CompletedProcess[str]":
    if shutil.which(command[0]) is None:
        pytest.skip(f"no {command[0]} here")
    return subprocess.run(
        command, capture_output=True, text=True, timeout=120, check=False, cwd=cwd
    )
