# SPDX-License-Identifier: Apache-2.0
"""A stand-in for sensor_msgs/PointCloud2, and clouds of any layout."""

from __future__ import annotations

from array import array
from types import SimpleNamespace
from typing import Any

import numpy as np

FLOAT32, FLOAT64 = 7, 8
SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 8: 8}


class Cloud(SimpleNamespace):
    """Taken by its fields, as the message is."""


def field(name: str, offset: int, datatype: int = FLOAT32, count: int = 1) -> SimpleNamespace:
    return SimpleNamespace(name=name, offset=offset, datatype=datatype, count=count)


def cloud(
    points: np.ndarray,
    datatype: int = FLOAT32,
    big: bool = False,
    offsets: tuple[int, int, int] | None = None,
    point_step: int = 0,
    padding: int = 0,
    seed: int = 1,
) -> Cloud:
    """A cloud of points (H, W, 3) or (N, 3); bytes between and behind the coordinates are rubbish."""
    grid = points if points.ndim == 3 else points[None]
    height, width = grid.shape[:2]
    size = SIZES[datatype]
    offsets = offsets or (0, size, 2 * size)
    point_step = point_step or max(offsets) + size
    row_step = width * point_step + padding
    data = np.random.default_rng(seed).integers(0, 256, height * row_step, np.uint8)
    for k, offset in enumerate(offsets):
        target = np.ndarray(
            (height, width), (">" if big else "<") + f"f{size}", data.data, offset, (row_step, point_step)
        )
        target[...] = grid[..., k]
    return Cloud(
        header=SimpleNamespace(frame_id="lidar", stamp=SimpleNamespace(sec=12, nanosec=34)),
        height=height,
        width=width,
        fields=[field(name, offset, datatype) for name, offset in zip("xyz", offsets, strict=True)],
        is_bigendian=big,
        point_step=point_step,
        row_step=row_step,
        data=array("B", data.tobytes()),
        is_dense=True,
    )


def some_points(count: int = 12, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3)).astype(np.float32).astype(np.float64)


def changed(message: Cloud, **values: Any) -> Cloud:
    return Cloud(**(vars(message) | values))
