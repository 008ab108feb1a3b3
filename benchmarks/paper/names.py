"""Name the designs as results do, and define what they have in common."""

from zswarm.ot.estimate.cost_model import TABLE_I

STOCK, NODELAY = "broker", "broker, TCP_NODELAY"
FILES = {"cc": "files, gcc", "catkin": "files, catkin_make"}
ZENOH = {
    "blob": "parameters over Zenoh",
    "turn": "optimizer over Zenoh, by turn",
    "agent": "optimizer over Zenoh, by agent",
}
LOCAL = "no transport"
PAPER_STEP_S = TABLE_I.step_s
