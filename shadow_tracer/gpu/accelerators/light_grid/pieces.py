# SPDX-License-Identifier: Apache-2.0
"""Pieces: 32 samples that lie together whatever the light, and so mostly do for it. On the CPU the tiles of ``packed``
are pieces in the order of (u, v).

Of an image a piece has 8 x 4 pixels, of points, and of small or narrow images, 32 samples in a row; which ones is
written down once per shape. Points that seem to come in rows (``rows.h``) are taken for an image; of such as come in no
order all pieces are taken apart. So rays are written straight to where they stay (``image16.h``): none is sorted, and
positions are looked up once for all lights of a frame (``shared16.h``, ``aim16.h``).

A piece on an edge of what the camera sees, or in a fog, may look large from the light: its box holds several times as
many rays as the piece itself. If its two halves along the longer side do not, they are two pieces, with the same lanes.
Else it is taken apart, and so is one whose rays are on several cube faces (``pool16.h``): their rays are sorted by u
and cut into columns, those by v, and every 32 of them are a piece, as sort-tile-recursive packing has it. The places
that they leave are enough for all of these but one per group, which may not be full.

Then pieces, not rays, are packed (``columns.h``). Which rays a piece has decides about time alone; what is asked of a
triangle is asked of the piece's box, which is that of its rays.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from shadow_tracer.gpu.accelerators.light_grid.tiles import TILE, TileBuffers
from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.device.launches import Launches
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.exact.light_space import FACES
from shadow_tracer.gpu.samples.sample_set import SampleSet

# Pixels of a piece; of points there is one row.
_ROWS, _COLUMNS = 4, 8
# Samples of a row that are worked on together, and pieces of which there may be so many times more than samples fill.
SEGMENT = 256
_SPARSE, _SPLIT = 1.25, 0.25
NO_GROUP, _SEVERAL_FACES = -1, -2
_LEAST, _MOST = 1.0, 4.0  # times the rays of a piece, see ``limit_of``
_CELLS = 64  # of the table of rays, each way
_LEAST_ROW, _MOST_ROW = 24, 4096  # points that a row may have
# Positions that lights share, see docs/exactness.md: steps in units of the anchor's scale, and how far they reach; the
# longest way from a sample to where its ray begins, in these units and in parts of its way to the light; the nearest
# that a ray may be to the light. What bounds of the filter grow by: a constant, and so many times the way.
_STEP, _FAR, _LONGEST, _PART, _NEAREST = 2.0**-31, 1.0 - 2.0**-20, 2.0**-4, 0.25, 2.0**-5
_FLOOR, _FACTOR = 2.0**-8, 4.0
native.constants(PLACE_STEP=_STEP, PLACE_MOST=_FAR, LARGEST_STEP=_LONGEST, MOST_PART=_PART, NEAREST=_NEAREST)
native.constants(PLACE_FLOOR=_FLOOR, STEP_FACTOR=_FACTOR)
native.constants(PIECE_ROWS=_ROWS, SEGMENT=SEGMENT, NO_GROUP=NO_GROUP, SEVERAL_FACES=_SEVERAL_FACES)
native.constants(POOL_CELLS=_CELLS, LEAST_ROW=_LEAST_ROW, MOST_ROW=_MOST_ROW)


@wp.struct
class Pieces:
    """Those of the lights of a pass, light after light, and behind them such as are made of taken ones."""

    of_light: int
    rows: int  # of samples in a piece
    width: int  # samples of a row
    across: int  # pieces side by side
    segments: int  # of a light
    loose: int  # whether pieces are of points in no order, which are all to be taken apart
    room: int  # for pieces and what is split of them
    limit: float  # rays that the box of a piece may hold, see ``limit_of``
    pool_order: int  # where in ``Tiles.order`` the rays of made pieces are
    rays: wp.array(dtype=wp.vec4)  # by number, those that are wild or taken apart
    box: wp.array(dtype=float)  # [piece][low u v t, high u v t]
    live: wp.array(dtype=int)  # bits of the rays that are in it
    group: wp.array(dtype=int)  # that its rays are in, or below zero
    count: wp.array(dtype=int)  # pieces there are
    extents: wp.array(dtype=float)  # of the rays of each light on each face
    more: wp.array(dtype=float)  # of each light: what bounds of the filter grow by, see ``aim16.h``
    turned: wp.array(dtype=int)  # of each light not in the aligned frustum: the first piece that was asked for its face
    table: wp.array(dtype=int)  # rays below and left of each corner of cells
    pool: wp.array(dtype=int)  # pieces that are taken apart
    # Shared by all lights, see ``shared16.h``: of the pieces of one of them.
    places: wp.array(dtype=int)  # [piece][x y z][32] steps from the anchor
    steps: wp.array(dtype=float)  # [piece][32] how far the ray begins from its sample
    longest: wp.array(dtype=float)  # of these; below zero if the positions of the piece do not fit
    there: wp.array(dtype=int)  # bits of the lanes that hold a sample with a measurement


@native.func_native("accelerators/light_grid/rows.h", calls="Rows::find", otherwise="return 0;")
def points_of_row(count: int, samples: wp.array(dtype=wp.vec4d)) -> int:
    """How many points a row seems to have, 0 if they come in no rows, below zero if in no order."""
    ...


@wp.kernel(enable_backward=False)
def find_rows(count: int, samples: wp.array(dtype=wp.vec4d), found: wp.array(dtype=int)):
    if count > 0:
        found[0] = points_of_row(count, samples)


def most_pieces(rays: int, lights: int) -> int:
    """Pieces of so many rays and lights, such as are split off or made included."""
    return int((_SPARSE + _SPLIT) * (rays // TILE + lights)) + 1 + int(FACES) * lights


def shape_of(count: int, width: int) -> tuple[int, int]:
    """Rows of a piece, and samples of a row, for ``count`` samples of an image that is ``width`` wide, or of points
    (0)."""
    if width:
        pieces = -(-width // _COLUMNS) * -(-count // (width * _ROWS))
        if pieces <= _SPARSE * -(-count // TILE):
            return _ROWS, width
    return 1, max(count, 1)


def samples_of(count: int, rows: int, width: int) -> npt.NDArray[np.int32]:
    """(P, 32) number of the sample of each lane of all pieces of ``shape_of``, 0 where there is none."""
    columns, height = TILE // rows, -(-count // width)
    numbers = np.zeros((-(-height // rows) * rows, -(-width // columns) * columns), np.int32)
    numbers[:height, :width].flat[:count] = np.arange(count, dtype=np.int32)
    four = numbers.reshape(numbers.shape[0] // rows, rows, numbers.shape[1] // columns, columns)
    return np.ascontiguousarray(four.transpose(0, 2, 1, 3)).reshape(-1, TILE)


def limit_of(rays: int, triangles: int) -> float:
    """Of how many rays the box of a piece may be worth: the more triangles there are for each ray, the more does a
    large box cost, and the less does sorting."""
    return TILE * min(max(_LEAST, _MOST * rays / max(triangles, 1)), _MOST)


def _shines_everywhere(light: LightFrame) -> bool:
    """Whether it has neither a cone nor a range, see ``aim16.h``."""
    return light.light[3] == 0.0 or (light.cosine < -1.0 and light.reach == np.inf)


class PieceBuffers:
    """Owns the memory of the pieces of a pass, and knows which samples they have."""

    def __init__(self, samples: SampleSet, tiles: TileBuffers) -> None:
        device, bounds = samples.device, samples.bounds
        self._samples, self._tiles, self._launch = samples, tiles, Launches(device)
        most = most_pieces(bounds.max_rays, bounds.max_lights)
        pieces = Pieces()
        pieces.room, pieces.pool_order = most - int(FACES) * bounds.max_lights, TILE * most
        pieces.rays = samples.rays
        pieces.box = wp.empty(6 * most, dtype=float, device=device)
        pieces.live = wp.empty(most, dtype=int, device=device)
        pieces.group = wp.empty(most, dtype=int, device=device)
        pieces.count = wp.zeros(1, dtype=int, device=device)
        pieces.extents = wp.empty(96 * int(FACES) * bounds.max_lights, dtype=float, device=device)
        pieces.more = wp.empty(bounds.max_lights, dtype=float, device=device)
        pieces.turned = wp.empty(bounds.max_lights, dtype=int, device=device)
        pieces.table = wp.empty((_CELLS + 1) ** 2, dtype=int, device=device)
        pieces.pool = wp.empty(most, dtype=int, device=device)
        one = most_pieces(bounds.max_rays, 1)
        pieces.places = wp.empty(3 * TILE * one, dtype=int, device=device)
        pieces.steps = wp.empty(TILE * one, dtype=float, device=device)
        pieces.longest = wp.empty(one, dtype=float, device=device)
        pieces.there = wp.empty(one, dtype=int, device=device)
        self._pieces = pieces
        self._shape = (0, 0, 0)
        self._rows = wp.zeros(1, dtype=int, device=device)
        self._row, self._looked = 0, -1  # of the points of that revision
        self._loaded = False  # whether the kernel that looks for rows is
        self._recorded = False
        self._shared: tuple[Any, ...] = ()  # what the positions that lights share are of
        self._again = self._keep = self._kept = False  # see ``share``

    def _width(self) -> int:
        """Of the image that the samples are of, or seem to be; 0 if of none, below zero if they are in no order."""
        samples = self._samples
        if not self._loaded:  # by the first frame, whatever asks: by a later one several bands might load it at once
            self._loaded = True
            self._launch(find_rows, (0,), lambda: (1, [0, samples.positions, self._rows]))
        if samples.width or self._recorded:
            return samples.width
        if self._looked != samples.revision:
            self._looked, self._row = samples.revision, 0
            if samples.count > 4 * _LEAST_ROW:
                inputs = [samples.count, samples.positions, self._rows]
                self._launch(find_rows, (samples.count,), lambda: (1, inputs))
                self._row = int(self._rows.numpy()[0])
        return self._row

    def arrange(self) -> None:
        """Write down the samples of each piece, for a recording that takes it that they are there: other samples may
        have been in between. From now on they follow from the shape of the image alone, as its key does."""
        self._recorded = True
        self.of()

    def of(self) -> Pieces:
        """Pieces of the samples as they are now; ``Tiles.order`` says which these are."""
        pieces, count = self._pieces, self._samples.count
        width = self._width()
        pieces.loose = int(width < 0)
        shape = (count, *shape_of(count, max(width, 0)))
        if shape != self._shape:
            _, pieces.rows, pieces.width = shape
            numbers = samples_of(*shape)
            pieces.of_light = len(numbers)
            pieces.across = -(-pieces.width // (TILE // pieces.rows))
            pieces.segments = len(numbers) // pieces.across * -(-pieces.width // SEGMENT)
            self._tiles.tiles.order.numpy()[: numbers.size] = numbers.reshape(-1)
            self._shape = shape
        return pieces

    def share(self, lights: Sequence[LightFrame]) -> tuple[bool, bool]:
        """Whether positions that lights share are to be made of the samples as they are now, for a pass of ``lights``,
        and whether to keep them for further passes, or that they have been: if there is a second pass, or was one with
        the samples before. What is recorded makes them in each pass: its lights may be others when it is replayed."""
        samples, light = self._samples, lights[0]
        if self._recorded:
            return True, False
        if not any(_shines_everywhere(one) for one in lights):
            return False, False
        look = samples.revision, samples.count, samples.width, tuple(light.center), light.inverse_scale
        if look != self._shared:
            self._keep, self._kept, self._again = self._again, False, False
            self._shared = look
            return True, self._keep
        self._again = self._keep = True
        return not self._kept, True

    def shared(self, done: tuple[bool, bool]) -> None:
        """What ``share`` said has been done."""
        self._kept |= done == (True, True)

    def nbytes(self) -> int:
        """Bytes on the device."""
        pieces = self._pieces
        arrays = (pieces.box, pieces.live, pieces.group, pieces.count, pieces.extents, pieces.table, pieces.pool)
        arrays += (pieces.more, pieces.turned, pieces.places, pieces.steps, pieces.longest, pieces.there)
        return sum(int(array.capacity) for array in arrays)
