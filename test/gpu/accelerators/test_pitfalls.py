# SPDX-License-Identifier: Apache-2.0
"""The pitfalls of ray hierarchies, found the hard way on a prototype: what each would break, breaks here.

Tests of ``tracer`` run on every pipeline and variant. Where another test has always covered a pitfall, it is named:

P1  half angles from an arc cosine in float32: ``test_narrow_bundles``, ``test_far_lights_cost_no_more_nodes``
P2  edges from corners rounded to float32: ``test_small_triangles_far_away``;
    test_safeguards.py::test_plain_edges_in_float32_fail_under_a_far_light
P3  triple products a.(b x c): test_far.py::test_light_distance_sweep, test_safeguards.py (plain edges, float64)
P4  tolerance relative to the ray's length: test_far.py::test_no_acne_on_a_plane
P5  samples relative to a far light in float32: test_far.py::test_light_distance_sweep,
    ::test_far_lights_converge_to_the_sun
P6  planes from projected corners: ``test_triangles_with_corners_behind_the_light``; test_fuzz.py (straddling)
P7  normals that face away: test_ties.py::test_both_sides_cast, test_invariance.py::test_retold_meshes
P8  cones near and beyond a half space: ``test_wide_bundles``, ``test_all_around_costs_no_more_than_spheres``
P9  a cone of one ray: ``test_equal_rays``, ``test_one_ray_rejects_nearly_everything``,
    ``test_images_with_few_valid_pixels``
P10 normals parallel to the axis: ``test_light_exactly_above``
P11 axes that cancel: ``test_antipodal_rays``, ``test_light_in_the_middle_of_what_is_seen``
P12 cones that grow with every level: ``test_all_around_costs_no_more_than_spheres``
P13 the light in the plane, on a vertex, on an edge: test_ties.py::test_light_in_or_almost_in_a_plane,
    test_fuzz.py (light_in_plane, light_on_vertex, light_on_edge)
P14 degenerate triangles: test_degenerate.py
P15 samples that are not finite or tiny poison their neighbours: ``test_images_with_few_valid_pixels``,
    ``test_samples_ever_nearer_to_the_light``;
    test_tracer_trace.py::test_invalid_pixels_change_nobody_else, ::test_extreme_depths_change_nobody_else
P16 no ray at all: ``test_images_with_few_valid_pixels``; test_tracer_trace.py::test_no_valid_pixel,
    ::test_tiny_and_odd_images
P17 keys over a fixed range: ``test_a_narrow_beam_is_sorted_as_well_as_a_wide_one``,
    ``test_far_lights_cost_no_more_nodes``;
    test_node_counts.py::test_sorting_costs_nothing_where_the_view_is_in_order
P18 culling of back faces: test_ties.py::test_both_sides_cast; test_front_face_culling.py
P19 early accept that only pays in two passes, or not through a diagonal: test_node_counts.py (walls, two passes)
P20 a covered cone written ray by ray: ``test_everything_covered``; test_node_counts.py::test_a_wall_costs_log_n_nodes
P21 queues that overflow: test_small_queues.py; test_tracer_bounds.py::test_any_queue_capacity
P22 peers as oracles: the oracle is test/oracle.py, itself tested by test_oracle.py
P23 unrolled loops that take for ever to compile: test_cuda_compiles.py (size of the machine code)
P24 neighbours that disagree about their edge: test_watertight.py, test_invariance.py
P25 bias relative to the ray: ``test_grazing_light_on_a_plane``; test_ties.py::test_bias_is_metres_along_the_ray
"""

from __future__ import annotations

from functools import cache
from typing import Any

import bundles
import geometry
import numpy as np
import probe
import pytest
import views
from scenario import Scenario

from shadow_tracer import Camera, DirectionalLight, PointLight, State, available_pipelines

_LAMP = PointLight("lamp", (0.0, 0.0, 0.0))
_VARIANTS = available_pipelines()["cone_hierarchy"]


# --- P1: narrow cones ---


@cache
def _narrow(spacing: float) -> Scenario:
    """Every bundle 16 x 16 rays, ``spacing`` radians apart, crossed by edges."""
    rng = np.random.default_rng(200)
    parts = [bundles.edges_across(rng, axis, 8.0 * spacing, 6) for axis in bundles.AXES]
    points = [bundles.grid(axis, spacing, 16, 2.0) for axis in bundles.AXES]
    vertices, triangles = geometry.join(parts)
    return Scenario(np.concatenate(points), _LAMP, vertices, triangles)


