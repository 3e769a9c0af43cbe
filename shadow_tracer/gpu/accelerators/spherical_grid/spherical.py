# SPDX-License-Identifier: Apache-2.0
"""Variant ``spherical``: the light grid of Guntury and Narayanan 2010 ("Ray Tracing Dynamic Scenes with Shadows on
GPU", section 4): tiles of azimuth and elevation around the light, depth cells between near and far, rays and
triangles sorted into them, everything made again for every light and frame.

The rays of a work item (``rays.py``) are tested with the entries of their tile (``cells.py``) from
front to back, each ray up to the depth cell it starts in and no further than the first triangle that surely hides it.
The answer goes to the state of the sample, in image space: as finding a ray in shadow twice is the same as once, work
items need not know of each other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import warp as wp

from shadow_tracer.gpu.accelerators.admission import Admission
from shadow_tracer.gpu.accelerators.interface import Accelerator, Context, Rays, Traits
from shadow_tracer.gpu.accelerators.spherical_grid.cells import CellLists
from shadow_tracer.gpu.accelerators.spherical_grid.rays import TiledRays, Tiles, cell_of
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.counters import LEAF_TESTS, PASSES
from shadow_tracer.gpu.exact.decision import NO, filter_pair, ray_magnitude
from shadow_tracer.gpu.exact.faces import Occluders
from shadow_tracer.gpu.exact.light_frame import LIT, LightFrame
from shadow_tracer.gpu.occluders.corners import Corners
from shadow_tracer.gpu.visibility.answers import Answers, settle
from shadow_tracer.gpu.visibility.queries import Query


@wp.kernel(enable_backward=False)
def trace_items(
    lanes: int,
    rays: wp.array(dtype=wp.vec4),
    polar: wp.array(dtype=wp.vec3),
    ray_keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
    items: wp.array(dtype=int),
    item_counts: wp.array(dtype=int),
    tiles: Tiles,
    begins: wp.array(dtype=int),
    entry_keys: wp.array(dtype=int),
    entry_values: wp.array(dtype=int),
    records: wp.array2d(dtype=wp.vec4),
    answers: Answers,
):
    """The rays of each work item against the entries of their tile; ``lanes`` threads share an item."""
    thread = wp.tid()
    if thread == 0:
        wp.atomic_add(answers.counters, 0, PASSES, wp.int64(1))
    item = thread // lanes
    if item >= item_counts[0]:
        return
    grid = tiles.grid[0]
    first = items[item]
    tile = ray_keys[first]
    begin = begins[tile]
    end = begins[tile + 1]
    if begin >= end:
        return
    tests = int(0)
    j = first + (thread - item * lanes)
    while j < items[item + 1]:
        i = order[j]
        if answers.states[i] == wp.uint8(LIT):
            ray = rays[i]
            magnitude = ray_magnitude(ray)
            last_cell = tile * grid.cells + cell_of(grid, polar[i][2])
            e = begin
            while e < end and entry_keys[e] <= last_cell:
                triangle = entry_values[e]
                answer = filter_pair(ray, magnitude, records, triangle)
                tests += 1
                e += 1
                if answer != NO and settle(i, triangle, answer, answers):
                    e = end
        j += lanes
    if tests > 0:
        wp.atomic_add(answers.counters, thread & 63, LEAF_TESTS, wp.int64(tests))


class SphericalGrid(Accelerator):
    """The pipeline's variant ``spherical``.

    Args:
        context: what to work on.
        rays_per_tile: rays per tile of the grid on the average; at least 1.
        cells: depth cells of a tile; at least 1.
        threshold: the most rays of a work item (the paper's r); at least 1.
        fixed: whether launches depend on nothing but counts and capacities, so that a frame can be recorded; by
            default not on the CPU, where sorting an entry list that is mostly empty would cost more than reading how
            long it is.
    """

    def __init__(
        self,
        variant: str,
        context: Context,
        rays_per_tile: int = 8,
        cells: int = 16,
        threshold: int = 32,
        fixed: bool | None = None,
    ) -> None:
        self._context = context
        self.traits = Traits(recordable=not forms.wide(context.samples.device) if fixed is None else fixed)
        self._admission = Admission(context)
        self._corners = context.shared.take(Corners, lambda: Corners(context.records))
        self.rays = TiledRays(context, self._admission, rays_per_tile, cells, threshold)
        self.lists = CellLists(context, self.rays, cells, self.traits.recordable)

    def aim(self, lights: Sequence[LightFrame]) -> None:
        """Records and corners of the light."""
        with self._context.stages.stage("setup"):
            self._corners.make(lights[0], self._context.records.prepare(lights[0]))

    def show(self, rays: Rays, query: Query) -> None:
        """Sort rays and triangles into the grid and test what meets there."""
        self._begin(rays)
        self._part(rays, 0)
        with self._context.stages.stage("trace"):
            self._admission.test_wild(rays)

    def more(self, rays: Rays) -> Iterator[None]:
        """A part of the entries after the other."""
        self._begin(rays)
        for part in range(int(self._context.samples.parts_of[rays.first].numpy()[0])):
            self._part(rays, part)
            yield

    def _begin(self, rays: Rays) -> None:
        stages = self._context.stages
        with stages.stage("sort"):
            self._admission.admit(rays)
            self.rays.make(rays)
        with stages.stage("count"):
            self.lists.count(rays, self._occluders(rays))

    def _part(self, rays: Rays, part: int) -> None:
        stages = self._context.stages
        with stages.stage("build"):
            self.lists.emit(rays, part, self._occluders(rays))
        with stages.stage("trace"):
            self._trace_items(rays)

    def _occluders(self, rays: Rays) -> Occluders:
        occluders = self._context.occluders(rays)
        occluders.corners = self._corners.of(rays.first)
        return occluders

    def _trace_items(self, rays: Rays) -> None:
        samples, items, lists = self._context.samples, self.rays, self.lists
        lanes = 1 if forms.wide(samples.device) else items.threshold
        inputs = [lanes, samples.rays, items.polar, items.keys, items.order, items.items, items.counts, items.tiles]
        inputs += [lists.begins, lists.keys, lists.values, self._context.records.of(rays.first)]
        inputs += [self._context.answers(rays)]
        wp.launch(trace_items, dim=items.item_bound * lanes, inputs=inputs, device=samples.device)

    def nbytes(self) -> int:
        """Bytes on the device."""
        return self._admission.nbytes() + self.rays.nbytes() + self.lists.nbytes()
