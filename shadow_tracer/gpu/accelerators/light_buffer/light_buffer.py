# SPDX-License-Identifier: Apache-2.0
"""Cells of directions around the light, with the triangles in each from the light outwards (Haines and Greenberg 1986:
"The light buffer: a shadow-testing accelerator"): a ray looks up its cell and is shown what lies there, the triangle
that hid another ray of the cell first.

Directions are those of light space (``exact/light_space.py``), on the six faces of a cube: of a near light, all around
it; of a far or directional one the samples are on the face ahead, which then is a plane that the light is at right
angles to. A face has about as many cells as there are triangles. A triangle is a member of every cell that its bounds
on the face touch; one that has no bounds there, because it reaches behind the face, or that covers more than half of
it, is on a list of the face. Members are sorted by how near to the light a triangle gets at most; a ray ends where they
are farther than its sample. What depends on the light is made again for each light, whenever it, the frame or the scene
changes. If the lists are too long, there are half as many cells along each axis, as often as it takes; if one cell a
face is too many, each ray is shown every triangle. Which it is, is decided on the device.

Why no triangle can be missed. Let the ray with the exact direction and depth (e, t) be hidden by a triangle; then the
triangle has a point on (e, t') with t' > t. In units u = 2^-24:

*Face and cell.* The stored ray is within 3 u of e, and a ray for which that is not sure, a *wild* one, is shown every
triangle (``accelerators/admission.py`` derives the same condition). Its coordinates on the face have one rounding more,
of a quotient of at most 1: 4 u. The face it is on may be another than that of e only if e is within 6 u of both; a
triangle touches a face if it comes within 16 u of it relative to its size, and its bounds are not cut off at the face's
border (``exact/faces.py``). They hold its own roundings, 4 u and 2^-27 (1 + |u|), and are 16 u (1 + |u|) wider: so
the stored ray's coordinates are between them, where they are bounds. The column is a monotone function of a coordinate,
a sum and a product that no compiler can contract, the same one for rays and bounds; what lies beyond a border counts as
at it. So the ray's cell is between the first and the last of the triangle's, along both axes, or the triangle is on the
list of the face.

*Depth.* The computed depth of a ray is within 5 u (1 + |t|) of t: a difference of 2^-46 (1 + the ray's magnitude), at
most u of the size that it is divided by, and three roundings. ``nearest`` of a triangle is at least t' + 60 u (1 +
|nearest|). If |t| is at most 8 (1 + |nearest|), the ray's depth is below nearest; if it is more, t is so far below 0
that it is, too, as t < t'. So the walk does not end before the triangle.

*The triangle that hid last* is any number below the count of triangles; a test of it decides rightly, whichever it is,
and whatever order rays, or threads, come in.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import warp as wp

from shadow_tracer.gpu.accelerators.cells import LEVELS, ROWS, level_that_fits
from shadow_tracer.gpu.accelerators.interface import Context, Rays
from shadow_tracer.gpu.accelerators.walker import Build, Walk, Walker
from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.device.stages import Stages
from shadow_tracer.gpu.exact.faces import Occluders
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.exact.light_space import FACES, WILD_RATIO, LightSpace, make_light_space
from shadow_tracer.gpu.occluders.corners import Corners

native.constants(WILD_RATIO=WILD_RATIO)
_MOST_COLUMNS = 512


@wp.struct
class Structure:
    """The cells of a light: ``columns`` and as many rows a face, 0 if there is no room for any. ``members[start[k]]``
    to ``members[start[k + 1]]`` are the triangles of list k: of a cell, or, behind all cells, of a face. ``depths``:
    how near to the light each gets. ``last``: of each cell, the triangle that hid a ray last; -1 if none has."""

    space: LightSpace
    columns: wp.array(dtype=int)
    start: wp.array(dtype=int)
    members: wp.array(dtype=int)
    depths: wp.array(dtype=float)
    last: wp.array(dtype=int)


@native.func_native("accelerators/light_buffer/on_cube.h", calls="LightCells::count")
def memberships(occluders: Occluders, space: LightSpace, triangle: int, columns: int) -> wp.int64:
    """In how many lists a triangle is."""
    ...


@native.func_native("accelerators/light_buffer/on_cube.h", calls="LightCells::enter")
def enter(
    occluders: Occluders,
    space: LightSpace,
    triangle: int,
    columns: int,
    begins: wp.array(dtype=int),
    members: wp.array(dtype=int),
    depths: wp.array(dtype=float),
):
    """Count a triangle in its lists; with ``members``, store it from ``begins`` on."""
    ...


@wp.func
def columns_at(finest: int, level: int) -> int:
    """Columns of a face, halved so many times."""
    return wp.max(finest >> level, 1)


@wp.kernel(enable_backward=False)
def count_memberships(finest: int, occluders: Occluders, space: LightSpace, needed: wp.array2d(dtype=wp.int64)):
    """How many there are at each level. One thread per level and triangle."""
    level, i = wp.tid()
    wp.atomic_add(needed, i & (ROWS - 1), level, memberships(occluders, space, i, columns_at(finest, level)))


@wp.kernel(enable_backward=False)
def choose_columns(finest: int, capacity: wp.int64, needed: wp.array2d(dtype=wp.int64), columns: wp.array(dtype=int)):
    """The most whose memberships fit, 0 if none do. One thread."""
    level = level_that_fits(needed, capacity)
    total = wp.int64(0)
    for row in range(ROWS):
        total += needed[row, level]
    columns[0] = wp.where(total <= capacity, columns_at(finest, level), 0)


@wp.kernel(enable_backward=False)
def enter_cells(
    occluders: Occluders,
    space: LightSpace,
    columns: wp.array(dtype=int),
    begins: wp.array(dtype=int),
    members: wp.array(dtype=int),
    depths: wp.array(dtype=float),
):
    """Count the triangles of each list in ``begins``; with ``members``, store them from there on. One thread each."""
    if columns[0] > 0:
        enter(occluders, space, wp.tid(), columns[0], begins, members, depths)


@native.func_native("accelerators/light_buffer/heap.h", calls="HeapSort::descending")
def sort_list(first: int, last: int, members: wp.array(dtype=int), depths: wp.array(dtype=float)):
    """Sort from ``first`` to before ``last``, the largest depth first; of equal ones the smallest number."""
    ...


@wp.kernel(enable_backward=False)
def sort_lists(lists: int, made: Structure):
    """From the light outwards. One thread per list."""
    k = wp.tid()
    if k < lists and made.columns[0] > 0:
        sort_list(made.start[k], made.start[k + 1], made.members, made.depths)


class Cells(Build):
    """Nothing that depends on the scene alone."""

    walk = Walk("accelerators/light_buffer/directions.h", Structure)

    def follow(self, stages: Stages) -> None:
        """There is nothing."""


class LightBuffer(Walker):
    """The ``light_buffer`` pipeline: each set of samples has cells, as its lights are others."""

    def __init__(self, variant: str, context: Context) -> None:
        super().__init__(Cells(variant, context.scene), context)
        bounds, device = context.samples.bounds, context.samples.device
        self._corners = context.shared.take(Corners, lambda: Corners(context.records))
        lists = self._lists(self._columns(bounds.max_triangles))
        self._needed = wp.zeros((int(ROWS), int(LEVELS)), dtype=wp.int64, device=device)
        self._begins = wp.empty(lists + 1, dtype=int, device=device)
        self._no_members = wp.empty(0, dtype=int, device=device)
        self._made: tuple[Any, ...] = ()
        self._cells = Structure()
        self._cells.columns = wp.zeros(1, dtype=int, device=device)
        self._cells.start = wp.empty(lists + 1, dtype=int, device=device)
        self._cells.members = wp.empty(bounds.grid_entries, dtype=int, device=device)
        self._cells.depths = wp.empty(bounds.grid_entries, dtype=float, device=device)
        self._cells.last = wp.empty(lists, dtype=int, device=device)

    @staticmethod
    def _columns(triangles: int) -> int:
        """Of a face, at most."""
        return min(math.isqrt(triangles) + 1, _MOST_COLUMNS)

    @staticmethod
    def _lists(columns: int) -> int:
        return int(FACES) * (columns * columns + 1)

    def forget(self) -> None:
        """Make cells again."""
        self._made = ()

    def aim(self, lights: Sequence[LightFrame]) -> None:
        """Records, corners and cells of the light."""
        scene, records, light = self._context.scene, self._context.records, lights[0]
        with self._context.stages.stage("setup"):
            self._corners.make(light, records.prepare(light))
        key = (scene.revision, tuple(light.light), tuple(light.center), light.inverse_scale)
        key = (*key, records.front_face_culling, scene.left_out)
        if key == self._made:
            return
        self._made = ()
        with self._context.stages.stage("build"):
            self.build.structure = self._build(light)
        self._made = key

    def _build(self, light: LightFrame) -> Structure:
        """Sort the triangles into cells."""
        device, cells, space = self._context.samples.device, self._cells, make_light_space(light)
        count, occluders = self._context.scene.triangle_count, self._context.occluders(Rays((light,)))
        occluders.corners = self._corners.of(light.number)
        finest = self._columns(count)
        lists = self._lists(finest)
        begins, start = self._begins[: lists + 1], cells.start[: lists + 1]
        cells.space = space
        cells.last[:lists].fill_(-1)
        self._needed.zero_()
        begins.zero_()
        inputs = [finest, occluders, space, self._needed]
        wp.launch(count_memberships, dim=(int(LEVELS), count), inputs=inputs, device=device)
        capacity = wp.int64(cells.members.shape[0])
        wp.launch(choose_columns, dim=1, inputs=[finest, capacity, self._needed, cells.columns], device=device)
        inputs = [occluders, space, cells.columns, begins]
        wp.launch(enter_cells, dim=count, inputs=[*inputs, self._no_members, cells.depths], device=device)
        wp.utils.array_scan(begins, start, inclusive=False)
        wp.copy(begins, start)
        wp.launch(enter_cells, dim=count, inputs=[*inputs, cells.members, cells.depths], device=device)
        wp.launch(sort_lists, dim=lists, inputs=[lists, cells], device=device)
        return cells

    def nbytes(self) -> int:
        """Bytes on the device."""
        cells = self._cells
        arrays = (self._needed, self._begins, cells.start, cells.members, cells.depths, cells.last)
        return sum(int(array.capacity) for array in arrays)
