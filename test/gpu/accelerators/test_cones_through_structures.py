# SPDX-License-Identifier: Apache-2.0
"""Cones through ``kd_tree`` and ``bvh`` get the answers that all triangles give: the same outcomes and lists, bit for
bit, wherever their planes and boxes lie."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import cones
import geometry
import numpy as np
import probe
import pytest
from trees import clusters, mesh_of, tracer_of, unlike_scenes

from shadow_tracer import DirectionalLight, PointLight, ShadowTracer
from shadow_tracer.gpu.accelerators.registry import REGISTRY, for_cones

pytestmark = probe.in_both_forms

_FREE, _PARTLY, _BLOCKED = 0, 1, 2
_trees = pytest.mark.parametrize("pipeline", ["kd_tree", "bvh"])


def _squares(rng: np.random.Generator, count: int) -> geometry.Geometry:
    """Rectangles along the axes, with corners in a lattice: cells are flat, and planes lie within triangles."""
    parts = []
    for _ in range(count):
        low, size = rng.integers(-4, 4, 3), rng.integers(1, 4, 3)
        size[rng.integers(3)] = 0
        axes, along = np.flatnonzero(size), size * np.eye(3)
        corners = [low, low + along[axes[0]], low + along[axes].sum(axis=0), low + along[axes[1]]]
        parts.append(geometry.quad(*np.array(corners) / 4.0))
    return geometry.join(parts)


_RNG = np.random.default_rng(560)
_MESHES = {
    "clusters": mesh_of(clusters(_RNG, 500)),
    "soup": geometry.soup(_RNG, 250, 0.5, 1.0),
    "few": geometry.soup(_RNG, 10, 0.4, 1.0),
    "integers": geometry.integer_soup(_RNG, 80),
    "squares": _squares(_RNG, 90),
    "slivers": geometry.join([geometry.box((-1, -1, -1), (1, 1, 1)), geometry.spiky_sphere()]),
    "flat": (_RNG.uniform(-1, 1, (60, 3)) * (1.0, 0.0, 1.0), np.arange(60).reshape(-1, 3)),
    "alike": mesh_of(np.repeat(_RNG.uniform(-1, 1, (2, 3, 3)), 20, axis=0)),
}


def _cones(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Apices, ends and half angles: slivers, rays and wide ones; along the axes, around an axis (it is inside of them),
    from places where planes lie, and from far away."""
    apices, axes = rng.uniform(-1.3, 1.3, (count, 3)), cones.unit(rng.uniform(-1, 1, (count, 3)))
    apices[::4] = np.rint(4.0 * apices[::4]) / 4.0
    axes[::3] = np.eye(3)[rng.integers(0, 3, len(axes[::3]))] * rng.choice([-1.0, 1.0], (len(axes[::3]), 1))
    axes[1::6] = cones.unit(axes[:-1:6] + 0.05 * axes[1::6])
    angles = 10.0 ** rng.uniform(-4.0, 0.17, count)
    angles[::7] = 0.0
    lengths = rng.uniform(0.1, 3.0, count)
    lengths[::5] = 10.0
    far = slice(2, None, 9)
    apices[far] -= 10.0 ** rng.uniform(1.0, 7.0, (len(apices[far]), 1)) * axes[far]
    angles[far] *= 1e-3
    lengths[far] = np.sqrt((apices[far] ** 2).sum(axis=1)) + 1.0
    return apices, apices + lengths[:, None] * axes, angles


def _answers(
    tracer: ShadowTracer, asked: tuple[np.ndarray, np.ndarray, np.ndarray], most: int = 40
) -> list[np.ndarray]:
    apices, ends, angles = asked
    outcomes = tracer.cones(apices, ends, half_angle=angles)
    return [
        outcomes,
        *tracer.cone_hits(apices, ends - apices, angles, most),
        *tracer.cone_hits(apices, ends, angles, 2),
    ]


