# SPDX-License-Identifier: Apache-2.0
"""Samples, rays and tiles of the frame before are taken again when nothing about them has changed, and only then."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import geometry
import numpy as np
import probe
import probe_accelerators
import pytest

from shadow_tracer import Bounds, Camera, DirectionalLight, PointLight, ShadowTracer
from shadow_tracer.gpu.accelerators.interface import Accelerator, Rays
from shadow_tracer.gpu.accelerators.light_grid.blocks import BlockGrid
from shadow_tracer.gpu.engine import band, bands
from shadow_tracer.gpu.engine import frame as frame_tracer

_WIDTH, _HEIGHT = 48, 36
_COUNT = _WIDTH * _HEIGHT
_CAMERA = Camera(_WIDTH, _HEIGHT, 40.0, 40.0, 23.5, 17.5)
_LIGHTS = [PointLight("a", (0.3, -0.4, -0.5)), DirectionalLight("b", (0.2, 0.1, 1.0)), PointLight("c", (1.5, 1.0, 0.4))]


def _depth(rng: np.random.Generator) -> np.ndarray:
    depth = rng.uniform(1.5, 2.5, (_HEIGHT, _WIDTH)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = np.nan
    return depth


def _mesh(rng: np.random.Generator, depth: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """With a depth image, 40 of the 150 triangles have a corner on the way of one of its samples to the first light:
    float32 cannot say whether they hide it."""
    vertices, triangles = geometry.soup(rng, 150, 0.2, 1.0)
    vertices = vertices + (0.0, 0.0, 1.2)
    if depth is not None:
        points = _CAMERA.unproject(depth.astype(np.float64)).reshape(-1, 3)
        some = points[rng.choice(np.flatnonzero(np.isfinite(points[:, 2])), 40, replace=False)]
        vertices[triangles[:40, 0]] = some + rng.uniform(0.1, 0.9, (40, 1)) * (_LIGHTS[0].position - some)
    return vertices, triangles


def _bounds(**more: Any) -> Bounds:
    return replace(Bounds(max_triangles=600, max_rays=3 * _COUNT, max_lights=3, queue_capacity=4096), **more)


@pytest.fixture
def projected(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Grows by a light's number for each light and band that is projected."""
    calls: list[int] = []

    def watch(kind: type) -> None:
        project = kind.project  # type: ignore[attr-defined]

        def counted(who: Any, rays: Rays, again: bool = False) -> None:
            calls.extend(light.number for light in rays.lights)
            project(who, rays, again)

        monkeypatch.setattr(kind, "project", counted)

    watch(Accelerator)
    watch(BlockGrid)
    return calls


class _Pair:
    """A tracer, and brute force that begins anew for each question."""

    def __init__(self, pipeline: str, bounds: Bounds, threads: int) -> None:
        self.tracer = ShadowTracer(pipeline, device="cpu", bounds=bounds, threads=threads)
        self.oracle = ShadowTracer("brute_force", device="cpu", bounds=_bounds(), threads=1)

    def put(self, vertices: np.ndarray, triangles: np.ndarray) -> None:
        for each in (self.tracer, self.oracle):
            each.scene.put("mesh", vertices, triangles)

    def check(self, depth: np.ndarray, camera: Camera, lights: list[Any], bias: float) -> None:
        found = self.tracer.trace(depth, camera, lights, bias=bias)
        probe.forget(self.oracle, "")
        expected = self.oracle.trace(depth, camera, lights, bias=bias)
        for light in lights:
            assert np.array_equal(found.state(light.name), expected.state(light.name)), light.name
        assert found.counters["rays"] == expected.counters["rays"]

    def check_points(self, points: np.ndarray, light: Any, bias: float) -> None:
        found = self.tracer.occluded(points, light, bias=bias)
        probe.forget(self.oracle, "")
        assert np.array_equal(found, self.oracle.occluded(points, light, bias=bias))


