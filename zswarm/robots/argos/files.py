"""Write a controller as files of ARGoS: NEAT's genome or AutoMoDe's machine, and its lines."""

from string import ascii_letters, digits

import numpy as np

from zswarm.champion.controller import Controller
from zswarm.config.decode import convert
from zswarm.errors import ConfigError
from zswarm.nets.chocolate import Chocolate, decoded
from zswarm.nets.feed_forward import FeedForward
from zswarm.nets.neat import Neat
from zswarm.nets.neat_genome import Genes
from zswarm.nets.representation import Representation
from zswarm.robots.argos import machine
from zswarm.robots.argos.genome import (
    LARGEST_ID,
    MODELS,
    OUTPUTS,
    SLOPE,
    ArgosNetwork,
    Gene,
)
from zswarm.robots.c.reference_steps import sha256
from zswarm.sims.epuck.missions import MISSIONS
from zswarm.sims.epuck.simulator import REALITIES, EpuckSettings

PLAIN = frozenset(f"{ascii_letters}{digits}._")  # "--" may not occur in a comment
CONTROLLERS = {
    "1.1": ("nn_rm_1dot1_controller", "nn_rm_1dot1"),
    "1.2": ("nn_rm_1dot2_controller", "nn_rm_1dot2"),
    "1.2-machine": ("automode_controller", "automode"),
}
LINES = """\
<!-- {about}
     Put this in the place of <controllers> in a mission's .argos file, and give its robots
     <controller config="{id}"/>. Set library to where yours is. -->
<controllers>
  <{element} id="{id}" library="lib{id}.so">
    <actuators>
      <epuck_wheels implementation="default" noise_std_dev="{wheels:g}"/>
      <epuck_rgb_leds implementation="default" medium="leds"/>
      <epuck_range_and_bearing implementation="medium" medium="rab" data_size="4"
                               range="{range:g}"/>
    </actuators>
    <sensors>
      <epuck_proximity implementation="default" show_rays="false" noise_level="{proximity:g}"
                       calibrated="true"/>
      <epuck_range_and_bearing implementation="medium" medium="rab" data_size="4"
                               loss_probability="{loss:g}" calibrated="true"/>
      <epuck_light implementation="default" show_rays="false" noise_level="{light:g}"
                   calibrated="true"/>
      <epuck_ground implementation="rot_z_only" noise_level="{ground:g}" calibrated="true"/>
      <epuck_omnidirectional_camera implementation="rot_z_only" medium="leds" show_rays="false"/>
    </sensors>
    <params {parameters}/>
  </{element}>
</controllers>
"""


def files(controller: Controller, name: str) -> dict[str, str]:
    """Return the genome or the machine, and the lines of an ``.argos`` file that use it.

    Raises:
        ConfigError: it is not a controller of e-pucks that ARGoS' controllers can read.
    """
    if controller.simulator != "epuck":
        raise ConfigError(
            f"--to argos: expected a controller of epuck, not of {controller.simulator}"
        )
    network, _ = controller.network()
    settings = convert(controller.simulator_settings, EpuckSettings, "problem.settings")
    if isinstance(network, Chocolate) == (settings.reference_model != "1.2-machine"):
        raise ConfigError(
            "--to argos: expected chocolate with reference_model 1.2-machine, or a network with "
            f"1.1 or 1.2, not {controller.representation} with {settings.reference_model}"
        )
    if isinstance(network, Chocolate):
        text = machine.written(decoded(network.vectors([controller.genome])[0])) + "\n"
        parameters = f'fsm-config="{text.strip()}"'
    else:
        text = written(_network(network, controller.genome), controller)
        parameters = f'genome_file="zs_{name}.txt" record="false"'
    lines = _lines(settings, parameters, _about(controller))
    return {f"zs_{name}.txt": text, f"zs_{name}.argos": lines}


def written(network: ArgosNetwork, controller: Controller) -> str:
    """Return the genome file of a network."""
    rows = ["/* " + _about(controller) + " */", "genomestart 1", "trait 1" + " 0" * 8]
    places = {network.bias: "1 3"}
    places |= dict.fromkeys(network.inputs, "1 1")
    places |= dict.fromkeys(network.outputs, "0 2")
    places |= dict.fromkeys(network.hidden, "0 0")
    order = [*network.inputs, network.bias, *network.outputs, *network.hidden]
    rows += [f"node {node} 1 {places[node]}" for node in order]
    for innovation, (source, target, weight, enabled) in enumerate(network.genes, 1):
        number = f"{weight:.17g}" if float(f"{weight:.6g}") != weight else f"{weight:.6g}"
        rows.append(
            f"gene 1 {source} {target} {number} 0 {innovation} {number} {enabled:d}"
        )
    return "\n".join([*rows, "genomeend 1", ""])


