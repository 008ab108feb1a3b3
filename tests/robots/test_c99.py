"""A controller's C99 pair decides as the controller does, bit for bit, and is C that strict compilers take."""

import ctypes
import re
import subprocess
from pathlib import Path

import msgspec
import numpy as np
import pytest
from compiled import STRICT, decisions, library
from controllers import KINDS, controller, named, observed

from zswarm.controller import Controller
from zswarm.robots.c99 import pair
from zswarm.robots.original import sha256

STEPS = 60
INPUTS, OUTPUTS = 4, 3


def stem(number: int) -> str:
    return f"zs_{number:02}"


@pytest.fixture(scope="module")
def controllers() -> list[Controller]:
    return [controller(*kind, seed=number, inputs=INPUTS, outputs=OUTPUTS) for number, kind in enumerate(KINDS)]


@pytest.fixture(scope="module")
def loaded(controllers: list[Controller], tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """All of them, compiled together."""
    sources: dict[str, str] = {}
    for number, evolved in enumerate(controllers):
        sources |= pair(evolved, f"{number:02}")
    return library(sources, tmp_path_factory.mktemp("pairs"), "-O2")


@pytest.mark.parametrize("number", range(len(KINDS)), ids=map(named, KINDS))
def test_the_pair_decides_as_the_kernel_does(number: int, controllers: list[Controller], loaded: ctypes.CDLL) -> None:
    evolved = controllers[number]
    seen, driver = observed(INPUTS, STEPS), evolved.driver()
    size = evolved.network()[0].state_size
    expected = [driver.act(row).tobytes().hex() for row in seen]
    assert decisions(loaded, stem(number), seen, OUTPUTS, size) == expected
    assert decisions(loaded, stem(number), seen, OUTPUTS, size) == expected, "after a reset it begins anew"


@pytest.mark.parametrize("number", range(len(KINDS)), ids=map(named, KINDS))
def test_the_pair_checks_itself(number: int, loaded: ctypes.CDLL) -> None:
    assert getattr(loaded, f"{stem(number)}_selftest")() == 0


@pytest.mark.parametrize("kind", ["fully-meshed", "neat", "ctrnn"])
def test_a_self_test_fails_where_a_number_differs_in_its_last_bit(kind: str, tmp_path: Path) -> None:
    files = pair(controller(kind), "night")
    table = re.search(r"night_parameters.*?};", files["zs_night.c"], re.DOTALL)
    assert table
    first = re.findall(r"-?0x1\.[0-9a-f]{5,}p[-+]\d+f", table[0])[-1]
    next_one = np.nextafter(np.float32(float.fromhex(first[:-1])), np.float32(9)).item().hex()
    files["zs_night.c"] = files["zs_night.c"].replace(table[0], table[0].replace(first, f"{next_one}f"))
    assert library(files, tmp_path).zs_night_selftest() > 0


def test_the_source_is_a_program_that_checks_itself(tmp_path: Path) -> None:
    files = pair(controller("fully-meshed"), "night")
    wrong = files["zs_night.c"].replace("zs_night_states[16] = {\n    ", "zs_night_states[16] = {\n    1U + ")
    for text, code in ((files["zs_night.c"], 0), (wrong, 1)):
        (tmp_path / "zs_night.h").write_text(files["zs_night.h"])
        (tmp_path / "zs_night.c").write_text(text)
        subprocess.run(["gcc", *STRICT, "-DZS_NIGHT_MAIN", "-o", tmp_path / "check", tmp_path / "zs_night.c"], check=True)
        assert subprocess.run([tmp_path / "check"], check=False).returncode == code


def test_the_self_test_can_be_left_out(tmp_path: Path) -> None:
    made = library(pair(controller("fully-meshed"), "night"), tmp_path, "-DZS_NIGHT_NO_SELFTEST")
    assert hasattr(made, "zs_night_step")
    assert not hasattr(made, "zs_night_selftest")


def test_the_same_controller_gives_the_same_text() -> None:
    for kind in KINDS:
        assert pair(controller(*kind), "night") == pair(controller(*kind), "night")


def test_the_header_says_what_it_is() -> None:
    evolved = controller("fully-meshed", inputs=INPUTS, outputs=OUTPUTS)
    header = pair(evolved, "Night 7")["zs_night_7.h"]
    macros = dict(re.findall(r"#define (ZS_\w+) (\S+|\"[^\"]*\")", header))
    _, parameters = evolved.network()
    assert macros["ZS_NIGHT_7_INPUTS"] == str(INPUTS)
    assert macros["ZS_NIGHT_7_OUTPUTS"] == str(OUTPUTS)
    assert macros["ZS_NIGHT_7_SHA256"] == f'"{sha256(parameters)}"'
    assert '#define ZS_NIGHT_7_SENSOR_3 "sensor 3"' in header
    assert "action[2]: motor 2" in header


def test_the_header_says_what_a_simulators_numbers_mean() -> None:
    evolved = msgspec.structs.replace(controller("fully-meshed"), simulator="minisim")
    assert "Observation:" in pair(evolved, "night")["zs_night.h"]
    gone = msgspec.structs.replace(evolved, simulator="of-somebody-else")
    assert "Observation:" not in pair(gone, "night")["zs_night.h"]


def test_only_what_is_used_is_written() -> None:
    clamp = pair(controller("fully-meshed"), "night")["zs_night.c"]
    sigmoid = pair(controller("fully-meshed", {"activation": "sigmoid"}), "night")["zs_night.c"]
    assert "zs_night_exp" not in clamp
    assert "math.h" not in clamp
    assert "zs_night_exp" in sigmoid
    assert "zs_night_tanh" not in sigmoid
    assert not re.search(r"\b(malloc|printf|stdio|static (?!const)\w+ \w+( =|;))", clamp + sigmoid)


HOSTILE = ["*/ int x; /*", "??/", "\\", 'a"b', "%s%n", "\N{SNOWMAN} \x07 \n#error no", "", "int", "a" * 200, "// \\\n", "\ud800"]


def test_hostile_names_stay_words(tmp_path: Path) -> None:
    """Of runs, simulators, sensors, actuators and settings."""
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
        assert all(re.fullmatch(r"zs_[a-z0-9_]+\.[ch]", file) and text.isascii() for file, text in files.items())
        (tmp_path / str(number)).mkdir()
        made = library(files, tmp_path / str(number), "-trigraphs")
        assert getattr(made, f"{next(iter(files))[:-2]}_selftest")() == 0


def test_a_string_of_c_is_the_name_that_was_given(tmp_path: Path) -> None:
    names = ['a "b" \\ ??/ %d', "Grüße \N{SNOWMAN}", "\t1"]
    evolved = msgspec.structs.replace(controller("fully-meshed", inputs=3, outputs=1), sensors=names)
    files = pair(evolved, "night")
    files["more.c"] = '#include "zs_night.h"\nconst char *name(int at);\nconst char *name(int at)\n{\n' + "".join(
        f"    if (at == {at}) {{\n        return ZS_NIGHT_SENSOR_{at};\n    }}\n" for at in range(3)
    ) + '    return "";\n}\n'  # fmt: skip
    made = library(files, tmp_path, "-trigraphs")
    made.name.restype = ctypes.c_char_p
    assert [made.name(at).decode() for at in range(3)] == names


def test_the_header_is_for_cplusplus_too(tmp_path: Path) -> None:
    files = pair(controller("fully-meshed"), "night")
    (tmp_path / "main.cpp").write_text(
        '#include "zs_night.h"\nint main() { zs_night_state s; zs_night_reset(&s); return zs_night_selftest(); }\n'
    )
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    subprocess.run(["gcc", *STRICT, "-c", "-o", tmp_path / "c.o", tmp_path / "zs_night.c"], check=True)
    strict = ["-std=c++11", *STRICT[1:]]
    subprocess.run(["g++", *strict, "-o", tmp_path / "main", tmp_path / "main.cpp", tmp_path / "c.o"], check=True)
    assert subprocess.run([tmp_path / "main"], check=False).returncode == 0


@pytest.mark.parametrize("flag", ["-ffast-math", "-Ofast", "-mfpmath=387"])
def test_flags_that_change_decisions_are_refused(flag: str, tmp_path: Path) -> None:
    for name, text in pair(controller("fully-meshed"), "night").items():
        (tmp_path / name).write_text(text)
    command = ["gcc", "-std=gnu11", flag, "-c", "-o", tmp_path / "c.o", tmp_path / "zs_night.c"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "#error" in done.stderr