@pytest.mark.parametrize("spacing", [1e-3, 1e-4, 1e-5, 1e-6, 1e-8])
def test_narrow_bundles(tracer: Any, spacing: float) -> None:
    _narrow(spacing).check(tracer)
    assert 0.3 < _narrow(spacing).answer.hidden.mean() < 0.999


# --- P2: small triangles far away ---


@cache
def _three_centimetres() -> Scenario:
    """Triangles of 3 cm, 300 m from the light, in front of samples aimed past their corners and edges."""
    rng = np.random.default_rng(201)
    light = np.array([211.0, -147.0, 153.0])
    vertices, triangles = geometry.soup(rng, 300, 0.02, 0.6)
    targets = np.concatenate([vertices, geometry.edge_points(vertices, triangles, (0.5, 0.3))])
    targets = targets[rng.permutation(len(targets))[:1500]]
    targets = targets + rng.normal(size=targets.shape) * 10.0 ** rng.uniform(-9, -2.5, (len(targets), 1))
    points = light + (targets - light) * (1.0 + 10.0 ** rng.uniform(-5, -1.5, (len(targets), 1)))
    return Scenario(points, PointLight("lamp", light), vertices, triangles)


def test_small_triangles_far_away(tracer: Any) -> None:
    _three_centimetres().check(tracer)
    assert 0.3 < _three_centimetres().answer.hidden.mean() < 0.99


# --- P6: straddling triangles ---


@cache
def _corners_behind(half_angle: float) -> list[Scenario]:
    """One per axis: three such triangles, and a bundle at and around their edges."""
    rng = np.random.default_rng(202)
    scenarios = []
    for axis in bundles.AXES:
        ways = bundles.cone(rng, axis, half_angle, 150)
        points = ways * rng.uniform(0.2, 6.0, (len(ways), 1))
        scenarios.append(Scenario(points, _LAMP, *bundles.straddling(rng, axis, half_angle, 3)))
    return scenarios


@pytest.mark.parametrize("half_angle", [0.0, 1e-3, 0.05, 0.5, 1.4])
def test_triangles_with_corners_behind_the_light(tracer: Any, half_angle: float) -> None:
    scenarios = _corners_behind(half_angle)
    for scenario in scenarios:
        scenario.check(tracer)
    hidden = np.array([scenario.answer.hidden.mean() for scenario in scenarios])
    assert 0.2 < hidden.mean() < 0.9 and ((hidden > 0.0) & (hidden < 1.0)).sum() >= 6


# --- P8, P11, P12: wide cones ---


@cache
def _wide(half_angle: float) -> Scenario:
    rng = np.random.default_rng(203)
    ways = bundles.cone(rng, np.array([0.2, -0.1, 1.0]), half_angle, 800)
    vertices, triangles = geometry.join(
        [geometry.soup(rng, 150, 0.2, 1.5), geometry.square(2, 1.0, 400.0), geometry.square(0, -2.0, 0.7)]
    )
    return Scenario(ways * rng.uniform(0.3, 4.0, (800, 1)), _LAMP, vertices, triangles)


@pytest.mark.parametrize("half_angle", [1.5, 1.5697, np.pi / 2, 1.58, 2.5, 3.14, np.pi])
def test_wide_bundles(tracer: Any, half_angle: float) -> None:
    _wide(half_angle).check(tracer)
    assert 0.2 < _wide(half_angle).answer.hidden.mean() < 0.95


@pytest.mark.parametrize("around", ["half", "all"])
def test_all_around_costs_no_more_than_spheres(tracers: Any, any_device: str, around: str) -> None:
    """Samples on one side of the light or on all: the precise test keeps its power, and no cone has grown until it
    rejects nothing: a small triangle meets a small part of the tree."""
    size, count = 128, 1000
    rng = np.random.default_rng(204)
    camera = Camera(size, size, 4.0 * size, 4.0 * size, 63.3, 63.6)
    depth = 10.0 + rng.uniform(0.05 if around == "half" else -1.5, 1.5, (size, size)).astype(np.float32)
    light = PointLight("lamp", (0.0, 0.0, 10.0))
    vertices, triangles = geometry.soup(rng, count, 0.01, 1.0)
    nodes = {}
    for variant in ("precise_sorted", "spheres_sorted", "linear"):
        tracer = tracers(any_device, "cone_hierarchy", variant)
        tracer.scene.put("soup", vertices + light.position, triangles)
        nodes[variant] = tracer.trace(depth, camera, [light], 0.0).counters["nodes_visited"]
    assert nodes["precise_sorted"] <= nodes["spheres_sorted"]
    tree = size * size // 3
    assert nodes["linear"] < nodes["precise_sorted"] < count * tree / 20


