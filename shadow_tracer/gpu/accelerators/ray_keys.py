# SPDX-License-Identifier: Apache-2.0
"""Sorting rays by direction: cube face, then a space-filling curve over the face (Arvo and Kirk 1987, "Fast Ray Tracing
by Ray Classification"; section 3.5 of the cone-hierarchy paper).

A direction is *cubified*: divided by its largest component, it lies on the face of that axis and sign, at (u, v) =
the other two components in [-1, 1]. The curve's 2^14 x 2^14 cells are fitted to the rays of each face, square: a far
light would otherwise put all rays into one cell. The mapping to cells is a monotone function of u and of v, so whatever
lies between two values lies between their cells.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.admission import IN_TREE, Admission
from shadow_tracer.gpu.accelerators.interface import Context
from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.device.extents import STRIPES, clear_extents, joined, stripe, widen
from shadow_tracer.gpu.device.sort import KeySort
from shadow_tracer.gpu.exact.light_frame import SHADOWED
from shadow_tracer.gpu.exact.light_space import FACES

CURVE_BITS = 14
KEY_BITS = 3 + 2 * CURVE_BITS
CELLS = 2.0**CURVE_BITS
# Rays within one of the 2^17 cells of a face may stay in image order, which is as good and takes fewer bits to sort;
# the lookup table needs 2^16 (``boxes.py``).
_SORTED_BITS = (11, KEY_BITS)
LAST_KEY = wp.constant(2**31 - 1)
native.constants(CURVE_BITS=CURVE_BITS)


@wp.func_native(
    native.snippet(
        "exact/cube.h",
        call="""
    OnCube1 at;
    at.look(ray[0], ray[1], ray[2]);
    return wp::vec3(at.u, at.v, (float)at.face);""",
    )
)
def cubified(ray: wp.vec4) -> wp.vec3:
    """(u, v, face) of a ray."""
    ...


@native.func_native("accelerators/ray_keys.h", calls="CubeCell1::cell")
def cell_of(x: float, low: float, scale: float) -> int:
    """Cell of a face coordinate: monotone in ``x``."""
    ...


@native.func_native("accelerators/ray_keys.h", calls="CubeCell1::morton")
def morton_index(x: int, y: int) -> int:
    """Position on the Morton curve."""
    ...


@wp.func
def hilbert_index(x: int, y: int) -> int:
    """Position on the Hilbert curve over 2^14 x 2^14 cells."""
    index = int(0)
    bit = int(1 << (CURVE_BITS - 1))
    while bit > 0:
        right = wp.where((x & bit) != 0, 1, 0)
        upper = wp.where((y & bit) != 0, 1, 0)
        index = (index << 2) | ((3 * right) ^ upper)
        # Turn the quadrant so that the curve enters and leaves it where its neighbours do.
        if upper == 0:
            if right != 0:
                x = (bit - 1) & ~x
                y = (bit - 1) & ~y
            swap = x
            x = y
            y = swap
        bit = bit >> 1
    return index


@wp.kernel(enable_backward=False)
def measure_extent(rays: wp.array(dtype=wp.vec4), group: wp.array(dtype=wp.uint8), extent: wp.array(dtype=float)):
    """Extents (``extents.py``) of the rays of each face."""
    i = wp.tid()
    if group[i] != wp.uint8(IN_TREE):
        return
    on = cubified(rays[i])
    widen(extent, 4 * (FACES * stripe(i) + int(on[2])), on[0], on[1])


@wp.kernel(enable_backward=False)
def fit_cells(stripes: int, extent: wp.array(dtype=float), fit: wp.array(dtype=wp.vec4)):
    """(low u, low v, cells per unit, 1 if the face has rays) of each face."""
    face = wp.tid()
    box = joined(extent, 4 * face, 4 * FACES, stripes)
    size = wp.max(box[2] - box[0], box[3] - box[1])
    if size < 0.0:
        fit[face] = wp.vec4(0.0, 0.0, 0.0, 0.0)
    else:
        fit[face] = wp.vec4(box[0], box[1], CELLS / wp.max(size, 1.0e-12), 1.0)


@wp.kernel(enable_backward=False)
def make_keys(
    hilbert: int,
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    group: wp.array(dtype=wp.uint8),
    fit: wp.array(dtype=wp.vec4),
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
):
    """Key of every sample; those not in the tree, or found in shadow by an earlier traversal, go to the end."""
    i = wp.tid()
    order[i] = i
    if group[i] != wp.uint8(IN_TREE) or states[i] == wp.uint8(SHADOWED):
        keys[i] = LAST_KEY
        return
    on = cubified(rays[i])
    face = int(on[2])
    grid = fit[face]
    x = cell_of(on[0], grid[0], grid[2])
    y = cell_of(on[1], grid[1], grid[2])
    code = morton_index(x, y)
    if hilbert != 0:
        code = hilbert_index(x, y)
    keys[i] = (face << (2 * CURVE_BITS)) | code


@wp.kernel(enable_backward=False)
def count_keys(count: int, keys: wp.array(dtype=int), counts: wp.array(dtype=int)):
    """``counts[0]``: how many of the sorted keys belong to rays. The last of them is alone in knowing."""
    i = wp.tid()
    if keys[i] != LAST_KEY:
        last = bool(i + 1 == count)
        if not last:
            last = keys[i + 1] == LAST_KEY
        if last:
            counts[0] = i + 1


@native.func_native("accelerators/ray_order.h", calls="RayOrder::measure")
def measure_all(
    count: int, rays: wp.array(dtype=wp.vec4), group: wp.array(dtype=wp.uint8), extent: wp.array(dtype=float)
):
    """``clear_extents`` and ``measure_extent`` in one go."""
    ...


@native.func_native("accelerators/ray_order.h", calls="RayOrder::pack")
def pack_keys_block(
    count: int,
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    group: wp.array(dtype=wp.uint8),
    fit: wp.array(dtype=wp.vec4),
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
    counts: wp.array(dtype=int),
):
    """``make_keys`` along the Morton curve for all samples, without those that are absent."""
    ...


@wp.kernel(enable_backward=False)
def measure_extent_wide(
    count: int, rays: wp.array(dtype=wp.vec4), group: wp.array(dtype=wp.uint8), extent: wp.array(dtype=float)
):
    """One thread, on the CPU."""
    measure_all(count, rays, group, extent)


@wp.kernel(enable_backward=False)
def pack_keys(
    count: int,
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    group: wp.array(dtype=wp.uint8),
    fit: wp.array(dtype=wp.vec4),
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
    counts: wp.array(dtype=int),
):
    """One thread, on the CPU."""
    pack_keys_block(count, rays, states, group, fit, keys, order, counts)


class RayOrder:
    """Tree rays in the order of a curve: ``order[:n]`` are their sample indices, n = ``admission.counts[0]`` (on the
    device), the rest follows in no order. ``fit`` describes the cells of each face (``fit_cells``). ``packed`` (CPU
    and Morton curve only) sorts present rays alone; their number is read by the host.
    """

    def __init__(self, context: Context, admission: Admission, hilbert: bool, packed: bool = False) -> None:
        self._context = context
        self._admission = admission
        self._hilbert = int(hilbert)
        self._packed = packed
        device = context.samples.device
        self._sort = KeySort(context.samples.bounds.max_rays, device)
        self._extent = wp.empty(4 * FACES * STRIPES, dtype=float, device=device)
        self.fit = wp.empty(FACES, dtype=wp.vec4, device=device)
        self.keys = self._sort.keys
        self.order = self._sort.values

    def sort(self, light: int) -> None:
        """Order the tree rays of light number ``light`` that are not known to be in shadow."""
        samples, who = self._context.samples, self._admission
        device, count, states = samples.device, samples.count, samples.states_of(light)
        if self._packed:
            # One thread: it can pack the keys of present rays as it goes, so that only they are sorted.
            wp.launch(measure_extent_wide, dim=1, inputs=[count, samples.rays, who.groups, self._extent], device=device)
            wp.launch(fit_cells, dim=FACES, inputs=[1, self._extent, self.fit], device=device)
            inputs = [count, samples.rays, states, who.groups, self.fit, self.keys, self.order, who.counts]
            wp.launch(pack_keys, dim=1, inputs=inputs, device=device)
            self._sort.sort(int(who.counts.numpy()[0]), *_SORTED_BITS)
            return
        who.counts[0:1].zero_()
        wp.launch(clear_extents, dim=4 * FACES * STRIPES, inputs=[self._extent], device=device)
        wp.launch(measure_extent, dim=count, inputs=[samples.rays, who.groups, self._extent], device=device)
        wp.launch(fit_cells, dim=FACES, inputs=[STRIPES, self._extent, self.fit], device=device)
        inputs = [self._hilbert, samples.rays, states, who.groups, self.fit, self.keys, self.order]
        wp.launch(make_keys, dim=count, inputs=inputs, device=device)
        self._sort.sort(count, *(_SORTED_BITS if self._hilbert == 0 else (0, KEY_BITS)))
        wp.launch(count_keys, dim=count, inputs=[count, self.keys, who.counts], device=device)

    def nbytes(self) -> int:
        """Bytes on the device."""
        return self._sort.nbytes() + int(self._extent.capacity + self.fit.capacity)
