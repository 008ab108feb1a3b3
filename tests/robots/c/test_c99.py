"""A controller's C99 pair has its bits, and strict compilers accept it."""

import ctypes
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.docs.documents import REPOSITORY
from tests.robots.c.compiled import STRICT, decisions, library, require
from tests.robots.controllers import KINDS, controller, named, observed
from zswarm.champion.controller import Controller
from zswarm.errors import ConfigError
from zswarm.plugins import registry as plugins
from zswarm.robots.c.c99 import pair
from zswarm.robots.c.reference_steps import sha256

PAGE = REPOSITORY / "docs" / "representations.md"
STEPS = 60
INPUTS, OUTPUTS = 4, 3

INCLUDE = '#include "zs_night.h"\n'


def stem(number: int) -> str:
    return f"zs_k{number:02}"


@pytest.fixture(scope="module")
def controllers() -> list[Controller]:
    return [
        controller(*kind, seed=number, inputs=INPUTS, outputs=OUTPUTS)
        for number, kind in enumerate(KINDS)
    ]


@pytest.fixture(scope="module")
def loaded(
    controllers: list[Controller], tmp_path_factory: pytest.TempPathFactory
) -> ctypes.CDLL:
    """Compile all controllers together and load them."""
    sources: dict[str, str] = {}
    for number, evolved in enumerate(controllers):
        sources |= pair(evolved, f"k{number:02}")
    return library(sources, tmp_path_factory.mktemp("pairs"), "-O1")


@pytest.mark.parametrize("number", range(len(KINDS)), ids=map(named, KINDS))
def test_the_c_files_decide_like_the_kernel(
    number: int, controllers: list[Controller], loaded: ctypes.CDLL
) -> None:
    evolved = controllers[number]
    seen, driver = observed(INPUTS, STEPS), evolved.driver()
    size = evolved.network()[0].state_size
    expected = [driver.act(row).tobytes().hex() for row in seen]
    assert decisions(loaded, stem(number), seen, OUTPUTS, size) == expected
    assert decisions(loaded, stem(number), seen, OUTPUTS, size) == expected, (
        "after a reset it begins anew"
    )


@pytest.mark.parametrize("number", range(len(KINDS)), ids=map(named, KINDS))
def test_the_c_files_check_themselves(number: int, loaded: ctypes.CDLL) -> None:
    assert getattr(loaded, f"{stem(number)}_selftest")() == 0


@pytest.mark.parametrize("kind", ["fully-meshed", "neat", "ctrnn"])
def test_a_self_test_fails_where_a_number_differs_in_its_last_bit(
    kind: str, tmp_path: Path
) -> None:
    files = pair(controller(kind), "night")
    table = re.search(r"night_parameters.*?};", files["zs_night.c"], re.DOTALL)
    assert table
    first = re.findall(r"-?0x1\.[0-9a-f]{5,}p[-+]\d+f", table[0])[-1]
    next_one = (
        np.nextafter(np.float32(float.fromhex(first[:-1])), np.float32(9)).item().hex()
    )
    files["zs_night.c"] = files["zs_night.c"].replace(
        table[0], table[0].replace(first, f"{next_one}f")
    )
    assert library(files, tmp_path).zs_night_selftest() > 0


def test_the_source_is_a_program_that_checks_itself(tmp_path: Path) -> None:
    require("gcc")
    files = pair(controller("fully-meshed"), "night")
    wrong = files["zs_night.c"].replace(
        "zs_night_states[16] = {\n    ", "zs_night_states[16] = {\n    1U + "
    )
    for text, code in ((files["zs_night.c"], 0), (wrong, 1)):
        (tmp_path / "zs_night.h").write_text(files["zs_night.h"])
        (tmp_path / "zs_night.c").write_text(text)
        subprocess.run(
            [
                "gcc",
                *STRICT,
                "-DZS_NIGHT_MAIN",
                "-o",
                tmp_path / "check",
                tmp_path / "zs_night.c",
            ],
            check=True,
        )
        assert subprocess.run([tmp_path / "check"], check=False).returncode == code


def test_the_self_test_can_be_left_out(tmp_path: Path) -> None:
    made = library(
        pair(controller("fully-meshed"), "night"), tmp_path, "-DZS_NIGHT_NO_SELFTEST"
    )
    assert hasattr(made, "zs_night_step")
    assert not hasattr(made, "zs_night_selftest")