@cache
def _antipodal(count: int) -> Scenario:
    rng = np.random.default_rng([206, count])
    ways = np.concatenate([geometry.directions(rng, count), bundles.AXES])
    ways = np.stack([ways, -ways], axis=1).reshape(-1, 3)[: 2 * count + 6]
    # two pairs that cancel beside twelve rays that do not: the twelve are half of what the four look at
    mixed = []
    for way in geometry.directions(rng, count):
        around = bundles.cone(rng, way, 0.1, 14)
        mixed.append(np.concatenate([around[:1], -around[:1], around[1:2], -around[1:2], around[2:]]))
    vertices, triangles = geometry.join([geometry.soup(rng, 100, 0.4, 1.0), geometry.slivers(rng, 20, spread=1.0)])
    return Scenario(2.5 * np.concatenate([*mixed, ways]), _LAMP, vertices, triangles)


@pytest.mark.parametrize("count", [1, 2, 3, 8, 64])
def test_antipodal_rays(tracer: Any, count: int) -> None:
    """Every ray beside its opposite, so that pairs and fours of neighbours have no mean direction at all."""
    _antipodal(count).check(tracer)


def test_light_in_the_middle_of_what_is_seen(tracer: Any, kernel_form: str) -> None:
    """From inside a sphere around the light everything is lit, from outside nothing."""
    tracer.scene.put("sphere", *geometry.icosphere(3, 2.0))
    rng = np.random.default_rng(207)
    slow = tracer.variant == "float64" or (tracer.pipeline == "brute_force" and kernel_form == probe.CUDA)
    step = 8 if slow else 1
    ways = geometry.directions(rng, 2000)[::step]
    assert not tracer.occluded(1.9 * ways, _LAMP).any()
    assert tracer.occluded(2.1 * ways, _LAMP).all()
    assert tracer.occluded(np.concatenate([2.1 * ways, 1.9 * ways]), _LAMP).sum() == len(ways)


# --- P9, P15, P16: few rays, equal rays ---

_COUNTS = [0, 1, 2, 3, 5, 17, 256]


@cache
def _few(count: int) -> tuple[views.View, np.ndarray]:
    """A view of the museum in which only ``count`` pixels are valid, the rest of every invalid kind, and its states."""
    view = views.procedural_view("museum", "centre", 48, views.SMALL)
    rng = np.random.default_rng([208, count])
    kept = rng.choice(view.depth.size, count, replace=False)
    depth = np.resize(np.array([0.0, np.nan, np.inf, -np.inf, -1.0, -1e-30], np.float32), view.depth.size)
    depth[kept] = view.depth.reshape(-1)[kept]
    view = views.View(
        view.vertices, view.triangles, depth.reshape(view.depth.shape), view.camera, view.lights, view.bias
    )
    return view, views.expected_states(view)


@pytest.mark.parametrize("count", _COUNTS)
def test_images_with_few_valid_pixels(tracer: Any, count: int) -> None:
    view, expected = _few(count)
    assert ((expected != State.INVALID).sum(axis=(1, 2)) == count).all()
    tracer.scene.put("mesh", view.vertices, view.triangles)
    np.testing.assert_array_equal(view.trace(tracer), expected)


@pytest.mark.parametrize("count", _COUNTS[1:])
def test_equal_rays(tracer: Any, count: int) -> None:
    """The same sample again and again, one in shadow and one lit: cones without any width, boxes without any size."""
    scenario = _wide(3.14)
    hidden = scenario.answer.hidden
    tracer.scene.put("mesh", scenario.vertices, scenario.triangles)
    for index in (int(np.argmax(hidden)), int(np.argmin(hidden))):
        got = tracer.occluded(np.repeat(scenario.points[index : index + 1], count, axis=0), _LAMP)
        np.testing.assert_array_equal(got, np.full(count, hidden[index]))


