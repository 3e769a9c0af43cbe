# SPDX-License-Identifier: Apache-2.0
"""Depth images: which triangle each pixel of a camera sees, and how far away."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from shadow_tracer.gpu.exact.hit import COUNTER_SHAPE, COUNTERS


@wp.struct
class Image:
    """Where the answer goes: depth [m], NaN where nothing is hit, and triangle, -1 there. ``triangle`` is also what a
    further pass goes on with."""

    depth: wp.array(dtype=float)
    triangle: wp.array(dtype=int)


@dataclass(frozen=True)
class Seen:
    """Result of a frame: (N,) depths [m] and triangles, and counters."""

    depth: npt.NDArray[np.float32]
    triangle: npt.NDArray[np.int32]
    counters: dict[str, int]


def make_image(pixels: int, device: Any) -> Image:
    """One of as many pixels."""
    image = Image()
    image.depth = wp.empty(pixels, dtype=float, device=device)
    image.triangle = wp.empty(pixels, dtype=int, device=device)
    return image


def seen_on(image: Image, pixels: int, counters: dict[str, int]) -> Seen:
    """The first pixels of an image on the device, copied."""
    return Seen(image.depth.numpy()[:pixels].copy(), image.triangle.numpy()[:pixels].copy(), counters)


def seen_nothing(pixels: int, counters: dict[str, int]) -> Seen:
    """No triangle anywhere."""
    return Seen(np.full(pixels, np.nan, np.float32), np.full(pixels, -1, np.int32), counters)


def make_counters(device: Any) -> wp.array:
    """Zeros, which threads add to, each to one of the rows."""
    return wp.zeros(COUNTER_SHAPE, dtype=wp.int64, device=device)


def counted(counters: wp.array) -> dict[str, int]:
    """The sums of the rows, by name."""
    return {name: int(total) for name, total in zip(COUNTERS, counters.numpy().sum(axis=0), strict=True)}
