"""An evolved controller as C99: a header and a source that need only C's own library.

Decisions have the bits that evolved. They are translated from the kernel's source; parameters are
tables of hexadecimal floating-point literals, sizes are constants. The caller owns the state;
nothing is allocated or printed. The same controller always gives the same text.
"""

import re
import textwrap

import msgspec
import numpy as np

from zswarm.champion.controller import Controller
from zswarm.errors import UnknownPlugin
from zswarm.plugins import registry as plugins
from zswarm.plugins.used_settings import used_settings
from zswarm.robots.c.c_types import FLOAT32, Array, folded, literal
from zswarm.robots.c.kernel_function import parse, plain
from zswarm.robots.c.quoting import Code, c_comment, c_string
from zswarm.robots.c.reference_steps import STEPS, check_steps, sha256
from zswarm.robots.c.templates import fill
from zswarm.robots.c.translate import Translation
from zswarm.robots.c.tree import INDENT, Callee, Value
from zswarm.system.version import VERSION

WIDTH = 110  # of comments

GUARDS = """/* Every operation rounds once: products and sums are not contracted. */
#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && (__FINITE_MATH_ONLY__ != 0))
#error "compile without -ffast-math, -Ofast and -ffinite-math-only: they change decisions"
#endif
/* 16: float as float, and shorter types as themselves. */
#if defined(FLT_EVAL_METHOD) && (FLT_EVAL_METHOD != 0) && (FLT_EVAL_METHOD != 16)
#error "float must be computed as float; on 32-bit x86: -msse2 -mfpmath=sse"
#endif
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize ("fp-contract=off")
#else
#pragma STDC FP_CONTRACT OFF
#endif
"""

# Those of the template, too.
NAN_BITS = 0x7FC00000
BASIS, PRIME = 2166136261, 16777619  # of FNV-1a with 32 bits
# Names that the templates take.
RESERVED = "state reset step selftest observations actions states bits digest".split()


def pair(controller: Controller, name: str) -> dict[str, str]:
    """Return the files ``zs_<name>.h`` and ``zs_<name>.c`` of a controller, as ASCII text by name.

    Args:
        name: any; ``folded`` makes it a part of names in C.

    Raises:
        ConfigError: its kind of network is not installed, its genome does not fit, or its step
            cannot be translated to C.
    """
    network, parameters = controller.network()
    unit = Translation(f"zs_{folded(name)}")
    for word in RESERVED:
        unit.name(word)
    table = unit.table("parameters", parameters)
    given = [
        Value(Array(FLOAT32, len(parameters)), table, parameters),
        Value(Array(FLOAT32, network.state_size), "state"),
        Value(Array(FLOAT32, network.inputs), "observation"),
        Value(Array(FLOAT32, network.outputs), "output"),
    ]
    callee = unit.add_function(parse(plain(network.step)), given, unit.name("decide"))
    source, steps = unit.source(), check_steps(controller)
    digests = ", ".join(map(literal, _digests(controller, steps.observations)))
    words = {
        "unit": unit.prefix,
        "macro": unit.prefix.upper(),
        "inputs": controller.inputs,
        "outputs": controller.outputs,
        "state": max(1, network.state_size),
        "sha256": sha256(parameters),
        "version": VERSION,
        "steps": STEPS,
    }
    code = {
        "about": "\n".join(f" * {line}".rstrip() for line in _about(controller)),
        "names": _names(controller, unit.prefix.upper()),
        "call": _call(callee),
        "observations": _rows(steps.observations),
        "actions": _rows(steps.actions),
        "states": textwrap.fill(
            digests, WIDTH, initial_indent=INDENT, subsequent_indent=INDENT
        ),
        "guards": GUARDS,
        **source._asdict(),
    }
    made = {name: Code("c", text) for name, text in code.items()}
    kinds = ("h", "c")
    return {
        f"{unit.prefix}.{kind}": fill(f"c/controller.{kind}", words | made)
        for kind in kinds
    }


def _names(controller: Controller, macro: str) -> str:
    """Return macros with the names of sensors and actuators."""
    kinds = (("SENSOR", controller.sensors), ("ACTUATOR", controller.actuators))
    return "".join(
        f"#define {macro}_{kind}_{at} {c_string(text)}\n"
        for kind, texts in kinds
        for at, text in enumerate(texts)
    )


def _about(controller: Controller) -> list[str]:
    """Return lines of a comment: what evolved, and what its numbers mean."""
    network = controller.representation, controller.representation_settings
    simulator = controller.simulator, controller.simulator_settings
    paragraphs = [
        f"A controller that evolved in zswarm: run {controller.run}, "
        f"fitness {controller.in_search()} in {controller.simulator}.",
        f"Network: {controller.representation}, {_shown('representation', *network)}.",
        f"Settings of the simulator: {_shown('simulator', *simulator)}.",
        *(f"observation[{at}]: {text}" for at, text in enumerate(controller.sensors)),
        *(f"action[{at}]: {text}" for at, text in enumerate(controller.actuators)),
        *_meaning(controller.simulator),
    ]
    wrap = textwrap.TextWrapper(WIDTH, subsequent_indent="  ").wrap
    return [line for text in paragraphs for line in wrap(c_comment(text))]


def _shown(kind: plugins.Kind, name: str, settings: dict[str, object]) -> str:
    """Return the settings that are used."""
    texts = (
        f"{key} = {msgspec.json.encode(value).decode()}"
        for key, value in used_settings(kind, name, settings).items()
    )
    return ", ".join(texts) or "none"


def _meaning(simulator: str) -> list[str]:
    """Return the lines on observations and actions in an installed simulator's docstring."""
    try:
        about = textwrap.dedent(plugins.load("simulator", simulator).__doc__ or "")
    except UnknownPlugin:
        return []
    pattern = r"^ *((?:Observation|Action):.*(?:\n {5,}.*)*)"
    return [" ".join(each.split()) for each in re.findall(pattern, about, re.MULTILINE)]


def _call(callee: Callee) -> str:
    given = ("", "state->x", "observation", "action")
    unread = [at for at in range(1, len(given)) if at not in callee.takes]
    lines = [f"(void){given[at].partition('->')[0]};" for at in unread]
    lines.append(f"{callee.name}({', '.join(given[at] for at in callee.takes)});")
    return "\n".join(INDENT + line for line in lines)


def _digests(controller: Controller, observations: np.ndarray) -> list[np.uint32]:
    """Return the digest of the state after each step, as the self-test computes it."""
    network, parameters = controller.network()
    state = np.zeros(network.state_size, np.float32)
    action = np.zeros(network.outputs, np.float32)
    digests = []
    for observation in observations:
        network.step(parameters, state, observation, action)
        numbers = state if len(state) else np.zeros(1, np.float32)
        bits = np.where(np.isnan(numbers), np.uint32(NAN_BITS), numbers.view(np.uint32))
        digest = BASIS
        for word in bits.tolist():
            digest = (digest ^ word) * PRIME % (1 << 32)
        digests.append(np.uint32(digest))
    return digests


def _rows(table: np.ndarray) -> str:
    wrapper = textwrap.TextWrapper(
        WIDTH, initial_indent=INDENT, subsequent_indent=INDENT + " "
    )
    rows = (wrapper.fill(f"{{{', '.join(map(literal, row))}}}") for row in table)
    return ",\n".join(rows)