@pytest.mark.wide
def test_a_mesh_moves_in_front_of_what_rests(projected: list[int]) -> None:
    rng = np.random.default_rng(491)
    pair, depth = _Pair("light_grid", _bounds(), 1), _depth(rng)
    mine = []
    for _ in range(4):
        pair.put(*_mesh(rng))
        before = len(projected)
        pair.tracer.trace(depth.copy(), _CAMERA, _LIGHTS, bias=0.01)
        mine.append(len(projected) - before)
        pair.check(depth, _CAMERA, _LIGHTS, 0.01)
    assert mine == [3, 0, 0, 0]


@pytest.mark.wide
def test_lights_of_many_rays_go_one_after_the_other_until_they_rest(projected: list[int]) -> None:
    """And what was kept before is not taken for what they have left in its place."""
    rng = np.random.default_rng(494)
    pair, depth = _Pair("light_grid", _bounds(), 1), _depth(rng)
    probe_accelerators.limit_rays_at_once(probe.pipeline(pair.tracer), 2 * _COUNT - 1)
    pair.put(*_mesh(rng))
    mine = []
    for lights in (*4 * (_LIGHTS,), _LIGHTS[:1], _LIGHTS[:2], *2 * (_LIGHTS[:1],), _LIGHTS):
        before = len(projected)
        found = pair.tracer.trace(depth.copy(), _CAMERA, lights, bias=0.01)
        mine.append((found.counters["passes"], len(projected) - before))
        assert found.differing(pair.oracle.trace(depth, _CAMERA, lights, bias=0.01)) == 0
    assert mine == [(3, 3), (1, 3), *2 * [(1, 0)], (1, 1), (2, 1), (1, 1), (1, 0), (3, 2)]


@pytest.mark.wide
def test_points_are_asked_about_again(projected: list[int]) -> None:
    rng = np.random.default_rng(492)
    pair, points = _Pair("light_grid", _bounds(), 1), rng.uniform(-1.0, 1.0, (500, 3)) + (0.0, 0.0, 2.5)
    mine = []
    for step in range(6):
        pair.put(*_mesh(rng))
        light = _LIGHTS[0] if step < 4 else _LIGHTS[2]
        bias = 0.01 if step != 2 else 0.02
        before = len(projected)
        pair.tracer.occluded(points.copy(), light, bias=bias)
        mine.append(len(projected) - before)
        pair.check_points(points, light, bias)
    assert mine == [1, 0, 1, 1, 1, 0]


@pytest.mark.wide
def test_a_second_opinion_makes_its_own_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(494)
    pair, depth, calls = _Pair("light_grid", _bounds(), 1), _depth(rng), []
    unproject = band.pixels.unproject_image
    monkeypatch.setattr(band.pixels, "unproject_image", lambda *inputs: (calls.append(1), unproject(*inputs)))
    pair.put(*_mesh(rng))
    for _ in range(2):
        pair.tracer.trace(depth, _CAMERA, _LIGHTS, bias=0.01)
    assert len(calls) == 1
    assert pair.tracer.verify(depth, _CAMERA, _LIGHTS, bias=0.01) == 0 and len(calls) == 2


def _changed(rng: np.random.Generator, what: str, now: dict[str, Any], pair: _Pair) -> None:
    """Change one thing, or ask for something else in between."""
    if what == "depth":
        now["depth"] = _depth(rng)
    elif what == "one bit":
        depth = now["depth"].copy()
        depth[7, 9] = np.nextafter(depth[7, 9], np.float32(9.0)) if np.isfinite(depth[7, 9]) else np.float32(2.0)
        now["depth"] = depth
    elif what == "camera":
        now["camera"] = replace(_CAMERA, camera_to_world=geometry.pose_of(np.eye(3), rng.uniform(-0.1, 0.1, 3)))
    elif what == "bias":
        now["bias"] = float(rng.uniform(0.001, 0.05))
    elif what == "light":
        now["lights"] = [replace(_LIGHTS[0], position=tuple(rng.uniform(-1.0, 0.5, 3))), *_LIGHTS[1:]]
    elif what == "fewer lights":
        now["lights"] = list(rng.permutation(np.array(_LIGHTS, object))[: rng.integers(1, 3)])
    elif what == "points":
        pair.check_points(rng.uniform(-1.0, 1.0, (rng.integers(1, 900), 3)) + (0.0, 0.0, 2.0), _LIGHTS[0], 0.01)
    elif what == "empty":
        for each in (pair.tracer, pair.oracle):
            each.scene.remove("mesh")
        pair.check(now["depth"], now["camera"], now["lights"], now["bias"])
        pair.put(*_mesh(rng))
    elif what == "verify":
        frame = pair.tracer.trace(now["depth"], now["camera"], now["lights"], bias=now["bias"])
        assert pair.tracer.verify(now["depth"], now["camera"], now["lights"], bias=now["bias"]) == 0, frame.names
    elif what == "other image":
        pair.check(now["depth"][:20, :].copy(), replace(now["camera"], height=20), now["lights"], now["bias"])
    elif what == "culling":
        for each in (pair.tracer, pair.oracle):
            each.front_face_culling = not each.front_face_culling


