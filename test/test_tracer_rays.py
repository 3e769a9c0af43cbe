# SPDX-License-Identifier: Apache-2.0
"""Cameras with a table of rays: a pixel is the sample that ``Camera.unproject`` says, whatever was traced before."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import geometry
import numpy as np
import oracle
import probe
import pytest

from shadow_tracer import Bounds, Camera, DirectionalLight, PointLight, ShadowTracer, State
from shadow_tracer.gpu.engine import bands
from shadow_tracer.gpu.engine import frame as frame_tracer

_WIDTH, _HEIGHT = 48, 36
_AZURE = (5.7, 3.6, 1e-4, -5e-5, 0.19, 6.0, 5.4, 1.0)
_LIGHTS: list[Any] = [PointLight("lamp", (0.4, -0.3, 0.2)), DirectionalLight("sun", (0.2, 0.1, 1.0))]
_BOUNDS = Bounds(max_triangles=500, max_rays=2 * _WIDTH * _HEIGHT, max_lights=2, queue_capacity=4000)


def _camera(kind: str, width: int = _WIDTH) -> Camera:
    f = 0.8 * width
    pose = geometry.pose_of(geometry.rotation(np.random.default_rng(3)), np.array([0.1, -0.2, 0.0]))
    optics = width, _HEIGHT, f, f, width / 2 - 0.7, _HEIGHT / 2 + 0.3
    if kind == "pinhole":
        return Camera(*optics, pose)
    if kind == "fisheye":  # its corners look to the side and behind
        return Camera.distorted(width, _HEIGHT, 0.4 * f, 0.4 * f, *optics[4:], "equidistant", [0.0] * 4, pose)
    if kind == "ragged":
        rays = Camera(*optics).pixel_rays()[..., :2]
        rays[np.random.default_rng(4).random(rays.shape[:2]) < 0.2] = np.nan
        return Camera(*optics, pose, rays)
    return Camera.distorted(*optics, "rational_polynomial", _AZURE, pose)


_KINDS = ("pinhole", "rational", "fisheye", "ragged")


def _depth(seed: int, dtype: Any = np.float32, width: int = _WIDTH) -> np.ndarray:
    rng = np.random.default_rng(seed)
    depth = rng.uniform(1.0, 4.0, (_HEIGHT, width))
    if dtype == np.uint16:
        return (1000.0 * depth * (rng.random(depth.shape) < 0.9)).astype(np.uint16)
    depth[rng.random(depth.shape) < 0.1] = np.nan
    return depth.astype(np.float32)


def _points(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """Samples, NaN where there is none."""
    metres = depth.astype(np.float64) / (1000.0 if depth.dtype == np.uint16 else 1.0)
    return camera.unproject(np.where(metres > 0.0, metres, np.nan))


def _soup(camera: Camera) -> geometry.Geometry:
    vertices, triangles = geometry.soup(np.random.default_rng(5), 60, 0.3, 1.0)
    vertices = vertices + (0.0, 0.0, 1.2)
    return vertices @ camera.camera_to_world[:3, :3].T + camera.position, triangles


@pytest.mark.parametrize("dtype", [np.float32, np.uint16])
@pytest.mark.parametrize("kind", _KINDS)
def test_states_are_those_of_the_unprojected_points(tracer: ShadowTracer, kind: str, dtype: Any) -> None:
    camera, depth = _camera(kind), _depth(1, dtype)
    mesh = _soup(camera)
    tracer.scene.put("soup", *mesh)
    frame = tracer.trace(depth, camera, _LIGHTS, 0.0)
    points = _points(depth, camera)
    there = np.isfinite(points).all(axis=2)
    for light in _LIGHTS:
        hidden = oracle.occluded(np.where(there[..., None], points, 1.0), light, *mesh).hidden.reshape(there.shape)
        expected = np.where(there, np.where(hidden, State.SHADOWED, State.LIT), State.INVALID)
        np.testing.assert_array_equal(frame.state(light.name), expected)
        assert (expected == State.SHADOWED).sum() > 50 < (expected == State.LIT).sum()
    if kind in ("fisheye", "ragged"):
        assert (~there & (depth > 0)).sum() > 50, "no measured pixel without a ray"


@pytest.mark.parametrize("graphs", [None, True], ids=["launched", "recorded"])
@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("names", [("light_grid", "packed"), ("mesh_bvh", None), ("brute_force", None)])
def test_cameras_that_differ_in_their_rays_alone_take_turns(
    names: tuple[str, str | None], threads: int, graphs: bool | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Depth image, lights, pose and size stay, so that whatever is kept could be taken again; each kind comes often
    enough for a recording to be replayed, and a second pipeline must agree."""
    for module in (bands, frame_tracer):
        monkeypatch.setattr(module, "LEAST", 64)
    tracer = ShadowTracer(*names, device="cpu", bounds=_BOUNDS, threads=threads, graphs=graphs)
    tracer.scene.put("soup", *_soup(_camera("pinhole")))
    rng, depth = np.random.default_rng(6), _depth(2)
    cameras = {kind: _camera(kind) for kind in _KINDS}
    cameras = {kind: replace(cameras["pinhole"], rays=camera.rays) for kind, camera in cameras.items()}
    cameras["narrow"] = _camera("rational", _WIDTH // 2)
    wanted: dict[str, np.ndarray] = {}
    for kind in [*cameras, *rng.choice(list(cameras), 16), "ragged", "ragged", "pinhole", "pinhole"]:
        image = depth[:, : _WIDTH // 2] if kind == "narrow" else depth
        frame = tracer.trace(image, cameras[kind], _LIGHTS, 0.0)
        states = np.stack([frame.state(light.name) for light in _LIGHTS])
        if kind not in wanted:
            points = _points(image, cameras[kind])
            found = tracer.states_at(points, _LIGHTS).reshape(states.shape)
            wanted[kind] = np.where(np.isfinite(points).all(axis=2), found, State.INVALID)
            frame = tracer.trace(image, cameras[kind], _LIGHTS, 0.0)
            states = np.stack([frame.state(light.name) for light in _LIGHTS])
        np.testing.assert_array_equal(states, wanted[kind], err_msg=kind)
        if rng.random() < 0.3:
            assert tracer.verify(image, cameras[kind], _LIGHTS, 0.0) == 0
    assert all((wanted[kind] != wanted["pinhole"]).any() for kind in ("rational", "fisheye", "ragged"))
    if graphs and names[0] == "light_grid":
        assert probe.recordings(tracer) > 0


@pytest.mark.parametrize(
    ("size", "f", "centre", "model", "d", "wrong"),
    [
        ((640, 576), 504.0, (320.0, 336.0), "rational_polynomial", _AZURE, 0.1),  # time of flight
        ((640, 360), 326.9, (326.2, 180.9), "plumb_bob", (-0.05176, 0.05644, -0.00081, 0.00137, -0.01871), 0.01),
    ],
    ids=["raw depth", "depth aligned to raw colour"],
)
def test_the_shadow_on_a_wall_is_where_geometry_says(
    size: tuple[int, int], f: float, centre: tuple[float, float], model: str, d: Any, wrong: float
) -> None:
    """A square between a lamp and a wall, seen by two real cameras. Rays by another inverse than the package's."""
    k1, k2, p1, p2, k3, *under = d
    k4, k5, k6 = under or (0.0, 0.0, 0.0)
    u, v = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    xd, yd = (u - centre[0]) / f, (v - centre[1]) / f
    x, y = xd, yd
    for _ in range(60):
        s = x * x + y * y
        scale = (1 + k1 * s + k2 * s**2 + k3 * s**3) / (1 + k4 * s + k5 * s**2 + k6 * s**3)
        across, down = 2 * p1 * x * y + p2 * (s + 2 * x * x), p1 * (s + 2 * y * y) + 2 * p2 * x * y
        x, y = (xd - across) / scale, (yd - down) / scale
    lamp, half, wall = np.array([0.5, -0.5, 0.0]), 0.25, 2.0
    # Where the way from the lamp to the wall crosses the plane of the square, half way.
    px, py = 0.5 * (lamp[0] + x * wall), 0.5 * (lamp[1] + y * wall)
    inside = (np.abs(px) < half) & (np.abs(py) < half)
    clear = (np.abs(np.abs(px) - half) > 1e-6) & (np.abs(np.abs(py) - half) > 1e-6)
    tracer = ShadowTracer(device="cpu", bounds=Bounds(max_triangles=2, max_rays=size[0] * size[1], max_lights=1))
    square = np.array([(-half, -half, 1.0), (half, -half, 1.0), (half, half, 1.0), (-half, half, 1.0)])
    tracer.scene.put("square", square, np.array([(0, 1, 2), (0, 2, 3)]))
    depth = np.full(size[::-1], wall, np.float32)
    seen = [
        tracer.trace(depth, camera, [PointLight("lamp", lamp)], 0.0).state("lamp") == State.SHADOWED
        for camera in (Camera.distorted(*size, f, f, *centre, model, d), Camera(*size, f, f, *centre))
    ]
    np.testing.assert_array_equal(seen[0][clear], inside[clear])
    assert (seen[1] != inside).sum() > wrong * inside.sum(), "as a pinhole's it would be right, too"


def test_a_table_is_uploaded_once_and_lies_in_the_declared_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    tracer = ShadowTracer("light_grid", device="cpu", bounds=_BOUNDS, threads=1)
    before, camera = tracer.device_bytes, _camera("rational")
    more = ShadowTracer("light_grid", device="cpu", bounds=replace(_BOUNDS, max_rays=_BOUNDS.max_rays + 1), threads=1)
    assert more.device_bytes - before >= 8
    uploads = probe.uploads(tracer, monkeypatch)
    for step in range(3):
        pose = geometry.pose_of(np.eye(3), np.array([0.1 * step, 0.0, 0.0]))
        tracer.trace(_depth(step), replace(camera, camera_to_world=pose), _LIGHTS)
    assert uploads.count(camera.rays.xy.nbytes) == 1
    tracer.trace(_depth(0), _camera("fisheye"), _LIGHTS)
    tracer.trace(_depth(0), camera, _LIGHTS)
    assert uploads.count(camera.rays.xy.nbytes) == 3
    assert tracer.device_bytes == before


def test_far_rays_move_no_anchor_beyond_the_numbers(tracer: ShadowTracer) -> None:
    """Rays along the plane z = 0 have samples farther than coordinates may be, which are none."""
    camera, depth = _camera("ragged"), _depth(1)
    rays = np.array(camera.rays.xy)
    rays[::2, ::3] = 3e38
    camera, depth[::2, ::3] = replace(camera, rays=rays), 3e38
    mesh = _soup(camera)
    tracer.scene.put("soup", *mesh)
    state = tracer.trace(depth, camera, _LIGHTS, 0.0).state("lamp")
    points = _points(depth, camera)
    there = (np.abs(points) <= 1e50).all(axis=2)
    assert not there[::2, ::3].any() and (state[~there] == State.INVALID).all()
    hidden = oracle.occluded(np.where(there[..., None], points, 1.0), _LIGHTS[0], *mesh).hidden.reshape(there.shape)
    np.testing.assert_array_equal(state[there] == State.SHADOWED, hidden[there])
    everywhere = replace(camera, rays=np.full_like(rays, 3e38))
    assert (tracer.trace(np.full_like(depth, 3e38), everywhere, _LIGHTS).state("lamp") == State.INVALID).all()
