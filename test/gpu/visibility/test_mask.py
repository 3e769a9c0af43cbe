# SPDX-License-Identifier: Apache-2.0
"""The query *mask*: all points of a light in one walk, against the same points as hard lights."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import geometry
import numpy as np
import probe
import pytest

from shadow_tracer import (
    Bias,
    Bounds,
    Camera,
    DiscLight,
    PointLight,
    RectangleLight,
    ShadowTracer,
    SphereLight,
    State,
    SunDisc,
    TubeLight,
)
from shadow_tracer.gpu.engine import area_lights, band

pytestmark = probe.in_both_forms

_BOUNDS = {"max_triangles": 3000, "max_rays": 6000, "max_lights": 8}
_CAMERA = Camera(40, 30, 35.0, 36.0, 19.25, 14.75)
_WALKERS = ["mesh_bvh/refit", "mesh_bvh/binary", "bvh/sah", "bvh/median", "bvh/lbvh", "bvh/threaded"]


def _tracer(names: str, device: str, **more: Any) -> ShadowTracer:
    return ShadowTracer(*names.split("/"), device=device, bounds=Bounds(**_BOUNDS), **more)


def _depth(seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    depth = rng.uniform(2.0, 4.5, (30, 40)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.05] = np.nan
    return depth


_MESHES: dict[str, geometry.Geometry] = {
    "ball": geometry.icosphere(2, 0.6, (0.0, 0.0, 2.0)),
    "soup": geometry.soup(np.random.default_rng(2), 300, 0.4, 2.5),
    "integers": geometry.integer_soup(np.random.default_rng(3), 200),
    "slivers": geometry.slivers(np.random.default_rng(4), 200),
    "walls": geometry.join([geometry.square(axis, 1.0, 2.0) for axis in range(3)]),
}
_LIGHTS = {
    "beside": SphereLight("s", (0.25, -1.0, 0.5), 0.25, samples=64),
    "within": SphereLight("s", (0.0, 0.0, 2.0), 0.5, samples=33),
    "wide": SphereLight("s", (0.5, 0.5, 1.0), 30.0, samples=130),
    "tiny": SphereLight("s", (1.0, 1.0, 1.0), 1e-9, samples=2),
    "short": SphereLight("s", (0.25, -1.0, 2.5), 0.75, range=1.5, samples=65),
    "disc": DiscLight("s", (0.5, -1.0, 1.5), (0.0, 1.0, 0.25), 0.5),
    "rectangle": RectangleLight("s", (0.25, -1.0, 3.0), (0.5, 0.0, 0.0), (0.0, 0.0, 1.0), two_sided=True, samples=63),
    "tube": TubeLight("s", (-1.0, -1.0, 1.0), (1.0, -0.5, 3.0), 0.125, range=3.0),
    "sun": SunDisc("s", (0.25, 1.0, 0.5)),
    "wide sun": SunDisc("s", (1.0, 1.0, 3.0), 1.5, samples=17),
}


@cache
def _by_hard_lights(device: str, mesh: str, light: str, bias: float) -> dict[str, np.ndarray]:
    """Once for all walkers and forms: it is most of the work."""
    oracle = _tracer("light_grid/packed", device)
    oracle.scene.put("mesh", *_MESHES[mesh])
    frame = oracle.trace(_depth(), _CAMERA, [_LIGHTS[light]], Bias(bias))
    found = {"state": frame.state("s"), "visibility": frame.visibility("s")}
    return found if _LIGHTS[light].samples > 64 else {"light_bits": frame.light_bits("s"), **found}


@pytest.mark.parametrize("names", _WALKERS)
@pytest.mark.parametrize("light", _LIGHTS)
@pytest.mark.parametrize("mesh", _MESHES)
def test_the_same_points_reach_as_hard_lights(any_device: str, mesh: str, light: str, names: str) -> None:
    tracer, light_of_points = _tracer(names, any_device), _LIGHTS[light]
    tracer.scene.put("mesh", *_MESHES[mesh])
    for bias in (0.0, 0.02):
        frame = tracer.trace(_depth(), _CAMERA, [light_of_points], Bias(bias))
        for what, expected in _by_hard_lights(any_device, mesh, light, bias).items():
            np.testing.assert_array_equal(getattr(frame, what)("s"), expected, what)
        assert np.isin(frame.state("s"), (State.LIT, State.SHADOWED, State.PENUMBRA)).sum() > 100


@dataclass(frozen=True)
class _Step:
    """A frame, points, and what is found by hard lights."""

    mesh: str | None
    lights: list[Any]
    bias: float
    depth: np.ndarray
    points: np.ndarray
    expected: list[np.ndarray]

    def found(self, tracer: ShadowTracer) -> list[np.ndarray]:
        if self.mesh is None:
            tracer.scene.clear()
        else:
            tracer.scene.put("mesh", *_MESHES[self.mesh])
        frame = tracer.trace(self.depth, _CAMERA, self.lights, Bias(self.bias))
        images = [image(light.name) for light in self.lights for image in (frame.visibility, frame.state)]
        return [*images, tracer.states_at(self.points, self.lights, 0.01)]


@cache
def _unlike_frames(device: str, cull: bool) -> list[_Step]:
    """Meshes, lights and biases change; a hard light before and behind; points in between."""
    oracle, steps = _tracer("light_grid/packed", device, front_face_culling=cull), []
    rng = np.random.default_rng(5)
    lamps = [PointLight("before", (0.1, -2.0, 0.3)), PointLight("behind", (2.0, 0.0, 1.0), 2.5)]
    for step in range(8):
        light = list(_LIGHTS.values())[step % len(_LIGHTS)]
        lights = [lamps[0], light, lamps[1]] if step % 2 else [light]
        mesh = None if step == 4 else list(_MESHES)[step % len(_MESHES)]
        points = rng.uniform(-2, 4, (50 + 300 * step, 3))
        asked = _Step(mesh, lights, 0.03 * (step % 3), _depth(step), points, [])
        steps.append(replace(asked, expected=asked.found(oracle)))
    return steps


@pytest.mark.parametrize("names", _WALKERS)
@pytest.mark.parametrize("cull", [False, True])
@pytest.mark.slow
def test_sequences_of_unlike_frames(any_device: str, names: str, cull: bool) -> None:
    tracer = _tracer(names, any_device, front_face_culling=cull)
    for number, step in enumerate(_unlike_frames(any_device, cull)):
        for found, expected in zip(step.found(tracer), step.expected, strict=True):
            np.testing.assert_array_equal(found, expected, str(number))


_ODD_BIASES = 0.0, 0.5, 5.0


@cache
def _odd_points(device: str) -> tuple[tuple[np.ndarray, np.ndarray], SphereLight, np.ndarray, list[np.ndarray]]:
    """A mesh, a light, points that are points of the light, corners of triangles, far away or in the middle of the
    light, and their states by hard lights, by bias."""
    vertices, triangles = _MESHES["ball"]
    vertices = np.concatenate([vertices, [(np.nan, 0, 0), (0, 0, 1), (1, 0, 1)]])
    triangles = np.concatenate([triangles, [(len(vertices) - 3, len(vertices) - 2, len(vertices) - 1)], [(0, 0, 1)]])
    sphere = SphereLight("s", (0.25, -0.5, 1.0), 0.75, samples=70)
    far = 10.0 ** np.arange(1, 16, 2)[:, None] * np.array([(1.0, 2.0, 3.0)])
    points = np.concatenate([sphere.points, vertices[:-3], [sphere.position], far, -far])
    oracle = _tracer("light_grid/packed", device)
    oracle.scene.put("mesh", vertices, triangles, nonfinite="skip")
    return (vertices, triangles), sphere, points, [oracle.states_at(points, [sphere], bias) for bias in _ODD_BIASES]


@pytest.mark.parametrize("names", _WALKERS)
def test_points_on_samples_edges_and_corners(any_device: str, names: str) -> None:
    mesh, sphere, points, expected = _odd_points(any_device)
    tracer = _tracer(names, any_device)
    tracer.scene.put("mesh", *mesh, nonfinite="skip")
    for bias, states in zip(_ODD_BIASES, expected, strict=True):
        np.testing.assert_array_equal(tracer.states_at(points, [sphere], bias), states)


@pytest.mark.parametrize("names", _WALKERS)
def test_samples_in_the_middle_of_the_light(any_device: str, names: str) -> None:
    """Rays of hardly any length to the middle, and all around to the points."""
    tracer, oracle = _tracer(names, any_device), _tracer("light_grid/packed", any_device)
    panel = RectangleLight("s", (0.25, -0.5, 1.0), (0.75, 0.0, 0.0), (0.0, 0.75, 0.0), two_sided=True)
    away = 10.0 ** np.arange(-16.0, 0.0)[:, None, None] * np.concatenate([np.eye(3), -np.eye(3)])
    points = np.concatenate([[panel.position], (panel.position + away).reshape(-1, 3)])
    for each in (tracer, oracle):
        each.scene.put("ball", *geometry.icosphere(2, 0.5, (0.25, -0.5, 1.0)))
        each.scene.put("soup", *_MESHES["soup"])
    bits = [each.light_bits(points, [panel]) for each in (tracer, oracle)]
    np.testing.assert_array_equal(*bits)
    assert 4 < int(bits[0][0, 0]).bit_count() < 60


_EXTENDED: dict[str, Any] = {
    "sphere": SphereLight("s", (0.1, -0.2, 0.3), 0.2, samples=64),
    "rectangle": RectangleLight("s", (0.1, -0.2, 0.3), (0.3, 0.1, 0.0), (-0.1, 0.3, 0.0)),
    "line": TubeLight("s", (-0.5, -0.2, 0.3), (0.6, 0.2, 0.2)),
    "sun": SunDisc("s", (0.25, -0.125, 0.75), 0.125),
}


@pytest.mark.parametrize("names", _WALKERS)
@pytest.mark.parametrize("shape", _EXTENDED)
def test_edges_and_planes_within_roundings_of_rays(any_device: str, names: str, shape: str) -> None:
    """Triangles with an edge, or their plane, through the ray from a sample to a point of the light, but for the
    rounding of their corners: no float64 sum tells on which side they are.."""
    rng, light = np.random.default_rng(8), _EXTENDED[shape]
    count = 600
    points = rng.uniform(-1.0, 1.0, (count, 3)) * (3.0, 3.0, 0.5) + (0.0, 0.0, 3.0)
    places = light.homogeneous_points[rng.integers(0, 64, count)]
    ends = places[:, :3] + (1.0 - places[:, 3:]) * points
    middles = points + rng.uniform(0.2, 0.8, (count, 1)) * (ends - points)
    along, aside = rng.normal(size=(2, count, 3)) * 0.03
    corners = np.stack([middles + along, middles - along, middles + aside], axis=1)
    flat = rng.random(count) < 0.5  # these have the ray in their plane, nearly
    corners[flat, 2] = (middles + 0.3 * (ends - points) + 0.1 * along)[flat]
    mesh = corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)
    tracer, oracle = _tracer(names, any_device), _tracer("light_grid/packed", any_device)
    for each in (tracer, oracle):
        each.scene.put("mesh", *mesh)
    for bias in (0.0, 0.3):
        bits = [each.light_bits(points, [light], bias) for each in (tracer, oracle)]
        assert np.array_equal(*bits), bias
        assert 0.02 < tracer.visibility(points, [light], bias).mean() < 0.98


def test_one_walk_for_all_points(any_device: str) -> None:
    """Nodes visited for 64 points: a little more than for one, not 64 times as many."""
    tracer = _tracer("mesh_bvh/refit", any_device)
    tracer.scene.put("mesh", *_MESHES["soup"])
    one = tracer.trace(_depth(), _CAMERA, [PointLight("p", (0.25, -1.0, 0.5))]).counters["nodes_visited"]
    all_points = tracer.trace(_depth(), _CAMERA, [_LIGHTS["beside"]]).counters["nodes_visited"]
    assert one < all_points < 6 * one


@pytest.mark.parametrize("names", _WALKERS)
@pytest.mark.parametrize("light", _LIGHTS)
def test_the_pilot_decides_about_time_alone(
    any_device: str, names: str, light: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A bundle, or rays one by one, as the pilot's count says: the same bits, beside hard lights and others, twice."""
    monkeypatch.setattr(area_lights, "PILOT", 8)
    tracer = _tracer(names, any_device)
    tracer.scene.put("mesh", *_MESHES["soup"])
    hard = PointLight("p", (0.5, 0.5, 1.0))
    disc = DiscLight("d", (0.5, -1.0, 1.5), (0.0, 1.0, 0.25), 0.5, samples=9, ignore=["mesh"])
    found, nodes = [], []
    for most in (1e9, 0.0, 1e9, 0.0):
        monkeypatch.setattr(area_lights, "ray_cost", lambda *_, most=most: most)
        frame = tracer.trace(_depth(), _CAMERA, [hard, _LIGHTS[light], disc], Bias(0.02))
        found.append([frame.visibility(name) for name in frame.names] + [frame.state(name) for name in frame.names])
        nodes.append(frame.counters["nodes_visited"])
    for other in found[1:]:
        for mine, others in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(mine, others)
    if _LIGHTS[light].samples > 2:
        assert nodes[2] != nodes[3], "these are two ways"


