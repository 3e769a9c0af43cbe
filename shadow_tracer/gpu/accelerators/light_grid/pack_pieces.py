# SPDX-License-Identifier: Apache-2.0
"""Samples to pieces, and pieces to tiles: the kernels of ``pieces.py``, each for one thread of the CPU."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators import admission  # noqa: F401 (headers name its constants)
from shadow_tracer.gpu.accelerators.light_grid.pieces import Pieces
from shadow_tracer.gpu.accelerators.light_grid.tiles import (
    ALL_BLOCKS,
    ALL_COLUMNS,
    ALL_RAYS,
    BLOCK_RAYS,
    COLUMNS_OF,
    FIRST_BLOCK,
    FIRST_COLUMN,
    LENGTH,
    TILE,
    U_CELLS,
    Tiles,
    lay_out,
    make_lookup,
    no_column,
)
from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.exact import decision  # noqa: F401 (the same)
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.exact.light_space import FACES, space_of

_TILE = wp.constant(TILE)
_ACROSS = wp.constant(4)  # pieces that a column is wide, and a block, if it is square


@native.func_native("accelerators/light_grid/pieces16.h", calls="Pieces16::begin")
def begin_light(place: int, tiles: Tiles, pieces: Pieces):
    """Nothing is known of the pieces of a light yet, but which samples they have."""
    ...


@native.func_native("accelerators/light_grid/image16.h", calls="Image16::look_around")
def look_around(
    place: int,
    frame: LightFrame,
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
    tiles: Tiles,
    pieces: Pieces,
):
    """If some rays of a light are beyond the aligned frustum, none is asked for it."""
    ...


@native.func_native("accelerators/light_grid/shared16.h", calls="Shared16::segment")
def share_segment(
    number: int,
    kept: int,
    frame: LightFrame,
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
    tiles: Tiles,
    pieces: Pieces,
):
    """Positions of the samples of some pieces side by side, about the anchor of a light."""
    ...


@native.func_native("accelerators/light_grid/image16.h", calls="Image16::segment")
def project_segment(
    number: int,
    kept: int,
    place: int,
    frame: LightFrame,
    inverse: int,
    counted: int,
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
    states: wp.array(dtype=wp.uint8),
    wild: wp.array(dtype=int),
    wild_counts: wp.array(dtype=int),
    tiles: Tiles,
    pieces: Pieces,
    counters: wp.array2d(dtype=wp.int64),
):
    """Rays and states of some pieces side by side, for the light at ``place``."""
    ...


@native.func_native("accelerators/light_grid/pieces16.h", calls="Pieces16::finish")
def finish_light(place: int, inverse: int, tiles: Tiles, pieces: Pieces):
    """Boxes and groups of the pieces of the light at ``place``, and the extents of its rays."""
    ...


@native.func_native("accelerators/light_grid/pool16.h", calls="Pool16::list", otherwise="return 0;")
def list_pool(place: int, inverse: int, found: int, tiles: Tiles, pieces: Pieces) -> int:
    """Split large pieces of a light, or list those that are to be taken apart, from ``found`` on; returns the end."""
    ...


@native.func_native("accelerators/light_grid/pool16.h", calls="Pool16::take_apart", otherwise="return 0;")
def take_apart(
    place: int,
    begin: int,
    end: int,
    count: int,
    tiles: Tiles,
    pieces: Pieces,
    cells: wp.array(dtype=int),
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
) -> int:
    """Keys and numbers of the rays of listed pieces, behind the first ``count``; returns how many there are now."""
    ...


@native.func_native("accelerators/light_grid/pool16.h", calls="Pool16::put_together", otherwise="return 0;")
def put_together(
    number: int,
    inverse: int,
    begin: int,
    end: int,
    made: int,
    bad: int,
    tiles: Tiles,
    pieces: Pieces,
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
) -> int:
    """The rays of group ``number`` that are in the pool as new pieces, behind the first ``made``; returns how many
    there are now."""
    ...


@native.func_native("accelerators/light_grid/columns.h", calls="Columns::list", otherwise="return 0;")
def list_pieces(
    count: int,
    tiles: Tiles,
    pieces: Pieces,
    cells: wp.array(dtype=int),
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
) -> int:
    """Keys and numbers of the first ``count`` pieces, as far as they have rays; returns how many these are."""
    ...


@native.func_native("accelerators/light_grid/counting.h", calls="Counting::gather")
def to_columns(
    count: int, tiles: Tiles, cells: wp.array(dtype=int), keys: wp.array(dtype=int), order: wp.array(dtype=int)
):
    """Bring what is to be in a column together, behind the first ``count`` elements of ``keys`` (then the cell of v)
    and ``order``; ``cells`` are then where each ends."""
    ...


@native.func_native("accelerators/light_grid/columns.h", calls="Columns::pack")
def pack_column(
    column: int,
    first_block: int,
    begin: int,
    end: int,
    tiles: Tiles,
    pieces: Pieces,
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
):
    """Tiles, blocks and the box of one column: its pieces are ``order[begin:end]``, with the cells of v in ``keys``."""
    ...


@native.func_native("accelerators/light_grid/counting.h", calls="Counting::clear")
def clear_cells(tiles: Tiles, cells: wp.array(dtype=int)):
    """Nothing has been counted."""
    ...


@wp.kernel(enable_backward=False)
def project_pieces(
    lights: wp.array(dtype=LightFrame),
    counted: int,
    fresh: int,
    kept: int,
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
    states: wp.array(dtype=wp.uint8),
    wild: wp.array(dtype=int),
    wild_counts: wp.array(dtype=int),
    tiles: Tiles,
    pieces: Pieces,
    counters: wp.array2d(dtype=wp.int64),
):
    """Rays and states of the samples for all lights of a pass: some samples for each light, as long as they are in the
    cache. ``fresh``: positions that lights share are to be made, and to be ``kept`` for passes that follow."""
    wild_counts[0] = 0
    wild_counts[1] = 0
    for place in range(tiles.lights):
        begin_light(place, tiles, pieces)
        look_around(place, lights[place], samples, valid, tiles, pieces)
    for number in range(pieces.segments):
        if fresh != 0 and pieces.loose == 0:
            share_segment(number, kept, lights[0], samples, valid, tiles, pieces)
        for place in range(tiles.lights):
            project_segment(
                number,
                kept,
                place,
                lights[place],
                space_of(lights[place]).inverse,
                counted,
                samples,
                valid,
                states,
                wild,
                wild_counts,
                tiles,
                pieces,
                counters,
            )


@wp.func
def mend_pieces(
    lights: wp.array(dtype=LightFrame),
    tiles: Tiles,
    pieces: Pieces,
    cells: wp.array(dtype=int),
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
):
    """Boxes of all pieces; those that are large are made smaller."""
    clear_cells(tiles, cells)
    tiles.counts[ALL_RAYS] = 0
    pieces.count[0] = pieces.of_light * tiles.lights
    bad = int(0)
    count = int(0)
    for place in range(tiles.lights):
        inverse = space_of(lights[place]).inverse
        finish_light(place, inverse, tiles, pieces)
        end = list_pool(place, inverse, bad, tiles, pieces)
        count = take_apart(place, bad, end, count, tiles, pieces, cells, keys, order)
        bad = end
    if count == 0:
        return
    to_columns(count, tiles, cells, keys, order)
    made = int(0)
    begin = int(0)
    for number in range(FACES * tiles.lights):
        last = cells[(number + 1) * U_CELLS - 1]
        if last > begin:
            inverse = space_of(lights[number // FACES]).inverse
            made = put_together(number, inverse, count + begin, count + last, made, bad, tiles, pieces, keys, order)
        begin = last


@wp.kernel(enable_backward=False)
def pack_pieces(
    lights: wp.array(dtype=LightFrame),
    tiles: Tiles,
    pieces: Pieces,
    cells: wp.array(dtype=int),
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
):
    """Pieces to tiles, blocks and columns."""
    mend_pieces(lights, tiles, pieces, cells, keys, order)
    clear_cells(tiles, cells)
    found = list_pieces(pieces.count[0], tiles, pieces, cells, keys, order)
    to_columns(found, tiles, cells, keys, order)
    begin = int(0)
    column = int(0)
    block = int(0)
    for number in range(FACES * tiles.lights):
        end = cells[(number + 1) * U_CELLS - 1]
        members = end - begin
        last = column + lay_out(number, _TILE * begin, _TILE * members, _ACROSS, column, block, tiles)
        for k in range(column + tiles.groups[number, COLUMNS_OF], last):
            no_column(k, tiles)
        length = tiles.groups[number, LENGTH] // _TILE
        for k in range(tiles.groups[number, COLUMNS_OF]):
            pack_column(
                tiles.groups[number, FIRST_COLUMN] + k,
                tiles.groups[number, FIRST_BLOCK] + k * (length // 16),
                found + begin + k * length,
                found + begin + wp.min(members, (k + 1) * length),
                tiles,
                pieces,
                keys,
                order,
            )
        make_lookup(number, tiles)
        column = last
        block += (_TILE * members + BLOCK_RAYS - 1) // BLOCK_RAYS
        begin = end
    tiles.counts[ALL_COLUMNS] = column
    tiles.counts[ALL_BLOCKS] = block
