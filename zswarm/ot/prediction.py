"""What the cost model says of an experiment: each way to run it, with messages, time, and how many slots are of use."""

import msgspec

from zswarm.ot import cost_model
from zswarm.ot.cost_model import Constants, Plan, Way

WAYS: dict[str, Way] = {
    "parameters": cost_model.blob,
    "optimizer, by turn": cost_model.by_turn,
    "optimizer, by agent": cost_model.by_agent,
    "broker": cost_model.internal,
    "files": cost_model.external,
}
MEANINGS = {
    "parameters": "candidates travel as parameters, the controller is on the server: what run does",
    "optimizer, by turn": 'controller = "optimizer": two messages for each turn',
    "optimizer, by agent": 'and messages = "agent": two messages for each agent and step',
    "broker": "the paper's first design: the same, and servers are discovered for each candidate",
    "files": "the paper's second design: exported as source code, compiled for each candidate",
}


class Predicted(msgspec.Struct, frozen=True, kw_only=True):
    """One way to run an experiment."""

    way: str
    messages: float  # of the whole run
    seconds: float
    useful_slots: int  # more gain less than a hundredth


def predict(plan: Plan, constants: Constants, slots: int) -> list[Predicted]:
    """Of each way, in the order of ``WAYS``."""
    return [
        Predicted(
            way=name,
            messages=way(plan, constants, slots).messages * plan.simulations,
            seconds=cost_model.expected_s(way, plan, constants, slots),
            useful_slots=cost_model.useful_slots(way, plan, constants),
        )
        for name, way in WAYS.items()
    ]
