# SPDX-License-Identifier: Apache-2.0
"""Packs the rays of a pass into tiles on CUDA; ``pack_pieces.py`` is the way of the CPU.

Two stable radix sorts: by (group, cell of u), which cuts the columns, and by (column, cell of v), which cuts the tiles.
Then boxes, level by level. The host knows bounds of all sizes from the number of rays; threads beyond what there is
return at once.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.accelerators.admission import IN_TREE
from shadow_tracer.gpu.accelerators.light_grid.tiles import (
    ALL_BLOCKS,
    ALL_COLUMNS,
    ALL_RAYS,
    BLOCK_RAYS,
    COLUMNS_OF,
    FIRST_BLOCK,
    FIRST_COLUMN,
    FIRST_RAY,
    FORWARD,
    LENGTH,
    LOOKUP,
    QUANTITIES,
    RAYS_OF,
    U_BITS,
    V_BITS,
    V_CELLS,
    TileBuffers,
    Tiles,
    column_length,
    column_places,
    lay_out,
    lookup_cell,
    no_column,
)
from shadow_tracer.gpu.accelerators.ray_keys import cubified
from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.device.extents import STRIPES, clear_extents, joined, stripe, widen
from shadow_tracer.gpu.exact.decision import ray_magnitude
from shadow_tracer.gpu.exact.light_frame import SHADOWED, LightFrame
from shadow_tracer.gpu.exact.light_space import FACES, face_axes, space_of

LAST_KEY = wp.constant(2**31 - 1)
# Extents per light: of the six faces, and of the aligned frustum.
_EXTENTS = wp.constant(7)


@native.func_native("accelerators/light_grid/on_face.h", calls="OnFace1::fits")
def fits_frustum(ray: wp.vec4) -> bool:
    """Whether the aligned frustum holds a ray."""
    ...


@native.func_native("accelerators/light_grid/on_face.h", calls="OnFace1::place")
def place_on_face(axes: wp.vec3, z: float, inverse: int) -> wp.vec3:
    """(u, v, depth) of a ray on a face, from ``face_axes`` and Z of it."""
    ...


@wp.kernel(enable_backward=False)
def measure_rays(
    tiles: Tiles,
    rays: wp.array(dtype=wp.vec4),
    group: wp.array(dtype=wp.uint8),
    extents: wp.array(dtype=float),
    misfits: wp.array(dtype=int),
):
    """Extents of the rays of each light, on cube faces and, as long as they fit, in the aligned frustum; ``misfits``
    tells the lights whose rays do not all fit there."""
    i = wp.tid()
    if group[i] != wp.uint8(IN_TREE):
        return
    ray = rays[i]
    place = i // tiles.samples
    base = 4 * _EXTENTS * (stripe(i) * tiles.lights + place)
    on = cubified(ray)
    widen(extents, base + 4 * int(on[2]), on[0], on[1])
    if fits_frustum(ray):
        ahead = place_on_face(wp.vec3(ray[2], ray[0], ray[1]), 0.0, 0)
        widen(extents, base + 24, ahead[0], ahead[1])
    else:
        misfits[place] = 1


@wp.func_native(native.snippet("accelerators/light_grid/fit.h", call="return Fit::of(box[0], box[1], box[2], box[3]);"))
def fit_between(box: wp.vec4) -> wp.vec4:
    """``Tiles.fit`` of rays with these low u, low v, high u and high v."""
    ...


@wp.func
def fit_of(extents: wp.array(dtype=float), tiles: Tiles, place: int, which: int) -> wp.vec4:
    """``Tiles.fit`` from the rows of extents number ``which`` of a light."""
    return fit_between(joined(extents, 4 * (_EXTENTS * place + which), 4 * _EXTENTS * tiles.lights, STRIPES))


@wp.kernel(enable_backward=False)
def fit_faces(tiles: Tiles, extents: wp.array(dtype=float), misfits: wp.array(dtype=int)):
    """One thread per group."""
    number = wp.tid()
    place = number // FACES
    face = number - place * FACES
    aligned = misfits[place] == 0
    if face == 0:
        tiles.aligned[place] = wp.where(aligned, 1, 0)
    if not aligned:
        tiles.fit[number] = fit_of(extents, tiles, place, face)
    elif face == FORWARD:
        tiles.fit[number] = fit_of(extents, tiles, place, 6)
    else:
        tiles.fit[number] = wp.vec4(0.0, 0.0, 0.0, 0.0)


@native.func_native("accelerators/light_grid/keys.h", calls="Keys1::of")
def key_of(place: int, ray: wp.vec4, tiles: Tiles) -> int:
    """Key of a ray of the light at ``place``: group, cell of u, cell of v."""
    ...


@wp.kernel(enable_backward=False)
def make_keys(
    tiles: Tiles,
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    group: wp.array(dtype=wp.uint8),
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
):
    """Key of every ray; those not in tiles, or found in shadow before, go to the end."""
    i = wp.tid()
    order[i] = i
    keys[i] = LAST_KEY
    if group[i] != wp.uint8(IN_TREE) or states[i] == wp.uint8(SHADOWED):
        return
    keys[i] = key_of(i // tiles.samples, rays[i], tiles)


@wp.kernel(enable_backward=False)
def find_groups(count: int, tiles: Tiles, keys: wp.array(dtype=int), starts: wp.array(dtype=int)):
    """``starts``: first ray of each group in key order, and their number at the end."""
    i = wp.tid()
    groups = tiles.lights * FACES
    here = wp.min(keys[i] >> (U_BITS + V_BITS), groups)
    before = int(-1)
    if i > 0:
        before = wp.min(keys[i - 1] >> (U_BITS + V_BITS), groups)
    for k in range(before + 1, here + 1):
        starts[k] = i
    if i + 1 == count:
        for k in range(here + 1, groups + 1):
            starts[k] = count


@wp.kernel(enable_backward=False)
def lay_out_groups(tiles: Tiles, starts: wp.array(dtype=int)):
    """Columns and blocks of all groups. One thread per group: each adds up what those before it take, so that none
    waits for another."""
    number = wp.tid()
    column = int(0)
    block = int(0)
    for before in range(number):
        rays = starts[before + 1] - starts[before]
        column += column_places(rays, column_length(rays, 1, tiles.fit[before]))
        block += (rays + BLOCK_RAYS - 1) // BLOCK_RAYS
    rays = starts[number + 1] - starts[number]
    end = column + lay_out(number, starts[number], rays, 1, column, block, tiles)
    for k in range(column + tiles.groups[number, COLUMNS_OF], end):
        no_column(k, tiles)
    if number == tiles.lights * FACES - 1:
        tiles.counts[ALL_RAYS] = starts[number + 1]
        tiles.counts[ALL_COLUMNS] = end
        tiles.counts[ALL_BLOCKS] = block + (rays + BLOCK_RAYS - 1) // BLOCK_RAYS


@wp.kernel(enable_backward=False)
def make_column_keys(tiles: Tiles, keys: wp.array(dtype=int)):
    i = wp.tid()
    key = keys[i]
    if key == LAST_KEY:
        return
    number = key >> (U_BITS + V_BITS)
    column = tiles.groups[number, FIRST_COLUMN] + (i - tiles.groups[number, FIRST_RAY]) // tiles.groups[number, LENGTH]
    keys[i] = (column << V_BITS) | (key & (V_CELLS - 1))


@wp.func
def group_of_block(tiles: Tiles, block: int) -> int:
    """The group that has dense block number ``block``."""
    number = int(tiles.lights * FACES - 1)
    while tiles.groups[number, FIRST_BLOCK] > block or tiles.groups[number, RAYS_OF] == 0:
        number -= 1
    return number


@wp.kernel(enable_backward=False)
def fill_lanes(tiles: Tiles, rays: wp.array(dtype=wp.vec4), order: wp.array(dtype=int), group_of: wp.array(dtype=int)):
    """Copy each ray to its lane. One thread per lane."""
    lane = wp.tid()
    block = lane // BLOCK_RAYS
    if block >= tiles.counts[ALL_BLOCKS]:
        return
    number = group_of_block(tiles, block)
    if lane == block * BLOCK_RAYS:
        group_of[block] = number
    at = lane - tiles.groups[number, FIRST_BLOCK] * BLOCK_RAYS
    if at >= tiles.groups[number, RAYS_OF]:
        return
    i = order[tiles.groups[number, FIRST_RAY] + at]
    ray = rays[i]
    tiles.order[lane] = i
    base = (lane >> 4) * 80 + (lane & 15)
    for k in range(4):
        tiles.rays[base + 16 * k] = ray[k]
    tiles.rays[base + 64] = ray_magnitude(ray)


@native.func_native("accelerators/light_grid/tile_box.h", calls="TileBox::put")
def store_box(boxes: wp.array(dtype=float), place: int, low: wp.vec3, high: wp.vec3):
    """A box among its sixteen, padded; low > high says that it is empty."""
    ...


@wp.func
def join_boxes(boxes: wp.array(dtype=float), first: int, count: int):
    """(low, high) of ``count`` boxes from number ``first`` on."""
    low = wp.vec3(3.0e38, 3.0e38, 3.0e38)
    high = wp.vec3(-3.0e38, -3.0e38, -3.0e38)
    for place in range(first, first + count):
        base = (place >> 4) * 16 * QUANTITIES + (place & 15)
        eu = boxes[base + 32]
        ev = boxes[base + 48]
        if eu >= 0.0:
            low = wp.min(low, wp.vec3(boxes[base] - eu, boxes[base + 16] - ev, boxes[base + 64]))
            high = wp.max(high, wp.vec3(boxes[base] + eu, boxes[base + 16] + ev, boxes[base + 80]))
    return low, high


@wp.kernel(enable_backward=False)
def bound_tiles(lights: wp.array(dtype=LightFrame), tiles: Tiles, group_of: wp.array(dtype=int)):
    """One thread per tile."""
    tile = wp.tid()
    block = tile >> 4
    if block >= tiles.counts[ALL_BLOCKS]:
        return
    number = group_of[block]
    space = space_of(lights[number // FACES])
    face = number % FACES
    used = tiles.groups[number, RAYS_OF] - (tile - 16 * tiles.groups[number, FIRST_BLOCK]) * 32
    low = wp.vec3(3.0e38, 3.0e38, 3.0e38)
    high = wp.vec3(-3.0e38, -3.0e38, -3.0e38)
    live = int(0)
    for j in range(wp.min(used, 32)):
        base = (2 * tile + (j >> 4)) * 80 + (j & 15)
        ray = wp.vec4(tiles.rays[base], tiles.rays[base + 16], tiles.rays[base + 32], tiles.rays[base + 48])
        at = place_on_face(face_axes(face, ray), ray[3], space.inverse)
        low = wp.min(low, at)
        high = wp.max(high, at)
        live = live | (1 << j)
    tiles.live[tile] = live
    tiles.covered[tile] = 0
    store_box(tiles.boxes, tile, low, high)


@wp.func
def column_of(tiles: Tiles, column: int):
    """Its blocks and the first of them; none of a place that holds no column."""
    number = int(tiles.lights * FACES - 1)
    while tiles.groups[number, FIRST_COLUMN] > column or tiles.groups[number, RAYS_OF] == 0:
        number -= 1
    k = column - tiles.groups[number, FIRST_COLUMN]
    length = tiles.groups[number, LENGTH]
    rays = wp.min(length, tiles.groups[number, RAYS_OF] - k * length)
    if k >= tiles.groups[number, COLUMNS_OF]:
        rays = 0
    return (rays + BLOCK_RAYS - 1) // BLOCK_RAYS, tiles.groups[number, FIRST_BLOCK] + k * (length // BLOCK_RAYS)


@wp.kernel(enable_backward=False)
def bound_blocks(tiles: Tiles):
    """The box of a block. One thread per place for a block of a column."""
    place = wp.tid()
    column = place >> 4
    if column >= tiles.counts[ALL_COLUMNS]:
        return
    blocks, first = column_of(tiles, column)
    if blocks == 0:
        return
    low = wp.vec3(1.0, 1.0, 1.0)
    high = wp.vec3(-1.0, -1.0, -1.0)
    if (place & 15) < blocks:
        low, high = join_boxes(tiles.boxes, 16 * (first + (place & 15)), 16)
    store_box(tiles.blocks, place, low, high)


@wp.kernel(enable_backward=False)
def bound_columns(tiles: Tiles):
    """The box of a column. One thread per place for a column."""
    column = wp.tid()
    if column >= tiles.counts[ALL_COLUMNS]:
        return
    blocks, first = column_of(tiles, column)
    if blocks > 0:
        low, high = join_boxes(tiles.blocks, 16 * column, 16)
        store_box(tiles.columns, column, low, high)


@wp.kernel(enable_backward=False)
def make_lookups(tiles: Tiles):
    """``Tiles.lookup``, as ``make_lookup`` makes it. One thread per cell of each group; all of a group read the same
    boxes."""
    i = wp.tid()
    number = i // LOOKUP
    cell = i - number * LOOKUP
    columns = tiles.groups[number, COLUMNS_OF]
    first = tiles.groups[number, FIRST_COLUMN]
    fit = tiles.fit[number]
    from_here = int(columns)  # the first column that ends in this cell or behind it
    to_here = int(-1)  # the last that begins in it or before it
    for c in range(columns):
        column = first + c
        box = (column >> 4) * 16 * QUANTITIES + (column & 15)
        middle = tiles.columns[box]
        extent = tiles.columns[box + 32]
        if lookup_cell(middle + extent, fit) >= cell:
            from_here = wp.min(from_here, c)
        if lookup_cell(middle - extent, fit) <= cell:
            to_here = c
    tiles.lookup[i] = wp.vec2i(from_here, to_here)


class Packer:
    """Runs the kernels above; the scratch memory is its own."""

    def __init__(self, buffers: TileBuffers, max_lights: int, device: Any) -> None:
        self._buffers = buffers
        self._device = device
        self._extents = wp.empty(4 * 7 * 64 * max_lights, dtype=float, device=device)
        self._misfits = wp.empty(max_lights, dtype=int, device=device)
        self._starts = wp.empty(6 * max_lights + 1, dtype=int, device=device)
        self._group_of = wp.empty(buffers.most_blocks, dtype=int, device=device)

    def pack(self, lights: wp.array, rays: wp.array, states: wp.array, group: wp.array) -> None:
        """Pack the rays of the pass that ``buffers.tiles`` describes."""
        tiles, sort, device = self._buffers.tiles, self._buffers.sort, self._device
        count, groups = tiles.lights * tiles.samples, 6 * tiles.lights

        def launch(kernel: Any, dim: int, *inputs: Any) -> None:
            wp.launch(kernel, dim=dim, inputs=inputs, device=device)

        launch(clear_extents, 4 * 7 * 64 * tiles.lights, self._extents)
        self._misfits.zero_()
        launch(measure_rays, count, tiles, rays, group, self._extents, self._misfits)
        launch(fit_faces, groups, tiles, self._extents, self._misfits)
        launch(make_keys, count, tiles, rays, states, group, sort.keys, sort.values)
        # So many bits that what goes to the end comes behind the last group.
        sort.sort(count, V_BITS, V_BITS + U_BITS + groups.bit_length())
        launch(find_groups, count, count, tiles, sort.keys, self._starts)
        launch(lay_out_groups, groups, tiles, self._starts)
        launch(make_column_keys, count, tiles, sort.keys)
        blocks = -(-count // BLOCK_RAYS) + groups
        columns = blocks + 16 * groups
        # One more than there are columns, so that what goes to the end comes behind the last of them.
        sort.sort(count, 0, V_BITS + (columns + 1).bit_length())
        launch(fill_lanes, blocks * BLOCK_RAYS, tiles, rays, sort.values, self._group_of)
        launch(bound_tiles, 16 * blocks, lights, tiles, self._group_of)
        launch(bound_blocks, 16 * columns, tiles)
        launch(bound_columns, columns, tiles)
        launch(make_lookups, LOOKUP * groups, tiles)

    def nbytes(self) -> int:
        """Bytes on the device."""
        return sum(int(array.capacity) for array in (self._extents, self._misfits, self._starts, self._group_of))
