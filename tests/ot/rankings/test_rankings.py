"""Rankings: who plays whom, and the resulting scores, worked out by hand."""

import tracemalloc
from typing import Any

import numpy as np
import pytest

from zswarm.config.decode import convert
from zswarm.errors import ConfigError
from zswarm.ot.rankings.ranking import Ranking, Round
from zswarm.plugins import registry as plugins

TOURNAMENTS = ("full-tournament", "multi-swiss", "swiss")
NAN = float("nan")


def ranking(kind: str, participants: int = 2, **settings: Any) -> Ranking:
    loaded = plugins.load("ranking", kind)
    made: Ranking = loaded(
        convert(settings, loaded.settings_type, "ranking"), participants
    )
    return made


def played(
    kind: Ranking, strength: list[float]
) -> tuple[list[Round], list[list[list[int]]]]:
    """Play a tournament where fitness is a candidate's strength; return rounds and games."""
    rounds: list[Round] = []
    while (games := kind.next_games(len(strength), rounds)) is not None:
        assert games.shape[1] == kind.participants
        assert len(rounds) < 100, "it has no end"
        rounds.append(Round(games, np.array(strength)[games]))
    return rounds, [round_.games.tolist() for round_ in rounds]


def test_absolute_ranking_gives_each_candidate_its_own_fitness() -> None:
    rounds, games = played(ranking("absolute", 1), [3.0, NAN, -1.0])
    assert games == [[[0], [1], [2]]]
    assert (
        ranking("absolute", 1).scores(3, rounds).tobytes()
        == np.array([3.0, NAN, -1.0]).tobytes()
    )


