# SPDX-License-Identifier: Apache-2.0
"""The ray side of the spherical light grid: limits of the grid, rays sorted by tile, tiles split into work items
(Guntury and Narayanan 2010, "Ray Tracing Dynamic Scenes with Shadows on GPU", sections 4.1 to 4.3).

Angles are those of h = (U, V, W) of ``light_space.py``, W being the way from the light to the samples: the azimuth
atan2(U, W) goes around the V axis, the elevation from the plane of U and W to V. For far and directional lights h is
stretched, so their rays fill the grid as those of a near light do. The paper prints atan2(right, forward) and
atan2(up, forward) for its two angles. That pair is singular where forward is 0: all directions at right angles to the
forward axis share four points, and half of its square belongs to no direction. Azimuth and elevation are regular but
for the two poles +V and -V, which are a single row of tiles each.

Everything is clamped to what the rays take up: limits of the two angles, near and far, and tiles without rays hold no
triangles. Angles are float32, within 2^-19 of exact (5 ulp of pi is the most an atan2 may be off); whoever asks which
tiles something covers has to allow for that. A ray's distance is its |h| if the light is near and minus its depth t
if it is far: what counts is that it grows from the light to the sample.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.admission import IN_TREE, Admission
from shadow_tracer.gpu.accelerators.interface import Context, Rays
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.sort import KeySort
from shadow_tracer.gpu.exact.light_frame import SHADOWED, LightFrame
from shadow_tracer.gpu.exact.light_space import ray_depth, space_of

_STRIPES = wp.constant(64)
_FAR_OUT = wp.constant(3.0e38)
_LEAST_ANGLE = 2.0**-20
_LEAST_DISTANCE = 1.0e-30


@wp.struct
class Grid:
    """Limits of the angles and of the distance, and how many columns, rows and depth cells lie between them."""

    columns: int
    rows: int
    cells: int
    inverse: int  # mode of the light space
    west: float  # least azimuth [rad]
    south: float  # least elevation [rad]
    near: float  # least distance
    columns_per_radian: float
    rows_per_radian: float
    cells_per_distance: float


@wp.struct
class Tiles:
    """What is known of the rays of each tile, and what the tiles hold; number = row * columns + column."""

    grid: wp.array(dtype=Grid)
    center: wp.array(dtype=wp.vec3)  # direction
    radius: wp.array(dtype=float)  # largest distance of a ray's direction from it; negative: no rays
    lowest: wp.array(dtype=float)  # least and largest depth t of a ray
    highest: wp.array(dtype=float)
    load: wp.array(dtype=int)  # triangles


@wp.func
def direction_of(ray: wp.vec4) -> wp.vec4:
    """Unit (U, V, W), within 4 u, and 1/|h|."""
    size = wp.max(wp.max(wp.abs(ray[0]), wp.abs(ray[1])), wp.abs(ray[2]))
    way = wp.vec3(ray[0] / size, ray[1] / size, ray[2] / size)
    inverse = 1.0 / wp.length(way)
    return wp.vec4(way[0] * inverse, way[1] * inverse, way[2] * inverse, inverse / size)


@wp.func
def distance_of(inverse: int, t: float) -> float:
    """Grows with the distance from the light along every ray; t > 0 if ``inverse``."""
    if inverse != 0:
        return 1.0 / t
    return -t


@wp.func
def cell_of(grid: Grid, t: float) -> int:
    """Depth cell: never smaller for a smaller t. The first one has no front, the last one no back."""
    x = (distance_of(grid.inverse, t) - grid.near) * grid.cells_per_distance
    if not x > 0.0:
        return 0
    return int(wp.min(x, float(grid.cells - 1)))


@wp.func
def tile_of(grid: Grid, azimuth: float, elevation: float) -> int:
    """Tile of a direction within the limits."""
    column = wp.min(int((azimuth - grid.west) * grid.columns_per_radian), grid.columns - 1)
    row = wp.min(int((elevation - grid.south) * grid.rows_per_radian), grid.rows - 1)
    return row * grid.columns + column


@wp.kernel(enable_backward=False)
def clear_limits(limits: wp.array(dtype=float)):
    """``limits``: least azimuth, elevation and distance, then minus the largest; in ``_STRIPES`` rows that threads
    spread over."""
    limits[wp.tid()] = _FAR_OUT


@wp.func
def lower(limits: wp.array(dtype=float), at: int, value: float):
    # Looking first keeps almost all threads from queueing for the same few addresses.
    if value < limits[at]:
        wp.atomic_min(limits, at, value)


@wp.kernel(enable_backward=False)
def measure_rays(
    light: wp.array(dtype=LightFrame),
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    group: wp.array(dtype=wp.uint8),
    polar: wp.array(dtype=wp.vec3),
    limits: wp.array(dtype=float),
):
    """(azimuth, elevation, t) of every ray that takes part, and their limits."""
    i = wp.tid()
    if group[i] != wp.uint8(IN_TREE) or states[i] == wp.uint8(SHADOWED):
        return
    space = space_of(light[0])
    ray = rays[i]
    way = direction_of(ray)
    azimuth = wp.atan2(way[0], way[2])
    elevation = wp.atan2(way[1], wp.sqrt(way[0] * way[0] + way[2] * way[2]))
    t = ray_depth(space, ray, way[3])
    polar[i] = wp.vec3(azimuth, elevation, t)
    distance = distance_of(space.inverse, t)
    base = 6 * (i & (_STRIPES - 1))
    lower(limits, base, azimuth)
    lower(limits, base + 1, elevation)
    lower(limits, base + 2, distance)
    lower(limits, base + 3, -azimuth)
    lower(limits, base + 4, -elevation)
    lower(limits, base + 5, -distance)


@wp.kernel(enable_backward=False)
def fit_grid(
    light: wp.array(dtype=LightFrame),
    tiles: int,
    cells: int,
    limits: wp.array(dtype=float),
    grid: wp.array(dtype=Grid),
):
    """Limits from the stripes, and as many columns and rows as make at most ``tiles`` tiles, about as wide as high."""
    for stripe in range(1, _STRIPES):
        for k in range(6):
            limits[k] = wp.min(limits[k], limits[6 * stripe + k])
    out = Grid()
    out.cells = cells
    out.columns = 1
    out.rows = 1
    out.inverse = space_of(light[0]).inverse
    if limits[0] < 4.0:
        width = wp.max(-limits[3] - limits[0], _LEAST_ANGLE)
        height = wp.max(-limits[4] - limits[1], _LEAST_ANGLE)
        # How wide a radian of azimuth is on the average.
        middle = wp.cos(0.5 * (limits[1] - limits[4])) * wp.sin(0.5 * height) / (0.5 * height)
        columns = wp.sqrt(float(tiles) * width * wp.max(middle, 1.0e-3) / height)
        out.columns = int(wp.clamp(wp.round(columns), 1.0, float(tiles)))
        out.rows = tiles // out.columns
        out.west = limits[0]
        out.south = limits[1]
        out.near = limits[2]
        out.columns_per_radian = float(out.columns) / width
        out.rows_per_radian = float(out.rows) / height
        out.cells_per_distance = float(cells) / wp.max(-limits[5] - limits[2], _LEAST_DISTANCE)
    grid[0] = out


@wp.kernel(enable_backward=False)
def place_tiles(tiles: Tiles):
    """Empty tiles, and the direction in the middle of each."""
    i = wp.tid()
    grid = tiles.grid[0]
    row = i // grid.columns
    azimuth = grid.west + (float(i - row * grid.columns) + 0.5) / grid.columns_per_radian
    elevation = grid.south + (float(row) + 0.5) / grid.rows_per_radian
    flat = wp.cos(elevation)
    tiles.center[i] = wp.vec3(flat * wp.sin(azimuth), wp.sin(elevation), flat * wp.cos(azimuth))
    tiles.radius[i] = -1.0
    tiles.lowest[i] = _FAR_OUT
    tiles.highest[i] = -_FAR_OUT
    tiles.load[i] = 0


@wp.kernel(enable_backward=False)
def map_rays(
    absent: int,
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    group: wp.array(dtype=wp.uint8),
    polar: wp.array(dtype=wp.vec3),
    tiles: Tiles,
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
):
    """The pair (tile, ray) of every ray, and the bounds of the tiles. Rays that do not take part go to the end."""
    i = wp.tid()
    order[i] = i
    if group[i] != wp.uint8(IN_TREE) or states[i] == wp.uint8(SHADOWED):
        keys[i] = absent
        return
    at = polar[i]
    tile = tile_of(tiles.grid[0], at[0], at[1])
    keys[i] = tile
    way = direction_of(rays[i])
    radius = wp.length(wp.vec3(way[0], way[1], way[2]) - tiles.center[tile])
    if radius > tiles.radius[tile]:
        wp.atomic_max(tiles.radius, tile, radius)
    if at[2] < tiles.lowest[tile]:
        wp.atomic_min(tiles.lowest, tile, at[2])
    if at[2] > tiles.highest[tile]:
        wp.atomic_max(tiles.highest, tile, at[2])


# Algorithm 1: hard boundaries between tiles, a segmented scan of ones that counts the rays of each tile, soft
# boundaries after every so many of them, and a stream compaction that leaves the first ray of each work item.


@wp.kernel(enable_backward=False)
def flag_tiles(absent: int, keys: wp.array(dtype=int), flags: wp.array(dtype=int)):
    """1 at the first ray of each tile."""
    i = wp.tid()
    flag = int(0)
    if keys[i] != absent:
        flag = 1
        if i > 0:
            if keys[i - 1] == keys[i]:
                flag = 0
    flags[i] = flag


@wp.kernel(enable_backward=False)
def note_starts(scan: wp.array(dtype=int), starts: wp.array(dtype=int), flags: wp.array(dtype=int)):
    """Where each flag is, in order. ``flags`` and their inclusive ``scan`` may not be the same array."""
    i = wp.tid()
    if flags[i] != 0:
        starts[scan[i] - 1] = i


@wp.kernel(enable_backward=False)
def flag_items(
    absent: int,
    threshold: int,
    keys: wp.array(dtype=int),
    scan: wp.array(dtype=int),
    starts: wp.array(dtype=int),
    flags: wp.array(dtype=int),
):
    """1 at every ``threshold``-th ray of each tile: the rank in its tile is what a segmented scan of ones gives."""
    i = wp.tid()
    flag = int(0)
    if keys[i] != absent:
        if (i - starts[scan[i] - 1]) % threshold == 0:
            flag = 1
    flags[i] = flag


@wp.kernel(enable_backward=False)
def end_items(
    absent: int,
    count: int,
    keys: wp.array(dtype=int),
    scan: wp.array(dtype=int),
    segments: wp.array(dtype=int),
    items: wp.array(dtype=int),
    counts: wp.array(dtype=int),
):
    """The end of the last work item, and ``counts``: work items, tiles with rays. The last ray is alone in knowing."""
    i = wp.tid()
    if keys[i] == absent:
        return
    last = bool(i + 1 == count)
    if not last:
        last = keys[i + 1] == absent
    if last:
        items[scan[i]] = i + 1
        counts[0] = scan[i]
        counts[1] = segments[i]


@wp.kernel(enable_backward=False)
def scan_flags(count: int, flags: wp.array(dtype=int), sums: wp.array(dtype=int)):
    """Inclusive sums, one thread: recordings on the CPU hold kernels only."""
    sum = int(0)
    for i in range(count):
        sum += flags[i]
        sums[i] = sum


class TiledRays:
    """Rays of a pass in tiles of the two angles.

    After ``make``: ``tiles``; the sorted pairs ``keys`` (tiles) and ``order`` (rays); ``items``, where in that order
    each work item begins, and one more; ``counts``: [0] work items, [1] tiles with rays; ``polar``: (azimuth,
    elevation, t) by ray.
    """

    def __init__(self, context: Context, admission: Admission, rays_per_tile: int, cells: int, threshold: int) -> None:
        self._context, self._admission = context, admission
        self._rays_per_tile, self._cells, self.threshold = rays_per_tile, cells, threshold
        device, rays = context.samples.device, context.samples.bounds.max_rays
        self._sort = KeySort(rays, device)
        self.keys, self.order = self._sort.keys, self._sort.values
        self.polar = wp.empty(rays, dtype=wp.vec3, device=device)
        self._limits = wp.empty(6 * _STRIPES, dtype=float, device=device)
        self._flags = wp.empty(rays, dtype=int, device=device)
        self._segments = wp.empty(rays, dtype=int, device=device)
        self._scan = wp.empty(rays, dtype=int, device=device)
        self._starts = wp.empty(rays, dtype=int, device=device)
        self.items = wp.empty(rays + 1, dtype=int, device=device)
        self.counts = wp.zeros(2, dtype=int, device=device)
        capacity = self._tiles_for(rays)
        self.tiles = Tiles()
        self.tiles.grid = wp.zeros(1, dtype=Grid, device=device)
        self.tiles.center = wp.empty(capacity, dtype=wp.vec3, device=device)
        self.tiles.radius = wp.empty(capacity, dtype=float, device=device)
        self.tiles.lowest = wp.empty(capacity, dtype=float, device=device)
        self.tiles.highest = wp.empty(capacity, dtype=float, device=device)
        self.tiles.load = wp.empty(capacity, dtype=int, device=device)

    def _tiles_for(self, rays: int) -> int:
        return max(1, rays // self._rays_per_tile)

    @property
    def tile_count(self) -> int:
        """Tiles there may be in this frame."""
        return self._tiles_for(self._context.samples.count)

    @property
    def item_bound(self) -> int:
        """The most work items there may be in this frame."""
        rays = self._context.samples.count
        return min(rays, rays // self.threshold + self.tile_count)

    def make(self, rays: Rays) -> None:
        """Measure, map, sort and split the rays that take part and are not known to be in shadow."""
        samples, light = self._context.samples, self._context.samples.light_frame_of[rays.first]
        device, count, absent = samples.device, samples.count, self.tile_count
        states, group = samples.states_of(rays.first), self._admission.groups
        wp.launch(clear_limits, dim=6 * _STRIPES, inputs=[self._limits], device=device)
        inputs = [light, samples.rays, states, group, self.polar, self._limits]
        wp.launch(measure_rays, dim=count, inputs=inputs, device=device)
        inputs = [light, absent, self._cells, self._limits, self.tiles.grid]
        wp.launch(fit_grid, dim=1, inputs=inputs, device=device)
        wp.launch(place_tiles, dim=absent, inputs=[self.tiles], device=device)
        inputs = [absent, samples.rays, states, group, self.polar, self.tiles, self.keys, self.order]
        wp.launch(map_rays, dim=count, inputs=inputs, device=device)
        self._sort.sort(count, 0, absent.bit_length())
        self._split(count, absent)

    def _split(self, count: int, absent: int) -> None:
        device = self._context.samples.device
        self.counts.zero_()
        wp.launch(flag_tiles, dim=count, inputs=[absent, self.keys, self._flags], device=device)
        self._sum(count, self._segments)
        wp.launch(note_starts, dim=count, inputs=[self._segments, self._starts, self._flags], device=device)
        inputs = [absent, self.threshold, self.keys, self._segments, self._starts, self._flags]
        wp.launch(flag_items, dim=count, inputs=inputs, device=device)
        self._sum(count, self._scan)
        wp.launch(note_starts, dim=count, inputs=[self._scan, self.items, self._flags], device=device)
        inputs = [absent, count, self.keys, self._scan, self._segments, self.items, self.counts]
        wp.launch(end_items, dim=count, inputs=inputs, device=device)

    def _sum(self, count: int, sums: wp.array) -> None:
        device = self._context.samples.device
        if forms.wide(device):
            wp.launch(scan_flags, dim=1, inputs=[count, self._flags, sums], device=device)
        else:
            wp.utils.array_scan(self._flags[:count], sums[:count], inclusive=True)

    def nbytes(self) -> int:
        """Bytes on the device."""
        tiles = self.tiles
        arrays = (self.polar, self._limits, self._flags, self._segments, self._scan, self._starts, self.items)
        arrays += (self.counts, tiles.grid, tiles.center, tiles.radius, tiles.lowest, tiles.highest, tiles.load)
        return self._sort.nbytes() + sum(int(array.capacity) for array in arrays)
