# SPDX-License-Identifier: Apache-2.0
"""Whether points are those that a set of samples holds: compared where both are, on the CPU."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from shadow_tracer.gpu.device import native
from shadow_tracer.scene.checks import FloatArray

_BLOCK = wp.constant(1024)


@native.func_native("samples/same_points.h", calls="SamePoints::differ")
def points_differ(
    first: int, last: int, points: wp.array(dtype=wp.vec3d), good: wp.array(dtype=wp.uint8),
    held: wp.array(dtype=wp.vec4d), valid: wp.array(dtype=wp.uint8),
) -> int:  # fmt: skip
    """Whether a coordinate or a mark of some points is another one; NaN is."""
    ...


@wp.kernel(enable_backward=False)
def compare_points(
    points: wp.array(dtype=wp.vec3d), good: wp.array(dtype=wp.uint8), held: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8), different: wp.array(dtype=int),
):  # fmt: skip
    """``different[0]`` becomes 1 where a block has a difference."""
    begin = wp.tid() * _BLOCK
    if points_differ(begin, wp.min(begin + _BLOCK, points.shape[0]), points, good, held, valid) != 0:
        different[0] = 1


def load_comparison(device: Any) -> None:
    """Load the kernel, which several threads must not be the first to launch."""
    wp.load_module(compare_points.module, device, max_workers=0)


def few_same(points: FloatArray, good: npt.NDArray[np.uint8], held: FloatArray, valid: npt.NDArray[np.uint8]) -> bool:
    """Whether a set that holds ``held`` and ``valid`` holds a few of these points, and their marks. Other points mostly
    differ in any few of them: only then all are read."""
    few = np.s_[: len(points) : 997]
    return bool((held[few, :3] == points[few]).all() and (valid[few] == good[few]).all())


def same_points(points: FloatArray, good: npt.NDArray[np.uint8], held: wp.array, valid: wp.array) -> bool:
    """Whether a set that holds ``held`` and ``valid`` on the CPU holds these points, (N, 3) in C order, and marks."""
    count, device = len(points), held.device

    def there(array: npt.NDArray[Any], kind: Any) -> wp.array:
        return wp.array(ptr=array.ctypes.data, dtype=kind, shape=(count,), device=device)

    different = wp.zeros(1, dtype=int, device=device)
    inputs = [there(points, wp.vec3d), there(good, wp.uint8), held, valid, different]
    wp.launch(compare_points, dim=-(-count // int(_BLOCK)), inputs=inputs, device=device)
    return not different.numpy()[0]
