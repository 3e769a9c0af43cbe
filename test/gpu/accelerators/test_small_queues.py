# SPDX-License-Identifier: Apache-2.0
"""Queues of one place and of 64 under the sixteen kinds of adversarial scenes: more passes, the same bits."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import probe
import pytest
from scenario import compare

from shadow_tracer import Bounds, ShadowTracer


def _fuzz_kinds() -> Any:
    """The module with the sixteen kinds of scenes. Pytest's import mode gives it no name to import it by."""
    spec = importlib.util.spec_from_file_location("fuzz_kinds", Path(__file__).resolve().parents[1] / "test_fuzz.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


_FUZZ = _fuzz_kinds()


@pytest.fixture(scope="module")
def cramped() -> Any:
    """Tracers with a queue of the given capacity, by device, form, pipeline, variant and capacity."""
    made: dict[tuple[Any, ...], ShadowTracer] = {}

    def get(case: tuple[str, str, str], capacity: int) -> ShadowTracer:
        device, pipeline, variant = case
        key = (*case, probe.wide(device), capacity)
        if key not in made:
            bounds = Bounds(max_triangles=2000, max_rays=1000, max_lights=1, queue_capacity=capacity)
            made[key] = ShadowTracer(pipeline, variant, device, bounds)
        return probe.reset(made[key])

    return get


@pytest.mark.parametrize("capacity", [1, 64])
@pytest.mark.parametrize("kind", _FUZZ._KINDS)
def test_fuzz_with_small_queues(cramped: Any, tracer_case: tuple[str, str, str], kind: str, capacity: int) -> None:
    """Further passes, the same bits. A queue of one place gets every eighth sample."""
    scenario = _FUZZ._scenario(kind, 0)
    some = slice(None, None, 8 if capacity == 1 else 2)
    tracer = cramped(tracer_case, capacity)
    tracer.scene.put("mesh", scenario.vertices, scenario.triangles, nonfinite="skip")
    hidden = tracer.occluded(scenario.points[some], scenario.light, scenario.bias)
    compare(hidden, scenario.answer.hidden[some], scenario.answer.tie[some], scenario.points[some])


@pytest.mark.parametrize("capacity", [1, 64])
@pytest.mark.parametrize("count", [0, 1, 2, 3, 5, 17, 256])
def test_any_number_of_rays_with_small_queues(
    cramped: Any, tracer_case: tuple[str, str, str], count: int, capacity: int
) -> None:
    scenario = _FUZZ._scenario("integers", 1)
    some = np.arange(count) % len(scenario.points)
    tracer = cramped(tracer_case, capacity)
    tracer.scene.put("mesh", scenario.vertices, scenario.triangles)
    hidden = tracer.occluded(scenario.points[some], scenario.light, scenario.bias)
    compare(hidden, scenario.answer.hidden[some], scenario.answer.tie[some], scenario.points[some])
