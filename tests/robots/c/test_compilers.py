"""The C99 pair has the same bits by every compiler, at every level, on other processors."""

import functools
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.robots.c.compiled import STRICT, require
from tests.robots.controllers import KINDS, controller, observed
from zswarm.champion.controller import Controller
from zswarm.plugins import registry as plugins
from zswarm.robots.c.c99 import GUARDS, pair

pytestmark = pytest.mark.robots

# Of a size: the folder with the sources, what the program reads, and what it must write.
Programs = Callable[[int], tuple[Path, bytes, np.ndarray]]

STEPS = 1000
SIZES = ((4, 3), (13, 1), (1, 9))  # inputs and outputs; other genomes with each
ARM64, ARM = ("aarch64-linux-gnu-gcc",), ("arm-linux-gnueabihf-gcc", "-mfpu=neon-vfpv4")
# Products and sums are joined where the source does not forbid it.
LOOSE = ("-std=gnu11", "-O3", "-Wall", "-Wextra", "-Werror")
OFF = "-ffp-contract=off"
WAYS = [
    *(
        (name, level, *STRICT)
        for name in ("gcc", "clang")
        for level in ("-O0", "-O2", "-O3")
    ),
    *((name, "-march=native", *LOOSE) for name in ("gcc", "clang")),
    ("gcc", "-flto", "-march=native", *LOOSE),
    ("gcc", "-Os", *STRICT),
    *(
        (*processor, *flags)
        for processor in (ARM64, ARM)
        for flags in (("-O2", *STRICT), LOOSE, (OFF, "-O2", *STRICT), (OFF, *LOOSE))
    ),
]
WHOLE = [(*processor, "-O2", *STRICT) for processor in (("gcc",), ARM64, ARM)]
QEMU = {
    "aarch64": ("qemu-aarch64", "-L", "/usr/aarch64-linux-gnu"),
    "arm": ("qemu-arm", "-L", "/usr/arm-linux-gnueabihf"),
}

MAIN = """#include <stdio.h>
{includes}
int main(void)
{{
    int failed = 0;
    float seen[64], done[64];
    (void)seen;
{plays}
    return failed;
}}
"""
PLAY = """    {{
        zs_{n}_state state;
        failed += zs_{n}_selftest() != 0;
        zs_{n}_reset(&state);
        for (int step = 0; step < {steps}; step++) {{
            if (fread(seen, 4, ZS_{upper}_INPUTS, stdin) != ZS_{upper}_INPUTS) {{
                return 99;
            }}
            zs_{n}_step(&state, seen, done);
            (void)fwrite(done, 4, ZS_{upper}_OUTPUTS, stdout);
        }}
    }}
"""


def program(controllers: list[Controller], folder: Path) -> tuple[bytes, np.ndarray]:
    """A program that plays them all, in a folder; what it reads, and what it must write."""
    read, expected, names = [], [], []
    for number, evolved in enumerate(controllers):
        names.append(f"k{number:03}")
        for file, text in pair(evolved, names[-1]).items():
            (folder / file).write_text(text)
        seen, driver = observed(evolved.inputs, STEPS, seed=number), evolved.driver()
        read.append(seen.tobytes())
        expected += [driver.act(row).copy() for row in seen]
    includes = "\n".join(f'#include "zs_{name}.h"' for name in names)
    plays = "".join(
        PLAY.format(n=name, upper=name.upper(), steps=STEPS) for name in names
    )
    (folder / "main.c").write_text(MAIN.format(includes=includes, plays=plays))
    return b"".join(read), canonical(np.concatenate(expected))


def canonical(numbers: np.ndarray) -> np.ndarray:
    """Return bits; all NaNs have the same, since processors differ in them."""
    return np.where(np.isnan(numbers), np.uint32(0x7FC00000), numbers.view(np.uint32))


