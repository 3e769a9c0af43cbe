# SPDX-License-Identifier: Apache-2.0
"""Where the samples of a frame are, roughly: the :class:`Anchor` that float32 numbers are relative to."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from shadow_tracer.gpu.exact.light_frame import Anchor, make_anchor
from shadow_tracer.scene.bias import Bias
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.checks import LARGEST, FloatArray


def depth_anchor(depth: np.ndarray, camera: Camera, bias: Bias, previous: Anchor | None) -> Anchor:
    """Anchor from a sparse look at the depth image: it needs to be near the samples, not around all of them."""
    step = max(1, min(depth.shape) // 32)
    rows, columns = (np.arange(step // 2, size, step) for size in depth.shape)
    z = depth[step // 2 :: step, step // 2 :: step].astype(np.float64)
    if depth.dtype == np.uint16:
        z /= 1000.0
    seen = (z > 0.0) & (z < np.inf)
    count = int(np.count_nonzero(seen))
    if count == 0:
        return previous or make_anchor(camera.position, 1.0, None)
    # A few samples at the end of the world must not make all others small: float32 could not tell them apart. A
    # background is no outlier: it has many.
    last = -(-49 * (count - 1) // 50)  # 98 in a hundred are no farther
    seen &= z <= 30.0 * float(np.partition(z[seen], last)[last])
    z[~seen] = 0.0  # nothing times infinity
    local = _scaled(*camera.ways(rows[:, None], columns[None, :]), z, seen)
    if not local.size:
        return previous or make_anchor(camera.position, 1.0, None)
    low, high = local.min(axis=1), local.max(axis=1)
    center = 0.5 * low + 0.5 * high
    world = camera.camera_to_world[:3, :3] @ center + camera.camera_to_world[:3, 3]
    # A scale of some biases keeps the biased starts from cancelling against it (project_samples).
    start = (1.0 + bias.normal) * (bias.constant + bias.quadratic * float(high[2]) ** 2)
    return make_anchor(world, max(float(np.linalg.norm(high - center)), 4.0 * start), previous)


def _scaled(x: FloatArray, y: FloatArray, z: FloatArray, seen: npt.NDArray[np.bool_]) -> FloatArray:
    """(3, N) the samples that are ``seen``, in the camera's frame, from rays at z = 1 that broadcast; what lies farther
    than any sample may, or has no ray, is none."""
    local = np.empty((3, *z.shape))
    np.multiply(x, z, out=local[0])
    np.multiply(y, z, out=local[1])
    local[2] = z
    local = local.reshape(3, -1) if seen.all() else local[:, seen]
    if local.size and np.abs(local).max() <= LARGEST:  # no for NaN
        return local
    return local[:, (np.abs(local) <= LARGEST).all(axis=0)]


def points_anchor(
    points: FloatArray, valid: npt.NDArray[np.bool_] | None, bias: float, previous: Anchor | None
) -> Anchor:
    """Anchor of (N, 3) points, those that are not ``valid`` left out if others are."""
    seen = points if valid is None or not valid.any() else points[valid]
    # A column at a time: numpy reduces a long strided column several times faster than an axis of length three.
    low, high = (np.array([reduce(column) for column in seen.T]) for reduce in (np.min, np.max))
    center = 0.5 * low + 0.5 * high
    return make_anchor(center, max(float(np.linalg.norm(high - center)), 4.0 * bias), previous)
