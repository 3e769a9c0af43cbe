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
triangle that comes to many boxes is not left to one thread: it becomes items of a few columns each, which warps take
one after the other, 32 boxes of a level at a time. Emitted entries are brought together by tile (counted on the way,
scanned, scattered); long lists are cut into chunks. A warp's 32 lanes, one ray each, take a chunk at a time; all of
them read the same record. Answers may be stored by several warps: storing is idempotent.

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
from shadow_tracer.gpu.exact import records  # noqa: F401 (headers name its constants)
from shadow_tracer.gpu.exact.faces import Occluders
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.exact.light_space import FACES, LightSpace, space_of
from shadow_tracer.gpu.visibility.answers import Answers

# Columns of an item: of the worst one, all of whose boxes are looked at, a lane looks at 1 + 4 + 64 boxes. Boxes that a
# thread looks at before it leaves its triangle to warps; at most 16 more.
ITEM_COLUMNS = 8
LONG_WALK = 64
# What becomes of a triangle: one thread takes it; it has become items; a warp takes it, as there was no room for items.
SHORT = wp.constant(0)
IN_ITEMS = wp.constant(1)
LONG = wp.constant(2)
native.constants(ITEM_COLUMNS=ITEM_COLUMNS, LONG_WALK=LONG_WALK, SHORT=SHORT, IN_ITEMS=IN_ITEMS, LONG=LONG)

# Elements of ``Bins.item_count``: items, and the next one, or chunk, that no warp has taken.
ITEMS = wp.constant(0)
NEXT_TO_COUNT = wp.constant(1)
NEXT_TO_EMIT = wp.constant(2)
NEXT_TO_TRACE = wp.constant(3)


@wp.struct
class Bins:
    """Lists between triangles and tiles."""

    capacity: int  # entries
    items: wp.array(dtype=wp.vec4i)  # of large triangles: record, face, first and last column
    item_count: wp.array(dtype=int)
    length_of: wp.array(dtype=int)  # of each triangle of each light: SHORT, IN_ITEMS or LONG
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