@_trees
@pytest.mark.parametrize("name", list(_MESHES))
def test_the_answers_of_all_triangles(any_device: str, pipeline: str, name: str) -> None:
    rng = np.random.default_rng(561)
    asked, every = _cones(rng, 250), tracer_of(any_device, "brute_force")
    tracer = tracer_of(any_device, pipeline)
    for each in (every, tracer):
        each.scene.put(name, *_MESHES[name])
    expected = _answers(every, asked)
    for mine, theirs in zip(_answers(tracer, asked), expected, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    free, partly, blocked = np.bincount(expected[0], minlength=3)
    assert (
        min(free, partly) > 2
        and (blocked > 2 or name in ("clusters", "few", "flat"))
        and (expected[1] >= 0).sum() > 100
    )


@pytest.mark.parametrize("pipeline", ["kd_tree", "brute_force"])
def test_never_wrong_beside_rays(any_device: str, pipeline: str) -> None:
    rng, tracer = np.random.default_rng(562), tracer_of(any_device, pipeline)
    tracer.scene.put("soup", *_MESHES["soup"])
    found = np.zeros(3, int)
    for apex in rng.uniform(-1.5, 1.5, (8, 3)):
        ends, share = cones.some(rng, 100, -1.5, 1.5)
        radius = share * np.sqrt(((ends - apex) ** 2).sum(axis=1))
        outcomes = tracer.cones(apex, ends, radius)
        rays = cones.ends_of_rays(np.broadcast_to(apex, ends.shape), ends, radius, 64)
        hidden = tracer.occluded(rays, PointLight("apex", apex))
        assert not hidden[outcomes == _FREE].any() and hidden[outcomes == _BLOCKED].all()
        found += np.bincount(outcomes, minlength=3)
    assert found.min() > 20


def test_a_list_in_pieces(any_device: str) -> None:
    """The mailboxes of a walk are few: what is in many cells comes again, and is kept once."""
    rng, tracer = np.random.default_rng(563), tracer_of(any_device, "kd_tree")
    tracer.scene.put("integers", *_MESHES["integers"])
    tracer.scene.put("clusters", *_MESHES["clusters"])
    apices, ends, angles = _cones(rng, 60)
    numbers, distances = tracer.cone_hits(apices, ends - apices, angles, 300)
    for row in numbers:
        assert len(set(row[row >= 0])) == (row >= 0).sum()
    for n in (1, 5, 16):
        after, pieces = None, []
        for _ in range(60 // n):
            pieces.append(tracer.cone_hits(apices, ends - apices, angles, n, after=after))
            after = (pieces[-1][1][:, -1], pieces[-1][0][:, -1])
        np.testing.assert_array_equal(np.hstack([some for some, _ in pieces]), numbers[:, : 60 // n * n])
        np.testing.assert_array_equal(np.hstack([t for _, t in pieces]), distances[:, : 60 // n * n])


def test_half_angle_zero_is_the_ray(any_device: str) -> None:
    rng, tracer = np.random.default_rng(564), tracer_of(any_device, "kd_tree")
    tracer.scene.put("integers", *_MESHES["integers"])
    points, apex = rng.integers(-4, 5, (300, 3)).astype(np.float64), np.array([5.0, 1.0, -4.0])
    for scale in (1.0, 1e8):  # from beyond the reach of the tree as well
        hidden = tracer.occluded(points * scale, PointLight("apex", apex))
        outcomes = tracer.cones(points * scale, apex, 0.0)
        np.testing.assert_array_equal(outcomes, np.where(hidden, _BLOCKED, _FREE))
        assert 20 < hidden.sum() < 290
    way = np.array([1.0, 2.0, -3.0])
    numbers, distances = tracer.cone_hits(points, way, 0.0, 1)
    np.testing.assert_array_equal(numbers[:, 0] >= 0, tracer.occluded(points, DirectionalLight("sun", -way)))
    assert (distances[numbers >= 0] >= 0).all()


@pytest.mark.parametrize("pipeline", ["kd_tree", "brute_force"])
def test_what_joins_hides_and_what_does_not_is_partly(any_device: str, pipeline: str) -> None:
    tracer, up = tracer_of(any_device, pipeline), np.array([0.0, 0.0, 2.0])
    plate = [(-3, -3, 1), (3, -3, 1), (3, 0.01, 1), (-3, 0.01, 1), (3, 3, 1), (-3, 3, 1), (0.02, 0.01, 1), (0, 0, 5)]
    joined = [(0, 1, 2), (0, 2, 3), (3, 2, 4), (3, 4, 5)]
    cut = [*joined[:2], (3, 6, 5), (6, 4, 5), (6, 2, 4)]
    for triangles, outcome in (
        (joined, _BLOCKED),
        (cut, _PARTLY),  # a T-junction
        ([*cut, (3, 2, 6)], _PARTLY),  # closed by a triangle without area
        ([*joined, (3, 2, 7)], _PARTLY),  # three triangles at an edge
    ):
        tracer.scene.put("plate", plate, triangles)
        assert tracer.cones((0, 0, 0), up, 0.5) == outcome
    assert tracer.cones((0, 0, 0), up, 0.0) == _BLOCKED


def test_a_budget_only_leaves_in_doubt(any_device: str) -> None:
    """And a narrow cone needs little: the counts of nodes and triangles that a budget bounds are the walk's."""
    rng, tracer = np.random.default_rng(565), tracer_of(any_device, "kd_tree")
    tracer.scene.put("clusters", *mesh_of(clusters(rng, 3000)))
    apices, ends = rng.uniform(-1, 1, (2, 300, 3))
    whole, known = tracer.cones(apices, ends, half_angle=0.01), []
    for budget in (1, 10, 40, 150, 10**12):
        some = tracer.cones(apices, ends, half_angle=0.01, budget=budget)
        assert ((some == whole) | (some == _PARTLY)).all()
        known.append(int((some == whole).sum() - (whole == _PARTLY).sum()))
    assert known == sorted(known) and known[0] == 0 and known[3] > 0.9 * known[4] > 100


def test_unlike_scenes(any_device: str) -> None:
    """On one tracer, rays and cones in turn: nothing of a scene before is read."""
    rng = np.random.default_rng(566)
    tracer, every = tracer_of(any_device, "kd_tree"), tracer_of(any_device, "brute_force")
    for number, _ in unlike_scenes(rng, (tracer, every), 400):
        asked = _cones(rng, 40 + 10 * (number % 3))
        with pytest.raises(ValueError, match="half_angle"):
            tracer.cones(*asked[:2], half_angle=-asked[2])
        for mine, theirs in zip(_answers(tracer, asked, 5), _answers(every, asked, 5), strict=True):
            np.testing.assert_array_equal(mine, theirs)
        light = PointLight("lamp", (0.1, 0.2, 3.0))
        np.testing.assert_array_equal(tracer.occluded(asked[0], light), every.occluded(asked[0], light))


@_trees
@pytest.mark.parametrize("far", [0.0, 1e7, 1e12])
def test_far_from_the_origin_with_gaps_and_what_casts_nothing(any_device: str, pipeline: str, far: float) -> None:
    """Corners that are no numbers, no area, a light that ignores a mesh; then one triangle, then none."""
    rng, shift = np.random.default_rng(568), far * np.array([1.0, -0.3, 0.7])
    tracer, every = tracer_of(any_device, pipeline), tracer_of(any_device, "brute_force")
    vertices, triangles = _MESHES["few"]
    broken = 1.2 * vertices[:, ::-1] + shift
    broken[3], broken[9:12] = np.nan, broken[9]
    apices, ends, angles = _cones(rng, 80)
    asked = apices + shift, ends + shift, angles
    light = PointLight("lamp", shift + (0.2, 0.1, 0.3), ignore=["broken"])
    for step in range(4):
        for each in (tracer, every):
            if step == 0:
                each.scene.put("whole", vertices + shift, triangles)
                each.scene.put("broken", vertices + shift, triangles)
                each.scene.deform("broken", broken, nonfinite="skip")
            elif step == 1:
                each.scene.remove("whole")
                each.scene.put("whole", vertices + shift, triangles[:3])
            elif step == 2:
                each.scene.clear()
                each.scene.put("one", vertices[:3] + shift, triangles[:1])
            else:
                each.scene.clear()
        found, expected = (_answers(each, asked, 5) for each in (tracer, every))
        found.append(tracer.cones(asked[0], light, 0.2))
        expected.append(every.cones(asked[0], light, 0.2))
        for mine, theirs in zip(found, expected, strict=True):
            np.testing.assert_array_equal(mine, theirs)
        assert (expected[0] != _FREE).any() == (step < 3)


@pytest.mark.parametrize("fewest", [0, 3])
def test_cells_that_are_not_split_for_want_of_room(
    any_device: str, monkeypatch: pytest.MonkeyPatch, fewest: int
) -> None:
    kind: Any = import_module("shadow_tracer.gpu.accelerators.kd_tree.kd_tree").KdTree
    monkeypatch.setattr(kind, "nodes_per_triangle", 0)
    monkeypatch.setattr(kind, "fewest", 1 + fewest)
    asked = _cones(np.random.default_rng(567), 60)
    tracer, every = tracer_of(any_device, "kd_tree"), tracer_of(any_device, "brute_force")
    for each in (tracer, every):
        each.scene.put("squares", *_MESHES["squares"])
    for mine, theirs in zip(_answers(tracer, asked), _answers(every, asked), strict=True):
        np.testing.assert_array_equal(mine, theirs)


def test_where_cones_go(any_device: str) -> None:
    """Through the pipeline's own structure if they can, which is not built a second time; else through bvh/sah."""
    for name, entry in REGISTRY.items():
        for variant, where in entry.classes.items():
            kind = None
            if where is not None:
                module, _, kind = where.partition(":")
                kind = getattr(import_module(f"shadow_tracer.gpu.accelerators.{module}"), kind)
            can = getattr(kind, "cones", None) is not None and (name != "bvh" or variant == "sah")
            assert for_cones(name, variant) == ((name, variant) if can else ("bvh", "sah"))
    tracer = tracer_of(any_device, "kd_tree")
    tracer.scene.put("soup", *_MESHES["soup"])
    tracer.occluded([(0.0, 0.0, 0.0)], PointLight("lamp", (0.1, 0.2, 3.0)))
    made = probe.structure(tracer).nodes.numpy().copy()
    assert tracer.cones((0, 0, 0), (0, 0, 1), 0.3) in (_FREE, _PARTLY, _BLOCKED)
    np.testing.assert_array_equal(probe.structure(tracer).nodes.numpy(), made)
