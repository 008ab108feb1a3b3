"""Read FREVO's XML: settings of its components, and networks with their fitness.

The file is untrusted: no entity is expanded, nothing it names is fetched, size and depth are
bounded.
"""

import math
import re
from collections.abc import Sequence
from decimal import Decimal
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np

from zswarm.errors import ConfigError
from zswarm.system.text import clean

MAX_DEPTH = 32
MAX_ELEMENTS = 2_000_000  # some 700 bytes each; a network of 300 nodes has 90,000
NET, NET_DEPTH = "FullyMeshedNet", 4  # frevo/populations/population/FullyMeshedNet
ACTIVATIONS = {"LINEAR": "clamp", "SIGMOID": "sigmoid", "RELU": "relu"}
INTEGER = re.compile(r"[+-]?\d{1,18}")
NUMBER = re.compile(r"[+-]?(\d{1,400}\.?\d{0,400}|\.\d{1,400})([eE][+-]?\d{1,4})?[fFdD]?")


class Net(NamedTuple):
    """A network."""

    shape: tuple[int, int, int]  # inputs, outputs, nodes
    settings: dict[str, Any]  # of its representation
    genome: bytes
    fitness: float


def parse(body: bytes) -> tuple[Element, list[Net]]:
    """Read the elements except networks, and the networks.

    Raises:
        ConfigError: not an XML text that FREVO wrote.
    """
    parser, builder, depth, elements = expat.ParserCreate(), TreeBuilder(), 0, 0
    nets: list[Net] = []

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, elements
        depth, elements = depth + 1, elements + 1
        if elements > MAX_ELEMENTS:
            raise ConfigError(
                f"not a result of FREVO: more than {MAX_ELEMENTS:,} elements"
            )
        if depth > MAX_DEPTH:
            raise ConfigError(f"not a result of FREVO: nested deeper than {MAX_DEPTH}")
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        element = builder.end(tag)
        if depth == NET_DEPTH:
            nets.append(_net(element))
            element.clear()
        depth -= 1

    def doctype(
        _name: str, _system: str | None, _public: str | None, internal: int
    ) -> None:
        if internal:  # FREVO's names ISave.dtd, which is not read
            raise ConfigError("not a result of FREVO: it declares a document type")

    def entity(*_declaration: object) -> None:
        raise ConfigError("not a result of FREVO: it declares entities")

    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler, parser.EntityDeclHandler = doctype, entity
    parser.buffer_text = True
    try:
        parser.Parse(body, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise ConfigError(f"damaged, or not XML: {clean(str(error))}") from None
    root = builder.close()
    if root.tag != "frevo":
        raise ConfigError(
            f"not a result of FREVO: its outermost element is {clean(root.tag)!r}"
        )
    return root, nets


def entries(root: Element, part: str) -> dict[str, str]:
    """Return the settings of a component; the first of equal keys counts."""
    found = reversed(root.findall(f"{part}/*"))
    return {entry.get("key", ""): entry.get("value", "").strip() for entry in found}


def _net(element: Element) -> Net:
    """Read a network as ``FullyMeshedNet.exportToXmlElement`` writes it."""
    if element.tag != NET:
        raise ConfigError(
            f"it holds {clean(element.tag)!r}; only results of {NET} can be imported"
        )
    shape = ("input_nodes", "output_nodes", "nodes")
    inputs, outputs, nodes = (
        integer(element.get(key, ""), f"{NET}: {key}") for key in shape
    )
    elements = element.findall("nodes/node")
    found = {integer(node.get("nr", ""), "node: nr"): node for node in elements}
    possible = 0 < inputs <= inputs + outputs <= nodes == len(elements)
    if not possible or sorted(found) != list(range(nodes)):
        raise ConfigError("damaged: a network does not hold the nodes that it states")
    if element.get("random_source", "false").lower() == "true":
        raise ConfigError(
            "its networks have a random source (noise on the biases), which zswarm's do not have"
        )
    activation = element.get("activation_function", "LINEAR")
    if activation not in ACTIVATIONS:
        raise ConfigError(
            f"unknown activation function {clean(activation)!r}; expected one of: "
            f"{', '.join(ACTIVATIONS)}"
        )
    settings: dict[str, Any] = {"activation": ACTIVATIONS[activation]}
    for key in ("weight_range", "bias_range"):
        settings[key] = number(element.get(key, "2.0"), f"{NET}: {key}")
    rows = [_row(found[node], node, nodes) for node in range(inputs, nodes)]
    fitness = element.get("fitness", "").strip()
    value = math.nan if fitness == "NaN" else number(fitness, f"{NET}: fitness")
    return Net((inputs, outputs, nodes), settings, b"".join(rows), value)


def _row(node: Element, index: int, nodes: int) -> bytes:
    """Return the weights and the bias of a node as float32."""
    weights = node.findall("weights/weight")
    sources = [integer(weight.get("from", ""), "weight: from") for weight in weights]
    if sources != list(range(nodes)):
        raise ConfigError(
            f"damaged: node {index} of a network does not have one weight from each of its {nodes} "
            "nodes"
        )
    return _singles(
        [*(weight.text for weight in weights), node.findtext("bias")]
    ).tobytes()


def integer(text: str, what: str) -> int:
    """Read a whole number."""
    if not INTEGER.fullmatch(text.strip()):
        raise ConfigError(f"{what}: expected a whole number, not {clean(text)!r}")
    return int(text)


def number(text: str | None, what: str) -> float:
    """Read a number as Java writes it, such as ``-1.0E-4`` or ``0.3f``."""
    text = (text or "").strip()
    if not NUMBER.fullmatch(text) or not math.isfinite(
        value := float(text.rstrip("fFdD"))
    ):
        raise ConfigError(f"{what}: expected a finite number, not {clean(text)!r}")
    return value


def _singles(texts: Sequence[str | None]) -> np.ndarray:
    """Return (numbers,) float32, each nearest to its decimal digits: the one that Java wrote."""
    what = "a weight or bias"
    values = np.array([number(text, what) for text in texts])
    with np.errstate(over="ignore"):
        near = values.astype("<f4")
    if not (finite := np.isfinite(near)).all():
        raise ConfigError(
            f"{what}: expected a number of 32 bits, not {values[~finite][0]:g}"
        )
    other = np.nextafter(near, np.where(values > near, np.inf, -np.inf).astype("<f4"))
    middles = (near.astype(float) + other.astype(float)) / 2
    # 64 bits were rounded to the middle between two float32: the digits decide.
    for index in np.flatnonzero((values != near) & (values == middles)).tolist():
        exact = Decimal((texts[index] or "").strip().rstrip("fFdD"))
        middle = Decimal(values[index].item())
        if exact != middle:
            near[index] = (max if exact > middle else min)(near[index], other[index])
    return near
