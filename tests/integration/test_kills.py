"""Many kills during one run; the long campaign is ``make kills``."""

import itertools
import os
import statistics
import sys
from collections import Counter
from pathlib import Path

import pytest

from tests.integration import kills
from tests.integration.paced import Scene, play_undisturbed

pytestmark = pytest.mark.faults

KILLS = int(os.environ.get("KILLS", "15"))


def test_a_run_with_repeated_kills_of_all_programs_has_the_same_result(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    size = kills.size(KILLS)
    undisturbed = play_undisturbed(tmp_path_factory.mktemp("undisturbed"), size)
    with Scene(tmp_path, size) as scene:
        campaign = kills.Campaign(scene, undisturbed.trials, KILLS, seed=KILLS)
        scene.check(campaign.run(), undisturbed)
        times = [0.0, *(strike.at_s for strike in campaign.strikes)]
        between = statistics.median(
            after - before for before, after in itertools.pairwise(times)
        )
        hits = Counter(strike.target for strike in campaign.strikes)
        sys.stdout.write(
            f"\n{campaign.kills()} kills in {times[-1]:.0f} s, median {between:.2f} s apart: "
            f"{dict(hits)}; "
            f"{campaign.paused} times the run stopped because one trial was hit three times, and "
            "was resumed\n"
        )
    assert campaign.kills() == KILLS
    killed = [strike.process for strike in campaign.strikes if strike.signal == "SIGKILL"]
    assert len(set(killed)) == KILLS, "a process was killed twice"
    assert all(strike.evidence for strike in campaign.strikes)
