"""What several modules of real programs need."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from paced import Scene, Size, Undisturbed, play_undisturbed


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Undisturbed:
    """What the run of a ``scene`` comes to when nothing happens to it."""
    return play_undisturbed(tmp_path_factory.mktemp("undisturbed"), Size())


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[Scene]:
    with Scene(tmp_path, Size()) as scene:
        yield scene
