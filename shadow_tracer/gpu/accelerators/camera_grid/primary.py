# SPDX-License-Identifier: Apache-2.0
"""Depth images: the closest triangle on every pixel's ray, by the perspective grid of section 3 of the paper.

The image is cut into sorting tiles of 8 x 8 pixels. Triangles go into the lists of the tiles they may be seen in
(``bins.py``), the rays of a tile test its list (``hit.py``). Indirect mapping: a thread block traces 2
x 2 sorting tiles, so that it has threads enough although lists stay short. Where the rays are a table, a pixel looks up
the tile that its ray lies in.

Two forms with the same bits: plain Warp kernels, one thread per pixel, and for the CPU one that bins in order and
tests sixteen rays at a time (``tiles16.h``), but those of a table one by one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from shadow_tracer.gpu.accelerators.camera_grid.bins import bin_triangles, count_entries, emit_entries, fill_lists
from shadow_tracer.gpu.accelerators.camera_grid.grid import Grid
from shadow_tracer.gpu.accelerators.camera_grid.hit import TILE, Sorted, threads_of, trace_pixels, trace_tiles
from shadow_tracer.gpu.accelerators.camera_grid.rays import Axis, tiles_of
from shadow_tracer.gpu.accelerators.camera_view import CameraView, pinhole_axes
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.exact.hit import COUNTERS
from shadow_tracer.gpu.occluders.corners import project
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.visibility.depth_image import Seen, counted, make_counters, make_image, seen_nothing, seen_on
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.camera import Camera, RayTable
from shadow_tracer.scene.mesh import Scene

_GROUP = 8
_BLOCK = 2
_MOST_THREADS = 256
_FILL_THREADS = 65536
_COUNTERS = ("triangles", "degenerate", "entries", "largest_tile", "passes", *COUNTERS)


class PrimaryRays:
    """Renders depth images on one device, with buffers allocated here and never again.

    Args:
        device: a Warp device.
        bounds: capacities.
        wide: whether to use the CPU's form; None: on the CPU. The answers are the same.
        tile: side of a sorting tile [px]; the CPU's form has 8.
        scene: the world on the device, ordered, if others have it already.
    """

    def __init__(
        self,
        device: Any,
        bounds: Bounds,
        wide: bool | None = None,
        tile: int = TILE,
        scene: SceneBuffers | None = None,
    ) -> None:
        self._device, self._bounds, self._tile = device, bounds, tile
        self._wide = forms.wide(device) if wide is None else wide
        if self._wide and tile != TILE:
            raise ValueError(f"tile: expected {TILE} for the CPU's form, got {tile}")
        rays, triangles, entries = bounds.max_rays, bounds.max_triangles, bounds.grid_entries
        self.scene = SceneBuffers(bounds, device, ordered=True) if scene is None else scene
        self._view = CameraView(self.scene, bounds, beyond=tile)
        self._corners = wp.empty(len(self.scene.vertices), dtype=wp.vec4, device=device)
        self._pairs = wp.empty(entries, dtype=wp.vec2i, device=device)
        self._lists = wp.empty(entries, dtype=int, device=device)
        self._ends = None if self._wide else wp.empty(triangles, dtype=wp.int64, device=device)
        side = tile * _GROUP
        # A one pixel high image has the most tiles for its pixels.
        tiles = sum(rays // s**2 + (rays + 1) // s + 2 for s in (tile, side))
        self._starts = wp.empty(tiles + 1, dtype=int, device=device)
        self._cursor = wp.zeros(3, dtype=int, device=device)
        self._counters = make_counters(device)
        self._axes = [wp.empty(rays + tile, dtype=float, device=device) for _ in range(2)]
        self._tile_of = wp.empty(rays, dtype=int, device=device)
        self._along: tuple[RayTable, Axis, Axis] | None = None  # what axes and tiles are of; None: a pinhole
        self._image = make_image(rays, device)
        self._grid = Grid()
        self._made_for: Camera | None = None

    def render(self, scene: Scene, camera: Camera) -> Seen:
        """The closest triangle of every pixel; arguments fit the bounds."""
        self.scene.sync(scene)
        count, rays = self.scene.triangle_count, camera.width * camera.height
        if count == 0:
            return seen_nothing(rays, {"rays": rays, **dict.fromkeys(_COUNTERS, 0)})
        self._look_from(camera)
        self._set_up()
        self._counters.zero_()
        passes = self._passes_in_order(count) if self._wide else self._passes_by_scan(count)
        values = (count, self._view.unseen(), *passes, *counted(self._counters).values())
        return seen_on(self._image, rays, {"rays": rays, **dict(zip(_COUNTERS, values, strict=True))})

    def nbytes(self) -> int:
        """Bytes reserved on the device."""
        arrays = [a for a in vars(self).values() if isinstance(a, wp.array)]
        arrays += [*self._axes, self._image.depth, self._image.triangle]
        return int(sum(a.capacity for a in arrays)) + self._view.nbytes() + self.scene.nbytes()

    def _look_from(self, camera: Camera) -> None:
        if camera is self._made_for:
            return
        self._made_for = None
        self._view.look_from(camera)
        grid, tile = Grid(), self._tile
        grid.rays, grid.tile, grid.group = self._view.rays, tile, _GROUP
        grid.tiles_x, grid.tiles_y = -(-camera.width // tile), -(-camera.height // tile)
        grid.coarse_x, grid.coarse_y = -(-grid.tiles_x // _GROUP), -(-grid.tiles_y // _GROUP)
        (grid.columns, grid.rows), grid.tile_of = self._axes, self._tile_of
        if camera.rays is not None:
            self._look_along(camera.rays, grid)
        else:
            grid.fx, grid.fy, grid.cx, grid.cy = camera.fx, camera.fy, camera.cx, camera.cy
            x, y = pinhole_axes(camera, tile)
            for axis, values in zip(self._axes, (x.astype(np.float32), -y.astype(np.float32)), strict=True):
                self.scene.upload(axis, values)
            self._along = None
        self._grid, self._made_for = grid, camera

    def _look_along(self, rays: RayTable, grid: Grid) -> None:
        """Axes and the tiles of rays, which another pose leaves as they are."""
        if self._along is None or self._along[0] != rays:
            across, down, tiles = tiles_of(rays, self._tile)
            self._along = None
            self.scene.upload(self._tile_of, tiles.reshape(-1))
            for axis, values in zip(self._axes, (across.edges, -down.edges), strict=True):
                self.scene.upload(axis, values)
            self._along = rays, across, down
        _, across, down = self._along
        grid.fx, grid.fy, grid.cx, grid.cy = across.focal, down.focal, across.centre, down.centre

    def _set_up(self) -> None:
        self._view.set_up()
        project(self._view.frame, self.scene.vertices, self._corners, (0, self.scene.vertex_count))

    def _passes_in_order(self, count: int) -> tuple[int, int, int]:
        grid, device, starts = self._grid, self._device, self._tile_starts()
        sizes = [
            self.scene.triangles,
            self._corners,
            self._view.records,
            self._pairs,
            starts,
            self._lists,
            self._cursor,
        ]
        self._cursor.zero_()
        passes = entries = largest = 0
        while passes == 0 or self._cursor.numpy()[0] < count:
            wp.launch(bin_triangles, dim=1, inputs=[count, grid, *sizes], device=device)
            inputs = [grid, self._sorted(starts), int(passes > 0), self._image, self._counters]
            if grid.rays.tabled:  # rays of a tile are not in rows
                wp.launch(trace_pixels, dim=threads_of(grid, _BLOCK), inputs=[_BLOCK, *inputs], device=device)
            else:
                wp.launch(trace_tiles, dim=grid.tiles_y, inputs=inputs, device=device)
            passes += 1
            entries += int(self._cursor.numpy()[2])
            largest = max(largest, self._largest(starts))
        return entries, largest, passes

    def _passes_by_scan(self, count: int) -> tuple[int, int, int]:
        grid, device, scene, starts = self._grid, self._device, self.scene, self._tile_starts()
        assert self._ends is not None
        ends = self._ends[:count]
        seen = [scene.triangles, self._corners, self._view.records]
        wp.launch(count_entries, dim=count, inputs=[grid, *seen, ends], device=device)
        wp.utils.array_scan(ends, ends, inclusive=True)
        capacity, threads = self._bounds.grid_entries, forms.tasks(device, _FILL_THREADS)
        first = passes = entries = largest = 0
        while passes == 0 or first < entries:
            starts.zero_()
            inputs = [wp.int64(first), grid, *seen, ends, self._pairs, starts]
            wp.launch(emit_entries, dim=count, inputs=inputs, device=device)
            wp.utils.array_scan(starts, starts, inclusive=True)
            inputs = [wp.int64(first), threads, count - 1, ends, self._pairs, starts, self._lists]
            wp.launch(fill_lists, dim=threads, inputs=inputs, device=device)
            inputs = [_BLOCK, grid, self._sorted(starts), int(passes > 0), self._image, self._counters]
            # A thread block is a tracing block, or as much of it as has registers enough.
            block_dim = min((_BLOCK * self._tile) ** 2, _MOST_THREADS)
            dim = threads_of(grid, _BLOCK)
            wp.launch(trace_pixels, dim=dim, inputs=inputs, device=device, block_dim=block_dim)
            # The host waits only here, when the image of the first pass is done.
            if passes == 0:
                entries = int(ends[count - 1 : count].numpy()[0])
            passes += 1
            first += capacity
            largest = max(largest, self._largest(starts))
        return entries, largest, passes

    def _tile_starts(self) -> wp.array:
        grid = self._grid
        return self._starts[: grid.tiles_x * grid.tiles_y + grid.coarse_x * grid.coarse_y + 1]

    def _largest(self, starts: wp.array) -> int:
        return int(np.diff(starts.numpy()).max())

    def _sorted(self, starts: wp.array) -> Sorted:
        made = Sorted()
        made.seen, made.starts, made.lists = self._view.seen(), starts, self._lists
        return made