@probe.in_forms("variant", _VARIANTS, ["linear"])
def test_one_ray_rejects_nearly_everything(tracers: Any, any_device: str, variant: str) -> None:
    """The node over a single ray tests as sharply as the ray itself."""
    view, _ = _few(1)
    tracer = tracers(any_device, "cone_hierarchy", variant)
    tracer.scene.put("mesh", view.vertices, view.triangles)
    counters = tracer.trace(view.depth, view.camera, view.lights[:1], view.bias).counters
    assert counters["rays"] == 1 and counters["leaf_tests"] <= len(view.triangles) // 20


@cache
def _nested(light: tuple[float, float, float]) -> Scenario:
    """Shells with holes around the light, each thousand times smaller than the one around it, samples between them."""
    rng = np.random.default_rng(212)
    radii = 10.0 ** np.arange(-13, 3, 3)
    shells = [geometry.icosphere(1, radius, light) for radius in radii]
    parts = [(vertices, triangles[rng.random(len(triangles)) < 0.15]) for vertices, triangles in shells]
    points = [light + 3.0 * radius * geometry.directions(rng, 60) for radius in radii]
    vertices, triangles = geometry.join(parts)
    return Scenario(
        np.concatenate(points)[rng.permutation(60 * len(radii))], PointLight("l", light), vertices, triangles
    )


@pytest.mark.parametrize("light", [(0.0, 0.0, 0.0), (0.5, -0.25, 0.125)], ids=["origin", "elsewhere"])
def test_samples_ever_nearer_to_the_light(tracer: Any, light: tuple[float, float, float]) -> None:
    """Among samples metres away, some so near that float32 has lost their direction: each has its own answer."""
    scenario = _nested(light)
    scenario.check(tracer)
    assert 0.2 < scenario.answer.hidden.mean() < 0.8


# --- P10: normals parallel to the axis ---


