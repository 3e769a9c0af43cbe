# SPDX-License-Identifier: Apache-2.0
"""Where the samples of a frame are, roughly: the :class:`Anchor` that float32 numbers are relative to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from shadow_tracer.gpu.exact.light_frame import Anchor, make_anchor
from shadow_tracer.scene.bias import Bias
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.checks import LARGEST, FloatArray

_Box = tuple[Sequence[float], Sequence[float]]
_FARTHEST = 30.0  # times what 98 of a hundred samples are away


def depth_anchor(depth: np.ndarray, camera: Camera, bias: Bias, previous: Anchor | None) -> Anchor:
    """Anchor from a sparse look at the depth image: it needs to be near the samples, not around all of them."""
    step = max(1, min(depth.shape) // 32)
    z = depth[step // 2 :: step, step // 2 :: step].astype(np.float64)
    if depth.dtype == np.uint16:
        z /= 1000.0
    ways = camera.ways(*_pixels(depth.shape, step))
    box = _box_of_all(*ways, z) or _box_of_seen(*ways, z)
    if box is None:
        return previous or make_anchor(camera.position, 1.0, None)
    low, high = box
    center = [0.5 * least + 0.5 * most for least, most in zip(low, high, strict=True)]
    world = camera.camera_to_world[:3, :3] @ center + camera.camera_to_world[:3, 3]
    # A scale of some biases keeps the biased starts from cancelling against it (project_samples).
    start = (1.0 + bias.normal) * (bias.constant + bias.quadratic * high[2] ** 2)
    return make_anchor(world, max(math.dist(high, center), 4.0 * start), previous)


@lru_cache(maxsize=16)
def _pixels(shape: tuple[int, int], step: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Rows and columns of every ``step``-th pixel, each way."""
    rows, columns = (np.arange(step // 2, size, step) for size in shape)
    return rows[:, None], columns[None, :]


def _box_of_all(x: FloatArray, y: FloatArray, z: FloatArray) -> _Box | None:
    """``_box_of_seen`` where all are seen, and none can be an outlier; None elsewhere."""
    near, far = _least(z), _most(z)
    if not (0.0 < near and far <= min(_FARTHEST * near, LARGEST)):  # NaN comes out of min and max
        return None
    across, down = x * z, y * z
    low, high = (_least(across), _least(down), near), (_most(across), _most(down), far)
    return (low, high) if -LARGEST <= min(low) and max(high) <= LARGEST and not math.isnan(sum(low)) else None


def _box_of_seen(x: FloatArray, y: FloatArray, z: FloatArray) -> _Box | None:
    """Low and high corner of the samples in the camera's frame, from rays at z = 1 that broadcast; those are left out
    that are much farther than others, that lie farther than any sample may, or have no ray. None if there are none."""
    seen = ((z > 0.0) & (z < np.inf)).reshape(-1).nonzero()[0]
    count = len(seen)
    if count == 0:
        return None
    depths = z.reshape(-1).take(seen)
    # A few samples at the end of the world must not make all others small: float32 could not tell them apart. A
    # background is no outlier: it has many.
    last = -(-49 * (count - 1) // 50)  # 98 in a hundred are no farther
    in_order = depths.copy()
    in_order.partition(last)
    farthest = _FARTHEST * float(in_order[last])
    if not _most(depths) <= farthest:
        near = (depths <= farthest).nonzero()[0]
        seen, depths = seen.take(near), depths.take(near)
    local = [np.broadcast_to(way, z.shape).take(seen) * depths for way in (x, y)]
    local.append(depths)
    low, high = ([found(values) for values in local] for found in (_least, _most))
    if -LARGEST <= min(low) and max(high) <= LARGEST and not math.isnan(sum(low)):
        return low, high
    some = np.stack(local)  # a NaN is in no range
    some = some[:, (np.abs(some) <= LARGEST).all(axis=0)]
    return (some.min(axis=1).tolist(), some.max(axis=1).tolist()) if some.size else None


def points_anchor(
    points: FloatArray, valid: npt.NDArray[np.bool_] | None, bias: float, previous: Anchor | None
) -> Anchor:
    """Anchor of (N, 3) points, those that are not ``valid`` left out if others are."""
    seen = points if valid is None or not valid.any() else points[valid]
    # A column at a time: numpy reduces a long strided column several times faster than an axis of length three.
    low, high = ([found(column) for column in seen.T] for found in (_least, _most))
    center = [0.5 * least + 0.5 * most for least, most in zip(low, high, strict=True)]
    return make_anchor(center, max(math.dist(high, center), 4.0 * bias), previous)


def _least(values: FloatArray) -> float:
    return float(np.minimum.reduce(values, axis=None))


def _most(values: FloatArray) -> float:
    return float(np.maximum.reduce(values, axis=None))
