# SPDX-License-Identifier: Apache-2.0
"""Triangles into tiles, and on the CPU tiles traced.

A triangle is taken to a tile's box by the planes that the shadow test has stored (``exact/planes.h``): on a face of a
light an edge plane is A u + B v + C, and the triangle's own plane P is linear in (u, v, t). A box is rejected if a
plane is negative all over it by more than its pad, or if the triangle's bounds miss it; the triangle covers the box if
every plane is positive all over it by more than its pad. So a box that holds an occluded ray is not rejected, and every
ray of a covered box is occluded, wherever the light is; there are no poles and no seams. Pads are those of
``light_space.py``, with M = 6 + 2.001 max |t|. The text of all that is ``side.h``, for one box and for sixteen.

On CUDA (``binning.h``; ``tracing.py`` goes on from there) entries are counted, scanned, and emitted, so that each has a
running number that says whether it belongs to the part at hand: of a part, no more entries than the list holds. A
triangle that may touch many columns is not left to one thread: it becomes items of a few columns each. Emitted entries
are brought together by tile (counted on the way, scanned, scattered); lists longer than 256 are cut into chunks. A
warp's 32 lanes, one ray each, take a chunk at a time; all of them read the same record. Answers may be stored by
several warps: storing is idempotent.

On the CPU (``binning16.h``, ``together16.h``, ``entries.h``) one thread takes clusters of sixteen triangles in order,
those that may concern any ray (``candidates.py``). Triangles of a cluster that lie close together share the way to the
tiles, by flat lists, and their entries are traced at once; others go one by one, sixteen boxes at a time, and their
(tile, triangle) entries gather in a list of limited length; whenever it is full, it is sorted by tile and traced, tile
by tile: the rays of a tile stay in the cache while its triangles pass by. A limit far below all entries has two
advantages: the list stays in the cache, and tiles that are finished take no more entries.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.light_grid.tiles import Tiles
from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.device.counters import LARGEST_TILE, OVERFLOWS, PASSES
from shadow_tracer.gpu.exact.faces import Occluders
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.exact.light_space import LightSpace, space_of
from shadow_tracer.gpu.visibility.answers import Answers

# Columns of an item, and columns from which on a triangle becomes items.
_ITEM_COLUMNS = 4
_MANY_COLUMNS = 8
native.constants(ITEM_COLUMNS=_ITEM_COLUMNS, MANY_COLUMNS=_MANY_COLUMNS)


@wp.struct
class Bins:
    """Lists between triangles and tiles."""

    capacity: int  # entries
    items: wp.array(dtype=wp.vec4i)  # of large triangles: record, face, first and last column
    item_count: wp.array(dtype=int)
    itemised: wp.array(dtype=int)  # of each record: faces that became items, as bits
    offsets: wp.array(dtype=wp.int64)  # inclusive sums of entries, by triangle, then by item
    tile: wp.array(dtype=int)  # of each entry
    record: wp.array(dtype=int)
    rank: wp.array(dtype=int)  # within its tile
    length: wp.array(dtype=int)  # entries of each tile
    start: wp.array(dtype=int)  # exclusive sums of them
    total: wp.array(dtype=int)  # the same over all parts
    chunks: wp.array(dtype=int)  # exclusive sums of each tile's chunks
    sorted: wp.array(dtype=int)  # records, tile by tile
    work: wp.array(dtype=wp.vec2i)  # tile and number of the chunk in it
    emitted: wp.array(dtype=int)


@native.func_native("accelerators/light_grid/binning.h", calls="Binning::itemise")
def itemise(
    triangle: int,
    place: int,
    space: LightSpace,
    tiles: Tiles,
    occluders: Occluders,
    bins: Bins,
    answers: Answers,
):
    """Make items of a triangle that may touch many columns."""
    ...


@native.func_native("accelerators/light_grid/binning.h", calls="Binning::whole")
def bin_triangle(
    triangle: int,
    place: int,
    emit: int,
    before: wp.int64,
    window: wp.int64,
    space: LightSpace,
    tiles: Tiles,
    occluders: Occluders,
    bins: Bins,
    answers: Answers,
) -> wp.int64:
    """The entries of a triangle that did not become items: how many, and with ``emit`` they are stored."""
    ...


@native.func_native("accelerators/light_grid/binning.h", calls="Binning::item")
def bin_item(
    triangle: int,
    place: int,
    face: int,
    first_column: int,
    last_column: int,
    emit: int,
    before: wp.int64,
    window: wp.int64,
    space: LightSpace,
    tiles: Tiles,
    occluders: Occluders,
    bins: Bins,
    answers: Answers,
) -> wp.int64:
    """The same for an item."""
    ...


@wp.kernel(enable_backward=False)
def itemise_triangles(
    lights: wp.array(dtype=LightFrame), tiles: Tiles, occluders: Occluders, bins: Bins, answers: Answers
):
    """One thread per triangle of each light."""
    i = wp.tid()
    place = i // occluders.count
    itemise(i - place * occluders.count, place, space_of(lights[place]), tiles, occluders, bins, answers)


@wp.func
def before_of(bins: Bins, i: int) -> wp.int64:
    """Number of the first entry of triangle, or item, ``i``."""
    if i == 0:
        return wp.int64(0)
    return bins.offsets[i - 1]


@wp.kernel(enable_backward=False)
def bin_triangles(
    lights: wp.array(dtype=LightFrame),
    emit: int,
    window: wp.int64,
    tiles: Tiles,
    occluders: Occluders,
    bins: Bins,
    answers: Answers,
):
    """Count (into ``bins.offsets``) or emit the entries of triangles: one thread each."""
    i = wp.tid()
    place = i // occluders.count
    before = wp.int64(0)
    if emit != 0:
        before = before_of(bins, i)
        if bins.offsets[i] <= before or bins.offsets[i] <= window or before >= window + wp.int64(bins.capacity):
            return
    space = space_of(lights[place])
    found = bin_triangle(
        i - place * occluders.count, place, emit, before, window, space, tiles, occluders, bins, answers
    )
    if emit == 0:
        bins.offsets[i] = found


@wp.kernel(enable_backward=False)
def bin_items(
    lights: wp.array(dtype=LightFrame),
    emit: int,
    window: wp.int64,
    tiles: Tiles,
    occluders: Occluders,
    bins: Bins,
    answers: Answers,
):
    """Count or emit the entries of items: one thread per place for one."""
    k = wp.tid()
    i = tiles.lights * occluders.count + k
    item = wp.vec4i(0, 0, 0, -1)
    if k < wp.min(bins.item_count[0], bins.items.shape[0]):
        item = bins.items[k]
    before = wp.int64(0)
    if emit == 0:
        bins.offsets[i] = wp.int64(0)
    else:
        before = before_of(bins, i)
        if bins.offsets[i] <= before or bins.offsets[i] <= window or before >= window + wp.int64(bins.capacity):
            return
    if item[3] < item[2]:
        return
    place = item[0] // occluders.records_apart
    space = space_of(lights[place])
    found = bin_item(
        item[0] - place * occluders.records_apart,
        place,
        item[1],
        item[2],
        item[3],
        emit,
        before,
        window,
        space,
        tiles,
        occluders,
        bins,
        answers,
    )
    if emit == 0:
        bins.offsets[i] = found


@wp.struct
class EntryList:
    """Entries gathered between two tracings."""

    capacity: int  # of tile and record, which have room for sixteen more
    bounded: int  # whether the capacity is smaller than it would be without a bound
    tile_places: int
    tile: wp.array(dtype=int)
    record: wp.array(dtype=int)
    sorted: wp.array(dtype=int)
    start: wp.array(dtype=int)  # per tile
    total: wp.array(dtype=int)  # entries of each tile so far
    count: wp.array(dtype=int)  # [entries waiting, times that it was full, clusters that have records]
    visited: wp.array(dtype=int)  # by a cluster: tiles; blocks, from number tile_places on
    masks: wp.array(dtype=int)  # of each tile that is visited: the triangles that touch it, as bits
    clusters: int  # that there is room for records of
    records: wp.array(dtype=float)  # [cluster][16 triangles][16]
    first: wp.array(dtype=int)  # triangle of each cluster


@wp.struct
class Casters:
    """Triangles that may cast shadows, to be set up sixteen at a time. Of each cluster it is counted how many are found
    to cast nothing, because they are degenerate, and because they are culled; lights are ``silent_apart`` clusters
    apart."""

    count: int
    cull: int
    silent_apart: int
    silent: wp.array(dtype=wp.uint8)  # [cluster][2]
    vertices: wp.array(dtype=wp.vec3d)
    triangles: wp.array(dtype=wp.vec3i)


@native.func_native("accelerators/light_grid/binning16.h", calls="Binning16::light")
def bin_light(
    place: int,
    first_cluster: int,
    last_cluster: int,
    clusters: wp.array(dtype=int),
    faces: wp.array(dtype=wp.uint8),
    frame: LightFrame,
    space: LightSpace,
    tiles: Tiles,
    casters: Casters,
    entries: EntryList,
    answers: Answers,
):
    """The triangles of some clusters on the ``faces`` of each, and the light at ``place``; entries that are left stay
    in the list."""
    ...


@native.func_native("accelerators/light_grid/entries.h", calls="Entries::finish")
def trace_list(tiles: Tiles, entries: EntryList, answers: Answers):
    """Trace what is in the list."""
    ...


@wp.kernel(enable_backward=False)
def bin_wide(
    lights: wp.array(dtype=LightFrame),
    clusters: wp.array(dtype=int),
    faces: wp.array(dtype=wp.uint8),
    ends: wp.array(dtype=int),
    tiles: Tiles,
    casters: Casters,
    entries: EntryList,
    answers: Answers,
):
    """One thread. ``clusters``, ``faces`` and ``ends`` are those of ``candidates.py``."""
    first = int(0)
    slots = 16 * tiles.counts[2]
    for k in range(slots):
        entries.total[k] = 0
    for k in range(3):
        entries.count[k] = 0
    for place in range(tiles.lights):
        light = lights[place]
        bin_light(place, first, ends[place], clusters, faces, light, space_of(light), tiles, casters, entries, answers)
        first = ends[place]
    trace_list(tiles, entries, answers)
    largest = int(0)
    for k in range(slots):
        largest = wp.max(largest, entries.total[k])
    wp.atomic_max(answers.counters, 0, LARGEST_TILE, wp.int64(largest))
    wp.atomic_add(answers.counters, 0, PASSES, wp.int64(1))
    if entries.bounded != 0:
        wp.atomic_add(answers.counters, 0, OVERFLOWS, wp.int64(entries.count[1]))