@native.func_native("accelerators/light_grid/binning.h", calls="Binning::whole")
def bin_triangle(
    unit: int,
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
    """The entries of a triangle, number ``unit`` of all: how many, and with ``emit`` they are stored. None of one that
    is too long for a thread."""
    ...


@native.func_native("accelerators/light_grid/binning.h", calls="Binning::itemise")
def itemise(
    unit: int,
    triangle: int,
    place: int,
    space: LightSpace,
    tiles: Tiles,
    occluders: Occluders,
    bins: Bins,
    answers: Answers,
):
    """Make items of a triangle that is ``LONG``, which then is ``IN_ITEMS``, if there is room for them."""
    ...


@native.func_native("accelerators/light_grid/binning.h", calls="Binning::together")
def bin_together(
    triangle: int,
    place: int,
    first_face: int,
    last_face: int,
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
    """The same as ``bin_triangle`` by a warp, for some faces and columns of a triangle."""
    ...


@wp.func_native(native.snippet("device/warp.h", call="return Warp::works(thread);"))
def works(thread: int) -> bool:
    """Whether a thread of a warp has anything to do."""
    ...


@wp.func_native(native.snippet("device/warp.h", call="return Warp::take(counters.data + which);"))
def take(counters: wp.array(dtype=int), which: int) -> int:
    """The next number of a counter, for all lanes of a warp."""
    ...


@wp.func_native(native.snippet("device/warp.h", call="return Warp::first();"))
def first_lane() -> int:
    """The first lane of its warp that this thread does the work of."""
    ...


@wp.func_native(native.snippet("device/warp.h", call="return Warp::last();"))
def last_lane() -> int:
    """The lane behind the last of them."""
    ...


@wp.func_native(native.snippet("device/warp.h", call="return (int)Warp::joined((unsigned)own);"))
def joined(own: int) -> int:
    """A bit for each lane of a warp, from those that each thread has for the lanes it does the work of."""
    ...


@wp.func_native(native.snippet("device/warp.h", call="return Warp::lowest((unsigned)mask);"))
def lowest(mask: int) -> int:
    """The lowest bit of a mask that is not 0."""
    ...


@wp.func
def left_to_warps(unit: int, units: int, bins: Bins) -> int:
    """Which of 32 triangles from ``unit`` on are ``LONG``, as bits."""
    own = int(0)
    for lane in range(first_lane(), last_lane()):
        if unit + lane < units and bins.length_of[unit + lane] == LONG:
            own = own | (1 << lane)
    return joined(own)


@wp.func
def begins(bins: Bins, i: int) -> wp.int64:
    """Number of the first entry of triangle, or item, ``i``."""
    if i == 0:
        return wp.int64(0)
    return bins.offsets[i - 1]


@wp.func
def concerned(bins: Bins, i: int, window: wp.int64) -> bool:
    """Whether any of the entries of triangle, or item, ``i`` are among those that a list from ``window`` on holds."""
    before = begins(bins, i)
    end = bins.offsets[i]
    return end > before and end > window and before < window + wp.int64(bins.capacity)


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
        if not concerned(bins, i, window):
            return
        before = begins(bins, i)
    space = space_of(lights[place])
    found = bin_triangle(
        i, i - place * occluders.count, place, emit, before, window, space, tiles, occluders, bins, answers
    )
    if emit == 0:
        bins.offsets[i] = found


@wp.kernel(enable_backward=False)
def itemise_triangles(
    lights: wp.array(dtype=LightFrame), tiles: Tiles, occluders: Occluders, bins: Bins, answers: Answers
):
    """One thread per triangle of each light."""
    i = wp.tid()
    place = i // occluders.count
    itemise(i, i - place * occluders.count, place, space_of(lights[place]), tiles, occluders, bins, answers)


@wp.kernel(enable_backward=False)
def bin_long(
    lights: wp.array(dtype=LightFrame),
    emit: int,
    window: wp.int64,
    tiles: Tiles,
    occluders: Occluders,
    bins: Bins,
    answers: Answers,
):
    """The same for what is too long for a thread: warps take one item after the other, then 32 triangles, of which
    they look at those that there was no room for."""
    if not works(wp.tid()):
        return
    units = tiles.lights * occluders.count
    items = wp.min(bins.item_count[ITEMS], bins.items.shape[0])
    job = take(bins.item_count, NEXT_TO_COUNT + emit)
    while job < items + (units + 31) // 32:
        item = wp.vec4i(0, 0, 0, -1)
        mask = int(0)
        base = 32 * (job - items)
        if job < items:
            item = bins.items[job]
            mask = wp.where(item[3] >= item[2], 1, 0)
        else:
            mask = left_to_warps(base, units, bins)
        while mask != 0:
            i = units + job
            place = item[0] // occluders.records_apart
            triangle = item[0] - place * occluders.records_apart
            first_face = item[1]
            last_face = item[1]
            if job >= items:
                i = base + lowest(mask)
                place = i // occluders.count
                triangle = i - place * occluders.count
                first_face = 0
                last_face = FACES - 1
                item = wp.vec4i(0, 0, 0, 2147483647)
            before = wp.int64(0)
            if emit != 0:
                before = begins(bins, i)
            if emit == 0 or concerned(bins, i, window):
                found = bin_together(
                    triangle,
                    place,
                    first_face,
                    last_face,
                    item[2],
                    item[3],
                    emit,
                    before,
                    window,
                    space_of(lights[place]),
                    tiles,
                    occluders,
                    bins,
                    answers,
                )
                if emit == 0:
                    bins.offsets[i] = found
            mask = mask & (mask - 1)
        job = take(bins.item_count, NEXT_TO_COUNT + emit)


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
    hidden: wp.array(dtype=int)  # of each tile: bits of the rays that triangles are certain to hide
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
    """Trace what is in the list, and write down what has been found."""
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
        entries.hidden[k] = 0
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
