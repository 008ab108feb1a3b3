"""Importance of settings: known decompositions, and what has none."""

import itertools

import numpy as np
import pytest
from scipy import stats

from zswarm.ot.analysis.importance import importance


def grid(**values: list[object]) -> list[dict[str, object]]:
    """Return all combinations."""
    return [
        dict(zip(values, row, strict=True)) for row in itertools.product(*values.values())
    ]


def test_additive_settings_have_their_shares_and_no_interaction() -> None:
    settings = grid(a=[0, 1], b=[0, 1])
    found = importance(settings, [3.0 * s["a"] + 1.0 * s["b"] for s in settings])
    shares = {effect.name: effect.eta2 for effect in found.effects}
    assert shares == pytest.approx({"a": 0.9, "b": 0.1, "a x b": 0.0})
    assert (found.noise, found.rest) == (None, pytest.approx(0.0))
    assert {effect.epsilon2 for effect in found.effects} == {None}  # without repeats


def test_a_product_is_an_interaction_alone() -> None:
    settings = grid(a=[-1, 1], b=[-1, 1], c=["x", "y"]) * 3
    found = importance(settings, [s["a"] * s["b"] for s in settings])
    assert (found.effects[0].name, found.effects[0].eta2) == ("a x b", 1.0)
    settings = grid(a=[-1, 1], b=[-1, 1], c=[-1, 1])
    assert importance(
        settings, [s["a"] * s["b"] * s["c"] for s in settings]
    ).rest == pytest.approx(1.0)


def test_one_setting_is_a_one_way_analysis_of_variance() -> None:
    """The same F as scipy's follows from the shares."""
    draws = np.random.default_rng(1)
    groups = [draws.normal(mean, 1.0, 12) for mean in (0.0, 0.5, 2.0)]
    settings = [{"a": place} for place in range(3) for _ in range(12)]
    found = importance(settings, np.concatenate(groups).tolist())
    (effect,) = found.effects
    assert found.noise is not None
    assert (effect.eta2 / 2) / (found.noise / 33) == pytest.approx(
        stats.f_oneway(*groups).statistic
    )
    assert effect.eta2 + found.noise == pytest.approx(1.0)
    assert effect.epsilon2 == pytest.approx(effect.eta2 - 2 * found.noise / 33)


def test_chance_has_a_share_but_none_beyond_chance() -> None:
    draws = np.random.default_rng(1)
    settings = grid(a=[0, 1, 2], b=[0, 1]) * 2000
    found = importance(settings, draws.normal(size=len(settings)).tolist())
    assert found.noise is not None
    assert found.noise > 0.998
    assert all((effect.epsilon2 or 0.0) < 0.002 for effect in found.effects)


def test_settings_that_change_together_count_once_under_the_first() -> None:
    """As a network and the settings that it alone has."""
    meshed: dict[str, object] = {"kind": "meshed", "kind.hidden": 3}
    layers: dict[str, object] = {"kind": "layers", "kind.sizes": [3]}
    settings = [{**net, "n": n} for net in (meshed, layers) for n in (10, 20)]
    found = importance(settings, [1.0, 1.0, 2.0, 2.0])
    assert [effect.name for effect in found.effects] == ["kind", "n", "kind x n"]


def test_what_one_of_three_kinds_alone_has_counts_with_the_kind() -> None:
    tables: list[dict[str, object]] = [
        {"optimizer.kind": "nnga", "optimizer.population": 20, "optimizer.severity": 0.3},
        {"optimizer.kind": "pso", "optimizer.population": 20, "optimizer.inertia": 0.7},
        {"optimizer.kind": "cmaes", "optimizer.population": 10, "optimizer.sigma": 0.5},
    ]
    cells = [
        (table, float(at + seed)) for at, table in enumerate(tables) for seed in (0, 1)
    ]
    found = importance([table for table, _ in cells], [value for _, value in cells])
    assert [effect.name for effect in found.effects] == ["optimizer.kind"]
    assert found.effects[0].eta2 == pytest.approx(4 / 5.5)


def test_groups_of_unequal_size_are_cut_to_the_smallest() -> None:
    settings = [{"a": 0}] * 5 + [{"a": 1}] * 2
    found = importance(settings, [1.0, 1.0, 9.0, 9.0, 9.0, 2.0, 2.0])
    assert (found.runs, found.effects[0].eta2, found.noise) == (4, 1.0, 0.0)


@pytest.mark.parametrize(
    ("settings", "values", "why"),
    [
        ([{"a": 1}, {"a": 1}], [1.0, 2.0], "the same settings"),
        ([{"a": 1}, {"a": 2}], [1.0, -np.inf], "every candidate failed"),
        ([{"a": 1}, {"a": 2}], [0.1, 0.1], "the same fitness"),
        ([{"a": 1}, {"a": 2}], [0.1, 0.2], "no setting was repeated"),
        (grid(a=[1, 2], b=[1, 2])[:3], [1.0, 2.0, 3.0], "no full grid"),
    ],
)
def test_without_a_decomposition_the_reason_is_given(
    settings: list[dict[str, object]], values: list[float], why: str
) -> None:
    found = importance(settings, values)
    assert found.effects == []
    assert why in found.why
