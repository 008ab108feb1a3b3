"""An evolved controller as C99: a header and a source that need no library but C's, with the bits that evolved.

The decision is translated from the kernel's own source (``translate.py``); parameters are tables of hexadecimal floating-point
literals, sizes are constants. The caller owns the state; nothing is allocated, printed or kept. The same controller gives the
same text.
"""

import re
import textwrap

import msgspec
import numpy as np

import zswarm
from zswarm import plugins
from zswarm.controller import Controller
from zswarm.errors import UnknownPlugin
from zswarm.nets.representation import Representation
from zswarm.robots.c_types import FLOAT32, Array, comment, literal
from zswarm.robots.names import folded, quoted
from zswarm.robots.original import STEPS, check_steps, sha256
from zswarm.robots.pieces import INDENT, Value
from zswarm.robots.translate import Callee, Translation

WIDTH = 110  # of comments

HEADER = """/*
{about}
 */
#ifndef ZS_{upper}_H
#define ZS_{upper}_H

#ifdef __cplusplus
extern "C" {{
#endif

#define ZS_{upper}_INPUTS {inputs}
#define ZS_{upper}_OUTPUTS {outputs}
#define ZS_{upper}_STATE {state} /* numbers that one robot keeps from step to step */
#define ZS_{upper}_SHA256 "{sha256}" /* of the parameters, float32, little-endian */
#define ZS_{upper}_GENERATOR "zswarm {version}"
{names}
/* What one robot's controller remembers; each robot has its own, and begins with zs_{name}_reset. */
typedef struct {{
    float x[ZS_{upper}_STATE];
}} zs_{name}_state;

/* Forget all of before, as at the start of a trial. */
void zs_{name}_reset(zs_{name}_state *state);

/* Decide: observation is what the sensors say, in the order above; action is written, in the order above. */
void zs_{name}_step(zs_{name}_state *state, const float observation[ZS_{upper}_INPUTS], float action[ZS_{upper}_OUTPUTS]);

/* {steps} steps of which decision and state are known: 0 when all have the same bits here, otherwise the number of the first
 * step that differs, from 1. Left out where ZS_{upper}_NO_SELFTEST is defined; where ZS_{upper}_MAIN is, the source is a
 * program that returns it. */
int zs_{name}_selftest(void);

#ifdef __cplusplus
}}
#endif

#endif
"""

GUARDS = """/* Every operation rounds once, as written: no compiler may join a product and a sum, or compute in other types. */
#if defined(__FAST_MATH__)
#error "compile without -ffast-math and -Ofast: they change what the controller decides"
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

PUBLIC = """void zs_{name}_reset(zs_{name}_state *state)
{{
    for (int32_t at = 0; at < ZS_{upper}_STATE; at++) {{
        state->x[at] = 0.0f;
    }}
}}

void zs_{name}_step(zs_{name}_state *state, const float observation[ZS_{upper}_INPUTS], float action[ZS_{upper}_OUTPUTS])
{{
{call}
}}
"""

SELFTEST = """#if !defined(ZS_{upper}_NO_SELFTEST)
static const float zs_{name}_observations[{steps}][ZS_{upper}_INPUTS] = {{
{observations}
}};

static const float zs_{name}_actions[{steps}][ZS_{upper}_OUTPUTS] = {{
{actions}
}};

/* A digest of the state behind each step: it shows differences that the decision does not, yet. */
static const uint32_t zs_{name}_states[{steps}] = {{
{states}
}};

/* A number's bits; those of one NaN for all of them. */
static uint32_t zs_{name}_bits(float number)
{{
    union {{
        float number;
        uint32_t bits;
    }} both;
    both.number = number;
    return (number != number) ? {nan}U : both.bits;
}}

/* FNV-1a, of words instead of bytes. */
static uint32_t zs_{name}_digest(const zs_{name}_state *state)
{{
    uint32_t digest = {basis}U;
    for (int32_t at = 0; at < ZS_{upper}_STATE; at++) {{
        digest = (digest ^ zs_{name}_bits(state->x[at])) * {prime}U;
    }}
    return digest;
}}

int zs_{name}_selftest(void)
{{
    zs_{name}_state state;
    float action[ZS_{upper}_OUTPUTS];
    int differs = 0;
    zs_{name}_reset(&state);
    for (int step = 0; (step < {steps}) && (differs == 0); step++) {{
        zs_{name}_step(&state, zs_{name}_observations[step], action);
        for (int at = 0; at < ZS_{upper}_OUTPUTS; at++) {{
            if (zs_{name}_bits(action[at]) != zs_{name}_bits(zs_{name}_actions[step][at])) {{
                differs = step + 1;
            }}
        }}
        if (zs_{name}_digest(&state) != zs_{name}_states[step]) {{
            differs = step + 1;
        }}
    }}
    return differs;
}}

