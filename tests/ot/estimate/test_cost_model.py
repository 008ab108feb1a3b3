"""The cost model gives the paper's numbers, and the servers beyond which more are of no use."""

import msgspec
import pytest

from benchmarks.paper.equations import coefficients, crossing, optimization_s, ratio
from zswarm.ot.estimate.cost_model import (
    TABLE_I,
    Constants,
    Plan,
    blob,
    by_agent,
    by_turn,
    expected_s,
    external,
    internal,
    useful_slots,
)

FIGURE_3 = {  # r by steps, for 1, 2, 4, 8 and 16 agents: computed apart from this project
    10: (0.178, 0.239, 0.361, 0.605, 1.093),
    18: (0.285, 0.386, 0.589, 0.995, 1.807),
    19: (0.297, 0.403, 0.616, 1.040, 1.889),
    50: (0.589, 0.806, 1.239, 2.106, 3.841),
    100: (0.857, 1.176, 1.813, 3.087, 5.635),
}


def paper(agents: int, steps: int) -> Plan:
    """Return the plan of an optimization with the parameters of Table I."""
    return Plan(generations=200, population=50, steps=steps, agents=agents)


def scaling(agents: int, steps: int) -> Plan:
    """Return the plan of an optimization of Figure 4."""
    return Plan(generations=4, population=4, steps=steps, agents=agents)


def test_the_paper_has_ten_thousand_simulations() -> None:
    assert paper(8, 50).simulations == 10_000


def test_elite_is_not_simulated_again() -> None:
    """NNGA keeps 13 of 50: FREVO makes 7,413 fitness calls in 200 generations."""
    assert msgspec.structs.replace(paper(8, 50), newcomers=37).simulations == 7_413


@pytest.mark.parametrize(
    ("agents", "first"), [(1, 145), (2, 73), (4, 37), (8, 19), (16, 10), (32, 5)]
)
def test_controllers_belong_outside_the_optimizer_from_a_number_of_steps(
    agents: int, first: int
) -> None:
    assert crossing(paper(agents, 1), TABLE_I) == first
    assert (
        ratio(paper(agents, first), TABLE_I)
        > 1
        >= ratio(paper(agents, first - 1), TABLE_I)
    )


@pytest.mark.parametrize("steps", FIGURE_3)
def test_the_ratios_equal_figure_3(steps: int) -> None:
    found = [ratio(paper(agents, steps), TABLE_I) for agents in (1, 2, 4, 8, 16)]
    assert found == pytest.approx(FIGURE_3[steps], abs=0.0005)


def test_the_coefficients_equal_those_of_equations_9_and_10() -> None:
    found = coefficients(paper(1, 1), TABLE_I)
    assert found.base_s == pytest.approx(2.4)
    assert found.internal == pytest.approx(250)
    assert found.messages == 2.5
    assert found.step == pytest.approx(1.67, abs=0.005)
    assert found.external == pytest.approx(416.67, abs=0.005)
    assert found.files == pytest.approx(88.39, abs=0.0051)  # 88.3904


@pytest.mark.parametrize("threads", [1, 2, 7.5, 50])
@pytest.mark.parametrize(("agents", "steps"), [(1, 1), (8, 18), (16, 100)])
def test_equations_9_and_10_follow_numerically_from_7_and_8(
    agents: int, steps: int, threads: float
) -> None:
    plan = paper(agents, steps)
    found = coefficients(plan, TABLE_I)
    inside = found.base_s * (
        1 + found.internal / threads * (found.messages + steps * (found.step + agents))
    )
    outside = found.base_s * (1 + found.external / threads * (found.files + steps))
    assert optimization_s(internal, plan, TABLE_I, threads) == pytest.approx(
        inside, rel=1e-12
    )
    assert optimization_s(external, plan, TABLE_I, threads) == pytest.approx(
        outside, rel=1e-12
    )


def test_ten_agents_and_fifty_steps_take_days() -> None:
    plan = paper(10, 50)
    assert optimization_s(internal, plan, TABLE_I) == pytest.approx(351_500, abs=50)
    assert optimization_s(external, plan, TABLE_I) == pytest.approx(138_400, abs=50)
    assert plan.simulations * TABLE_I.compile_s == pytest.approx(88_330, abs=0.5)
    assert optimization_s(blob, plan, TABLE_I) == pytest.approx(50_600, abs=5)


