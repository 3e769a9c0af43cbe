# SPDX-License-Identifier: Apache-2.0
"""The perspective grid of a camera, as kernels see it."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.exact.camera_records import CameraRays


@wp.struct
class Grid:
    """A camera and its tiles."""

    rays: CameraRays
    tile: int  # pixels along a side of a sorting tile
    group: int  # sorting tiles along a side of a coarse tile
    tiles_x: int
    tiles_y: int
    coarse_x: int
    coarse_y: int
    # Of a pinhole the camera's; of a camera with a table of rays those that ``rays.py`` has chosen.
    fx: float
    fy: float
    cx: float
    cy: float
    columns: wp.array(dtype=float)  # x of each column and -y of each row, up to the end of the last tile
    rows: wp.array(dtype=float)
    tile_of: wp.array(dtype=int)  # the sorting tile that a ray of a table lies in, -1 where there is none