def test_the_same_controller_gives_the_same_text() -> None:
    for kind in plugins.BUNDLED["representation"]:
        assert pair(controller(kind), "night") == pair(controller(kind), "night")


def test_the_header_defines_sizes_and_the_hash_of_the_controller() -> None:
    evolved = controller("fully-meshed", inputs=INPUTS, outputs=OUTPUTS)
    header = pair(evolved, "Night 7")["zs_night_7.h"]
    macros = dict(re.findall(r"#define (ZS_\w+) (\S+|\"[^\"]*\")", header))
    _, parameters = evolved.network()
    assert macros["ZS_NIGHT_7_INPUTS"] == str(INPUTS)
    assert macros["ZS_NIGHT_7_OUTPUTS"] == str(OUTPUTS)
    assert macros["ZS_NIGHT_7_SHA256"] == f'"{sha256(parameters)}"'
    assert '#define ZS_NIGHT_7_SENSOR_3 "sensor 3"' in header
    assert "action[2]: motor 2" in header


def test_the_header_documents_the_numbers_of_a_known_simulator() -> None:
    evolved = msgspec.structs.replace(controller("fully-meshed"), simulator="minisim")
    assert "Observation:" in pair(evolved, "night")["zs_night.h"]
    gone = msgspec.structs.replace(evolved, simulator="of-somebody-else")
    assert "Observation:" not in pair(gone, "night")["zs_night.h"]


def test_the_header_names_the_settings_that_are_used() -> None:
    settings = {"field": "stadium", "steps": 50, "agents": 10}
    stadium = msgspec.structs.replace(
        controller("fully-meshed"),
        simulator="emergency-exit",
        simulator_settings=settings,
    )
    line = 'Settings of the simulator: field = "stadium", steps = 50.'
    assert line in pair(stadium, "night")["zs_night.h"]
    gone = msgspec.structs.replace(stadium, simulator="of-somebody-else")
    assert "steps = 50, agents = 10." in pair(gone, "night")["zs_night.h"]


def test_only_what_is_used_is_written() -> None:
    clamp = pair(controller("fully-meshed"), "night")["zs_night.c"]
    sigmoid = pair(controller("fully-meshed", {"activation": "sigmoid"}), "night")[
        "zs_night.c"
    ]
    assert "zs_night_exp" not in clamp
    assert "math.h" not in clamp
    assert "zs_night_exp" in sigmoid
    assert "zs_night_tanh" not in sigmoid
    assert not re.search(
        r"\b(malloc|printf|stdio|static (?!const)\w+ \w+( =|;))", clamp + sigmoid
    )


@pytest.fixture
def plugin(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[[str, str], Controller]]:
    """Return a controller of the plug-in in docs/representations.md, with one text replaced."""
    (code,) = re.findall(
        r"`zswarm_linear.py`:\n\n```python\n(.*?)```",
        PAGE.read_text(encoding="utf-8"),
        re.DOTALL,
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setitem(
        plugins.BUNDLED["representation"], "linear", "zswarm_linear:Linear"
    )

    def made(old: str, new: str) -> Controller:
        assert old in code
        (tmp_path / "zswarm_linear.py").write_text(
            code.replace(old, new), encoding="utf-8"
        )
        plugins._installed.cache_clear()
        return controller("linear", inputs=INPUTS, outputs=OUTPUTS)

    yield made
    sys.modules.pop("zswarm_linear", None)
    monkeypatch.undo()
    plugins._installed.cache_clear()


def test_a_plugin_is_translated_too(
    plugin: Callable[[str, str], Controller], tmp_path: Path
) -> None:
    """The plug-in here has no state."""
    evolved = plugin("ZERO", "ZERO")
    made = library(pair(evolved, "night"), tmp_path, "-O2")
    assert made.zs_night_selftest() == 0
    seen, driver = observed(INPUTS, STEPS), evolved.driver()
    seen[7, 1], seen[9, 2] = np.inf, -np.inf
    assert decisions(made, "zs_night", seen, OUTPUTS, 1) == [
        driver.act(row).tobytes().hex() for row in seen
    ]


def test_a_plugin_that_cannot_be_translated_to_c_is_refused_in_one_line(
    plugin: Callable[[str, str], Controller],
) -> None:
    evolved = plugin("min(max(total, ZERO), ONE)", "np.minimum(total, ONE)")
    with pytest.raises(
        ConfigError,
        match=r"^zswarm_linear\.py, line \d+: cannot be translated to C: `np\.minimum`$",
    ):
        pair(evolved, "night")


def test_c_is_written_without_loading_the_compiler() -> None:
    """Programs that evaluate nothing can write it, too."""
    code = (
        "from tests.robots.controllers import controller; "
        "from zswarm.robots.c.c99 import pair; import sys; "
        "sys.stdout.write(pair(controller('ctrnn'), 'night')['zs_night.c']); "
        "assert 'numba' not in sys.modules"
    )
    environment = {
        **os.environ,
        "ZSWARM_PLAIN": "1",
        "PYTHONPATH": os.pathsep.join([str(REPOSITORY), *sys.path]),
    }
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
    )
    assert (done.stdout, done.stderr) == (
        pair(controller("ctrnn"), "night")["zs_night.c"],
        "",
    )


