# SPDX-License-Identifier: Apache-2.0
"""Keys, leaves and boxes of rays have the same bits from vector registers, sixteen at a time, as from a thread each."""

from __future__ import annotations

from functools import cache

import numpy as np
import probe_accelerators
import pytest
import warp as wp
from node_fuzz import LIGHTS, bundles

from shadow_tracer import Bounds, ShadowTracer
from shadow_tracer.gpu.accelerators import ray_keys
from shadow_tracer.gpu.accelerators.cone_hierarchy.boxes import QUANTITIES, RayTree, make_leaves
from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.device.extents import STRIPES, clear_extents
from shadow_tracer.gpu.exact.faces import Occluders
from shadow_tracer.gpu.exact.light_space import FACES, LightSpace

pytestmark = pytest.mark.wide

_NUMBERS = ("found by one", "covered by one", "found by sixteen", "covered by sixteen")


@wp.func_native(
    native.snippet(
        "accelerators/cone_hierarchy/triangle.h@1",
        "accelerators/cone_hierarchy/triangle.h@16",
        "accelerators/cone_hierarchy/boxes.h",
        call="""
    enum { LOG = 4, BRANCH = 1 << LOG };
    Traveller1 one = { space, tree, occluders };
    Traveller16 sixteen = { space, tree, occluders };
    Corners1 corners;
    Runs runs;
    int* to = &wp::index(out, group, triangle, face, 0);
    if (!one.load(triangle) || !sixteen.load(triangle) || !(one.look(triangle, corners) >> face & 1)
        || !one.enter(face, corners, runs))
        return;
    sixteen.enter(face, corners, runs);
    const float* box = NodeBox::at(tree, BRANCH * group, LOG);
    for (int lane = 0; lane < BRANCH; ++lane) {
        int covered = 0;
        to[0] |= one.judge(box + lane, BRANCH, covered) << lane;
        to[1] |= covered << lane;
    }
    to[2] = sixteen.judge(box, BRANCH, to[3]);""",
    )
)
def judge(
    group: int,
    triangle: int,
    face: int,
    space: LightSpace,
    tree: RayTree,
    occluders: Occluders,
    out: wp.array4d(dtype=int),
): ...


@wp.kernel(enable_backward=False)
def judge_all(space: LightSpace, tree: RayTree, occluders: Occluders, out: wp.array4d(dtype=int)):
    group, triangle, face = wp.tid()
    judge(group, triangle, face, space, tree, occluders, out)


@cache
def _built(name: str) -> probe_accelerators.RayTree:
    light = LIGHTS[name]
    rays, corners = bundles(np.random.default_rng(7), light)
    points, triangles = rays.reshape(-1, 3)[:-5], np.arange(corners.size // 3).reshape(-1, 3)  # the last leaf: not full
    bounds = Bounds(len(triangles), len(points), 1, 64, 1)
    tracer = ShadowTracer("cone_hierarchy", "linear", device="cpu", bounds=bounds)
    tracer.scene.put("mesh", corners.reshape(-1, 3), triangles)
    return probe_accelerators.ray_tree(tracer, points, light, 0.02)


@pytest.mark.parametrize("name", LIGHTS)
def test_keys(name: str) -> None:
    built = _built(name)
    frame, order, group, found = built.frame, built.order, built.group, built.count
    count = frame.count
    assert 0 < found <= count
    extent, fit = wp.empty(4 * FACES * STRIPES, dtype=float), wp.empty(FACES, dtype=wp.vec4)
    wp.launch(clear_extents, dim=4 * FACES * STRIPES, inputs=[extent])
    wp.launch(ray_keys.measure_extent, dim=count, inputs=[frame.rays, group, extent])
    wp.launch(ray_keys.fit_cells, dim=FACES, inputs=[STRIPES, extent, fit])
    np.testing.assert_array_equal(fit.numpy(), order.fit.numpy())
    keys, samples = wp.empty(count, dtype=int), wp.empty(count, dtype=int)
    lit = wp.zeros(count, dtype=wp.uint8)
    wp.launch(ray_keys.make_keys, dim=count, inputs=[0, frame.rays, lit, group, fit, keys, samples])
    expected = keys.numpy()
    assert found == (expected != ray_keys.LAST_KEY).sum()
    np.testing.assert_array_equal(order.keys.numpy()[:found], expected[order.order.numpy()[:found]])
    assert len(np.unique(expected)) > 100


@pytest.mark.parametrize("name", LIGHTS)
def test_leaves(name: str) -> None:
    built = _built(name)
    frame, tree = built.frame, built.tree
    leaves = int(tree.offset.numpy()[1])
    rays, boxes, live = tree.leaves.numpy(), tree.boxes.numpy(), tree.live.numpy()
    wide = [array.copy() for array in (rays, boxes, live)]
    rays[:], boxes[: QUANTITIES * leaves], live[:leaves] = -7.0, -7.0, -7
    wp.launch(make_leaves, dim=leaves, inputs=[frame.light_frame_of[0], frame.rays, tree])
    np.testing.assert_array_equal(live, wide[2])
    np.testing.assert_array_equal(boxes, wide[1])
    lanes = (live[:leaves, None] >> np.arange(16)) & 1 == 1
    assert lanes.all(axis=1).sum() > 10 and 0 < lanes[lanes.any(axis=1)][-1].sum() < 16
    one, other = (array.reshape(-1, 5, 16).transpose(0, 2, 1)[:leaves][lanes] for array in (rays, wide[0]))
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", LIGHTS)
def test_boxes(name: str) -> None:
    built = _built(name)
    tree = built.tree
    groups = int(tree.offset.numpy()[tree.levels]) // 16
    out = wp.zeros((groups, built.scene.triangle_count, FACES, len(_NUMBERS)), dtype=int)
    wp.launch(judge_all, dim=out.shape[:3], inputs=[built.space, tree, built.occluders, out])
    found, covered, found16, covered16 = np.moveaxis(out.numpy(), -1, 0)
    np.testing.assert_array_equal(found, found16)
    np.testing.assert_array_equal(covered, covered16)
    assert (found != 0).sum() > 1000 and (covered != 0).sum() > 100 and (found != covered).sum() > 1000