def _about(controller: Controller) -> str:
    run = "".join(letter for letter in controller.run if letter in PLAIN)
    _, parameters = controller.network()
    return (
        f"Controller of zswarm: run {run}, fitness {controller.in_search()}, parameters sha256 "
        f"{sha256(parameters)}"
    )


def _lines(settings: EpuckSettings, parameters: str, about: str) -> str:
    element, id_ = CONTROLLERS[settings.reference_model]
    wheels, proximity, light, ground, loss = REALITIES[settings.reality]
    return LINES.format(
        about=about,
        element=element,
        id=id_,
        wheels=wheels,
        proximity=proximity,
        light=light,
        ground=ground,
        loss=loss,
        range=MISSIONS[settings.mission].hearing,
        parameters=parameters,
    )


def _network(network: Representation, genome: bytes) -> ArgosNetwork:
    if network.inputs not in MODELS or network.outputs != OUTPUTS:
        raise ConfigError(
            f"--to argos: expected 14 or 24 inputs and 2 outputs, not {network.inputs} and "
            f"{network.outputs}"
        )
    if isinstance(network, FeedForward):
        return _of_layer(network, genome)
    if isinstance(network, Neat):
        return _of_neat(network, genome)
    raise ConfigError(
        "--to argos: expected feed-forward, neat or chocolate: ARGoS' controllers know no other"
    )


def _of_layer(network: FeedForward, genome: bytes) -> ArgosNetwork:
    settings = network.settings
    if settings.hidden or settings.output_activation != "sigmoid":
        raise ConfigError(
            "--to argos: expected feed-forward with hidden = [] and sigmoid outputs: NEAT's "
            "networks have sigmoids only, and each hidden layer takes a decision more there"
        )
    ((table,),) = network.tables([genome])[:1]
    scale = 1.0 if settings.steepness == SLOPE else settings.steepness / SLOPE
    sensors, outputs = _numbered(network)
    genes = [
        Gene(source, target, scale * _decimal(weight), enabled=True)
        for target, row in zip(outputs, table, strict=True)
        for source, weight in zip(sensors, row, strict=True)
    ]
    return ArgosNetwork(sensors[:-1], sensors[-1], outputs, [], genes)


def _of_neat(network: Neat, genome: bytes) -> ArgosNetwork:
    if not network.settings.synchronous:
        raise ConfigError(
            "--to argos: expected neat with synchronous = true: NEAT's networks in ARGoS decide so"
        )
    network.parameters([genome])  # checks the genome
    nodes, links = Genes.copied(genome)
    sensors, outputs = _numbered(network)
    ids = nodes["id"][OUTPUTS:].tolist()
    first = outputs[-1] + 1
    if ids and not first <= min(ids) <= max(ids) <= LARGEST_ID:
        hidden = [*range(first, first + len(ids))]
    else:
        hidden = ids
    known = dict(zip([*range(1, network.inputs + 1)], sensors[:-1], strict=True))
    known |= dict(zip(nodes["id"].tolist(), [*outputs, *hidden], strict=True))
    # Each neuron's factor, which is NEAT's for all, goes into its weights.
    scales = dict(zip(known.values(), [1.0] * len(known), strict=True))
    for id_, _, factor in nodes.tolist():
        scales[known[id_]] = 1.0 if factor == -SLOPE else factor / -SLOPE
    genes = [
        Gene(known[source], known[target], weight * scales[known[target]], bool(enabled))
        for source, target, weight, enabled in links.tolist()
    ]
    genes += [
        Gene(sensors[-1], known[id_], -bias * scales[known[id_]], enabled=True)
        for id_, bias, _ in nodes.tolist()
        if bias
    ]
    return ArgosNetwork(sensors[:-1], sensors[-1], outputs, hidden, genes)


def _numbered(network: Representation) -> tuple[list[int], list[int]]:
    """Return the numbers of inputs and bias, and those of the outputs."""
    bias = network.inputs + 1
    return [*range(1, bias + 1)], [bias + 1, bias + 2]


def _decimal(weight: np.float32) -> float:
    """Return the number with the fewest digits that is this one in float32."""
    return float(str(weight))