HOSTILE = [
    "*/ int x; /*",
    "??/",
    "\\",
    'a"b',
    "%s%n",
    "\N{SNOWMAN} \x07 \n#error no",
    "",
    "int",
    "a" * 200,
    "// \\\n",
    "\ud800",
]


def test_hostile_names_stay_single_words(tmp_path: Path) -> None:
    """Runs, simulators, sensors, actuators and settings may have such names."""
    for number, name in enumerate(HOSTILE):
        evolved = msgspec.structs.replace(
            controller("fully-meshed", inputs=2, outputs=1),
            run=name,
            simulator=name,
            sensors=[name, name],
            actuators=[name],
            simulator_settings={"name": name.encode("ascii", "ignore").decode()},
        )
        files = pair(evolved, name)
        assert all(
            re.fullmatch(r"zs_[a-z0-9_]+\.[ch]", file) and text.isascii()
            for file, text in files.items()
        )
        (tmp_path / str(number)).mkdir()
        for file, text in files.items():
            (tmp_path / str(number) / file).write_text(text)
    require("gcc")
    subprocess.run(
        ["gcc", *STRICT, "-trigraphs", "-fsyntax-only", *tmp_path.glob("*/*.c")],
        check=True,
    )


def test_a_string_of_c_is_the_name_that_was_given(tmp_path: Path) -> None:
    names = ['a "b" \\ ??/ %d', "Grüße \N{SNOWMAN}", "\t1"]
    evolved = msgspec.structs.replace(
        controller("fully-meshed", inputs=3, outputs=1), sensors=names
    )
    files = pair(evolved, "night")
    branches = "".join(
        f"    if (at == {at}) {{\n        return ZS_NIGHT_SENSOR_{at};\n    }}\n"
        for at in range(3)
    )
    head = "const char *name(int at);\nconst char *name(int at)\n{\n"
    files["more.c"] = f'{INCLUDE}{head}{branches}    return "";\n}}\n'
    made = library(files, tmp_path, "-trigraphs")
    made.name.restype = ctypes.c_char_p
    assert [made.name(at).decode() for at in range(3)] == names


def test_the_header_also_compiles_as_cplusplus(tmp_path: Path) -> None:
    require("gcc", "g++")
    files = pair(controller("fully-meshed"), "night")
    (tmp_path / "main.cpp").write_text(
        INCLUDE
        + "int main() { zs_night_state s; zs_night_reset(&s); return zs_night_selftest(); }\n"
    )
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    subprocess.run(
        ["gcc", *STRICT, "-c", "-o", tmp_path / "c.o", tmp_path / "zs_night.c"],
        check=True,
    )
    strict = ["-std=c++11", *STRICT[1:]]
    subprocess.run(
        [
            "g++",
            *strict,
            "-o",
            tmp_path / "main",
            tmp_path / "main.cpp",
            tmp_path / "c.o",
        ],
        check=True,
    )
    assert subprocess.run([tmp_path / "main"], check=False).returncode == 0


@pytest.mark.parametrize(
    "flag", ["-ffast-math", "-Ofast", "-ffinite-math-only", "-mfpmath=387"]
)
def test_flags_that_change_decisions_are_refused(flag: str, tmp_path: Path) -> None:
    require("gcc")
    for name, text in pair(controller("fully-meshed"), "night").items():
        (tmp_path / name).write_text(text)
    command = [
        "gcc",
        "-std=gnu11",
        flag,
        "-c",
        "-o",
        tmp_path / "c.o",
        tmp_path / "zs_night.c",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "#error" in done.stderr
