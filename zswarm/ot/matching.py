"""Which servers an experiment can use. A server judges what is asked of it, the experiment what the server offers."""

from typing import NamedTuple

from zswarm import labels
from zswarm.experiment import Cluster, Experiment
from zswarm.labels import Preference, Term
from zswarm.protocol.messages import Offer, Requirements
from zswarm.version_hash import version_hash, versions


class Choice(NamedTuple):
    """What ``[cluster]`` says of the servers to use."""

    require: tuple[Term, ...] = ()
    rank: tuple[Preference, ...] = ()
    max_slots: int = 0  # of them all; 0: no limit

    def mismatch(self, offer: Offer) -> str:
        """Why a server is not used, by its own words or by what is required; "" when it is."""
        return offer.mismatch or labels.unmet(self.require, offer.labels)

    def place(self, offer: Offer) -> tuple[float, ...]:
        """Where a server stands among others: the lower, the earlier."""
        return labels.place(self.rank, offer.labels)


def choice(options: Cluster) -> Choice:
    """What ``[cluster]`` says of the servers to use."""
    require = labels.requirements(options.require, "cluster.require")
    return Choice(require, labels.preferences(options.rank, "cluster.rank"), options.max_slots)


def requirements(complete: Experiment, options: Cluster) -> Requirements:
    """What servers are asked whether they can play an experiment."""
    problem, representation = complete.problem, complete.representation.kind
    return Requirements(
        simulator=problem.simulator,
        representation=representation,
        version_hash=version_hash(problem.simulator, representation),
        trial_memory_mb=options.trial_memory_mb,
        settings=problem.settings,
        versions=versions(problem.simulator, representation),
    )
