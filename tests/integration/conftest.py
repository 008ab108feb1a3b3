"""Define fixtures for several modules of real programs."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration import asleep
from tests.integration.paced import Scene, Size, Undisturbed, play_undisturbed
from zswarm.plugins import registry as plugins


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Undisturbed:
    """Return the result of a ``scene``'s run without faults."""
    return play_undisturbed(tmp_path_factory.mktemp("undisturbed"), Size())


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[Scene]:
    with Scene(tmp_path, Size()) as scene:
        yield scene


@pytest.fixture(scope="module")
def sleeping(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Have trials that sleep here and in the programs."""
    folder = tmp_path_factory.mktemp("asleep")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in asleep.installed(folder).items():
            patch.setenv(name, value)
        patch.syspath_prepend(folder)
        for cached in (plugins.entry_points, plugins._installed):
            cached.cache_clear()
        yield
    for cached in (plugins.entry_points, plugins._installed):
        cached.cache_clear()