def test_the_ratio_depends_slightly_on_threads() -> None:
    """The paper says it does not: the time between generations has no threads."""
    assert ratio(paper(1, 1), TABLE_I) == pytest.approx(0.0347, abs=5e-5)
    assert ratio(paper(1, 1), TABLE_I, 50) == pytest.approx(0.0360, abs=5e-5)
    assert ratio(paper(1, 100), TABLE_I, 50) / ratio(
        paper(1, 100), TABLE_I
    ) == pytest.approx(1, abs=1e-3)


def test_compared_with_parameters_the_controller_never_belongs_in_the_optimizer() -> None:
    found = [
        ratio(paper(agents, steps), TABLE_I, against=blob)
        for agents in (1, 8, 16)
        for steps in (10, 50, 100)
    ]
    assert found == pytest.approx(
        [1.65, 1.61, 1.60, 5.6, 5.8, 5.8, 10.1, 10.5, 10.6], rel=0.01
    )
    assert crossing(paper(1, 1), TABLE_I, against=blob) == 1


def test_a_faster_simulator_makes_many_messages_look_worse() -> None:
    found = [
        ratio(paper(8, 50), msgspec.structs.replace(TABLE_I, step_s=step_s), against=blob)
        for step_s in (1.0, 0.1, 0.01, 0.001)
    ]
    assert found == sorted(found)
    assert found[-1] > 100


def test_free_messages_have_no_crossing() -> None:
    free = msgspec.structs.replace(TABLE_I, message_s=0.0)
    assert crossing(paper(1, 1), free) is None


def test_more_than_two_servers_are_of_no_use_behind_a_broker() -> None:
    """The paper's figure 4: two beat one, and no more beat two."""
    for steps in (10, 50, 100, 1000):
        plan = scaling(8, steps)
        assert useful_slots(internal, plan, TABLE_I) == 2
        one, two, four, sixteen = (
            expected_s(internal, plan, TABLE_I, slots) for slots in (1, 2, 4, 16)
        )
        assert two < 0.9 * one
        assert four == pytest.approx(two, rel=0.02)
        assert sixteen > four, "each more server answers each discovery"


def test_parameters_scale_to_every_candidate() -> None:
    assert useful_slots(blob, scaling(8, 100), TABLE_I) == 4
    assert useful_slots(blob, paper(8, 100), TABLE_I) == 50
    assert expected_s(blob, scaling(8, 100), TABLE_I, 4) == pytest.approx(
        expected_s(blob, scaling(8, 100), TABLE_I, 1) / 4, rel=0.01
    )


def test_the_optimizer_itself_is_the_limit_at_last() -> None:
    """20 us for a candidate that is simulated for 1 ms: 50 slots."""
    constants = Constants(step_s=1e-5, message_s=0, busy_s=0, dispatch_s=2e-5)
    plan = Plan(generations=10, population=10_000, steps=100, agents=8)
    assert useful_slots(blob, plan, constants) == 50


def test_rounds_are_whole_numbers() -> None:
    """Three slots are no better than two for four candidates."""
    constants = Constants(step_s=1.0, message_s=0, busy_s=0)
    assert [
        expected_s(blob, scaling(1, 1), constants, slots) for slots in (1, 2, 3, 4, 5)
    ] == [
        16,
        8,
        8,
        4,
        4,
    ]


def test_each_way_has_its_number_of_messages() -> None:
    plan = Plan(generations=1, population=4, steps=50, agents=8)
    assert internal(plan, TABLE_I).messages == 805
    assert internal(plan, TABLE_I, 16).messages == 820
    assert external(plan, TABLE_I).messages == 0
    assert blob(plan, TABLE_I).messages == 2
    assert by_turn(plan, TABLE_I).messages == 102
    assert by_agent(plan, TABLE_I).messages == 802
    assert by_turn(msgspec.structs.replace(plan, turns=8), TABLE_I).messages == 802
    assert blob(
        plan, msgspec.structs.replace(TABLE_I, batch=10)
    ).messages == pytest.approx(0.2)


@pytest.mark.parametrize("threads", [0, 0.5, 51])
def test_threads_are_no_more_than_candidates(threads: float) -> None:
    with pytest.raises(
        ValueError, match=r"threads: expected 1 to 50 \(population x evaluations\), got"
    ):
        optimization_s(internal, paper(1, 1), TABLE_I, threads)


def test_zero_slots_are_refused() -> None:
    with pytest.raises(ValueError, match="slots: expected 1 or more, got 0"):
        expected_s(blob, paper(1, 1), TABLE_I, 0)
