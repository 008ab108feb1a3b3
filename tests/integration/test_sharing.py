"""Users share a server, as real programs: a second one gets half of what a study has."""

import json
import sys
import time
from collections import Counter
from collections.abc import Iterator

import pytest
from click.testing import CliRunner

from tests.integration.paced import Scene, Size, play_undisturbed
from tests.integration.programs import Optimizer, wait_until
from tests.promise.promise import check_run
from zswarm.ss.cli import command

pytestmark = pytest.mark.faults

SLOTS, RUNS, TRIAL_S = 8, 6, 0.15
SIZE = Size(generations=2, population=30, trials=4)
STUDY = f"""
[study]
repeat = {RUNS}
at_once = {RUNS}
"""
LATE_S = 60.0  # for what takes 5 s at most on a machine that does little else


class Lab:
    """A server, and users who start runs on it."""

    def __init__(self, scene: Scene) -> None:
        self._scene, self.programs = scene, list[Optimizer]()
        self._server, pace = scene.server("ss", capacity=SLOTS)
        pace.set(TRIAL_S)

    def start(self, user: str, more: str = "") -> Optimizer:
        """Let a user start a run, or the study that ``more`` describes."""
        folder = self._scene.folder / user
        folder.mkdir()
        file = folder / "paced.toml"
        SIZE.write(file)
        file.write_text(file.read_text() + more)
        where = ["--servers", "1", f"--connect={self._server.endpoint}", "--no-multicast"]
        names = self._scene.environment | {"LOGNAME": user}
        optimizer = Optimizer(folder, "ot", ["run", str(file), "--json", *where], **names)
        self.programs.append(optimizer)
        return optimizer

    def slots(self) -> Counter[str]:
        """Return the slots of each user with a lease, as the server's status has them."""
        where = {"RUNTIME_DIRECTORY": str(self._scene.folder)}
        asked = CliRunner().invoke(command, ["status", "--json"], env=where)
        held = Counter[str]()
        for lease in json.loads(asked.stdout)["leases"]:
            held[lease["user"]] += lease["slots"]
        return held


@pytest.fixture
def lab(scene: Scene) -> Iterator[Lab]:
    lab = Lab(scene)
    yield lab
    for program in lab.programs:
        program.close()


def test_a_second_user_has_half_of_the_slots_of_a_study_in_a_moment(
    scene: Scene, lab: Lab
) -> None:
    """And the study has them again when his run has ended; no history is another one."""
    study = lab.start("ada", STUDY)
    wait_until(lambda: lab.slots() == {"ada": SLOTS}, "the study has all slots")
    run = lab.start("bob")
    wait_until(lambda: "bob" in lab.slots(), "the second user has a lease")
    begun = time.monotonic()
    half = {"ada": SLOTS // 2, "bob": SLOTS // 2}
    wait_until(lambda: lab.slots() == half, "both have half of the slots", LATE_S)
    sys.stdout.write(f"\nhalf of the slots after {time.monotonic() - begun:.2f} s\n")
    done = run.done()
    wait_until(lambda: lab.slots() == {"ada": SLOTS}, "the study has all slots again")
    assert study.done()["finished"] == RUNS
    (scene.folder / "alone").mkdir()
    alone = play_undisturbed(scene.folder / "alone", SIZE)
    assert done["history_hash"] == alone.history_hash
    of_study = check_run(scene.folder / "ada" / "runs" / "paced" / "seed-5", sample=0)
    assert of_study.history_hash == alone.history_hash
