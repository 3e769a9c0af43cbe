# SPDX-License-Identifier: Apache-2.0
"""Points that are asked about once more: found to be there, to the last coordinate and mark, or made again."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from shadow_tracer import Bounds, DirectionalLight, ShadowTracer, State
from shadow_tracer.gpu.samples.same_points import same_points


@pytest.mark.parametrize("count", [1, 996, 1024, 1025, 3000])
def test_every_coordinate_and_mark_counts(count: int) -> None:
    rng = np.random.default_rng(count)
    points, good = rng.normal(size=(count, 3)), rng.integers(0, 2, count).astype(np.uint8)
    positions = np.full((count + 5, 4), 7.0)
    positions[:count, :3] = points
    held = wp.array(positions, dtype=wp.vec4d, device="cpu")
    valid = wp.array(np.concatenate([good, good[:1]]), dtype=wp.uint8, device="cpu")
    assert same_points(points, good, held, valid)
    for row in {0, count // 2, count - 1}:
        for k in range(3):
            other = points.copy()
            other[row, k] = np.nextafter(other[row, k], 9.0)
            assert not same_points(other, good, held, valid)
            other[row, k] = np.nan
            assert not same_points(other, good, held, valid)
        marks = good.copy()
        marks[row] ^= 1
        assert not same_points(points, marks, held, valid)


@pytest.mark.parametrize("threads", [1, 2])
def test_the_same_points_far_away_and_back(threads: int) -> None:
    """What is kept of points, where they are among it, is never that of others: also not after an error between."""
    rng = np.random.default_rng(0)
    bounds = Bounds(max_triangles=64, max_rays=40_000, max_lights=2)
    tracer = ShadowTracer("light_grid", device="cpu", threads=threads, bounds=bounds)
    truth = ShadowTracer("brute_force", device="cpu", threads=1, bounds=bounds)
    near, suns = rng.uniform(-1.0, 1.0, (30_000, 3)), [DirectionalLight("sun", (0.1, 0.2, -1.0))]
    far = near + (4e5, -3e5, 100.0)
    for each in (tracer, truth):
        for number, shift in enumerate((np.zeros(3), np.array([4e5, -3e5, 100.0]))):
            corners = np.array([(-0.7, -0.7, 0.5), (0.7, -0.7, 0.5), (0.0, 0.7, 0.6)]) + shift
            each.scene.put(f"plate {number}", corners, [(0, 1, 2)])
    for points in (near, near, far, far, near, near[::-1], near[:20_000], near):
        with pytest.raises(ValueError, match="finite"):
            tracer.occluded(points * np.nan, suns[0])
        got, wanted = (each.states_at(points, suns) for each in (tracer, truth))
        np.testing.assert_array_equal(got, wanted)
        assert (got == State.SHADOWED).any()
