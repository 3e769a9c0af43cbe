# SPDX-License-Identifier: Apache-2.0
"""The nodes and start cells of variant `linear`, alone: nothing that the exact decision calls hidden is rejected or
missing from the cells a triangle starts from, nothing it calls lit is accepted; and all of it happens often."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import probe
import probe_accelerators
import pytest
import warp as wp
from node_fuzz import LIGHTS, bundles, decide_all

from shadow_tracer import Bounds, ShadowTracer
from shadow_tracer.gpu.accelerators.cone_hierarchy.boxes import RayTree
from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.exact.faces import Occluders
from shadow_tracer.gpu.exact.light_space import LightSpace, face_of
from shadow_tracer.gpu.visibility.answers import Answers

# The tree is that of a CUDA thread; the CPU's own is compared with it in test_sixteen_lanes.py.
pytestmark = probe.in_cuda_form

_ABSENT, _BESIDE, _REJECTED, _OPEN, _WHOLE = -1, -2, 0, 1, 2


# What becomes of (triangle, node) on one face: _ABSENT if the triangle casts nothing or cannot touch the face, _BESIDE
# for a leaf outside its cells, else the answer of the box test.
@wp.func_native(
    native.snippet(
        "accelerators/cone_hierarchy/descent.h",
        call="""
    Descent it = { { space, tree, occluders }, tree, answers, 0, 0, 0 };
    Corners1 corners;
    Runs runs;
    if (!it.triangle.load(thread) || !(it.triangle.look(thread, corners) >> face & 1)
        || !it.triangle.enter(face, corners, runs))
        return -1;
    if (number < tree.offset.data[1]) {
        bool within = false;
        for (int k = 0; k < runs.count; ++k)
            within = within || (runs.first[k] <= number && number <= runs.last[k]);
        if (!within)
            return -2;
    }
    return it.judge(number);""",
    )
)
def judge(
    thread: int, face: int, number: int, space: LightSpace, tree: RayTree, occluders: Occluders, answers: Answers
) -> int: ...


@wp.kernel(enable_backward=False)
def judge_all(space: LightSpace, tree: RayTree, occluders: Occluders, answers: Answers, out: wp.array3d(dtype=int)):
    number, triangle, face = wp.tid()
    out[number, triangle, face] = judge(triangle, face, number, space, tree, occluders, answers)


@wp.kernel(enable_backward=False)
def find_faces(rays: wp.array(dtype=wp.vec4), out: wp.array(dtype=int)):
    i = wp.tid()
    out[i] = face_of(rays[i])


@dataclass(frozen=True)
class Outcome:
    """answers (nodes, T, 6); hidden (N, T) exact; faces (N,); nodes_of (levels, N): node number of each ray."""

    answers: np.ndarray
    hidden: np.ndarray
    faces: np.ndarray
    nodes_of: np.ndarray


@cache
def _outcome(device: str, name: str, seed: int) -> Outcome:
    light = LIGHTS[name]
    rays, corners = bundles(np.random.default_rng(seed), light)
    points, triangles = rays.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3)
    bounds = Bounds(len(triangles), len(points), 1, 64, 1)
    tracer = ShadowTracer("cone_hierarchy", "linear", device=device, bounds=bounds)
    tracer.scene.put("mesh", corners.reshape(-1, 3), triangles)
    built = probe_accelerators.ray_tree(tracer, points, light, 0.02)
    tree, frame, scene = built.tree, built.frame, built.scene
    offset = tree.offset.numpy()
    nodes = int(offset[tree.levels])
    out = wp.empty((nodes, len(triangles), 6), dtype=int, device=device)
    inputs = [built.space, tree, built.occluders, built.answers, out]
    wp.launch(judge_all, dim=out.shape, inputs=inputs, device=device)
    hidden = wp.empty((len(points), len(triangles)), dtype=wp.uint8, device=device)
    homogeneous = wp.vec4d(*light.homogeneous)
    inputs = [homogeneous, frame.positions, scene.vertices, scene.triangles, hidden]
    wp.launch(decide_all, dim=hidden.shape, inputs=inputs, device=device)
    faces = wp.empty(len(points), dtype=int, device=device)
    wp.launch(find_faces, dim=len(points), inputs=[frame.rays, faces], device=device)
    place = np.empty(len(points), int)
    place[tree.order.numpy()[: len(points)]] = np.arange(len(points))
    shifts = [tree.log_leaf + level * tree.log_branch for level in range(tree.levels)]
    nodes_of = np.array([offset[level] + (place >> shift) for level, shift in enumerate(shifts)])
    return Outcome(out.numpy(), hidden.numpy().astype(bool), faces.numpy(), nodes_of)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", LIGHTS)
def test_no_hidden_ray_is_missed_and_no_lit_one_taken(any_device: str, name: str, seed: int) -> None:
    outcome = _outcome(any_device, name, seed)
    for level, nodes in enumerate(outcome.nodes_of):
        answers = outcome.answers[nodes, :, outcome.faces]  # (N, T)
        missed = outcome.hidden & (answers != _OPEN) & (answers != _WHOLE)
        taken = ~outcome.hidden & (answers == _WHOLE)
        assert not missed.any(), f"level {level}: {answers[missed][:5]} for hidden rays {np.argwhere(missed)[:3]}"
        assert not taken.any(), f"level {level}: accepted with light at {np.argwhere(taken)[:3]}"


@pytest.mark.parametrize("name", LIGHTS)
def test_cells_and_boxes_decide(any_device: str, name: str) -> None:
    """Most lit pairs never reach a leaf, many hidden pairs are accepted with theirs, and cells, boxes and faces all
    have a share in it."""
    counts = dict.fromkeys((_ABSENT, _BESIDE, _REJECTED), 0)
    lit = whole = hidden = 0
    for seed in range(3):
        outcome = _outcome(any_device, name, seed)
        answers = outcome.answers[outcome.nodes_of[0], :, outcome.faces]
        for value in counts:
            counts[value] += int((answers == value)[~outcome.hidden].sum())
        lit += int((~outcome.hidden).sum())
        hidden += int(outcome.hidden.sum())
        whole += int((answers == _WHOLE).sum())
    assert sum(counts.values()) > 0.75 * lit, (counts, lit)
    assert min(counts[_BESIDE], counts[_REJECTED]) > 0.02 * lit, (counts, lit)
    assert (counts[_ABSENT] > 0.1 * lit) == (name == "inside"), (counts, lit)
    assert whole > 0.3 * hidden > 10_000, (whole, hidden)
