"""Play the champion of a run once more where it evolved: in the Stage that a slot starts.

python champion.py runs/stage-exit
"""

import sys

import zswarm

run = zswarm.read(sys.argv[1])
with zswarm.connect("local") as cluster:
    played = cluster.outcomes(
        zswarm.problem(run.experiment), [run.champion().genome], seeds=[1]
    )
out, seconds = (int(played.metrics["escaped"].item()), played.metrics["seconds"].item())
robots = run.experiment.problem.settings["robots"]
print(
    f"{out} of {robots} robots left, after {seconds:.1f} s; fitness {played.fitness.item():g}"
)
