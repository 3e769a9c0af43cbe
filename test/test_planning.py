# SPDX-License-Identifier: Apache-2.0
"""Where to stand and for how long: plans keep what they say, and the solver's are not longer than greedy's."""

from __future__ import annotations

import math
from typing import Any

import geometry
import numpy as np
import pytest

from shadow_tracer import DoseMap, Plan, PointLight, ShadowTracer, Stop, Strength, irradiance_matrix, plan_positions

WATTS = Strength(power=20.0)
TARGET = 50.0


def lamp(x: float, y: float, z: float = 0.8) -> PointLight:
    return PointLight("lamp", (x, y, z), strength=WATTS)


def pose(x: float, y: float) -> np.ndarray:
    made = np.eye(4)
    made[:2, 3] = x, y
    return made


@pytest.fixture
def floor(reference: ShadowTracer) -> DoseMap:
    """A floor with a wall across it, and a robot that stands beside its lamp."""
    reference.scene.put("floor", *geometry.square(2, 0.0, 2.0))
    reference.scene.put("wall", *geometry.box((-0.1, -2.0, 0.0), (0.1, 2.0, 1.5)))
    reference.scene.put("robot", *geometry.box((-0.2, -0.2, 0.05), (0.2, 0.2, 0.3)))
    return DoseMap(reference, "floor", 0.4)


def stops() -> list[Stop]:
    places = [(x, y) for x in (-1.5, -0.7, 0.7, 1.5) for y in (-1.2, 0.0, 1.2)]
    return [Stop([lamp(x, y)], {"robot": pose(x, y)}) for x, y in places]


def play(dose_map: DoseMap, candidates: list[Stop], plan: Plan) -> None:
    """Do what a plan says."""
    assert dose_map.tracer is not None
    for number, seconds in zip(plan.stops, plan.seconds, strict=True):
        for name, where in candidates[number].poses.items():
            dose_map.tracer.scene.move(name, where)
        dose_map.add(candidates[number].lights, seconds)


def test_the_matrix_is_irradiance_and_leaves_the_scene_alone(floor: DoseMap) -> None:
    assert floor.tracer is not None
    before = floor.tracer.scene["robot"].pose
    rows = irradiance_matrix(floor, stops())
    assert rows.shape == (12, len(floor)) and np.array_equal(floor.tracer.scene["robot"].pose, before)
    assert floor.seconds == 0.0
    floor.tracer.scene.move("robot", stops()[4].poses["robot"])
    assert np.array_equal(rows[4], floor.irradiance_by(stops()[4].lights))
    alone = irradiance_matrix(floor, [[lamp(0.7, 0.0)]])
    assert not np.array_equal(alone[0], rows[7]), "the robot stands elsewhere"


@pytest.mark.parametrize("travel", [0.0, 10.0])
@pytest.mark.parametrize("method", ["greedy", "highs"])
@pytest.mark.parametrize("coverage", [0.7, 1.0])
def test_a_plan_keeps_what_it_says(floor: DoseMap, method: str, coverage: float, travel: float) -> None:
    if method == "highs":
        pytest.importorskip("scipy")
    candidates = stops()
    plan = plan_positions(floor, candidates, TARGET, coverage, travel, method)
    assert 0.5 < plan.reachable < 1.0
    assert plan.coverage[-1] >= coverage * plan.reachable * (1.0 - 1e-9)
    assert list(plan.coverage) == sorted(plan.coverage) and len(set(plan.stops)) == len(plan.stops)
    play(floor, candidates, plan)
    assert floor.coverage(TARGET) == pytest.approx(plan.coverage[-1], abs=1e-12)
    assert floor.dose == pytest.approx(plan.dose, rel=1e-9)
    assert floor.seconds == pytest.approx(plan.total, rel=1e-12)


@pytest.mark.parametrize("travel", [0.0, 10.0, 1000.0])
def test_the_solver_is_not_worse_than_greedy(floor: DoseMap, travel: float) -> None:
    pytest.importorskip("scipy")
    candidates, rows = stops(), irradiance_matrix(floor, stops())
    plans = [
        plan_positions(floor, candidates, TARGET, 0.9, travel, method, matrix=rows) for method in ("greedy", "highs")
    ]
    costs = [plan.total + travel * len(plan.stops) for plan in plans]
    assert costs[1] <= costs[0] * (1.0 + 1e-12)
    assert plans[1].coverage[-1] >= plans[0].coverage[-1] - 1e-12


def test_a_solver_without_time_leaves_greedys_plan(floor: DoseMap) -> None:
    pytest.importorskip("scipy")
    greedy, hurried = (
        plan_positions(floor, stops(), TARGET, 0.9, 10.0, method, time_limit=1e-9) for method in ("greedy", "highs")
    )
    assert (hurried.stops, hurried.seconds) == (greedy.stops, greedy.seconds)


