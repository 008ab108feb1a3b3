"""Write result files as FREVO 1.5 does.

See its FrevoMain.saveResult, NNGA.saveResults and FullyMeshedNet.exportToXmlElement.
"""

import json
from collections.abc import Mapping, Sequence
from typing import Any
from xml.sax.saxutils import quoteattr

from tests.repository import REPOSITORY

GOLDEN = REPOSITORY / "tests" / "golden"
SESSION = {
    "CustomName": "DEFAULT",
    "NumberofRuns": "1",
    "StartingSeed": "12345",
    "CurrentSeed": "12345",
}
PROBLEM = {
    "width": "20",
    "steps": "50",
    "NumberofEvaluations": "10",
    "fieldsource": "FIELD_FROM_FILE",
    "height": "20",
    "seedforEmergencyExits": "0",
    "NumberofAgents": "10",
    "NumberofBlockades": "20",
    "NumberofEmergencyExits": "5",
    "Filename": "Components/Problems/EmergencyExit/emergencyexit/Stadium.ser",
    "length_of_timestep_ms": "200",
}
METHOD = {
    "xoverMethod": "1",
    "mutationseverity": "0.3f",
    "populationsize": "50",
    "populationnumber": "1",
    "percentage_random": "0.10f",
    "mutationprobability": "1f",
    "percentage_mutate": "0.40f",
    "saveImprovements": "true",
    "percentage_elite": "0.15f",
    "mutationMethod": "1",
    "percentage_xover": "0.30f",
    "saveinterval": "0",
    "interXover_frequency": "10",
    "percentage_renew": "0.05f",
    "generations": "200",
}
REPRESENTATION = {
    "mutation_rate": "0.2f",
    "variable_mutation_rate": "false",
    "iterations": "2",
    "bias_range": "2f",
    "weight_range": "2f",
    "random_source": "false",
    "hiddenNodes": "2",
    "activationFunction": "LINEAR",
    "random_bias_range": "0.2f",
}


def golden_nets(name: str) -> list[dict[str, Any]]:
    """Return recorded nets of Emergency Exit's size."""
    nets = json.loads((GOLDEN / f"{name}.json").read_text())["nets"]
    return [net for net in nets if (net["inputs"], net["outputs"]) == (10, 2)]


def entries(name: str, settings: Mapping[str, str]) -> str:
    rows = (
        f'    <{name} key={quoteattr(key)} type="STRING" value={quoteattr(value)}/>'
        for key, value in settings.items()
    )
    return "\n".join(rows)


def net(
    weights_into: Sequence[Sequence[float]],
    bias: Sequence[float],
    fitness: float,
    activation: str = "LINEAR",
    inputs: int = 10,
) -> str:
    """Format a net: weights into, and bias of, each node that is not an input."""
    nodes = inputs + len(bias)
    written = [f'<node nr="{number}" type="inputNode"/>' for number in range(inputs)]
    for number, (weights, constant) in enumerate(
        zip(weights_into, bias, strict=True), start=inputs
    ):
        rows = "\n".join(
            f'<weight from="{source}">{weight}</weight>'
            for source, weight in enumerate(weights)
        )
        written.append(
            f'<node nr="{number}" type="node">\n<bias>{constant}</bias>\n'
            f"<weights>\n{rows}\n</weights>\n</node>"
        )
    return (
        f'<FullyMeshedNet input_nodes="{inputs}" output_nodes="2" nodes="{nodes}" '
        'weight_range="2.0" bias_range="2.0" '
        'random_bias_range="0.2" random_source="false" variable_mutation_rate="false" '
        f'activation_function="{activation}" '
        f'fitness="{fitness}">\n<nodes>\n'
        + "\n".join(written)
        + "\n</nodes>\n</FullyMeshedNet>"
    )


def text(
    nets: Sequence[str],
    *,
    session: Mapping[str, str] = {},
    problem: Mapping[str, str] = {},
    method: Mapping[str, str] = {},
    representation: Mapping[str, str] = {},
    generation: int = 4,
) -> str:
    """Return a whole file; mappings say what differs from FREVO's defaults."""
    populations = "\n".join(nets)
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<!DOCTYPE frevo SYSTEM "somewhere//Components//ISave.dtd">

<frevo>
  <sessionconfig>
{entries("configentry", {**SESSION, **session})}
  </sessionconfig>
  <problem class="emergencyexit.EmergencyExit">
{entries("problementry", {**PROBLEM, **problem})}
  </problem>
  <method class="nnga.NNGA">
{entries("methodentry", {**METHOD, **method})}
  </method>
  <ranking class="AbsoluteRanking.AbsoluteRanking">
    <rankingentry key="parallelthreads" type="INT" value="1"/>
  </ranking>
  <representation class="fullyMeshedNet.FullyMeshedNet">
{entries("representationentry", {**REPRESENTATION, **representation})}
  </representation>
  <populations count="1" generation="{generation}" randomseed="12345" best_fitness="0.0">
    <population>
{populations}
    </population>
  </populations>
</frevo>
"""


def trace() -> tuple[str, list[bytes], list[float]]:
    """Return a population that FREVO ranked: its file, genomes (weights, bias) and fitness."""
    import numpy as np

    recorded = json.loads((GOLDEN / "nnga_trace.json").read_text())
    ranked = recorded["generations"][-1]["ranked"]
    tables = [
        np.array(recorded["genomes"][str(number)], "<f4").reshape(4, 15)
        for number, _ in ranked
    ]
    nets = [
        net(table[:, :-1].tolist(), table[:, -1].tolist(), fitness)
        for table, (_, fitness) in zip(tables, ranked, strict=True)
    ]
    written = text(
        nets,
        problem={"fieldsource": "RANDOM_FIELD", "NumberofEvaluations": "2"},
        method={"populationsize": "10", "generations": "5"},
    )
    return (
        written,
        [table.tobytes() for table in tables],
        [fitness for _, fitness in ranked],
    )
