"""Show a run in TensorBoard.

Install ``tensorboardX`` and ``tensorboard``, then run ``tensorboard --logdir runs``.
"""

import argparse
import math
from typing import Any

from tensorboardX import SummaryWriter

import zswarm


class TensorBoard(zswarm.Logger):
    """Write an event file into the run's folder: fitness and other numbers by generation."""

    writer: SummaryWriter

    def on_start(self, run: zswarm.Started) -> None:
        """Open the event file when the run starts or resumes."""
        self.writer = SummaryWriter(
            str(run.folder / "tensorboard"), purge_step=run.generation
        )
        self.writer.add_text(
            "experiment", f"{run.experiment.name}, seed {run.experiment.seed}"
        )

    def on_generation(self, generation: zswarm.Generation) -> None:
        """Write the numbers of a generation."""
        numbers = {
            **generation.statistics,
            "evaluations": generation.evaluations,
            "slots": generation.slots,
        }
        for name, value in numbers.items():
            if math.isfinite(value):
                self.writer.add_scalar(name, value, generation.generation)

    def on_event(self, event: zswarm.Note) -> None:
        """Write an event, such as a lost server or a repeated trial."""
        self.writer.add_text("events", f"{event.event} {event.server} {event.text}")

    def on_end(self, result: zswarm.Result | None) -> None:
        """Close the event file."""
        self.writer.close()


def evolve(generations: int, out: str = "runs", servers: Any = "auto") -> zswarm.Run:
    """Run the experiment with the logger."""
    experiment = zswarm.load(
        "stadium", {"generations": generations, "cluster.servers": servers}
    )
    return zswarm.run(experiment, out=out, loggers=[TensorBoard()], progress=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--generations", type=int, default=100)
    parser.add_argument("--servers", default="auto", choices=["auto", "local"])
    given = parser.parse_args()
    evolve(given.generations, servers=given.servers)
