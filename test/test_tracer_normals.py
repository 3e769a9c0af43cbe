# SPDX-License-Identifier: Apache-2.0
"""A bias along the normal: every pipeline against the oracle of moved samples, any number of threads, what is kept from
frame to frame, and what it is for."""

from __future__ import annotations

from functools import cache
from typing import Any

import geometry
import numpy as np
import oracle
import pytest

from shadow_tracer import Bias, Bounds, Camera, DirectionalLight, PointLight, ShadowTracer, State
from shadow_tracer.gpu.engine import bands
from shadow_tracer.gpu.engine import frame as frame_tracer
from shadow_tracer.scene.depth_mesh import depth_mesh
from shadow_tracer.scene.normals import displaced_samples

_CAMERA = Camera(40, 30, 175.0, 183.0, 19.2, 15.5, geometry.look_at((-2.0, 0.3, 1.0), (0.0, 0.0, 0.5), (0, 0, 1)))
_LIGHTS: list[Any] = [PointLight("lamp", (-0.5, 1.2, 1.4)), DirectionalLight("sun", (0.2, -0.4, -0.9))]
_BIAS = Bias(0.01, 0.002, normal=0.7)


@cache
def _depth(millimetres: bool = False) -> np.ndarray:
    """A surface that waves, with a step, noise and holes."""
    rng = np.random.default_rng(51)
    row, column = np.mgrid[:30, :40]
    depth = 2.0 + 0.1 * np.sin(row / 5.0) + 0.1 * np.cos(column / 6.0) - 0.3 * (column > 25)
    depth = (depth + rng.normal(0.0, 0.003, depth.shape)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.05] = np.nan
    return (1000.0 * np.nan_to_num(depth)).astype(np.uint16) if millimetres else depth


@cache
def _surface() -> tuple[np.ndarray, np.ndarray]:
    """What the camera sees, in the world: samples lie on its corners and beside them, and it shadows itself."""
    vertices, triangles = depth_mesh(_depth(), _CAMERA, 2, 0.05)
    pose = _CAMERA.camera_to_world
    return vertices @ pose[:3, :3].T + pose[:3, 3], triangles


@cache
def _expected(millimetres: bool, bias: Bias) -> tuple[np.ndarray, ...]:
    depth = _depth(millimetres)
    points = displaced_samples(depth, _CAMERA, bias).reshape(-1, 3)
    valid = (np.nan_to_num(depth) > 0).reshape(-1)
    z = np.where(valid, depth.reshape(-1).astype(np.float64) / (1000.0 if millimetres else 1.0), 0.0)
    states = []
    for light in _LIGHTS:
        lengths = (bias.constant + bias.quadratic * (z * z))[valid]
        answer = oracle.occluded(points[valid], light, *_surface(), lengths, cull=True)
        assert not answer.tie.any()
        state = np.full(len(points), State.INVALID, np.uint8)
        state[valid] = np.where(answer.hidden, State.SHADOWED, State.LIT)
        states.append(state.reshape(depth.shape))
    return tuple(states)


@pytest.mark.parametrize("millimetres", [False, True])
def test_every_pixel_is_that_of_its_moved_sample(tracer: Any, millimetres: bool) -> None:
    tracer.scene.put("surface", *_surface())
    frame = tracer.trace(_depth(millimetres), _CAMERA, _LIGHTS, _BIAS)
    for light, expected in zip(_LIGHTS, _expected(millimetres, _BIAS), strict=True):
        np.testing.assert_array_equal(frame.state(light.name), expected, err_msg=light.name)
    assert tracer.verify(_depth(millimetres), _CAMERA, _LIGHTS, _BIAS) == 0


def test_the_oracle_above_moves_samples_into_light() -> None:
    without, moved = (_expected(False, Bias(0.01, 0.002, normal)) for normal in (0.0, 0.7))
    assert sum((a != b).sum() for a, b in zip(without, moved, strict=True)) > 50


