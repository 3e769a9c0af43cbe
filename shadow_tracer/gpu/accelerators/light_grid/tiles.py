# SPDX-License-Identifier: Apache-2.0
"""Tiles of the variant ``packed``: equal numbers of rays that lie close together, seen from the light.

All rays of a light go into one frustum, the *aligned* one around +W, if they all have W > 0 and |U|, |V| <= 2 W (spots,
lights outside the view, far and directional lights); else into six cube faces. On a face a ray is (u, v), the two other
coordinates divided by the one along the face's axis. On CUDA the rays of a face are sorted by u and cut into columns of
equal numbers; the rays of each column are sorted by v and cut into tiles of 32 (sort-tile-recursive packing:
Leutenegger, Lopez and Edgington 1997, "STR: a simple and efficient algorithm for R-tree packing"). So there is no tile
without rays and none with many, wherever rays crowd. On the CPU tiles are pieces of the image (``pieces.py``). Tile
rectangles and depth ranges are taken from the rays themselves; how these came together decides about time only.

Sixteen tiles are a *block*, up to sixteen blocks a column, and columns come in sixteens: each of the three levels has
boxes in (u, v, depth), a box of a higher level holding the rays of those below it. Boxes lie in groups of sixteen, each
quantity of all of them together: [group][cu cv eu ev tmin tmax][16]. A box without rays has half extents of -1e30,
which fails every test by far. t is the depth of light space (``light_space.py``) with h divided by its coordinate along
the face's axis, not by its largest: in the aligned frustum |h| there is up to twice as large, so |U| + |V| + |W| <= 5
and the magnitude bound of a box is 6 + 2.001 max |t| in place of 4 + 2.001 max |t|.

A ray's u and v are within 2 u of exact relative, values up to 2; half extents are padded by 16 u for that and for their
own rounding, depths by 8 u relative. On the CPU both are off by a little more (docs/exactness.md, "positions that
lights share").
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.device.sort import KeySort
from shadow_tracer.gpu.exact.light_space import FACES
from shadow_tracer.gpu.samples.sample_set import SampleSet

TILE = 32  # rays
QUANTITIES = 6
GONE = -1.0e30
TILE_PAD = 2.0**-20  # of half extents; depths are padded by half of it, relative
# Bits of a key: group, cell of u, cell of v. Columns are cut at any ray, tiles too: cells are for sorting.
U_BITS, V_BITS = 11, 10
U_CELLS, V_CELLS = 2**U_BITS, 2**V_BITS
FIT_BITS = 12  # cells across the extents of a face, as bits
LOOKUP = 256
MOST_BLOCKS = 16  # of a column
BLOCK_RAYS = 16 * TILE

# Columns of ``Tiles.groups``: first ray in key order, rays, rays per column, first column, columns, first block.
FIRST_RAY = wp.constant(0)
RAYS_OF = wp.constant(1)
LENGTH = wp.constant(2)
FIRST_COLUMN = wp.constant(3)
COLUMNS_OF = wp.constant(4)
FIRST_BLOCK = wp.constant(5)
GROUP_COLUMNS = 6
# The cube face on which the aligned frustum lies.
FORWARD = wp.constant(4)
# Elements of ``Tiles.counts``.
ALL_RAYS = wp.constant(0)
ALL_COLUMNS = wp.constant(1)
ALL_BLOCKS = wp.constant(2)
native.constants(TILE_RAYS=TILE, BLOCK_RAYS=BLOCK_RAYS, TILE_QUANTITIES=QUANTITIES, GONE=GONE, COLUMN_LOOKUP=LOOKUP)
native.constants(FIT_BITS=FIT_BITS, FIT_CELLS=2**FIT_BITS, RAYS_OF=RAYS_OF, LENGTH=LENGTH, FIRST_COLUMN=FIRST_COLUMN)
native.constants(U_BITS=U_BITS, V_BITS=V_BITS, U_CELLS=U_CELLS, V_CELLS=V_CELLS, TILE_PAD=TILE_PAD, FORWARD=FORWARD)
native.constants(FIRST_BLOCK=FIRST_BLOCK, GROUP_COLUMNS=GROUP_COLUMNS, ALL_BLOCKS=ALL_BLOCKS, ALL_RAYS=ALL_RAYS)
native.constants(MOST_BLOCKS=MOST_BLOCKS)


@wp.struct
class Tiles:
    """Rays of a pass in tiles. A *group* is a face of a light: number 6 * (the light's place in the pass) + face."""

    lights: int
    samples: int  # per light
    fit: wp.array(dtype=wp.vec4)  # of each group: low u, low v, 2^12 / extent of u, of v; 0 where there is no ray
    far: wp.array(dtype=wp.vec2)  # of each group, on the CPU: beyond all rays along the face's axis; least Z of all
    aligned: wp.array(dtype=int)  # of each light: whether its rays are in one frustum
    groups: wp.array2d(dtype=int)
    columns: wp.array(dtype=float)  # boxes of the columns; each group of rays starts a new sixteen
    blocks: wp.array(dtype=float)  # boxes of the blocks, sixteen places per column
    boxes: wp.array(dtype=float)  # boxes of the tiles, sixteen per block
    # [tile][half][U V W Z magnitude][16]; lanes that are not ``live`` hold anything. On the CPU by piece (pieces.py),
    # and without magnitudes.
    rays: wp.array(dtype=float)
    magnitudes: wp.array(dtype=wp.vec2)  # on the CPU, see magnitudes16.h
    order: wp.array(dtype=int)  # ray of each lane: [tile][32]; on the CPU see ``numbers``
    source: wp.array(dtype=wp.vec2i)  # on the CPU, of a tile: the piece that has its lanes, and which it is
    # and of each piece: the piece that has its lanes, where in ``order`` its rays are, and what is to be added there
    numbers: wp.array(dtype=wp.vec3i)
    live: wp.array(dtype=int)  # of each tile: bits of the rays that are to be tested
    covered: wp.array(dtype=int)  # of each tile: whether a triangle occludes all of it
    lookup: wp.array(dtype=wp.vec2i)  # [group][cell of u]: first and last column that may touch it
    counts: wp.array(dtype=int)


@wp.func
def column_length(rays: int, across: int, fit: wp.vec4) -> int:
    """Rays per column of a face: a multiple of those of a block, such that it is about so many square tiles wide."""
    if rays <= BLOCK_RAYS:
        return BLOCK_RAYS
    aspect = wp.clamp(fit[2] / fit[3], 0.125, 8.0)  # extent in v / extent in u
    blocks = int(float(across) * wp.sqrt(float(rays) / float(TILE) * aspect) / 16.0 + 0.5)
    return BLOCK_RAYS * wp.clamp(blocks, 1, MOST_BLOCKS)


@wp.func
def column_places(rays: int, length: int) -> int:
    """Places for the columns of a group, ``length`` rays each: whole sixteens."""
    return ((rays + length - 1) // length + 15) // 16 * 16


@wp.func
def lay_out(number: int, first_ray: int, rays: int, across: int, column: int, block: int, tiles: Tiles) -> int:
    """Columns and blocks of group ``number``, whose rays begin at ``first_ray``, from ``column`` and ``block`` on;
    returns how many places for columns they take."""
    length = column_length(rays, across, tiles.fit[number])
    tiles.groups[number, FIRST_RAY] = first_ray
    tiles.groups[number, RAYS_OF] = rays
    tiles.groups[number, LENGTH] = length
    tiles.groups[number, FIRST_COLUMN] = column
    tiles.groups[number, COLUMNS_OF] = (rays + length - 1) // length
    tiles.groups[number, FIRST_BLOCK] = block
    return column_places(rays, length)


@native.func_native("accelerators/light_grid/fit.h", calls="Fit::cell")
def lookup_cell(u: float, fit: wp.vec4) -> int:
    """Cell of u in ``Tiles.lookup``: monotone, so what lies between two values lies between their cells."""
    ...


@wp.func
def make_lookup(number: int, tiles: Tiles):
    """``Tiles.lookup`` of group ``number`` from the boxes of its columns."""
    columns = tiles.groups[number, COLUMNS_OF]
    base = number * LOOKUP
    for k in range(LOOKUP):
        tiles.lookup[base + k] = wp.vec2i(columns, -1)
    for c in range(columns):
        column = tiles.groups[number, FIRST_COLUMN] + c
        box = (column >> 4) * 16 * QUANTITIES + (column & 15)
        low = lookup_cell(tiles.columns[box] - tiles.columns[box + 32], tiles.fit[number])
        high = lookup_cell(tiles.columns[box] + tiles.columns[box + 32], tiles.fit[number])
        at = tiles.lookup[base + high]
        tiles.lookup[base + high] = wp.vec2i(wp.min(at[0], c), at[1])
        at = tiles.lookup[base + low]
        tiles.lookup[base + low] = wp.vec2i(at[0], wp.max(at[1], c))
    for k in range(1, LOOKUP):
        at = tiles.lookup[base + k]
        tiles.lookup[base + k] = wp.vec2i(at[0], wp.max(at[1], tiles.lookup[base + k - 1][1]))
        m = LOOKUP - 1 - k
        at = tiles.lookup[base + m]
        tiles.lookup[base + m] = wp.vec2i(wp.min(at[0], tiles.lookup[base + m + 1][0]), at[1])


@wp.func
def no_column(column: int, tiles: Tiles):
    """Box of a column without rays."""
    base = (column >> 4) * 16 * QUANTITIES + (column & 15)
    for k in range(QUANTITIES):
        tiles.columns[base + 16 * k] = wp.where(k == 2 or k == 3, GONE, 0.0)


class TileBuffers:
    """Owns the memory of the tiles of a pass.

    Args:
        pieces: the most pieces that there may be, on the CPU.
    """

    def __init__(self, buffers: SampleSet, pieces: int = 0) -> None:
        device, rays = buffers.device, buffers.bounds.max_rays
        groups = FACES * buffers.bounds.max_lights
        # Every group may end in a column that is not full.
        self.most_blocks = max(-(-rays // BLOCK_RAYS), -(-pieces // 16)) + groups
        self.most_columns = self.most_blocks
        column_places = self.most_columns + 16 * groups
        self.sort = KeySort(max(rays, pieces), device)
        self.cells = wp.empty(groups * U_CELLS, dtype=int, device=device)
        tiles = Tiles()
        tiles.fit = wp.empty(groups, dtype=wp.vec4, device=device)
        tiles.far = wp.empty(groups, dtype=wp.vec2, device=device)
        tiles.aligned = wp.empty(buffers.bounds.max_lights, dtype=int, device=device)
        tiles.groups = wp.empty((groups, GROUP_COLUMNS), dtype=int, device=device)
        tiles.columns = wp.empty((column_places + 15) // 16 * 16 * QUANTITIES, dtype=float, device=device)
        tiles.blocks = wp.empty(column_places * 16 * QUANTITIES, dtype=float, device=device)
        tiles.boxes = wp.empty(self.most_blocks * 16 * QUANTITIES, dtype=float, device=device)
        tiles.rays = wp.empty(4 * TILE * pieces or 5 * self.most_blocks * BLOCK_RAYS, dtype=float, device=device)
        tiles.magnitudes = wp.empty(pieces, dtype=wp.vec2, device=device)
        tiles.order = wp.empty(2 * TILE * pieces or self.most_blocks * BLOCK_RAYS, dtype=int, device=device)
        tiles.source = wp.empty(self.most_blocks * 16 if pieces else 0, dtype=wp.vec2i, device=device)
        tiles.numbers = wp.empty(pieces, dtype=wp.vec3i, device=device)
        tiles.live = wp.empty(self.most_blocks * 16, dtype=int, device=device)
        tiles.covered = wp.empty(self.most_blocks * 16, dtype=int, device=device)
        tiles.lookup = wp.empty(groups * LOOKUP, dtype=wp.vec2i, device=device)
        tiles.counts = wp.zeros(3, dtype=int, device=device)
        self.tiles = tiles

    def nbytes(self) -> int:
        """Bytes on the device."""
        tiles = self.tiles
        arrays = (
            tiles.fit,
            tiles.far,
            tiles.aligned,
            tiles.groups,
            tiles.columns,
            tiles.blocks,
            tiles.boxes,
            tiles.rays,
            tiles.magnitudes,
        )
        arrays += (self.cells, tiles.order, tiles.source, tiles.numbers, tiles.live, tiles.covered)
        arrays += (tiles.lookup, tiles.counts)
        return self.sort.nbytes() + sum(int(array.capacity) for array in arrays)
