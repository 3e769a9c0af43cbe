# SPDX-License-Identifier: Apache-2.0
"""Samples moved along normals: the bits of numpy in both forms of the kernel, wherever an image is cut."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import geometry
import numpy as np
import pytest

wp = pytest.importorskip("warp")

from shadow_tracer import Bias, Bounds, Camera  # noqa: E402
from shadow_tracer.gpu.device.devices import pick_device  # noqa: E402
from shadow_tracer.gpu.samples import normals, pixels  # noqa: E402
from shadow_tracer.gpu.samples.pinhole import make_pinhole  # noqa: E402
from shadow_tracer.gpu.samples.sample_set import SampleSet  # noqa: E402
from shadow_tracer.scene.normals import depth_normals, displaced_samples  # noqa: E402

_PIXELS = 8000
_GARBAGE = 77.0


@pytest.fixture(scope="module")
def frame(any_device: str) -> SampleSet:
    return SampleSet(Bounds(10, _PIXELS, 1, queue_capacity=1), pick_device(any_device))


def _metres(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """A surface with noise, steps, holes, and what a float32 image may hold besides."""
    row, column = np.mgrid[: shape[0], : shape[1]]
    depth = 2.0 + 0.4 * np.sin(row / 9.0) + 0.3 * np.cos(column / 7.0) + rng.normal(0.0, 0.005, shape)
    depth = np.where((row + 2 * column) % 60 < 25, depth, 0.8 * depth).astype(np.float32)
    bad = rng.random(shape) < 0.05
    special = [0.0, -0.0, -1.0, np.nan, np.inf, -np.inf, 1e-45, 1e-38, 1e-30, 1e30, 3.4e38]
    depth[bad] = rng.choice(np.array(special, np.float32), int(bad.sum()))
    return depth


def _millimetres(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    depth = np.nan_to_num(_metres(rng, shape), nan=0.0, posinf=0.0, neginf=0.0)
    return np.clip(1000.0 * depth.astype(np.float64), 0, 65535).astype(np.uint16)


def _table(rng: np.random.Generator, camera: Camera, wild: bool) -> np.ndarray:
    """Rays with a barrel distortion and some missing ones, or any rays at all."""
    rays = camera.pixel_rays()[..., :2]
    rays *= 1.0 + 0.2 * (rays**2).sum(axis=2, keepdims=True)
    if wild:
        rays = rng.uniform(-2.0, 2.0, rays.shape) * 10.0 ** rng.integers(-20, 20)
    rays[rng.random(rays.shape[:2]) < 0.05] = np.nan
    return rays


def _samples(
    frame: SampleSet, depth: np.ndarray, camera: Camera, bias: Bias, parts: list[int], scalar: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Samples and validity of an image that is cut at ``parts``, by the kernel of this form or the one of CUDA."""
    array = frame.depth_metres if depth.dtype == np.float32 else frame.depth_millimetres
    array.fill_(1)  # what lies beyond the image must not matter
    frame.upload(array, depth.reshape(-1))
    frame.ray_table.fill_(wp.vec2(1.0, 1.0))
    if camera.rays is not None:
        frame.upload(frame.ray_table, camera.rays.xy.reshape(-1, 2))
    found = []
    for first, end in zip([0, *parts], [*parts, depth.size], strict=True):
        frame.set_samples(end - first, camera.width, first)
        frame.set_camera(make_pinhole(camera, bias, first))
        frame.positions.fill_(wp.vec4d(_GARBAGE, _GARBAGE, _GARBAGE, _GARBAGE))
        pixels.unproject_image(frame.mine(array), frame)
        if scalar:
            inputs = [frame.pinhole, frame.ray_table, array, frame.positions]
            wp.launch(normals.displace_samples, dim=end - first, inputs=inputs, device=frame.device)
        else:
            normals.displace(array, frame)
        samples, valid = frame.positions.numpy(), frame.valid.numpy()
        assert (samples[end - first :] == _GARBAGE).all(), "written beyond the samples"
        found.append((samples[: end - first].copy(), valid[: end - first].copy()))
    return np.concatenate([one for one, _ in found]), np.concatenate([one for _, one in found])


@pytest.mark.parametrize("scalar", [False, True])
@pytest.mark.parametrize("make", [_metres, _millimetres])
@pytest.mark.parametrize("shape", [(1, 1), (1, 1500), (1500, 1), (3, 7), (48, 64), (25, 257), (5, 1500)])
@pytest.mark.parametrize("focal", [525.0, 250.0, 60.0, 1e-13, 1e-280, 1e12, 1e300, "table", "wild table"])
def test_bits_of_numpy(frame: SampleSet, shape: tuple[int, int], focal: float | str, make: Any, scalar: bool) -> None:
    rays, focal = (focal, 250.0) if isinstance(focal, str) else ("", focal)
    rng = np.random.default_rng(shape[0] + int(min(focal, 1e6)))
    place = rng.uniform(-9, 9, 3) * rng.choice([1.0, 1e49])  # in a corner of all coordinates
    pose = geometry.pose_of(geometry.rotation(rng), place)
    camera = Camera(shape[1], shape[0], focal, 0.9 * focal, shape[1] / 2.1, shape[0] / 1.9, pose)
    if rays:
        camera = replace(camera, rays=_table(rng, camera, rays == "wild table"))
    depth = make(rng, shape)
    bias = Bias(*(float(rng.choice(values)) for values in ([0.0, 0.02, 1e50], [0.0, 0.003], [0.5, 1e-9, 3.0, 1e50])))
    parts = sorted(int(k) for k in rng.integers(0, depth.size + 1, 3))
    samples, valid = _samples(frame, depth, camera, bias, parts, scalar)
    whole, _ = _samples(frame, depth, camera, bias, [], scalar)
    seen = valid == 1
    expected = displaced_samples(depth, camera, bias).reshape(-1, 3)
    for found in (samples, whole):
        bits = np.ascontiguousarray(found[seen, :3]).view(np.uint64)
        np.testing.assert_array_equal(bits, expected[seen].view(np.uint64))


def test_the_images_above_have_normals_and_have_none() -> None:
    rng = np.random.default_rng(5)
    for make in (_metres, _millimetres):
        depth = make(rng, (48, 64))
        has = np.isfinite(depth_normals(depth, Camera(64, 48, 525.0, 500.0, 31.0, 24.0))).all(axis=-1)
        assert 0.1 < has.mean() < 0.95 and not has[~(depth > 0)].any()