def test_a_full_tournament_has_every_pair_and_two_points_for_a_win() -> None:
    """0 beats 1, 2 and 3; 1 and 2 are level, and beat 3."""
    full = ranking("full-tournament", all_sides=False)
    rounds, games = played(full, [5.0, 4.0, 4.0, 1.0])
    assert games == [[[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]]
    assert full.scores(4, rounds).tolist() == [6.0, 3.0, 3.0, 0.0]


def test_a_full_tournament_of_three_counts_each_participant_of_a_game() -> None:
    """012: 4, 2, 0. 013: 4, 2, 0. 023: 4, 1, 1. 123: 4, 1, 1."""
    full = ranking("full-tournament", 3, all_sides=False)
    rounds, games = played(full, [9.0, 7.0, 2.0, 2.0])
    assert games == [[[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]]
    assert full.scores(4, rounds).tolist() == [12.0, 8.0, 2.0, 2.0]


def test_a_game_is_played_from_all_sides_and_the_results_are_added() -> None:
    """The first place gets 10 more here; over both sides the better one wins."""
    full = ranking("full-tournament")
    games = full.next_games(3, [])
    assert games is not None
    assert games.tolist() == [[0, 1], [1, 0], [0, 2], [2, 0], [1, 2], [2, 1]]
    results = np.array([0.0, 1.0, 2.0])[games] + [10.0, 0.0]
    assert full.scores(3, [Round(games, results)]).tolist() == [0.0, 2.0, 4.0]


def test_every_participant_of_three_is_in_every_place_once() -> None:
    full = ranking("full-tournament", 3)
    games = full.next_games(3, [])
    assert games is not None
    assert games.tolist() == [[0, 1, 2], [1, 2, 0], [2, 0, 1]]
    results = np.array([0.0, 1.0, 2.0])[games] + [10.0, 5.0, 0.0]
    assert full.scores(3, [Round(games, results)]).tolist() == [0.0, 2.0, 4.0]


def test_a_swiss_tournament_pairs_by_points_and_no_pair_twice() -> None:
    """Round 1 is won by 0 to 3, round 2 by 0, 2, 4, 6: 0 and 2 have 4 points, others 2 or 0."""
    swiss = ranking("swiss", all_sides=False)
    rounds, games = played(swiss, [8.0, 7.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0])
    assert games == [
        [[0, 7], [1, 6], [2, 5], [3, 4]],
        [[0, 1], [2, 3], [4, 5], [6, 7]],
        [[0, 2], [1, 3], [4, 6], [5, 7]],
    ]
    assert swiss.scores(8, rounds).tolist() == [6.0, 4.0, 4.0, 2.0, 4.0, 2.0, 2.0, 0.0]


def test_a_bye_in_a_swiss_tournament_counts_as_a_win_and_rotates() -> None:
    """Byes: 2, in the middle; 4, which lost and is last; 3, the last that had none."""
    swiss = ranking("swiss", all_sides=False)
    rounds, games = played(swiss, [5.0, 4.0, 3.0, 2.0, 1.0])
    assert games == [[[0, 4], [1, 3]], [[0, 1], [2, 3]], [[0, 2], [1, 4]]]
    assert swiss.scores(5, rounds).tolist() == [6.0, 4.0, 4.0, 2.0, 2.0]


def test_a_swiss_tournament_scores_ties_and_configured_points() -> None:
    swiss = ranking("swiss", all_sides=False, win=5, tie=2, rounds=1)
    rounds, _ = played(swiss, [1.0, 3.0, 2.0, 1.0])
    assert swiss.scores(4, rounds).tolist() == [2.0, 5.0, 0.0, 2.0]


def test_a_candidate_that_has_met_all_others_plays_one_of_them_again() -> None:
    swiss = ranking("swiss", all_sides=False, rounds=5)
    _, games = played(swiss, [4.0, 3.0, 2.0, 1.0])
    assert [len(round_) for round_ in games] == [2] * 5
    assert {tuple(sorted(pair)) for round_ in games[:3] for pair in round_} == {
        (0, 3),
        (1, 2),
        (0, 1),
        (2, 3),
        (0, 2),
        (1, 3),
    }


def test_multi_swiss_groups_neighbours_and_averages_places() -> None:
    """Places give 3, 2 and 1 points; after round 1 the order is 0, 4, 5, 1, 2, 3."""
    multi = ranking("multi-swiss", 3, all_sides=False)
    rounds, games = played(multi, [8.0, 6.0, 6.0, 1.0, 5.0, 3.0])
    assert games == [[[0, 1, 2], [3, 4, 5]], [[0, 4, 5], [1, 2, 3]]]
    # round 1: 3, 1.5, 1.5 and 1, 3, 2; round 2: 3 for 0, 2 for 4, 1 for 5; 2.5 for 1 and 2, 1 for 3
    assert multi.scores(6, rounds).tolist() == [3.0, 2.0, 2.0, 1.0, 2.5, 1.5]


def test_multi_swiss_varies_who_sits_out() -> None:
    """Three of four play: 3 sits out and gets the average score 2; then 0, the last, sits out."""
    multi = ranking("multi-swiss", 3, all_sides=False)
    rounds, games = played(multi, [1.0, 2.0, 3.0, 0.0])
    assert games == [[[0, 1, 2]], [[2, 1, 3]]]
    assert multi.scores(4, rounds).tolist() == [1.0, 2.0, 3.0, 1.0]


def test_a_candidate_that_fails_every_game_loses_and_has_no_score() -> None:
    for kind in TOURNAMENTS:
        made = ranking(kind)
        rounds, _ = played(made, [1.0, NAN, 2.0, NAN])
        scores = made.scores(4, rounds)
        assert np.isnan(scores).tolist() == [False, True, False, True], kind
        assert scores[2] >= scores[0] > 0, kind
        rounds, _ = played(made, [NAN] * 4)
        assert np.isnan(made.scores(4, rounds)).all(), kind


@pytest.mark.parametrize("kind", TOURNAMENTS)
@pytest.mark.parametrize("candidates", [2, 3, 4, 5, 6, 7, 9, 16, 21])
def test_each_candidate_plays_at_most_once_per_round_and_the_best_comes_first(
    kind: str, candidates: int
) -> None:
    """A full tournament has one round of all."""
    made = ranking(kind, all_sides=False)
    strength = np.random.default_rng(candidates).permutation(candidates).astype(float)
    rounds, games = played(made, strength.tolist())
    for round_ in games:
        who = [candidate for pair in round_ for candidate in pair]
        if kind != "full-tournament":
            assert len(set(who)) == len(who) == candidates - candidates % 2
    best = made.scores(candidates, rounds)
    assert best[strength.argmax()] == best.max()
    if kind == "full-tournament":
        assert np.argsort(best).tolist() == np.argsort(strength).tolist()


@pytest.mark.parametrize("kind", TOURNAMENTS)
def test_replaying_the_results_requests_the_same_games(kind: str) -> None:
    """Resuming a run in the middle of a generation relies on this."""
    made = ranking(kind)
    rounds, games = played(made, [2.0, 7.0, 1.0, 8.0, 2.0, 8.0, 1.0])
    for number in range(len(rounds)):
        again = ranking(kind).next_games(7, rounds[:number])
        assert again is not None
        assert again.tolist() == games[number]


@pytest.mark.parametrize(
    ("kind", "participants", "candidates", "words"),
    [
        (
            "absolute",
            2,
            0,
            "ranking: absolute judges each candidate by itself, and this problem is a game of 2;",
        ),
        (
            "swiss",
            1,
            0,
            "ranking: a tournament needs a problem of several participants; for this one, exp",
        ),
        (
            "swiss",
            3,
            0,
            "ranking: swiss pairs two, and this problem is a game of 3; expected multi-swiss",
        ),
        (
            "multi-swiss",
            4,
            3,
            "ranking: a game of 4 needs as many candidates; there are 3",
        ),
    ],
)
def test_impossible_tournaments_are_refused_in_one_line(
    kind: str, participants: int, candidates: int, words: str
) -> None:
    with pytest.raises(ConfigError) as refusal:
        ranking(kind, participants).next_games(candidates, [])
    assert str(refusal.value).startswith(words)


@pytest.mark.long
def test_the_games_of_a_great_tournament_take_no_more_memory_than_their_numbers() -> None:
    """Half a million games are 8 MB; as tuples they would be 60 MB more."""
    full = ranking("full-tournament", all_sides=False)
    tracemalloc.start()
    try:
        games = full.next_games(1000, [])
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert games is not None
    assert len(games) == 1000 * 999 / 2
    assert peak < 4 * games.nbytes, "they and two copies"
