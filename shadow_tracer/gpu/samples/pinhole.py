# SPDX-License-Identifier: Apache-2.0
"""A camera and a bias as kernels see them."""

from __future__ import annotations

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


def make_pinhole(camera: Camera, bias: Bias, first: int = 0) -> Pinhole:
    """From a camera and a bias, for the pixels from ``first`` on."""
    pinhole = Pinhole()
    pinhole.width, pinhole.first, pinhole.tabled = camera.width, first, camera.rays is not None
    pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy = camera.fx, camera.fy, camera.cx, camera.cy
    rows = [wp.vec4d(*row) for row in camera.camera_to_world[:3]]
    pinhole.row0, pinhole.row1, pinhole.row2 = rows
    pinhole.bias_constant, pinhole.bias_quadratic, pinhole.bias_normal = bias.constant, bias.quadratic, bias.normal
    pinhole.height = camera.height
    (pinhole.step_across, pinhole.across), (pinhole.step_down, pinhole.down) = map(neighbours, focal_lengths(camera))
    return pinhole