def played(folder: Path, way: tuple[str, ...], read: bytes) -> tuple[int, np.ndarray]:
    made = folder / "program"
    done = subprocess.run(
        [*way, "-o", made, *sorted(folder.glob("*.c")), "-lm"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    start = QEMU.get(way[0].split("-")[0], ())
    out = subprocess.run([*start, made], input=read, capture_output=True, check=False)
    return out.returncode, canonical(np.frombuffer(out.stdout, np.float32))


def machine(kind: tuple[str, dict[str, Any]]) -> bool:
    """Return whether a kind has a table with a row for each combination of inputs."""
    return "mealy" in (kind[0], kind[1].get("of", {}).get("kind"))


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Programs:
    """Return the program of each size, made when it is first asked for."""

    @functools.cache
    def made(turn: int) -> tuple[Path, bytes, np.ndarray]:
        folder = tmp_path_factory.mktemp("size")
        inputs, outputs = SIZES[turn]
        controllers = [
            controller(
                *kind, seed=1 + number + 100 * turn, inputs=inputs, outputs=outputs
            )
            for number, kind in enumerate(KINDS)
            if not (machine(kind) and inputs == 13)
            and not ("thresholds" in kind[1] and inputs != 4)
        ]
        return folder, *program(controllers, folder)

    return made


@pytest.mark.parametrize("way", WAYS, ids=" ".join)
def test_every_compiler_and_processor_gives_the_same_bits(
    way: tuple[str, ...], programs: Programs
) -> None:
    """Compare a thousand steps of every kind of controller, and run the self-tests there.

    Every size is played on every processor; the flags of the others are tried with one.
    """
    require(way[0], *(QEMU.get(way[0].split("-")[0], ())[:1]))
    turns = range(len(SIZES)) if way in WHOLE else [WAYS.index(way) % len(SIZES)]
    for turn in turns:
        folder, read, expected = programs(turn)
        failed, bits = played(folder, way, read)
        assert failed == 0
        assert len(bits) == len(expected)
        assert not np.flatnonzero(bits != expected).size


def test_the_self_test_detects_a_compiler_that_contracts_products_and_sums(
    tmp_path: Path,
) -> None:
    """GCC contracts in its own dialect without the flag, so the other tests can fail."""
    require(ARM64[0], "qemu-aarch64")
    read, expected = program(
        [controller("fully-meshed", {"activation": "tanh"}, seed=1)], tmp_path
    )
    source = tmp_path / "zs_k000.c"
    assert GUARDS in source.read_text()
    source.write_text(source.read_text().replace(GUARDS, ""))
    failed, bits = played(tmp_path, (*ARM64, *LOOSE), read)
    assert failed == 1
    assert (bits != expected).any()
    failed, bits = played(tmp_path, (*ARM64, OFF, *LOOSE), read)
    assert failed == 0
    assert (bits == expected).all(), "the flag alone is enough"


# Advisory rules of MISRA C:2012 that the text breaks on purpose; docs/c99.md says why.
BROKEN = {"2.5", "8.7", "8.9", "15.5", "19.2"}


def test_no_required_rule_of_misra_c_is_broken(tmp_path: Path) -> None:
    """The check covers what cppcheck's add-on covers."""
    require("cppcheck")
    for number, kind in enumerate(plugins.BUNDLED["representation"]):
        for file, text in pair(controller(kind), f"k{number:02}").items():
            (tmp_path / file).write_text(text)
    command = [
        "cppcheck",
        "--addon=misra",
        "--std=c99",
        "--suppress=missingIncludeSystem",
        "--enable=style",
        "--quiet",
    ]
    done = subprocess.run(
        [*command, *sorted(tmp_path.glob("*.c"))],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    found = set(re.findall(r"\[misra-c2012-([\d.]+)\]", done.stderr))
    assert found, "the add-on does not look"
    assert found <= BROKEN, [
        line for line in done.stderr.splitlines() if "misra" in line
    ][:20]
    assert "[error]" not in done.stderr