def test_the_solver_finds_what_is_known(reference: ShadowTracer) -> None:
    """Two places that shine on a floor each, and one in the middle that shines on both, half as strongly."""
    pytest.importorskip("scipy")
    reference.scene.put(
        "floor", [(0, 0, 0), (1, 0, 0), (0, 1, 0), (2, 0, 0), (3, 0, 0), (2, 1, 0)], [(0, 1, 2), (3, 4, 5)]
    )
    two = DoseMap(reference, "floor", 10.0)
    rows = [[1.0, 0.0], [0.0, 1.0], [0.75, 0.75]]
    places = [Stop([lamp(0, 0)])] * 3
    middle = plan_positions(two, places, 30.0, travel=0.0, method="highs", matrix=rows)
    assert middle.stops == (2,) and middle.seconds[0] == pytest.approx(40.0)
    rows[2] = [0.25, 0.25]
    apart = plan_positions(two, places, 30.0, travel=0.0, method="highs", matrix=rows)
    assert apart.stops == (0, 1) and apart.seconds == pytest.approx((30.0, 30.0))
    far = plan_positions(two, places, 30.0, travel=100.0, method="highs", matrix=rows)
    assert far.stops == (2,) and far.seconds[0] == pytest.approx(120.0)


def test_what_has_been_received_counts(floor: DoseMap) -> None:
    candidates = stops()
    first = plan_positions(floor, candidates, TARGET, 0.9)
    play(floor, candidates, first)
    assert plan_positions(floor, candidates, TARGET, 0.9).stops == ()
    more = plan_positions(floor, candidates, 2.0 * TARGET, 0.9)
    assert more.total > 0.0 and more.coverage[-1] >= 0.9 * more.reachable - 1e-9


def test_what_lacks_hardly_anything_is_brought_to_the_target_too(reference: ShadowTracer) -> None:
    """One of two floors has all but 1e-10 of it: so little against what the other one lacks is no rounding."""
    reference.scene.put(
        "floor", [(0, 0, 0), (1, 0, 0), (0, 1, 0), (9, 0, 0), (10, 0, 0), (9, 1, 0)], [(0, 1, 2), (3, 4, 5)]
    )
    two = DoseMap(reference, "floor", 10.0)
    two.add([lamp(0.3, 0.3)], 10.0)
    target = float(two.dose.max()) * (1.0 + 1e-10)
    plan = plan_positions(two, [Stop([lamp(0, 0)])] * 2, target, matrix=np.eye(2))
    assert sorted(plan.stops) == [0, 1] and plan.coverage[-1] == plan.reachable == 1.0


def test_what_no_place_reaches_is_not_promised(floor: DoseMap) -> None:
    below = plan_positions(floor, [[lamp(0.0, 0.0, -1.0)]], TARGET)
    assert below.stops == () and below.reachable == 0.0 and (below.dose == 0.0).all()


@pytest.mark.parametrize(
    ("what", "says"),
    [
        ({"target": 0.0}, "target: expected a positive dose in J/m2"),
        ({"coverage": 0.0}, "coverage: expected a share above 0 and at most 1"),
        ({"coverage": 1.1}, "coverage"),
        ({"travel": -1.0}, "travel: expected a time in seconds of 0 or more"),
        ({"travel": math.nan}, "travel"),
        ({"time_limit": 0.0}, "time_limit: expected a positive time"),
        ({"method": "gurobi"}, "method: expected one of 'greedy', 'highs'"),
        ({"candidates": []}, "candidates: expected at least one place"),
        ({"candidates": [3]}, r"candidates\[0\]: expected a Stop or lights"),
        ({"candidates": [[PointLight("dark", (0, 0, 1))]]}, r"candidates\[0\].strength: the light 'dark' has none"),
        ({"candidates": [Stop([lamp(0, 0)], {"cart": np.eye(4)})]}, r"candidates\[0\].name: expected one of"),
        ({"candidates": [Stop([lamp(0, 0)], {"robot": np.zeros((4, 4))})]}, r"candidates\[0\].pose: expected"),
        ({"candidates": 3}, "candidates: expected an iterable of places to stand, got int"),
        ({"candidates": [], "matrix": np.ones((0, 2))}, "candidates: expected at least one place"),
        ({"matrix": np.ones((2, 2))}, "matrix: expected finite irradiances"),
        ({"matrix": [[1.0], [1.0, 2.0]]}, "matrix: expected finite irradiances"),
        ({"matrix": "rows"}, "matrix: expected finite irradiances"),
    ],
)
def test_plans_that_are_refused(floor: DoseMap, what: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        plan_positions(floor, **{"candidates": [[lamp(0.7, 0.0)]], "target": TARGET, **what})
