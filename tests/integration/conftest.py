"""Define fixtures for several modules of real programs."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.paced import Scene, Size, Undisturbed, play_undisturbed


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Undisturbed:
    """Return the result of a ``scene``'s run without faults."""
    return play_undisturbed(tmp_path_factory.mktemp("undisturbed"), Size())


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[Scene]:
    with Scene(tmp_path, Size()) as scene:
        yield scene
