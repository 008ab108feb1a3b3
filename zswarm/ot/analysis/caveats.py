"""Caveats that a reader of a run's results has to know."""

from zswarm.ot.record.epochs import epochs, mark
from zswarm.ot.record.folder import EXPERIMENT
from zswarm.ot.record.reader import Run
from zswarm.system.format import plural


def caveats(run: Run) -> list[str]:
    """Return why the experiment may have another history when it is run again."""
    faulted, doubtful = run.marked()
    source = run.meta.get("imported_from")
    changed = run.changed
    wrong = "came from a server that was later proved to compute wrong."
    versions = mark(epochs(run), run.generations())
    simulator = run.experiment.problem.simulator
    found = {
        f"Trials of {simulator} do not repeat (repeatable = False): another run of this experiment "
        "has other results and another history hash.": "repeatable" in run.meta,
        "Time limits the run ([stop] seconds): when it is run again it may end after another "
        "generation, with another history hash.": run.experiment.stop.seconds,
        f"The run was {versions}.": versions,
        f"The run was imported, not evolved here: {source}.": source,
        f"{plural(faulted, 'trial')} failed by what a machine did, and counted as failed.": faulted,
        f"{plural(doubtful, 'trial')} {wrong}": doubtful,
        f"{EXPERIMENT} was changed after the run began ({', '.join(changed)}); this page shows "
        "what was run.": changed,
    }
    return [text for text, applies in found.items() if applies]
