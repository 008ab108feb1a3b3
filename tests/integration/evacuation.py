"""The experiment that most tests disturb: a compiled simulator with trials of a chosen length."""

from pathlib import Path

EXPERIMENT = """
name = "{name}"
seed = 3
generations = 4
[problem]
simulator = "{simulator}"
trials = 20
[problem.settings]
{settings}
[representation]
kind = "fully-meshed"
[optimizer]
kind = "nnga"
population = 50
"""
TRIALS = (50 + 3 * 37) * 20
ASSESSED = TRIALS // 10  # more, at the end
COUNTED = "SELECT coalesce(sum(count), 0) FROM outcomes"


def write(folder: Path, name: str, steps: int, more: str = "") -> str:
    """Write the experiment into a folder; 4,000 steps take a millisecond."""
    file = folder / "experiment.toml"
    settings = f"steps = {steps}\nagents = 20"
    parts = {"simulator": "emergency-exit", "settings": settings}
    file.write_text(EXPERIMENT.format(name=name, **parts) + more)
    return str(file)