#if defined(ZS_{upper}_MAIN)
int main(void)
{{
    return zs_{name}_selftest();
}}
#endif
#endif
"""

NAN_BITS, BASIS, PRIME = 0x7FC00000, 2166136261, 16777619  # of FNV-1a with 32 bits


def pair(controller: Controller, name: str) -> dict[str, str]:
    """The files ``zs_<name>.h`` and ``zs_<name>.c`` of a controller.

    Args:
        controller: what evolved.
        name: what its functions and files are called by; ``names.folded`` says how it is written there.

    Returns:
        file name -> ASCII text.

    Raises:
        ConfigError: its kind of network is not installed, its genome does not fit, or its step cannot be said in C.
    """
    name = folded(name)
    network, parameters = controller.network()
    translation = Translation(f"zs_{name}")
    callee = _translate(translation, network, parameters)
    header = _header(controller, name, network, parameters)
    return {f"zs_{name}.h": header, f"zs_{name}.c": _source(controller, name, translation, callee)}


def _translate(translation: Translation, network: Representation, parameters: np.ndarray) -> Callee:
    for taken in ("state", "reset", "step", "selftest", "observations", "actions", "states", "bits", "digest"):
        translation.name(taken)
    given = [
        Value(Array(FLOAT32, len(parameters)), translation.table("parameters", parameters), parameters),
        Value(Array(FLOAT32, network.state_size), "state"),
        Value(Array(FLOAT32, network.inputs), "observation"),
        Value(Array(FLOAT32, network.outputs), "output"),
    ]
    return translation.entry("decide", network.step, given)


def _header(controller: Controller, name: str, network: Representation, parameters: np.ndarray) -> str:
    upper = name.upper()
    lists = (("SENSOR", controller.sensors), ("ACTUATOR", controller.actuators))
    names = "".join(f"#define ZS_{upper}_{what}_{at} {quoted(text)}\n" for what, texts in lists for at, text in enumerate(texts))
    return HEADER.format(
        about="\n".join(f" * {line}".rstrip() for line in _about(controller)),
        name=name,
        upper=upper,
        inputs=controller.inputs,
        outputs=controller.outputs,
        state=max(1, network.state_size),
        sha256=sha256(parameters),
        version=zswarm.__version__,
        names=names,
        steps=STEPS,
    )


def _about(controller: Controller) -> list[str]:
    """Lines of a comment: what evolved, and what its numbers mean."""
    paragraphs = [
        f"A controller that evolved in zswarm: run {controller.run}, fitness {controller.fitness!r} in {controller.simulator}.",
        f"Network: {controller.representation}, {_shown(controller.representation_settings)}.",
        f"Settings of the simulator: {_shown(controller.simulator_settings)}.",
        *(f"observation[{at}]: {text}" for at, text in enumerate(controller.sensors)),
        *(f"action[{at}]: {text}" for at, text in enumerate(controller.actuators)),
        *_meaning(controller.simulator),
    ]
    return [line for text in paragraphs for line in textwrap.wrap(comment(text), WIDTH, subsequent_indent="  ")]


def _shown(settings: dict[str, object]) -> str:
    return ", ".join(f"{key} = {msgspec.json.encode(value).decode()}" for key, value in settings.items()) or "none"


def _meaning(simulator: str) -> list[str]:
    """What a simulator's data sheet says of observations and actions, where it is installed."""
    try:
        sheet = plugins.load("simulator", simulator).__doc__ or ""
    except UnknownPlugin:
        return []
    found = re.findall(r"^ *((?:Observation|Action):.*(?:\n {5,}.*)*)", textwrap.dedent(sheet), re.MULTILINE)
    return [" ".join(each.split()) for each in found]


def _source(controller: Controller, name: str, translation: Translation, callee: Callee) -> str:
    upper = name.upper()
    given = ("", "state->x", "observation", "action")
    call = [f"{INDENT}(void){each.split('->', maxsplit=1)[0]};" for at, each in enumerate(given) if at and at not in callee.takes]
    call.append(f"{INDENT}{callee.name}({', '.join(given[at] for at in callee.takes)});")
    parts = [
        f'/* See zs_{name}.h. */\n#include "zs_{name}.h"\n\n{translation.includes()}',
        GUARDS,
        translation.definitions(),
        PUBLIC.format(name=name, upper=upper, call="\n".join(call)),
        _selftest(controller, name),
    ]
    return "\n".join(parts)


def _selftest(controller: Controller, name: str) -> str:
    checked = check_steps(controller)
    digests = ", ".join(literal(digest) for digest in _digests(controller, checked.observations))
    return SELFTEST.format(
        name=name,
        upper=name.upper(),
        steps=STEPS,
        observations=_rows(checked.observations),
        actions=_rows(checked.actions),
        states=textwrap.fill(digests, WIDTH, initial_indent=INDENT, subsequent_indent=INDENT),
        nan=NAN_BITS,
        basis=BASIS,
        prime=PRIME,
    )


def _digests(controller: Controller, observations: np.ndarray) -> list[np.uint32]:
    """Of the states behind each step, as the self-test computes them."""
    network, parameters = controller.network()
    state, action = np.zeros(network.state_size, np.float32), np.zeros(network.outputs, np.float32)
    digests = []
    for observation in observations:
        network.step(parameters, state, observation, action)
        numbers = state if len(state) else np.zeros(1, np.float32)
        digest = BASIS
        for bits in np.where(np.isnan(numbers), np.uint32(NAN_BITS), numbers.view(np.uint32)).tolist():
            digest = (digest ^ bits) * PRIME % (1 << 32)
        digests.append(np.uint32(digest))
    return digests


def _rows(table: np.ndarray) -> str:
    return ",\n".join(
        "\n".join(
            textwrap.wrap(f"{{{', '.join(map(literal, row))}}}", WIDTH, initial_indent=INDENT, subsequent_indent=INDENT + " ")
        )
        for row in table
    )
