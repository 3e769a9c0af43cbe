# SPDX-License-Identifier: Apache-2.0
"""The packed grid in the wide form; see ``tiles.py`` and ``binning.py``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from shadow_tracer.gpu.accelerators.admission import Admission
from shadow_tracer.gpu.accelerators.interface import Context, Rays
from shadow_tracer.gpu.accelerators.light_grid import binning, candidates
from shadow_tracer.gpu.accelerators.light_grid import pack_pieces as packing
from shadow_tracer.gpu.accelerators.light_grid.candidates import Candidates
from shadow_tracer.gpu.accelerators.light_grid.pieces import PieceBuffers, limit_of
from shadow_tracer.gpu.accelerators.light_grid.tiles import ALL_BLOCKS, QUANTITIES, TileBuffers
from shadow_tracer.gpu.device.launches import Launches
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.occluders.clusters import CLUSTER

# Entries that are gathered on the CPU before they are traced, per place for a tile.
_ENTRIES_PER_TILE = 2
# Elements behind the last that a list without branches may write.
_AHEAD = 16
# Clusters of which entries wait, as a part of these, and the most and the least of them: 1 KB each.
_ENTRIES_PER_CLUSTER = 32
_MOST_CLUSTERS, _LEAST_CLUSTERS = 512, 64


class BlockGrid:
    """The packed grid of one thread and its vector registers."""

    def __init__(self, context: Context, buffers: TileBuffers, admission: Admission) -> None:
        self._context, self._buffers, self._admission = context, buffers, admission
        self._launch = Launches(context.samples.device)
        device, bound = context.samples.device, context.samples.bounds.grid_entries
        places = 16 * buffers.most_blocks
        natural = max(4096, _ENTRIES_PER_TILE * places)
        entries = binning.EntryList()
        entries.capacity = min(natural, bound)
        entries.bounded = int(bound < natural)
        entries.tile = wp.empty(entries.capacity + _AHEAD, dtype=int, device=device)
        entries.record = wp.empty(entries.capacity + _AHEAD, dtype=int, device=device)
        entries.sorted = wp.empty(entries.capacity, dtype=int, device=device)
        entries.start = wp.empty(places + 1, dtype=int, device=device)
        entries.total = wp.empty(places, dtype=int, device=device)
        entries.hidden = wp.empty(places, dtype=int, device=device)
        entries.count = wp.zeros(3, dtype=int, device=device)
        entries.tile_places = places + _AHEAD
        entries.visited = wp.empty(places + buffers.most_blocks + 2 * _AHEAD, dtype=int, device=device)
        entries.masks = wp.empty(places, dtype=int, device=device)
        entries.clusters = min(_MOST_CLUSTERS, max(_LEAST_CLUSTERS, entries.capacity // _ENTRIES_PER_CLUSTER))
        entries.records = wp.empty(entries.clusters * CLUSTER * 16, dtype=float, device=device)
        entries.first = wp.empty(entries.clusters, dtype=int, device=device)
        self._entries = entries
        bounds = context.samples.bounds
        self._candidates = context.shared.take(Candidates, lambda: Candidates(context))
        self._clusters = wp.empty(bounds.max_triangles // CLUSTER + bounds.max_lights, dtype=int, device=device)
        self._faces = wp.empty(len(self._clusters), dtype=wp.uint8, device=device)
        self._ends = wp.zeros(bounds.max_lights, dtype=int, device=device)
        # What tracing changes of the tiles, as the host sees it.
        self._changing = [array.numpy() for array in (buffers.tiles.live, buffers.tiles.boxes)]
        self._pieces = PieceBuffers(context.samples, buffers)
        self._kept = [np.empty_like(array) for array in self._changing]
        self._counts = buffers.tiles.counts.numpy()

    def follow(self) -> None:
        self._candidates.follow()

    def prepare(self, light: LightFrame) -> None:
        self._candidates.open(light)

    def arrange(self) -> None:
        """Pieces for what is recorded, or replayed."""
        self._pieces.arrange()

    def project(self, rays: Rays, counted: bool) -> None:
        """Rays and states of all samples; ``counted``: the rays have been counted."""
        samples, tiles, pieces = self._context.samples, self._buffers.tiles, self._pieces.of()
        shared = self._pieces.share(rays.lights)

        def prepare() -> tuple[int, list[Any]]:
            inputs = [samples.lights_from(rays.first), int(counted), *map(int, shared)]
            inputs += [
                samples.positions,
                samples.valid,
                samples.states_of(rays.first, len(rays.lights)),
                *self._admission.listed,
            ]
            return 1, [*inputs, tiles, pieces, samples.counters]

        self._launch(packing.project_pieces, (*self._look(rays), counted, shared), prepare)
        self._pieces.shared(shared)

    def pack(self, rays: Rays) -> None:
        """Pieces into tiles."""
        samples, buffers, pieces = self._context.samples, self._buffers, self._pieces.of()
        pieces.limit = limit_of(samples.count, self._context.scene.triangle_count)

        def prepare() -> tuple[int, list[Any]]:
            inputs = [samples.lights_from(rays.first), buffers.tiles, pieces, buffers.cells]
            return 1, [*inputs, buffers.sort.keys, buffers.sort.values]

        self._launch(packing.pack_pieces, self._look(rays), prepare)
        if rays.keep:
            self._copy(self._kept, self._changing)

    def _look(self, rays: Rays) -> tuple[int, int, int, int]:
        samples = self._context.samples
        return rays.first, len(rays.lights), samples.count, samples.width

    def unpack(self) -> None:
        """Tiles as they were before they were traced."""
        self._copy(self._changing, self._kept)

    def _copy(self, to: Sequence[npt.NDArray[Any]], of: Sequence[npt.NDArray[Any]]) -> None:
        blocks = int(self._counts[ALL_BLOCKS])
        for one, other, size in zip(to, of, (16, 16 * QUANTITIES), strict=True):
            one[: size * blocks] = other[: size * blocks]

    def choose(self, rays: Rays) -> None:
        samples, scene, wild = self._context.samples, self._context.scene, self._admission.counts

        def prepare() -> tuple[int, list[Any]]:
            turn = wp.vec2i(samples.number, samples.bands)
            inputs = [samples.lights_from(rays.first), turn, self._buffers.tiles, wild]
            inputs += [scene.vertices, scene.triangles, *self._candidates.structs(rays)]
            return 1, [*inputs, self._clusters, self._faces, self._ends]

        self._launch(candidates.find_candidates, self._context.key(rays), prepare)

    def casters(self, rays: Rays) -> binning.Casters:
        """The triangles of a pass."""
        context = self._context
        casters = binning.Casters()
        casters.count, casters.cull = context.scene.triangle_count, int(context.records.front_face_culling)
        casters.silent_apart, casters.silent = self._candidates.counts(rays)
        casters.vertices, casters.triangles = context.scene.vertices, context.scene.triangles
        return casters

    def trace(self, rays: Rays) -> None:
        samples = self._context.samples

        def prepare() -> tuple[int, list[Any]]:
            inputs = [samples.lights_from(rays.first), self._clusters, self._faces, self._ends, self._buffers.tiles]
            return 1, [*inputs, self.casters(rays), self._entries, self._context.answers(rays)]

        self._launch(binning.bin_wide, self._context.key(rays), prepare)

    def silent(self, light: LightFrame) -> tuple[int, int]:
        return self._candidates.silent(light)

    def nbytes(self) -> int:
        entries = self._entries
        arrays = (entries.tile, entries.record, entries.sorted, entries.start, entries.total, entries.count)
        arrays += (entries.hidden, entries.visited, entries.masks, entries.records, entries.first)
        arrays += (self._clusters, self._faces, self._ends)
        kept = sum(array.nbytes for array in self._kept)
        return self._pieces.nbytes() + kept + sum(int(array.capacity) for array in arrays)