@cache
def _above(bias: float) -> Scenario:
    """Axis-parallel squares exactly before the light, samples around the common axis and exactly on it."""
    parts, points = [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            parts += [geometry.square(axis, side * at, half) for at, half in ((1.0, 0.25), (1.5, 0.125), (4.0, 9.0))]
            way = side * np.eye(3)[axis]
            for distance in (0.5, 1.0, 1.25, 2.0, 4.0, 5.0):
                points += [bundles.grid(way, 0.0625, 7, distance), bundles.grid(way, 1e-5, 3, distance)]
    vertices, triangles = geometry.join(parts)
    return Scenario(np.concatenate(points), _LAMP, vertices, triangles, bias)


@pytest.mark.parametrize("bias", [0.0, 0.3])
def test_light_exactly_above(tracer: Any, bias: float) -> None:
    _above(bias).check(tracer)
    assert 0.2 < _above(bias).answer.hidden.mean() < 0.9


# --- P17: far lights ---

_TOWARDS = np.array([0.42, -0.16, -0.89])
_WITHOUT_ACCEPTING = {
    "precise_sea": "precise_sorted",
    "precise_seatp": "precise_sorted",
    "precise_eatp": "precise",
}


@probe.in_forms("variant", _VARIANTS, ["linear"])
def test_far_lights_cost_no_more_nodes(tracers: Any, any_device: str, variant: str) -> None:
    """All rays within a microradian: keys and cones still tell them apart, as they do under the sun.

    Where nodes are accepted and threads work side by side, how many nodes are left to look at depends on who comes
    first. There the bound is that of the variant that accepts nothing, in as many passes.
    """
    view = views.procedural_view("robots", "corridor", 64, views.SMALL)

    def counters(variant: str, light: Any) -> dict[str, int]:
        tracer = tracers(any_device, "cone_hierarchy", variant)
        tracer.scene.put("mesh", view.vertices, view.triangles)
        found: dict[str, int] = tracer.trace(view.depth, view.camera, [light], view.bias).counters
        return found

    sun = counters(variant, DirectionalLight("sun", _TOWARDS))
    most = sun["nodes_visited"]
    if not probe.wide(any_device) and variant in _WITHOUT_ACCEPTING:
        most = sun["passes"] * counters(_WITHOUT_ACCEPTING[variant], DirectionalLight("sun", _TOWARDS))["nodes_visited"]
    for distance in (1e4, 1e6, 1e8):
        star = counters(variant, PointLight("star", -_TOWARDS * distance))
        assert star["nodes_visited"] <= 1.1 * most, f"{distance} m, the sun costs {sun}"
    near = counters(variant, PointLight("lamp", -_TOWARDS * 100.0))
    assert sun["nodes_visited"] <= 3 * near["nodes_visited"]


@probe.in_forms("variant", [name for name in _VARIANTS if name == "linear" or "_s" in name], ["linear"])
def test_a_narrow_beam_is_sorted_as_well_as_a_wide_one(tracers: Any, any_device: str, variant: str) -> None:
    """A scene and the same scene a hundred times narrower, seen from the light: the order of rays is fitted to them.

    The light is beside the camera and depths are random, so that the order of pixels is of no use. (Squeezed triangles
    are long, and so are their bounding spheres.)
    """
    size, count = 64, 1500
    rng = np.random.default_rng(211)
    depth = rng.uniform(5.0, 10.0, (size, size)).astype(np.float32)
    centres = rng.uniform((-0.5, -0.5, 2.0), (0.5, 0.5, 9.0), (count, 3)) * [8.0, 8.0, 1.0]
    vertices = (centres[:, None] + rng.normal(size=(count, 3, 3)) * [0.1, 0.1, 0.1]).reshape(-1, 3)
    triangles = np.arange(3 * count).reshape(-1, 3)
    tracer = tracers(any_device, "cone_hierarchy", variant)
    nodes = []
    for width in (1e-2, 1e-4):
        camera = Camera(size, size, size / width, size / width, 31.5, 31.5)
        tracer.scene.put("mesh", vertices * [width, width, 1.0], triangles)
        light = PointLight("lamp", (10.0 * width, 3.0 * width, 0.0))
        nodes.append(tracer.trace(depth, camera, [light], 0.0).counters["nodes_visited"])
    assert nodes[1] <= (3.0 if variant.startswith("spheres") else 1.5) * nodes[0], nodes


# --- P20: everything covered ---


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_everything_covered(tracer: Any, side: float) -> None:
    """One triangle hides all samples, in any direction's order, alone and among many others that hide nothing."""
    rng = np.random.default_rng(209)
    big = (np.array([(-90.0, -90.0, 1.0), (90.0, -90.0, 1.0), (0.0, 150.0, 1.0)]) * side, np.array([[0, 1, 2]]))
    small_vertices, small = geometry.soup(rng, 100, 0.1, 0.5)
    points = np.column_stack([rng.uniform(-3, 3, (700, 2)), rng.uniform(1.01, 9.0, 700)]) * side
    points = points[:: 1 if tracer.variant != "float64" else 10]
    for mesh in (big, geometry.join([(small_vertices - [0, 0, 4.0 * side], small), big])):
        tracer.scene.put("mesh", *mesh)
        assert tracer.occluded(points, _LAMP).all()
        assert not tracer.occluded(points * [1, 1, 0.1], _LAMP).any()


# --- P25: grazing light ---


@cache
def _grazing(angle: float, bias: float) -> Scenario:
    """Samples on, just above and just below a plane of 128 triangles under a light almost in it."""
    rng = np.random.default_rng(210)
    x, y = (g.reshape(-1) for g in np.meshgrid(np.linspace(-8, 8, 9), np.linspace(-8, 8, 9)))
    vertices = np.stack([x, y, np.zeros(81)], axis=1)
    cells = (np.arange(8)[:, None] * 9 + np.arange(8)).reshape(-1)
    triangles = np.concatenate(
        [np.stack([cells, cells + 1, cells + 10], 1), np.stack([cells, cells + 10, cells + 9], 1)]
    )
    points = np.column_stack([rng.uniform(-6, 6, (700, 2)), rng.choice([0.0, 1e-7, -1e-7, -1e-4, -0.02], 700)])
    light = PointLight("lamp", (20.0 * np.cos(angle), 3.0, 20.0 * np.sin(angle)))
    return Scenario(points, light, vertices, triangles.astype(np.int32), bias)


@pytest.mark.parametrize("bias", [0.0, 0.01])
@pytest.mark.parametrize("angle", [1e-1, 1e-2, 1e-4, 1e-7])
def test_grazing_light_on_a_plane(tracer: Any, angle: float, bias: float) -> None:
    scenario = _grazing(angle, bias)
    scenario.check(tracer)
    on = scenario.points[:, 2] >= 0.0
    assert not scenario.answer.hidden[on].any() and scenario.answer.hidden[~on].mean() > 0.3