_WHAT = ("nothing", "nothing", "depth", "one bit", "camera", "bias", "light", "fewer lights", "points", "empty")
_WHAT += ("verify", "other image")


@pytest.mark.wide
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize(
    ("pipeline", "more"),
    [
        ("light_grid", {}),
        ("light_grid", {"queue_capacity": 2}),
        ("light_grid", {"max_rays": _COUNT}),
        ("light_grid", {"grid_entries": 64}),
        ("light_grid", {"max_triangles": 200}),
        ("auto", {}),
    ],
)
@pytest.mark.slow
def test_whatever_changes_between_frames(
    pipeline: str, more: dict[str, int], threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A long random walk: what is kept never answers for something else."""
    monkeypatch.setattr(bands, "LEAST", 64)
    monkeypatch.setattr(frame_tracer, "LEAST", 64)
    rng = np.random.default_rng([493, threads, len(more)])
    pair = _Pair(pipeline, _bounds(**more), threads)
    assert pair.tracer.threads == threads
    now: dict[str, Any] = {"depth": _depth(rng), "camera": _CAMERA, "lights": list(_LIGHTS), "bias": 0.01}
    pair.put(*_mesh(rng))
    for _ in range(60):
        _changed(rng, str(rng.choice(_WHAT)), now, pair)
        if rng.random() < 0.7:
            pair.put(*_mesh(rng, now["depth"] if now["depth"].shape == (_HEIGHT, _WIDTH) else None))
        pair.check(now["depth"], now["camera"], now["lights"], now["bias"])


@pytest.mark.wide
def test_rays_that_another_pipeline_has_overwritten_are_made_again(projected: list[int]) -> None:
    """Pipeline auto with one thread: mesh_bvh traces a frame in between, light after light in the same place. A ray so
    near to its light that it is tested by itself would be that of another light."""
    rng = np.random.default_rng(30)
    depth = _depth(rng)
    tracers = [ShadowTracer(name, device="cpu", bounds=_bounds(), threads=1) for name in ("auto", "brute_force")]
    chooser: Any = probe.chooser(tracers[0])
    points = _CAMERA.unproject(depth.astype(np.float64)).reshape(-1, 3)
    for sample in rng.choice(np.flatnonzero(np.isfinite(points[:, 2])), 10, replace=False):
        lights = [PointLight("near", points[sample] + 1e-7), PointLight("far", (0.3, -0.4, -0.5))]
        mesh = _mesh(rng)
        mesh[0][mesh[1][0]] = points[sample] + (0.0, 0.0, -0.4) + rng.uniform(-0.3, 0.3, (3, 3)) * (1.0, 1.0, 0.0)
        for tracer in tracers:
            tracer.scene.put("mesh", *mesh)
        expected = tracers[1].trace(depth, _CAMERA, lights, bias=0.0)
        for names, lights_projected in (("light_grid", 2), ("light_grid", 0), ("mesh_bvh", 2), ("light_grid", 2)):
            chooser.forced = next(one for one in chooser.candidates if one[0] == names)
            projected.clear()
            assert tracers[0].trace(depth, _CAMERA, lights, bias=0.0).differing(expected) == 0
            assert len(projected) == lights_projected, names
