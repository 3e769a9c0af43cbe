# SPDX-License-Identifier: Apache-2.0
"""The surface in a depth image, made on the device: corners and triangles, with the bits of ``scene/depth_mesh.py``.

Up go the image and, when they are other ones, the ways of its rays. Every cell between four corners has a place for two
triangles; one that is not there is that of a gap.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.device.transfers import Uploads
from shadow_tracer.gpu.exact.records import GAP_VERTEX
from shadow_tracer.scene.checks import LARGEST
from shadow_tracer.scene.depth_mesh import corner_ways
from shadow_tracer.scene.parts import DepthSurface

native.constants(GAP_VERTEX=GAP_VERTEX, LARGEST_COORDINATE=LARGEST)


@wp.struct
class DepthGrid:
    """Sizes of an image and of its corners.

    Attributes:
        steps: 1 for uint16 millimetres, 0 for float32 metres.
        width: of the image.
        step: pixels from corner to corner.
        rows, columns: of corners.
        down: where the ways in y begin.
        each: 1 if every corner has a way, 0 if every column and every row.
        place: of the first corner in the array of corners.
        vertex, triangle: first of the mesh.
        widest: largest ratio of depths in a triangle.
    """

    steps: int
    width: int
    step: int
    rows: int
    columns: int
    down: int
    each: int
    place: int
    vertex: int
    triangle: int
    widest: wp.float64


@native.func_native("occluders/depth_surface.h", calls="DepthSurface::corners")
def corners_of(
    image: wp.array(dtype=wp.uint8), steps: bool, width: int, step: int, ways: wp.array(dtype=wp.float64), down: int,
    each: bool, columns: int, row: int, first: int, last: int, place: int, to: wp.array(dtype=wp.vec3d),
):  # fmt: skip
    """Corners ``first`` to ``last`` of a row."""
    ...


@native.func_native("occluders/depth_surface.h", calls="DepthSurface::cells")
def cells_of(
    corners: wp.array(dtype=wp.vec3d), place: int, number: int, columns: int, widest: wp.float64, row: int, first: int,
    last: int, triangle: int, to: wp.array(dtype=wp.vec3i),
):  # fmt: skip
    """Triangles of the cells ``first`` to ``last`` of a row."""
    ...


@wp.kernel(enable_backward=False)
def make_corners(
    grid: DepthGrid, image: wp.array(dtype=wp.uint8), ways: wp.array(dtype=wp.float64), width: int,
    to: wp.array(dtype=wp.vec3d),
):  # fmt: skip
    """``width`` corners of a row for each task."""
    row, first = wp.tid()
    begin = first * width
    last = wp.min(begin + width, grid.columns)
    corners_of(image, grid.steps != 0, grid.width, grid.step, ways, grid.down, grid.each != 0, grid.columns, row, begin,
               last, grid.place, to)  # fmt: skip


@wp.kernel(enable_backward=False)
def make_cells(grid: DepthGrid, corners: wp.array(dtype=wp.vec3d), width: int, to: wp.array(dtype=wp.vec3i)):
    """Triangles of ``width`` cells of a row for each task."""
    row, first = wp.tid()
    begin = first * width
    last = wp.min(begin + width, grid.columns - 1)
    cells_of(corners, grid.place, grid.vertex, grid.columns, grid.widest, row, begin, last, grid.triangle, to)


@dataclass
class _Held:
    """What is on the device of one surface.

    Attributes:
        image: bytes of its pixels.
        ways: of its rays, x and then y.
        camera: whose rays they are: intrinsics, size, step.
        corners: of the wide form, which has no array of all meshes.
    """

    image: wp.array
    ways: wp.array
    camera: tuple[Any, ...] = ()
    corners: wp.array | None = None


class DepthSurfaces:
    """Makes the surfaces of a scene; buffers grow with the largest image."""

    def __init__(self, device: Any, upload: Uploads) -> None:
        self._device = device
        self._upload = upload
        self._held: dict[str, _Held] = {}

    def keep(self, names: set[str]) -> None:
        """Free the buffers of all others."""
        self._held = {name: held for name, held in self._held.items() if name in names}

    def nbytes(self) -> int:
        """Bytes reserved."""
        arrays = [array for held in self._held.values() for array in (held.image, held.ways, held.corners)]
        return sum(int(array.capacity) for array in arrays if array is not None)

    def corners(self, mesh: DepthSurface, local: wp.array, first: int) -> wp.array:
        """Make the vertices in the optical frame.

        Args:
            local: vertices of all meshes in their frames; not used in the wide form.
            first: of the mesh.

        Returns:
            The array that they are in: ``local``, or one that begins with them.
        """
        held = self._ready(mesh)
        place = first if held.corners is None else 0
        corners = local if held.corners is None else held.corners
        grid = self._grid(mesh, place, first, 0)
        self._launch(make_corners, mesh, [grid, held.image, held.ways], corners, 0)
        return corners

    def triangles(self, mesh: DepthSurface, local: wp.array, first_vertex: int, first: int, to: wp.array) -> None:
        """Make the triangles, from number ``first`` of ``to`` on, after the corners have been made."""
        held = self._held[mesh.name]
        place = first_vertex if held.corners is None else 0
        corners = local if held.corners is None else held.corners
        self._launch(make_cells, mesh, [self._grid(mesh, place, first_vertex, first), corners], to, 1)

    def _launch(self, kernel: Any, mesh: DepthSurface, inputs: list[Any], to: wp.array, less: int) -> None:
        rows, columns = (count - less for count in mesh.corners)
        if rows < 1 or columns < 1:
            return
        width = columns if forms.wide(self._device) else 1
        wp.launch(kernel, dim=(rows, -(-columns // width)), inputs=[*inputs, width, to], device=self._device)

    def _grid(self, mesh: DepthSurface, place: int, vertex: int, triangle: int) -> DepthGrid:
        grid = DepthGrid()
        rows, columns = mesh.corners
        each = mesh.camera.rays is not None
        grid.steps = int(mesh.image.dtype == np.uint16)
        grid.width, grid.step, grid.rows, grid.columns = mesh.image.shape[1], mesh.step, rows, columns
        grid.down, grid.each = rows * columns if each else columns, int(each)
        grid.place, grid.vertex, grid.triangle = place, vertex, triangle
        grid.widest = 1.0 + mesh.max_jump
        return grid

    def _ready(self, mesh: DepthSurface) -> _Held:
        """The buffers of a surface, with its image and the ways of its rays."""
        data = mesh.image.reshape(-1).view(np.uint8)
        camera, wide = mesh.camera, forms.wide(self._device)
        held = self._held.get(mesh.name)
        if held is None:
            held = self._held[mesh.name] = _Held(self._empty(0, wp.uint8), self._empty(0, wp.float64))
        if wide:  # the CPU reads it where it is, and the mesh keeps it there
            held.image = wp.array(ptr=data.ctypes.data, dtype=wp.uint8, shape=(data.size,), device=self._device)
            if held.corners is None or held.corners.size < mesh.vertex_count:
                held.corners = self._empty(mesh.vertex_count, wp.vec3d)
        else:
            if held.image.size < data.size:
                held.image = self._empty(data.size, wp.uint8)
            self._upload(held.image, data)
        key = (camera.fx, camera.fy, camera.cx, camera.cy, mesh.image.shape, mesh.step, camera.rays)
        if not held.camera or held.camera[:-1] != key[:-1] or held.camera[-1] is not key[-1]:
            ways = np.concatenate([way.reshape(-1) for way in corner_ways(camera, mesh.step)])
            if camera.rays is not None:
                missing = ~camera.rays.known[:: mesh.step, :: mesh.step].reshape(-1)
                ways[: missing.size][missing] = np.nan  # so that they have no corner
            if held.ways.size < ways.size:
                held.ways = self._empty(ways.size, wp.float64)
            self._upload(held.ways, ways)
            held.camera = key
        return held

    def _empty(self, count: int, dtype: Any) -> wp.array:
        return wp.empty(count, dtype=dtype, device=self._device)
