# SPDX-License-Identifier: Apache-2.0
"""The half-lines by which cones meet boxes reject no box that a cone meets, and know from where to where."""

from __future__ import annotations

from typing import Any

import cones
import numpy as np
import pytest
import warp as wp

from shadow_tracer.gpu.accelerators.bvh.bvh import ConeScene
from shadow_tracer.gpu.accelerators.segment import scene_box
from shadow_tracer.gpu.device import native

_CALL = """
const wp::vec3d& end = ends.data[i];
const Triple way = Triple(end) - Triple(apices.data[i]);
const Cone cone(apices.data[i], way, slopes.data[i], way.length().number);
const ConeWalk walk(scene, cone, slopes.data[i], 0.0, false);
double in, out;
const bool met = walk.meets(boxes.data + 8 * i, in, out);
found.data[i] = wp::vec3d(met ? 1.0 : 0.0, in, out);
"""


@wp.func_native(native.snippet("accelerators/bvh/cone_walk.h", call=_CALL))
def meet(
    i: int,
    scene: ConeScene,
    apices: wp.array(dtype=wp.vec3d),
    ends: wp.array(dtype=wp.vec3d),
    slopes: wp.array(dtype=wp.float64),
    boxes: wp.array(dtype=float),
    found: wp.array(dtype=wp.vec3d),
): ...


@wp.kernel(enable_backward=False, module="unique")
def meet_all(
    scene: ConeScene,
    apices: wp.array(dtype=wp.vec3d),
    ends: wp.array(dtype=wp.vec3d),
    slopes: wp.array(dtype=wp.float64),
    boxes: wp.array(dtype=float),
    found: wp.array(dtype=wp.vec3d),
):
    meet(wp.tid(), scene, apices, ends, slopes, boxes, found)


def _meet(device: str, apices: Any, ends: Any, slopes: Any, low: Any, high: Any) -> np.ndarray:
    count, scene = len(apices), ConeScene()
    scene.tree.box = scene_box(np.full(3, -1.0), np.full(3, 1.0))
    scene.tree.corners = wp.array(np.array([-1, -1, -1, 0, 1, 1, 1, 0]), dtype=float, device=device)
    boxes = np.zeros((count, 8))
    # Boxes of the tree are padded and rounded outwards; of these the padding is not more than is left for the walk.
    boxes[:, :3], boxes[:, 4:7] = low - 27 * 2.0**-24, high + 27 * 2.0**-24
    found = wp.zeros(count, dtype=wp.vec3d, device=device)
    arrays = [wp.array(apices, dtype=wp.vec3d, device=device), wp.array(ends, dtype=wp.vec3d, device=device)]
    arrays += [wp.array(slopes, dtype=wp.float64, device=device)]
    arrays += [wp.array(boxes.reshape(-1), dtype=float, device=device), found]
    wp.launch(meet_all, dim=count, inputs=[scene, *arrays], device=device)
    answer: np.ndarray = found.numpy()
    return answer


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("far", [1.0, 1e3, 1e6])
def test_no_box_that_a_cone_meets_is_rejected(any_device: str, seed: int, far: float) -> None:
    """Boxes around a point of the cone, often on its mantle: with it at a corner, on an edge or side, or inside; flat
    in any axis; axes along those of boxes; apices inside, on a side, and far away."""
    rng, count = np.random.default_rng(540 + seed), 20_000
    points = rng.uniform(-1, 1, (count, 3))
    slopes = 10.0 ** rng.uniform(-8.0, np.log10(14.0), count)
    slopes[::7] = 0.0
    axes = cones.unit(rng.uniform(-1, 1, (count, 3)))
    axes[::3] = np.eye(3)[rng.integers(0, 3, len(axes[::3]))] * rng.choice([-1.0, 1.0], (len(axes[::3]), 1))
    axes[1::3, 0] = 0.0
    axes = cones.unit(axes)
    along = far * rng.uniform(0.0, 1.0, count)
    along[::11] = 0.0  # the apex itself
    across = cones.unit(np.cross(axes, rng.uniform(-1, 1, (count, 3))))
    share = rng.choice([0.0, 0.5, 1.0 - 1e-12], count)
    apices = points - along[:, None] * (axes + (share * slopes)[:, None] * across)
    ends = apices + axes * (along * rng.choice([1.0 + 1e-12, 2.0], count) + 1e-9)[:, None]
    sizes = rng.choice([0.0, 1e-6, 0.3], (count, 3)) * rng.uniform(0.5, 1.0, (count, 3))
    low = points - sizes * rng.choice([0.0, 0.5, 1.0], (count, 3))
    met, first, last = _meet(any_device, apices, ends, slopes, low, low + sizes).T
    assert met.all()
    slack = 1e-9 * (1.0 + along)
    assert (first <= along + slack).all() and (last >= along - slack).all()


def test_most_boxes_beside_a_cone_are_rejected(any_device: str) -> None:
    rng, count = np.random.default_rng(550), 20_000
    apices, ends = rng.uniform(-1, 1, (2, count, 3))
    low = rng.uniform(-1, 1, (count, 3))
    slopes = np.full(count, np.tan(np.radians(1.5)))
    met = _meet(any_device, apices, ends, slopes, low, low + 0.05)[:, 0] > 0
    axis = cones.unit(ends - apices)
    along, beside = cones.parts(low + 0.025, apices, axis)
    length = np.sqrt(((ends - apices) ** 2).sum(axis=1))
    outside = (beside > slopes * along + 0.1) | (along > length + 0.1) | (along < -0.1)
    assert not met[outside & (beside > 0.3)].any()
    assert met[outside].mean() < 0.01 and met.sum() > 20
