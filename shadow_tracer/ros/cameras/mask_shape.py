# SPDX-License-Identifier: Apache-2.0
"""How a mask is changed before it is published, and depth where a mask says lit or shadowed. No ROS here."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.ros.wire.messages import MILLIMETRE

Mask = npt.NDArray[np.uint8]
_LIT = 255


def shadow_grown(mask: Mask, known: npt.NDArray[np.bool_], pixels: int) -> Mask:
    """A mask whose shadow has grown.

    Args:
        mask: (H, W) uint8, 255 lit, 0 in shadow.
        known: (H, W) bool: other pixels stay as they are, and nothing grows out of them.
        pixels: by how many, on every side: each pixel takes the least value in the square of 2 * pixels + 1 around it.

    Returns:
        (H, W) uint8, ``mask`` itself if ``pixels`` is 0.
    """
    if pixels == 0:
        return mask
    least = np.where(known, mask, np.uint8(_LIT))
    for axis in (0, 1):
        least = _least(least, pixels, axis)
    return np.where(known, least, mask)


def _least(values: Mask, pixels: int, axis: int) -> Mask:
    """Least value within ``pixels`` along an axis; windows are put together from two of half their size, so that large
    ones cost little more than small ones."""
    rows = np.moveaxis(values, axis, 0)
    padding = np.full((pixels, rows.shape[1]), _LIT, np.uint8)
    window, width = np.concatenate([padding, rows, padding]), 1
    whole = 2 * pixels + 1
    while 2 * width <= whole:
        window, width = np.minimum(window[:-width], window[width:]), 2 * width
    count, rest = len(rows), whole - width
    return np.moveaxis(np.minimum(window[:count], window[rest : rest + count]), 0, axis)


def inverted(mask: Mask) -> Mask:
    """255 in shadow and 0 where light reaches; what stands for unknown is inverted too, so that it never means lit."""
    return np.subtract(np.uint8(_LIT), mask)


def depth_where(depth: npt.NDArray[Any], wanted: npt.NDArray[np.bool_], unit: float, steps: bool) -> npt.NDArray[Any]:
    """A depth image with all other pixels invalid, in the format that the camera sent.

    Args:
        depth: (H, W) uint16 millimetres or float32 metres, as the tracer takes it.
        wanted: (H, W) bool.
        unit: metres per step of the camera's image.
        steps: whether the camera sends steps (16UC1, mono16), not metres (32FC1).

    Returns:
        (H, W) uint16 steps, 0 where invalid, or float32 metres, NaN where invalid.
    """
    if not steps:
        return np.where(wanted, depth, np.float32(np.nan))
    if depth.dtype != np.uint16:  # steps of another unit, taken as metres: rounding finds the step again
        assert unit != MILLIMETRE
        depth = np.rint(depth.astype(np.float64) / unit).astype(np.uint16)
    return np.where(wanted, depth, np.uint16(0))
