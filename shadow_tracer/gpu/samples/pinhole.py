# SPDX-License-Identifier: Apache-2.0
"""A camera and a bias as kernels see them."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from shadow_tracer.scene.bias import Bias
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.normals import focal_lengths, neighbours


@wp.struct
class Pinhole:
    """Camera and bias as kernels see them."""

    width: wp.int32
    first: wp.int32  # pixel of the image that the buffers begin with
    tabled: wp.int32  # whether rays come from the table (SampleSet.ray_table), and not from the four below
    fx: wp.float64
    fy: wp.float64
    cx: wp.float64
    cy: wp.float64
    row0: wp.vec4d  # camera_to_world, by rows
    row1: wp.vec4d
    row2: wp.vec4d
    bias_constant: wp.float64
    bias_quadratic: wp.float64
    bias_normal: wp.float64
    height: wp.int32
    # Pixels to the neighbours that a normal is made of, and how far a pinhole's rays are apart.
    step_across: wp.int32
    step_down: wp.int32
    across: wp.float32
    down: wp.float32


_DTYPE = np.dtype(Pinhole.numpy_dtype())  # type: ignore[attr-defined]


def make_pinhole(camera: Camera, bias: Bias, first: int = 0) -> npt.NDArray[Any]:
    """A :class:`Pinhole` as a value of numpy, which takes a tenth of the time, (1,): from a camera and a bias, for the
    pixels from ``first`` on."""
    tabled = camera.rays is not None
    optics = camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, tabled, focal_lengths(camera)
    pinhole = _at_origin(optics, bias, first).copy()
    pinhole["row0"], pinhole["row1"], pinhole["row2"] = camera.camera_to_world[:3]
    return pinhole


@lru_cache(maxsize=64)
def _at_origin(optics: tuple[Any, ...], bias: Bias, first: int) -> npt.NDArray[Any]:
    """All of it but the pose, which changes."""
    width, height, fx, fy, cx, cy, tabled, focal = optics
    (step_across, across), (step_down, down) = map(neighbours, focal)
    pinhole = np.zeros(1, _DTYPE)
    names = "width", "height", "fx", "fy", "cx", "cy", "tabled", "first", "step_across", "across", "step_down", "down"
    values = width, height, fx, fy, cx, cy, tabled, first, step_across, across, step_down, down
    for name, value in zip(names, values, strict=True):
        pinhole[name] = value
    pinhole["bias_constant"], pinhole["bias_quadratic"] = bias.constant, bias.quadratic
    pinhole["bias_normal"] = bias.normal
    pinhole.setflags(write=False)
    return pinhole
