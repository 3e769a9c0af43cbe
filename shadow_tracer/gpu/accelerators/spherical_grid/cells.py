# SPDX-License-Identifier: Apache-2.0
"""The triangle side of the spherical light grid: (triangle, cell) pairs by count, scan, emit and sort.

Of the tiles within the angles of a triangle (``extent.py``) those remain whose rays the filter could answer
for: tests of the edge planes and the own plane with the directions and depths of the rays in the tile and the pads of
``light_space.py``. With t the depth, the own plane also says how near to the light (largest t) the triangle may be met
in this tile. It goes to that depth cell and no other: any ray in its shadow is behind it, so its cell is that one or a
later one, and the test of ray and triangle, done once, decides the pair. (The paper has an entry for each cell that a
triangle spans and tests it in each.)

Counting and emitting are two launches of one kernel, so that they cannot disagree.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.interface import Context, Rays
from shadow_tracer.gpu.accelerators.spherical_grid.extent import (
    PAD,
    TURN,
    Extent,
    azimuth_pad,
    azimuths_of,
    elevations_of,
)
from shadow_tracer.gpu.accelerators.spherical_grid.rays import Grid, TiledRays, Tiles, cell_of
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.counters import ENTRIES, LARGEST_TILE, SPLITS
from shadow_tracer.gpu.device.sort import KeySort
from shadow_tracer.gpu.exact.faces import Occluders
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.exact.light_space import LightSpace, edge_pad, magnitude_bound, plane_of, plane_pad, space_of

_FAR_OUT = 1.0e18
_RADIUS_PAD = 2.0**-20
# Of a quotient of float32.
_UP = 1.0 + 2.0**-20
_DOWN = 1.0 - 2.0**-20


@wp.struct
class Planes:
    """A triangle's planes over light space."""

    ab: wp.vec3
    bc: wp.vec3
    ca: wp.vec3
    reach: wp.vec3  # lengths of the three
    edge_error: float
    own: wp.vec4  # P of light_space.py
    own_reach: float  # length of its first three
    slope_error: float
    offset_error: float


@wp.struct
class Lists:
    """Where entries go."""

    counts: wp.array(dtype=wp.int64)  # of each triangle; their inclusive sums
    sums: wp.array(dtype=wp.int64)
    keys: wp.array(dtype=int)  # tile * cells + cell
    values: wp.array(dtype=int)  # triangle


@wp.func
def planes_of(space: LightSpace, records: wp.array2d(dtype=wp.vec4), triangle: int) -> Planes:
    planes = Planes()
    ab = records[triangle, 0]
    bc = records[triangle, 1]
    ca = records[triangle, 2]
    planes.ab = wp.vec3(ab[0], ab[1], ab[2])
    planes.bc = wp.vec3(bc[0], bc[1], bc[2])
    planes.ca = wp.vec3(ca[0], ca[1], ca[2])
    planes.reach = wp.vec3(wp.length(planes.ab), wp.length(planes.bc), wp.length(planes.ca))
    planes.edge_error = ab[3]
    planes.slope_error = bc[3]
    planes.offset_error = ca[3]
    planes.own = plane_of(space, records[triangle, 3])
    planes.own_reach = wp.length(wp.vec3(planes.own[0], planes.own[1], planes.own[2]))
    return planes


@wp.func
def cell_in(planes: Planes, grid: Grid, tiles: Tiles, tile: int) -> int:
    """The first depth cell of a tile in which a ray may be behind the triangle; -1 if no ray of the tile is in its
    shadow. Comparisons with NaN must not reject."""
    if tiles.radius[tile] < 0.0:
        return -1
    center = tiles.center[tile]
    radius = tiles.radius[tile] + _RADIUS_PAD
    lowest = tiles.lowest[tile]
    magnitude = magnitude_bound(lowest, tiles.highest[tile])
    pad = edge_pad(planes.edge_error, magnitude)
    if (
        wp.dot(planes.ab, center) + planes.reach[0] * radius < -pad
        or wp.dot(planes.bc, center) + planes.reach[1] * radius < -pad
        or wp.dot(planes.ca, center) + planes.reach[2] * radius < -pad
    ):
        return -1
    # P . (e, t) >= -pad with P[3] <= 0: t is at most this.
    own = planes.own
    most = own[0] * center[0] + own[1] * center[1] + own[2] * center[2] + planes.own_reach * radius
    most += plane_pad(planes.slope_error, planes.offset_error, magnitude)
    nearest = most / wp.abs(own[3])
    nearest *= wp.where(nearest > 0.0, _UP, _DOWN)
    if nearest < lowest:
        return -1
    if not nearest < _FAR_OUT:
        return 0
    return cell_of(grid, nearest)


