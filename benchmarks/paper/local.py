"""Simulate within this process: the cost without any transport."""

from zswarm.evaluate import turns
from zswarm.ot.problem import Problem
from zswarm.ot.workload import Workload


class Local:
    """Simulate and count.

    Attributes:
        turns: in which agents acted.
        decisions: of all agents.
    """

    def __init__(self) -> None:
        self.turns = self.decisions = 0

    def play(self, problem: Problem, workload: Workload) -> None:
        """Simulate, one candidate after another."""
        parameters = problem.representation.parameters(workload.genomes)
        for trial, seed in enumerate(workload.seeds):
            row = parameters[workload.participants[trial]]
            for turn in turns(problem.simulator, problem.representation, row, int(seed)):
                self.turns += 1
                self.decisions += len(turn.agents)
            workload.fitness[trial, 0] = problem.simulator.outcome().fitness[0]
