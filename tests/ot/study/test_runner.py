"""Play a study in a folder with other content; tests/integration plays whole ones."""

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from msgspec import structs

from tests.ot.invented_record import EXPERIMENT
from zswarm.errors import ConfigError
from zswarm.ot.cluster.connection import Connection
from zswarm.ot.logger import Logger
from zswarm.ot.study.outcome import StudyLogger
from zswarm.ot.study.runner import Player
from zswarm.ot.study.study import Study


@pytest.fixture
def study(tmp_path: Path) -> Iterator[Study]:
    with Study.create(
        structs.replace(EXPERIMENT, generations=1), "x", tmp_path / "runs"
    ) as study:
        yield study


def player(study: Study) -> Player:
    connection = Connection(study.experiment.cluster)
    event = threading.Event()
    return Player(study.folder, study.left, connection, StudyLogger(), event, study.ended)


def test_a_link_in_the_place_of_a_run_is_neither_followed_nor_removed(
    study: Study, tmp_path: Path
) -> None:
    (one,) = study.planned
    place, elsewhere = study.folder / one.name, tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "lock").touch()
    for target, said in (
        (tmp_path / "nowhere", "No such file"),
        (elsewhere, "symbolic link"),
    ):
        place.symlink_to(target)
        with pytest.raises(
            ConfigError, match=f"expected a run's folder or none: .*{said}"
        ):
            player(study)._opened(one, Logger())
        assert place.is_symlink()
        place.unlink()
    assert (elsewhere / "lock").exists()


def test_leaving_does_not_wait_for_a_run_whose_thread_did_not_start(study: Study) -> None:
    """Ctrl-C may come while it is being started."""
    left = player(study)
    left._threads.append(threading.Thread())
    left._leave()
    assert not left.going_on
