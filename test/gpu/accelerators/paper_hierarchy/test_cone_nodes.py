# SPDX-License-Identifier: Apache-2.0
"""The node tests of the paper's variants, alone: a node that a triangle is rejected for holds no ray that the exact
decision says yes to, a covered node no ray that it says no to; and both happen where they should."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
import warp as wp
from node_fuzz import LIGHTS, RAYS, bundles, decide_all

from shadow_tracer import Bounds, Scene
from shadow_tracer.gpu.accelerators.admission import Admission
from shadow_tracer.gpu.accelerators.interface import Context, Rays
from shadow_tracer.gpu.accelerators.paper_hierarchy import cone_test, cones
from shadow_tracer.gpu.accelerators.paper_hierarchy.breadth_first import Triangles, see
from shadow_tracer.gpu.device.stages import Stages
from shadow_tracer.gpu.exact.light_frame import make_anchor, make_light_frame
from shadow_tracer.gpu.exact.light_space import make_light_space
from shadow_tracer.gpu.occluders.corners import Corners
from shadow_tracer.gpu.occluders.seen import TriangleRecords
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.samples.rays import project
from shadow_tracer.gpu.samples.sample_set import SampleSet


@wp.kernel(enable_backward=False)
def judge_nodes(first: int, triangles: Triangles, tree: cones.Tree, answers: wp.array2d(dtype=int)):
    node, triangle = wp.tid()
    occluder = see(triangles, triangle)
    index = first + node
    if triangles.spheres != 0:
        answers[node, triangle] = cone_test.test_sphere(occluder, tree.cones[index], tree.ranges[index])
    else:
        answers[node, triangle] = cone_test.test_precise(occluder, tree.cones[index], tree.ranges[index])


@dataclass(frozen=True)
class Outcome:
    """Per level: (nodes, T) answers of a node test; exact (nodes, T) any, all of the node's rays; angles (nodes,)."""

    answers: list[np.ndarray]
    some: list[np.ndarray]
    every: list[np.ndarray]
    angles: list[np.ndarray]


@cache
def _outcome(device: str, name: str, spheres: bool, seed: int) -> Outcome:
    light = LIGHTS[name]
    rays, corners = bundles(np.random.default_rng(seed), light)
    points, triangles = rays.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3)
    bounds = Bounds(len(triangles), len(points), 1, 64, 1)
    frame, scene = SampleSet(bounds, wp.get_device(device)), SceneBuffers(bounds, wp.get_device(device))
    context = Context(
        frame, scene, TriangleRecords(bounds, scene, frame.light_frame_of, frame.host), Stages(frame.device)
    )
    world = Scene(bounds)
    world.put("mesh", corners.reshape(-1, 3), triangles)
    scene.sync(world)
    bias = np.where(np.arange(len(points)) % 3 == 0, 0.02, 0.0)
    frame.upload(frame.positions, np.concatenate([points, bias[:, None]], axis=1))
    frame.upload(frame.valid, np.ones(len(points), np.uint8))
    frame.set_samples(len(points), 0)
    # A small anchor leaves most samples far to the side of it.
    around = make_light_frame(light, make_anchor(np.zeros(3), (4.0, 0.3)[seed % 2], None))
    frame.set_lights([around])
    project(frame, 0, 0, 0)
    context.records.plan([around], 1)
    made = context.records.prepare(around)
    seen, rays_in_tree, tree = Corners(context.records), Admission(context), cones.ConeTree(context)
    seen.make(around, made)
    rays_in_tree.admit(Rays((around,)))
    assert (rays_in_tree.groups.numpy() == 1).all()
    leaves = cones.Leaves()
    leaves.rays, leaves.group = frame.rays, rays_in_tree.groups
    leaves.order = leaves.counts = rays_in_tree.counts
    tree.shape(True)
    what = Triangles()
    what.space, what.spheres = make_light_space(around), int(spheres)
    what.corners, what.indices, what.records = seen.of(0), scene.triangles, context.records.memory
    tree.build(what.space, leaves, frame.states_of(0))
    hidden = wp.empty((len(points), len(triangles)), dtype=wp.uint8, device=device)
    inputs = [around.light, frame.positions, scene.vertices, scene.triangles, hidden]
    wp.launch(decide_all, dim=hidden.shape, inputs=inputs, device=device)
    exact = hidden.numpy().astype(bool)
    outcome = Outcome([], [], [], [])
    for level in range(1, tree.tree.top + 1):
        count, _, _, first = tree.tree.levels.numpy()[level]
        answers = wp.empty((int(count), len(triangles)), dtype=int, device=device)
        wp.launch(judge_nodes, dim=answers.shape, inputs=[int(first), what, tree.tree, answers], device=device)
        starts = np.arange(0, len(points), 4**level)
        outcome.answers.append(answers.numpy())
        outcome.some.append(np.logical_or.reduceat(exact, starts))
        outcome.every.append(np.logical_and.reduceat(exact, starts))
        outcome.angles.append(tree.tree.cones.numpy()[first : first + count, 3])
    return outcome


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("spheres", [False, True], ids=["precise", "spheres"])
@pytest.mark.parametrize("name", LIGHTS)
def test_no_node_is_wrongly_rejected_or_accepted(any_device: str, name: str, spheres: bool, seed: int) -> None:
    outcome = _outcome(any_device, name, spheres, seed)
    for level, (answers, some, every) in enumerate(
        zip(outcome.answers, outcome.some, outcome.every, strict=True), start=1
    ):
        rejected, covered = answers == int(cone_test.REJECTED), answers == int(cone_test.COVERED)
        assert not (rejected & some).any(), (
            f"level {level}: rejected with a shadow at {np.argwhere(rejected & some)[0]}"
        )
        assert not (covered & ~every).any(), f"level {level}: covered with light at {np.argwhere(covered & ~every)[0]}"


@pytest.mark.parametrize("name", LIGHTS)
def test_node_tests_decide(any_device: str, name: str) -> None:
    """Of the pairs without a shadow most are rejected, of those with nothing but shadow many accepted, and the precise
    test rejects more than spheres."""
    counts = np.zeros(5, int)
    for seed in range(3):
        precise, sphere = _outcome(any_device, name, False, seed), _outcome(any_device, name, True, seed)
        for level in range(3):
            answers, some, every = precise.answers[level], precise.some[level], precise.every[level]
            spheres = sphere.answers[level]
            of = (answers == int(cone_test.REJECTED), ~some, answers == int(cone_test.COVERED), every)
            counts += [*(int(x.sum()) for x in of), int((spheres == int(cone_test.REJECTED)).sum())]
    rejected, empty, covered, full, by_sphere = counts
    assert rejected > 0.8 * empty and covered > 0.8 * full > 20_000
    assert 0.45 * empty < by_sphere < 0.9 * rejected


@pytest.mark.parametrize("name", LIGHTS)
def test_half_angles_keep_their_resolution(any_device: str, name: str) -> None:
    """Nodes around bundles far narrower than the resolution of a cosine are as narrow as the bundles, and some nodes
    are wider than pi/2, where there is a light inside."""
    narrow, widest = [], 0.0
    for seed in (0, 2):  # with the large anchor
        angles = _outcome(any_device, name, False, seed).angles
        nodes = RAYS // 4
        narrow += [angles[0][:nodes].max(), angles[0][4 * nodes : 5 * nodes].max()]
        widest = max(widest, angles[2].max())
        assert all((a >= 0.0).all() and (a <= np.pi + 1e-6).all() for a in angles)
    assert max(narrow[::2]) < 3e-6 and max(narrow[1::2]) < 4e-4
    assert (widest > 2.0) == (name == "inside")
