"""Repeat what an optimizer was told, where its state is not recorded."""

import time
from collections.abc import Callable, Iterable, Iterator

from zswarm.errors import ConfigError
from zswarm.ot.optimizers.optimizer import Optimizer, Told
from zswarm.ot.record.history_hash import digest

FIRST_S, NEXT_S = 2.0, 30.0  # between lines about the progress


def retell(
    optimizer: Optimizer, told: Iterable[Told], digests: Callable[[int], list[bytes]]
) -> None:
    """Have an optimizer ask again for all generations, and tell it their recorded fitness.

    Args:
        digests: returns those of the recorded genomes of a generation.

    Raises:
        ConfigError: it proposes other genomes than were recorded.
    """
    for generation, one in enumerate(told):
        if list(map(digest, optimizer.ask())) != digests(generation):
            raise ConfigError(
                f"optimizer: generation {generation + 1} was recorded with other candidates than "
                "this program proposes: resume with the versions with which the run began"
            )
        optimizer.tell(one.fitness, one.measures)


def timed(
    told: Iterable[Told], generations: int, say: Callable[[str], None]
) -> Iterator[Told]:
    """Yield generations, and say how long repeating them will take if that is noticeable."""
    began = time.monotonic()
    line = began + FIRST_S
    for done, one in enumerate(told):
        if done and (now := time.monotonic()) >= line:
            line = now + NEXT_S
            rest = (now - began) / done * (generations - done)
            say(
                f"replaying the recorded generations to the optimizer: {done} of {generations}, "
                f"about {rest:.0f} s to go"
            )
        yield one