@pytest.mark.slow
@pytest.mark.parametrize("names", ["bvh/sah", "mesh_bvh/refit"])
def test_points_of_large_lights_are_traced_apart(any_device: str, names: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the pilot's counts; in the CPU's form by the light grid, whose memory is reserved once. The bits are those of
    hard lights."""
    monkeypatch.setattr(area_lights, "PILOT", 64)
    tracer, oracle = _tracer(names, any_device), _tracer("light_grid/packed", any_device)
    before = tracer.device_bytes
    for each in (tracer, oracle):
        each.scene.put("soup", *geometry.soup(np.random.default_rng(23), 2500, 0.3, 2.5))
    reserved, entries, small = [], [], replace(_LIGHTS["beside"], radius=0.01)
    for light in (_LIGHTS["beside"], _LIGHTS["wide"], small, _LIGHTS["within"]) * 2:
        frames = [each.trace(_depth(), _CAMERA, [light], Bias(0.02)) for each in (tracer, oracle)]
        np.testing.assert_array_equal(*[frame.visibility("s") for frame in frames])
        entries.append(frames[0].counters["entries"])
        reserved.append(tracer.device_bytes)
    assert len(set(reserved)) == 1 and reserved[0] >= before
    if probe.wide(any_device):
        assert reserved[0] > before
        assert entries[5] > 0 and entries[7] > 0 and entries[6] == 0
    else:
        assert not any(entries)


@pytest.mark.parametrize("names", ["bvh/sah", "mesh_bvh/refit"])
def test_points_where_another_light_has_its_middle(
    any_device: str, names: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever traces them apart makes its own of them, though the other pipeline has made records of the same light."""
    monkeypatch.setattr(area_lights, "PILOT", 8)
    monkeypatch.setattr(area_lights, "ray_cost", lambda *_: 0.0)
    disc = DiscLight("d", (0.5, -1.0, 1.5), (0.0, 1.0, 0.25), 0.5, samples=9)
    ball = SphereLight("s", disc.points[1], 0.25, samples=5)
    tracer, oracle = _tracer(names, any_device), _tracer("light_grid/packed", any_device)
    for each in (tracer, oracle):
        each.scene.put("soup", *_MESHES["soup"])
    for _ in range(2):
        frames = [each.trace(_depth(), _CAMERA, [disc, ball], Bias(0.02)) for each in (tracer, oracle)]
        for name in ("d", "s"):
            np.testing.assert_array_equal(*[frame.light_bits(name) for frame in frames])


def test_the_pilot_is_spread_over_the_image(any_device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its samples are those of no column, and one in about so many."""
    tracer = _tracer("mesh_bvh/refit", any_device)
    tracer.scene.put("mesh", *_MESHES["soup"])
    tried: list[dict[str, int]] = []
    try_out = band.Band.try_out
    monkeypatch.setattr(band.Band, "try_out", lambda *given: tried.append(try_out(*given)) or tried[-1])
    monkeypatch.setattr(area_lights, "PILOT", 30)
    tracer.trace(np.full((30, 40), 3.0, np.float32), _CAMERA, [_LIGHTS["disc"]], 0.0)
    assert sum(counts["rays"] for counts in tried) in range(20 * 64, 41 * 64)


@pytest.mark.parametrize("names", ["mesh_bvh/refit"])
def test_the_pilot_asks_both_halves_of_an_image_of_powers_of_two(
    any_device: str, names: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where it asks one sample in as many as a row has; triangles stand before samples of the right half alone."""
    tracer = _tracer(names, any_device)
    tracer.scene.put("mesh", np.array([(0.25, -2.0, 2.0), (0.25, 2.0, 2.0), (2.0, 0.0, 2.0)]), [[0, 1, 2]])
    tried: list[dict[str, int]] = []
    try_out = band.Band.try_out
    monkeypatch.setattr(band.Band, "try_out", lambda *given: tried.append(try_out(*given)) or tried[-1])
    monkeypatch.setattr(area_lights, "PILOT", 64)
    lamp = SphereLight("s", (0.0, 0.0, 1.0), 0.01, samples=64)
    tracer.trace(np.full((64, 64), 3.0, np.float32), Camera(64, 64, 32.0, 32.0, 31.5, 31.5), [lamp], 0.0)
    asked = sum(counts["rays"] for counts in tried) / 64
    assert 5 < sum(counts["leaf_tests"] for counts in tried) < 0.75 * asked