@wp.func
def cover_row(
    triangle: int,
    row: int,
    extent: Extent,
    planes: Planes,
    grid: Grid,
    tiles: Tiles,
    emit: int,
    place: int,
    first: wp.int64,
    lists: Lists,
) -> int:
    """Count or emit the entries of a triangle in a row of tiles; ``place`` entries precede them. Returns how many
    there are with these."""
    south = grid.south + float(row) / grid.rows_per_radian
    north = grid.south + float(row + 1) / grid.rows_per_radian
    aside = wp.cos(wp.max(wp.abs(south), wp.abs(north))) - PAD
    pad = azimuth_pad(extent, aside)
    done = int(0)
    turn = float(-1.0)
    while turn < 1.5:
        begin = int(0)
        end = grid.columns
        if pad >= 0.0:
            west = extent.west + turn * TURN - grid.west
            x = (west - pad) * grid.columns_per_radian
            y = (west + extent.width + pad) * grid.columns_per_radian
            begin = int(wp.clamp(x, 0.0, float(grid.columns)))
            end = int(wp.clamp(y + 1.0, 0.0, float(grid.columns)))
        for column in range(wp.max(begin, done), end):
            tile = row * grid.columns + column
            cell = cell_in(planes, grid, tiles, tile)
            if cell >= 0:
                if emit == 0:
                    wp.atomic_add(tiles.load, tile, 1)
                else:
                    at = first + wp.int64(place)
                    if at >= wp.int64(0) and at < wp.int64(lists.keys.shape[0] // 2):
                        lists.keys[int(at)] = tile * grid.cells + cell
                        lists.values[int(at)] = triangle
                place += 1
        done = wp.max(done, end)
        turn += 1.0
    return place


@wp.kernel(enable_backward=False)
def cover_tiles(
    light: wp.array(dtype=LightFrame),
    emit: int,
    skipped: wp.int64,
    occluders: Occluders,
    tiles: Tiles,
    lists: Lists,
):
    """Count the entries of each triangle, or emit those from number ``skipped`` on that fit the list."""
    t = wp.tid()
    first = wp.int64(0)
    if emit != 0:
        first = lists.sums[t] - lists.counts[t] - skipped
        if lists.counts[t] == wp.int64(0) or lists.sums[t] <= skipped or first >= wp.int64(lists.keys.shape[0] // 2):
            return
    found = int(0)
    own = occluders.records[t, 3]
    grid = tiles.grid[0]
    if own[0] != 0.0 or own[1] != 0.0 or own[2] != 0.0:
        corners = occluders.triangles[t]
        a = occluders.corners[corners[0]]
        b = occluders.corners[corners[1]]
        c = occluders.corners[corners[2]]
        extent = elevations_of(a, b, c)
        low = (extent.south - grid.south) * grid.rows_per_radian
        high = (extent.north - grid.south) * grid.rows_per_radian
        if low <= float(grid.rows) and high >= 0.0:
            if extent.around == 0:
                extent = azimuths_of(extent, a, b, c)
            planes = planes_of(space_of(light[0]), occluders.records, t)
            last = wp.min(int(wp.min(high, float(grid.rows))), grid.rows - 1)
            row = wp.min(int(wp.max(low, 0.0)), grid.rows - 1)
            while row <= last:
                found = cover_row(t, row, extent, planes, grid, tiles, emit, found, first, lists)
                row += 1
    if emit == 0:
        lists.counts[t] = wp.int64(found)


@wp.kernel(enable_backward=False)
def scan_counts(count: int, lists: Lists):
    """Inclusive sums, one thread: recordings on the CPU hold kernels only."""
    sum = wp.int64(0)
    for i in range(count):
        sum += lists.counts[i]
        lists.sums[i] = sum


@wp.kernel(enable_backward=False)
def note_parts(
    row: int,
    count: int,
    lists: Lists,
    items: wp.array(dtype=int),
    parts: wp.array(dtype=int),
    counters: wp.array2d(dtype=wp.int64),
):
    """How many parts the entries take, and what is counted of a light: set, as a frame may begin it more than once."""
    capacity = wp.int64(lists.keys.shape[0] // 2)
    total = lists.sums[count - 1]
    parts[0] = int(wp.min((total + capacity - wp.int64(1)) / capacity, wp.int64(2147483647)))
    counters[row, ENTRIES] = total
    counters[row, SPLITS] = wp.int64(items[0] - items[1])
    counters[row, LARGEST_TILE] = wp.int64(0)


@wp.kernel(enable_backward=False)
def note_largest(row: int, tiles: Tiles, counters: wp.array2d(dtype=wp.int64)):
    load = wp.int64(tiles.load[wp.tid()])
    if load > counters[row, LARGEST_TILE]:
        wp.atomic_max(counters, row, LARGEST_TILE, load)


@wp.kernel(enable_backward=False)
def find_tiles(count: int, skipped: wp.int64, tiles: Tiles, lists: Lists, begins: wp.array(dtype=int)):
    """Where the entries of each tile begin in the sorted list, and where the last ones end. ``count`` is the number of
    triangles."""
    tile = wp.tid()
    key = tile * tiles.grid[0].cells
    low = int(0)
    high = int(wp.clamp(lists.sums[count - 1] - skipped, wp.int64(0), wp.int64(lists.keys.shape[0] // 2)))
    while low < high:
        middle = (low + high) // 2
        if lists.keys[middle] < key:
            low = middle + 1
        else:
            high = middle
    begins[tile] = low


class CellLists:
    """Entries of a pass, or of a part of it, sorted by cell: ``keys`` (tile * cells + cell) and ``values`` (triangle);
    those of tile k are from ``begins[k]`` to ``begins[k + 1]``.

    With ``fixed``, launches and sorts depend only on capacities; else the host reads how many entries there are and
    sorts no more.
    """

    def __init__(self, context: Context, rays: TiledRays, cells: int, fixed: bool) -> None:
        self._context, self._rays, self._cells, self._fixed = context, rays, cells, fixed
        bounds, device = context.samples.bounds, context.samples.device
        self._sort = KeySort(bounds.grid_entries, device)
        self.keys, self.values = self._sort.keys, self._sort.values
        self.begins = wp.empty(len(rays.tiles.load) + 1, dtype=int, device=device)
        self._lists = Lists()
        self._lists.counts = wp.empty(bounds.max_triangles, dtype=wp.int64, device=device)
        self._lists.sums = wp.empty(bounds.max_triangles, dtype=wp.int64, device=device)
        self._lists.keys, self._lists.values = self.keys, self.values

    def count(self, rays: Rays, occluders: Occluders) -> None:
        """Count the entries and tell how many parts they take."""
        samples, triangles, lists = self._context.samples, self._context.scene.triangle_count, self._lists
        device, tiles = samples.device, self._rays.tiles
        inputs = [samples.light_frame_of[rays.first], 0, wp.int64(0), occluders, tiles, lists]
        wp.launch(cover_tiles, dim=triangles, inputs=inputs, device=device)
        if forms.wide(device):
            wp.launch(scan_counts, dim=1, inputs=[triangles, lists], device=device)
        else:
            wp.utils.array_scan(lists.counts[:triangles], lists.sums[:triangles], inclusive=True)
        row = rays.first % len(samples.counters)
        inputs = [row, triangles, lists, self._rays.counts, samples.parts_of[rays.first], samples.counters]
        wp.launch(note_parts, dim=1, inputs=inputs, device=device)
        wp.launch(note_largest, dim=self._rays.tile_count, inputs=[row, tiles, samples.counters], device=device)

    def emit(self, rays: Rays, part: int, occluders: Occluders) -> None:
        """Make the list of part number ``part``."""
        samples, triangles, lists = self._context.samples, self._context.scene.triangle_count, self._lists
        device, tiles, absent = samples.device, self._rays.tiles, self._rays.tile_count * self._cells
        capacity = samples.bounds.grid_entries
        skipped = part * capacity
        entries = capacity
        if self._fixed:
            self.keys.fill_(absent)
        else:
            total = int(lists.sums[triangles - 1 : triangles].numpy()[0])
            entries = min(max(total - skipped, 0), capacity)
        inputs = [samples.light_frame_of[rays.first], 1, wp.int64(skipped), occluders, tiles, lists]
        wp.launch(cover_tiles, dim=triangles, inputs=inputs, device=device)
        self._sort.sort(entries, 0, absent.bit_length())
        inputs = [triangles, wp.int64(skipped), tiles, lists, self.begins]
        wp.launch(find_tiles, dim=self._rays.tile_count + 1, inputs=inputs, device=device)

    def nbytes(self) -> int:
        """Bytes on the device."""
        arrays = (self.begins, self._lists.counts, self._lists.sums)
        return self._sort.nbytes() + sum(int(array.capacity) for array in arrays)
