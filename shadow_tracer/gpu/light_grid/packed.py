# SPDX-License-Identifier: Apache-2.0
"""Variant ``packed``: rays in equal tiles, triangles sorted into them."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.buffers import Change
from shadow_tracer.gpu.corners import Corners
from shadow_tracer.gpu.light_grid import binning_wide, packing_wide
from shadow_tracer.gpu.light_grid.tiles import TileBuffers
from shadow_tracer.gpu.participants import Participants
from shadow_tracer.gpu.passes import Pass
from shadow_tracer.gpu.triangle_planes import Occluders
from shadow_tracer.gpu.triangles import Context

# Entries that are gathered before they are traced, per place for a tile.
_ENTRIES_PER_TILE = 2


class PackedGrid:
    """The pipeline's variant ``packed``; see ``tiles.py``."""

    recordable = True

    def __init__(self, variant: str, context: Context) -> None:
        self._context = context
        frame = context.frame
        self.lights_together = frame.bounds.max_lights
        self._participants = Participants(context)
        self._corners = Corners(context)
        self._buffers = TileBuffers(frame)
        places = 16 * self._buffers.most_blocks
        natural = max(4096, _ENTRIES_PER_TILE * places)
        entries = binning_wide.EntryList()
        entries.capacity = min(natural, frame.bounds.grid_entries)
        entries.bounded = int(entries.capacity < natural)
        entries.tile = wp.empty(entries.capacity, dtype=int, device=frame.device)
        entries.record = wp.empty(entries.capacity, dtype=int, device=frame.device)
        entries.sorted = wp.empty(entries.capacity, dtype=int, device=frame.device)
        entries.start = wp.empty(places + 1, dtype=int, device=frame.device)
        entries.total = wp.empty(places, dtype=int, device=frame.device)
        entries.count = wp.zeros(4, dtype=int, device=frame.device)
        self._entries = entries

    def update(self, change: Change) -> None:
        """Nothing is kept of the scene but what the shared buffers keep."""

    def trace(self, work: Pass) -> None:
        """Pack the rays of the pass, sort the triangles into their tiles, test."""
        context, buffers = self._context, self._context.frame
        stages, device, tiles = context.stages, buffers.device, self._buffers.tiles
        tiles.lights, tiles.samples = len(work.lights), buffers.count
        lights, states = buffers.lights_from(work.first), buffers.states_of(work.first, len(work.lights))
        with stages.stage("setup"):
            for light in work.lights:
                if context.records.prepare(light):
                    self._corners.make(light)
        with stages.stage("pack"):
            self._participants.choose(work)
            pack = self._buffers
            inputs = [lights, buffers.rays, states, self._participants.group, tiles]
            inputs += [pack.cells, pack.scratch, pack.sort.keys, pack.sort.values]
            wp.launch(packing_wide.pack_wide, dim=1, inputs=inputs, device=device)
        with stages.stage("trace"):
            occluders = Occluders()
            occluders.count = context.scene.triangle_count
            occluders.triangles = context.scene.triangles
            occluders.corners = self._corners.of(work.first, len(work.lights))
            occluders.records = context.records.of(work.first, len(work.lights))
            answers = self._participants.answers(work)
            inputs = [lights, context.scene.vertex_count, tiles, occluders, self._entries, answers]
            wp.launch(binning_wide.bin_wide, dim=1, inputs=inputs, device=device)
            self._participants.finish(work)

    def learn(self, counters: dict[str, int]) -> None:
        """Nothing to adapt."""

    def nbytes(self) -> int:
        """Bytes on the device."""
        entries = self._entries
        arrays = (entries.tile, entries.record, entries.sorted, entries.start, entries.total, entries.count)
        parts = (self._participants, self._corners, self._buffers)
        return sum(part.nbytes() for part in parts) + sum(int(array.capacity) for array in arrays)