def test_another_bias_is_another_frame(tracer: Any) -> None:
    """Depth, camera, lights and mesh stay: nothing that is kept answers for samples that are elsewhere."""
    tracer.scene.put("surface", *_surface())
    for normal in (0.0, 0.7, 0.7, 0.3, 0.0):
        bias = Bias(0.01, 0.002, normal)
        frame = tracer.trace(_depth(), _CAMERA, _LIGHTS, bias)
        for light, expected in zip(_LIGHTS, _expected(False, bias), strict=True):
            np.testing.assert_array_equal(frame.state(light.name), expected, err_msg=f"{light.name}, {normal}")
    assert tracer.verify(_depth(), _CAMERA, _LIGHTS, _BIAS) == 0, "the frame before was another one"


def test_recorded_frames(any_device: str) -> None:
    """Each bias twice more, so that its frame is recorded and replayed."""
    tracer = ShadowTracer(device=any_device, bounds=Bounds(5000, 40 * 30, 2, grid_entries=65536), graphs=True)
    tracer.scene.put("surface", *_surface())
    for normal in (0.0, 0.7, 0.0, 0.7):
        bias = Bias(0.01, 0.002, normal)
        for _ in range(3):
            frame = tracer.trace(_depth(), _CAMERA, _LIGHTS, bias)
            for light, expected in zip(_LIGHTS, _expected(False, bias), strict=True):
                np.testing.assert_array_equal(frame.state(light.name), expected, err_msg=f"{light.name}, {normal}")


@pytest.mark.wide
@pytest.mark.parametrize(
    "names", ["light_grid/packed", "cone_hierarchy/linear", "brute_force/filtered", "uniform_grid/dda"]
)
@pytest.mark.parametrize("threads", [2, 3, 4, 8])
def test_wherever_the_image_is_cut(names: str, threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Bands need rows of each other. A bound without room for more makes cuts in the middle of rows."""
    for module in (bands, frame_tracer):
        monkeypatch.setattr(module, "LEAST", 64)
    bounds = Bounds(5000, 40 * 30, 2, queue_capacity=4096, grid_entries=65536)
    tracer = ShadowTracer(*names.split("/"), device="cpu", bounds=bounds, threads=threads)
    tracer.scene.put("surface", *_surface())
    for _ in range(3):
        frame = tracer.trace(_depth(), _CAMERA, _LIGHTS, _BIAS)
        for light, expected in zip(_LIGHTS, _expected(False, _BIAS), strict=True):
            np.testing.assert_array_equal(frame.state(light.name), expected, err_msg=light.name)


def _wall() -> tuple[np.ndarray, Camera, PointLight]:
    """A flat wall at 2 m with the noise of a structured light camera, and a lamp whose light meets its middle at ten
    degrees."""
    rng = np.random.default_rng(52)
    camera = Camera(320, 240, 262.5, 262.5, 159.5, 119.5)
    disparity = 580 * 0.075 / (2.0 + rng.normal(0.0, 0.0043, (240, 320)))
    depth = (580 * 0.075 / (np.round(8 * disparity) / 8)).astype(np.float32)
    angle = np.radians(10.0)
    return depth, camera, PointLight("lamp", (0.0, -2.0 * np.cos(angle), 2.0 - 2.0 * np.sin(angle)))


def test_grazing_light_on_a_flat_wall(any_device: str) -> None:
    """What the bias along the normal is for, with the defaults of the node: from a third to less than a hundredth."""
    depth, camera, lamp = _wall()
    tracer = ShadowTracer(device=any_device, bounds=Bounds(160_000, 320 * 240, 1))
    tracer.scene.put("wall", *depth_mesh(depth, camera, 1, 0.05))
    shadow = [
        (tracer.trace(depth, camera, [lamp], Bias(0.02, 0.003, normal)).state("lamp") == State.SHADOWED)[8:-8, 8:-8]
        for normal in (0.0, 0.6)
    ]
    assert shadow[0].mean() > 0.25
    assert shadow[1].mean() < 0.002
