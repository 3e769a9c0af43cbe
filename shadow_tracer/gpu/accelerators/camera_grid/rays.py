# SPDX-License-Identifier: Apache-2.0
"""The grid of a camera whose rays are a table: where its tiles lie, and in which of them each ray.

The tiles are those of a pinhole that sees all rays, with as many pixels as the image; rays more than ``_WIDEST`` from
the axis count to the outermost tiles, whose outer edges are the farthest rays. A ray lies in a tile by comparison of
its float32 numbers with the float32 edges, so it is between the corners that ``may_meet`` looks at. ``bound`` measures
in pixels: an edge is off there by 2^-24 |x| fx, a sixteenth of its pad.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shadow_tracer.scene.camera import RayTable

_WIDEST = 4.0
_NARROWEST = 1e-3

Floats = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Axis:
    """One axis of the grid.

    Attributes:
        focal, centre: of the pinhole [px], float32 numbers.
        edges: (n + 1,) positions of the edges of its pixels, increasing.
    """

    focal: float
    centre: float
    edges: Floats


def tiles_of(table: RayTable, tile: int) -> tuple[Axis, Axis, npt.NDArray[np.int32]]:
    """The axes of the grid for x and y, and (H, W) numbers of the sorting tiles, -1 where a pixel has no ray."""
    height, width = table.xy.shape[:2]
    across, columns = _axis(table.xy[..., 0][table.known], width, tile)
    down, rows = _axis(table.xy[..., 1][table.known], height, tile)
    tiles = np.full((height, width), -1, np.int32)
    tiles[table.known] = rows * -(-width // tile) + columns
    return across, down, tiles


def _axis(values: Floats, pixels: int, tile: int) -> tuple[Axis, npt.NDArray[np.intp]]:
    """An axis, and which of its tiles each value lies in."""
    least, most = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
    low, high = np.clip((least, most), -_WIDEST, _WIDEST)
    focal = float(np.float32(pixels / max(high - low, _NARROWEST)))
    centre = float(np.float32(-low * focal))
    count = -(-pixels // tile) * tile
    edges = ((np.arange(count + 1, dtype=np.float64) - centre) / focal).astype(np.float32)
    edges[0], edges[-1] = min(edges[0], least), max(edges[-1], most)
    return Axis(focal, centre, edges), np.searchsorted(edges[tile:-1:tile], values, side="right")
