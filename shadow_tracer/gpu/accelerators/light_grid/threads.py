# SPDX-License-Identifier: Apache-2.0
"""The packed grid in the CUDA form; see ``tiles.py`` and ``binning.py``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import warp as wp

from shadow_tracer.gpu.accelerators.admission import Admission
from shadow_tracer.gpu.accelerators.interface import Context, Rays
from shadow_tracer.gpu.accelerators.light_grid import binning, tracing
from shadow_tracer.gpu.accelerators.light_grid.packing import Packer
from shadow_tracer.gpu.accelerators.light_grid.tiles import (
    TileBuffers,
)
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.slices import Slices
from shadow_tracer.gpu.exact.faces import Occluders
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.exact.light_space import FACES
from shadow_tracer.gpu.occluders.corners import Corners

_LEAST_ITEMS = 65536
# Threads that share lists whose length the host does not know.
_THREADS_CUDA = 131072


def room_for_items(triangles: int) -> int:
    """Places for items of at most so many triangles: of a street of robots seen in 1024 x 1024 pixels 30,700 were used
    by 70,000 triangles, 265,500 by 975,000."""
    return min(max(_LEAST_ITEMS, triangles // 2), 64 * triangles)


class ThreadGrid:
    """The packed grid with a thread per ray, tile or triangle."""

    def __init__(self, context: Context, buffers: TileBuffers, admission: Admission) -> None:
        self._context, self._buffers, self._admission = context, buffers, admission
        samples = context.samples
        device, capacity, triangles = samples.device, samples.bounds.grid_entries, samples.bounds.max_triangles
        self._packer = Packer(buffers, samples.bounds.max_lights, device)
        self._slices = Slices()
        places = 16 * buffers.most_blocks
        items = room_for_items(triangles)
        bins = binning.Bins()
        bins.capacity = capacity
        bins.items = wp.empty(items, dtype=wp.vec4i, device=device)
        bins.item_count = wp.zeros(4, dtype=int, device=device)
        bins.length_of = wp.empty(triangles, dtype=int, device=device)
        bins.offsets = wp.empty(triangles + items, dtype=wp.int64, device=device)
        bins.tile = wp.empty(capacity, dtype=int, device=device)
        bins.record = wp.empty(capacity, dtype=int, device=device)
        bins.rank = wp.empty(capacity, dtype=int, device=device)
        bins.sorted = wp.empty(capacity, dtype=int, device=device)
        bins.length = wp.empty(places, dtype=int, device=device)
        bins.start = wp.empty(places, dtype=int, device=device)
        bins.total = wp.empty(places, dtype=int, device=device)
        bins.chunks = wp.empty(places + 1, dtype=int, device=device)
        bins.work = wp.empty(places + capacity // int(tracing.CHUNK), dtype=wp.vec2i, device=device)
        bins.emitted = wp.zeros(1, dtype=int, device=device)
        self._bins = bins
        self._corners = context.shared.take(Corners, lambda: Corners(context.records))

    def follow(self) -> None:
        pass

    def prepare(self, light: LightFrame) -> None:
        self._corners.make(light, self._context.records.prepare(light))

    def choose(self, rays: Rays) -> None:
        """All triangles may concern some ray."""

    def pack(self, rays: Rays) -> None:
        samples, group = self._context.samples, self._admission.groups
        states = samples.states_of(rays.first, len(rays.lights))
        self._packer.pack(samples.lights_from(rays.first), samples.rays, states, group)

    def occluders(self, rays: Rays) -> Occluders:
        """The triangles of a pass."""
        occluders = self._context.occluders(rays)
        occluders.corners = self._corners.of(rays.first, len(rays.lights))
        occluders.corners_apart = self._corners.stride
        return occluders

    def trace(self, rays: Rays) -> None:
        """As many entries as the list holds."""
        self._count(rays)
        self._trace_part(rays, 0)

    def trace_parts(self, rays: Rays) -> Iterator[None]:
        """All entries, a list after the other."""
        self._count(rays)
        part, parts = 0, 1
        while part < parts:
            self._trace_part(rays, part)
            yield
            parts = int(self._context.samples.parts_of[rays.first].numpy()[0])
            part += 1

    def _units(self, rays: Rays) -> tuple[int, int]:
        """Triangles of the pass, and with them the places for items: what entries are counted of."""
        triangles = self._context.scene.triangle_count * len(rays.lights)
        return triangles, triangles + self._bins.items.shape[0]

    def _places(self) -> int:
        tiles = self._buffers.tiles
        return 16 * (-(-tiles.lights * tiles.samples // 512) + FACES * tiles.lights)

    def _run(self, kernel: Any, dim: int, *inputs: Any) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, device=self._context.samples.device)

    def _bin(self, rays: Rays, emit: int, part: int) -> None:
        samples, bins, (triangles, _) = self._context.samples, self._bins, self._units(rays)
        window = wp.int64(part * bins.capacity)
        given = (samples.lights_from(rays.first), emit, window, self._buffers.tiles, self.occluders(rays), bins)
        answers = self._context.answers(rays)
        self._run(binning.bin_triangles, triangles, *given, answers)
        if emit == 0:
            self._run(binning.itemise_triangles, triangles, given[0], *given[3:], answers)
        self._run(binning.bin_long, 32 * self._warps(), *given, answers)

    def _warps(self) -> int:
        return forms.tasks(self._context.samples.device, _THREADS_CUDA // 32)

    def _count(self, rays: Rays) -> None:
        """Number the entries, and store the rays of covered tiles."""
        bins, (triangles, units) = self._bins, self._units(rays)
        tiles, answers = self._buffers.tiles, self._context.answers(rays)
        bins.item_count.zero_()
        offsets = self._slices(bins.offsets, 0, units)
        # Places for items that nobody takes have no entries.
        if units > triangles:
            self._slices(bins.offsets, triangles, units - triangles).zero_()
        self._bin(rays, 0, 0)
        wp.utils.array_scan(offsets, offsets, inclusive=True)
        self._run(tracing.write_covered, self._places(), tiles, answers)

    def _trace_part(self, rays: Rays, part: int) -> None:
        samples, tiles, bins, places = self._context.samples, self._buffers.tiles, self._bins, self._places()
        answers = self._context.answers(rays)
        self._run(tracing.start_part, 1, self._units(rays)[1], part, bins, samples.parts_of[rays.first], answers)
        bins.length.zero_()
        self._bin(rays, 1, part)
        length, start = self._slices(bins.length, 0, places), self._slices(bins.start, 0, places)
        wp.utils.array_scan(length, start, inclusive=False)
        threads = forms.tasks(samples.device, _THREADS_CUDA)
        self._run(tracing.scatter_entries, threads, threads, bins)
        self._run(tracing.count_chunks, places + 1, part, places, bins, answers)
        chunks = self._slices(bins.chunks, 0, places + 1)
        wp.utils.array_scan(chunks, chunks, inclusive=False)
        self._run(tracing.list_chunks, places, bins)
        self._run(tracing.trace_chunks, 32 * self._warps(), places, tiles, self.occluders(rays), bins, answers)

    def silent(self, light: LightFrame) -> tuple[int, int]:
        return self._context.records.silent(light.number)

    def nbytes(self) -> int:
        bins = self._bins
        arrays = (bins.items, bins.item_count, bins.length_of, bins.offsets, bins.tile, bins.record, bins.rank)
        arrays += (bins.sorted, bins.length, bins.start, bins.total, bins.chunks, bins.work, bins.emitted)
        return self._packer.nbytes() + sum(int(array.capacity) for array in arrays)
