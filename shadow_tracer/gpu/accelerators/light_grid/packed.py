# SPDX-License-Identifier: Apache-2.0
"""Variant ``packed``: rays in equal tiles, triangles sorted into them. ``packed_scalar`` is what CUDA does, on any
device."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

import warp as wp

from shadow_tracer.gpu.accelerators.interface import Context
from shadow_tracer.gpu.accelerators.light_grid import binning, candidates, tracing
from shadow_tracer.gpu.accelerators.light_grid.candidates import CandidateRecords
from shadow_tracer.gpu.accelerators.light_grid.packing import Packer
from shadow_tracer.gpu.accelerators.light_grid.tiles import (
    ALL_BLOCKS,
    ALL_COLUMNS,
    ALL_RAYS,
    BLOCK_RAYS,
    COLUMNS_OF,
    FIRST_BLOCK,
    FIRST_COLUMN,
    FIRST_RAY,
    LENGTH,
    QUANTITIES,
    RAYS_OF,
    U_CELLS,
    TileBuffers,
    Tiles,
    lay_out,
    make_lookup,
    no_column,
)
from shadow_tracer.gpu.accelerators.participants import Participants
from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.device.launches import Launches
from shadow_tracer.gpu.device.slices import Slices
from shadow_tracer.gpu.exact.faces import Occluders
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.exact.light_space import FACES, space_of
from shadow_tracer.gpu.exact.records import BLOCK
from shadow_tracer.gpu.occluders.clusters import CLUSTER
from shadow_tracer.gpu.occluders.corners import Corners
from shadow_tracer.gpu.samples.passes import Pass

# Entries that are gathered on the CPU before they are traced, per place for a tile.
_ENTRIES_PER_TILE = 2
_MOST_ITEMS = 65536
# Threads that share lists whose length the host does not know.
_THREADS_CUDA = 131072


@native.func_native("accelerators/light_grid/packing16.h", calls="Packing16::measure")
def measure(place: int, rays: wp.array(dtype=wp.vec4), group: wp.array(dtype=wp.uint8), tiles: Tiles):
    """Frustum and extents of the rays of the light at ``place``."""
    ...


@native.func_native("accelerators/light_grid/packing16.h", calls="Packing16::keys", otherwise="return 0;")
def write_keys(
    place: int,
    first: int,
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    group: wp.array(dtype=wp.uint8),
    tiles: Tiles,
    cells: wp.array(dtype=int),
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
) -> int:
    """Keys and numbers of the light's rays that are in tiles and not known to be in shadow, to be stored from ``first``
    on; returns the end. ``cells`` counts the rays in each (group, cell of u)."""
    ...


@native.func_native("accelerators/light_grid/columns.h", calls="Columns::gather")
def to_columns(
    count: int, tiles: Tiles, cells: wp.array(dtype=int), keys: wp.array(dtype=int), order: wp.array(dtype=int)
):
    """Bring the rays of each column together, behind the first ``count`` elements of ``keys`` (then the cell of v) and
    ``order``."""
    ...


@native.func_native("accelerators/light_grid/columns.h", calls="Columns::pack")
def pack_column(
    number: int,
    inverse: int,
    column: int,
    first_block: int,
    begin: int,
    end: int,
    rays: wp.array(dtype=wp.vec4),
    tiles: Tiles,
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
):
    """Tiles, blocks and the box of one column of group ``number``: its rays are ``order[begin:end]``, with the cells of
    v in ``keys``; ``inverse``: the mode of light space."""
    ...


@wp.kernel(enable_backward=False)
def pack_wide(
    lights: wp.array(dtype=LightFrame),
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    group: wp.array(dtype=wp.uint8),
    tiles: Tiles,
    cells: wp.array(dtype=int),
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
):
    """``packing.py`` on the CPU, sixteen rays at a time: one thread, and counting takes the place of the sorts."""
    for k in range(FACES * tiles.lights * U_CELLS):
        cells[k] = 0
    count = int(0)
    for place in range(tiles.lights):
        measure(place, rays, group, tiles)
        count = write_keys(place, count, rays, states, group, tiles, cells, keys, order)
    ray = int(0)
    column = int(0)
    block = int(0)
    for number in range(FACES * tiles.lights):
        rays_of = int(0)
        for k in range(U_CELLS):
            rays_of += cells[number * U_CELLS + k]
        last = column + lay_out(number, ray, rays_of, column, block, tiles)
        for k in range(column + tiles.groups[number, COLUMNS_OF], last):
            no_column(k, tiles)
        column = last
        ray += rays_of
        block += (rays_of + BLOCK_RAYS - 1) // BLOCK_RAYS
    to_columns(count, tiles, cells, keys, order)
    for number in range(FACES * tiles.lights):
        first = tiles.groups[number, FIRST_RAY]
        length = tiles.groups[number, LENGTH]
        for k in range(tiles.groups[number, COLUMNS_OF]):
            pack_column(
                number,
                space_of(lights[number // FACES]).inverse,
                tiles.groups[number, FIRST_COLUMN] + k,
                tiles.groups[number, FIRST_BLOCK] + k * (length // BLOCK_RAYS),
                count + first + k * length,
                count + first + wp.min(tiles.groups[number, RAYS_OF], (k + 1) * length),
                rays,
                tiles,
                keys,
                order,
            )
        make_lookup(number, tiles)
    tiles.counts[ALL_RAYS] = count
    tiles.counts[ALL_COLUMNS] = column
    tiles.counts[ALL_BLOCKS] = block


class PackedGrid:
    """The pipeline's variants ``packed`` and ``packed_scalar``; see ``tiles.py``."""

    def __init__(self, variant: str, context: Context) -> None:
        self._context = context
        self.lights_together = context.frame.bounds.max_lights
        self._participants = Participants(context)
        self._buffers = TileBuffers(context.frame)
        wide = forms.wide(context.frame.device) and variant == "packed"
        self._way: _Wide | _Scalar = (_Wide if wide else _Scalar)(context, self._buffers, self._participants)
        self.recordable, self.keeps_rays = True, wide

    def follow(self) -> None:
        """What is kept of the scene is shared."""
        self._way.follow()

    def prepare(self, work: Pass) -> None:
        """Records and corners of the lights."""
        with self._context.stages.stage("setup"):
            for light in work.lights:
                self._way.prepare(light)

    def trace(self, work: Pass) -> None:
        """Pack the rays of the pass, sort the triangles into their tiles, test."""
        context, count = self._context, len(work.lights)
        stages, tiles = context.stages, self._buffers.tiles
        tiles.lights, tiles.samples = count, context.frame.count
        if work.part == 0:
            with stages.stage("pack"):
                if work.again:
                    assert isinstance(self._way, _Wide)  # which keeps rays
                    self._participants.choose_again(count)
                    self._way.unpack()
                else:
                    self._participants.choose(work)
                    self._way.pack(work)
            with stages.stage("setup"):
                self._way.choose(work)
        with stages.stage("trace"):
            self._way.trace(work)
            if work.part == 0:
                self._participants.finish(work)

    def learn(self, counters: dict[str, int]) -> None:
        """Nothing to adapt."""

    def nbytes(self) -> int:
        """Bytes on the device."""
        return sum(part.nbytes() for part in (self._participants, self._buffers, self._way))


def _occluders(context: Context, work: Pass) -> Occluders:
    occluders = Occluders()
    occluders.count = context.scene.triangle_count
    occluders.triangles = context.scene.triangles
    occluders.records = context.records.of(work.first, len(work.lights))
    occluders.records_apart = context.records.stride
    return occluders


class _Wide:
    """One thread and its vector registers."""

    def __init__(self, context: Context, buffers: TileBuffers, participants: Participants) -> None:
        self._context, self._buffers, self._participants = context, buffers, participants
        self._launch = Launches(context.frame.device)
        device, bound = context.frame.device, context.frame.bounds.grid_entries
        places = 16 * buffers.most_blocks
        natural = max(4096, _ENTRIES_PER_TILE * places)
        entries = binning.EntryList()
        entries.capacity = min(natural, bound)
        entries.bounded = int(bound < natural)
        entries.tile = wp.empty(entries.capacity, dtype=int, device=device)
        entries.record = wp.empty(entries.capacity, dtype=int, device=device)
        entries.sorted = wp.empty(entries.capacity, dtype=int, device=device)
        entries.start = wp.empty(places + 1, dtype=int, device=device)
        entries.total = wp.empty(places, dtype=int, device=device)
        entries.count = wp.zeros(2, dtype=int, device=device)
        self._entries = entries
        bounds = context.frame.bounds
        self._candidates = context.shared.take(CandidateRecords, lambda: CandidateRecords(context))
        self._clusters = wp.empty(bounds.max_triangles // CLUSTER + bounds.max_lights, dtype=int, device=device)
        self._ends = wp.zeros(bounds.max_lights, dtype=int, device=device)
        # What tracing changes of the tiles.
        self._changing = (buffers.tiles.live, buffers.tiles.boxes)
        self._kept = tuple(wp.empty_like(array) for array in self._changing)

    def follow(self) -> None:
        self._candidates.follow()

    def prepare(self, light: LightFrame) -> None:
        self._candidates.open(light)

    def pack(self, work: Pass) -> None:
        frame, buffers, group = self._context.frame, self._buffers, self._participants.group

        def prepare() -> tuple[int, list[Any]]:
            states = frame.states_of(work.first, len(work.lights))
            inputs = [frame.lights_from(work.first), frame.rays, states, group, buffers.tiles, buffers.cells]
            return 1, [*inputs, buffers.sort.keys, buffers.sort.values]

        self._launch(pack_wide, (work.first, len(work.lights), frame.count), prepare)
        if work.keep:
            self._copy(self._kept, self._changing)

    def unpack(self) -> None:
        """Tiles as they were before they were traced."""
        self._copy(self._changing, self._kept)

    def _copy(self, to: tuple[wp.array, ...], of: tuple[wp.array, ...]) -> None:
        blocks = int(self._buffers.tiles.counts.numpy()[ALL_BLOCKS])
        for one, other, size in zip(to, of, (16, 16 * QUANTITIES), strict=True):
            one.numpy()[: size * blocks] = other.numpy()[: size * blocks]

    def choose(self, work: Pass) -> None:
        frame, scene, wild = self._context.frame, self._context.scene, self._participants.counts

        def prepare() -> tuple[int, list[Any]]:
            turn = wp.vec2i(frame.number, frame.shares)
            inputs = [frame.lights_from(work.first), work.attempt, turn, self._buffers.tiles, wild]
            inputs += [scene.vertices, scene.triangles, *self._candidates.structs(work)]
            return 1, [*inputs, self._clusters, self._ends]

        self._launch(candidates.find_candidates, (work.attempt, *self._key(work)), prepare)

    def trace(self, work: Pass) -> None:
        frame = self._context.frame

        def prepare() -> tuple[int, list[Any]]:
            apart = BLOCK * self._context.records.blocks
            inputs = [frame.lights_from(work.first), self._clusters, self._ends, apart, self._candidates.corners(work)]
            inputs += [self._buffers.tiles, self.occluders(work), self._entries, self._participants.answers(work)]
            return 1, inputs

        self._launch(binning.bin_wide, self._key(work), prepare)

    def occluders(self, work: Pass) -> Occluders:
        """The triangles of a pass; corners are of another form here, see ``candidates.py``."""
        return _occluders(self._context, work)

    def _key(self, work: Pass) -> tuple[Hashable, ...]:
        """All that the inputs of a pass depend on."""
        context, lights = self._context, len(work.lights)
        place, apart = context.records.place(work.first), context.records.stride
        culled = context.records.front_face_culling
        return work.first, lights, context.frame.count, context.scene.triangle_count, place, apart, culled

    def nbytes(self) -> int:
        entries = self._entries
        arrays = (entries.tile, entries.record, entries.sorted, entries.start, entries.total, entries.count)
        arrays += (self._clusters, self._ends, *self._kept)
        return sum(int(array.capacity) for array in arrays)


class _Scalar:
    """A thread per ray, tile or triangle."""

    def __init__(self, context: Context, buffers: TileBuffers, participants: Participants) -> None:
        self._context, self._buffers, self._participants = context, buffers, participants
        frame = context.frame
        device, capacity, triangles = frame.device, frame.bounds.grid_entries, frame.bounds.max_triangles
        self._packer = Packer(buffers, frame.bounds.max_lights, device)
        self._slices = Slices()
        places = 16 * buffers.most_blocks
        items = min(_MOST_ITEMS, 64 * triangles)
        bins = binning.Bins()
        bins.capacity = capacity
        bins.items = wp.empty(items, dtype=wp.vec4i, device=device)
        bins.item_count = wp.zeros(1, dtype=int, device=device)
        bins.itemised = wp.empty(triangles, dtype=int, device=device)
        bins.offsets = wp.empty(triangles + items, dtype=wp.int64, device=device)
        bins.tile = wp.empty(capacity, dtype=int, device=device)
        bins.record = wp.empty(capacity, dtype=int, device=device)
        bins.rank = wp.empty(capacity, dtype=int, device=device)
        bins.sorted = wp.empty(capacity, dtype=int, device=device)
        bins.length = wp.empty(places, dtype=int, device=device)
        bins.start = wp.empty(places, dtype=int, device=device)
        bins.total = wp.empty(places, dtype=int, device=device)
        bins.chunks = wp.empty(places + 1, dtype=int, device=device)
        bins.work = wp.empty(places + capacity // 256, dtype=wp.vec2i, device=device)
        bins.emitted = wp.zeros(1, dtype=int, device=device)
        self._bins = bins
        self._corners = context.shared.take(Corners, lambda: Corners(context.records))

    def follow(self) -> None:
        pass

    def prepare(self, light: LightFrame) -> None:
        self._corners.make(light, self._context.records.prepare(light))

    def choose(self, work: Pass) -> None:
        """All triangles may concern some ray."""

    def pack(self, work: Pass) -> None:
        frame, group = self._context.frame, self._participants.group
        states = frame.states_of(work.first, len(work.lights))
        self._packer.pack(frame.lights_from(work.first), frame.rays, states, group)

    def occluders(self, work: Pass) -> Occluders:
        """The triangles of a pass."""
        occluders = _occluders(self._context, work)
        occluders.corners = self._corners.of(work.first, len(work.lights))
        occluders.corners_apart = self._corners.stride
        return occluders

    def trace(self, work: Pass) -> None:
        frame, tiles, bins = self._context.frame, self._buffers.tiles, self._bins
        occluders, answers = self.occluders(work), self._participants.answers(work)
        device, items = frame.device, bins.items.shape[0]
        triangles = occluders.count * tiles.lights
        units = triangles + items
        blocks = -(-tiles.lights * tiles.samples // 512) + FACES * tiles.lights
        places = 16 * blocks
        lights = frame.lights_from(work.first)

        def launch(kernel: Any, dim: int, *inputs: Any) -> None:
            wp.launch(kernel, dim=dim, inputs=inputs, device=device)

        def bin(emit: int) -> None:
            window = wp.int64(work.part * bins.capacity)
            for kernel, dim in ((binning.bin_triangles, triangles), (binning.bin_items, items)):
                launch(kernel, dim, lights, emit, window, tiles, occluders, bins, answers)

        if work.part == 0:
            bins.item_count.zero_()
            launch(binning.itemise_triangles, triangles, lights, tiles, occluders, bins, answers)
            bin(0)
            offsets = self._slices(bins.offsets, 0, units)
            wp.utils.array_scan(offsets, offsets, inclusive=True)
            launch(tracing.write_covered, places, tiles, answers)
        launch(tracing.start_part, 1, units, work.part, bins, frame.parts_of[work.first], answers)
        bins.length.zero_()
        bin(1)
        length, start = self._slices(bins.length, 0, places), self._slices(bins.start, 0, places)
        wp.utils.array_scan(length, start, inclusive=False)
        threads = forms.tasks(device, _THREADS_CUDA)
        launch(tracing.scatter_entries, threads, threads, bins)
        launch(tracing.count_chunks, places + 1, work.part, places, bins, answers)
        chunks = self._slices(bins.chunks, 0, places + 1)
        wp.utils.array_scan(chunks, chunks, inclusive=False)
        launch(tracing.list_chunks, places, bins)
        warps = forms.tasks(device, _THREADS_CUDA // 32)
        launch(tracing.trace_chunks, 32 * warps, warps, places, tiles, occluders, bins, answers)

    def nbytes(self) -> int:
        bins = self._bins
        arrays = (bins.items, bins.item_count, bins.itemised, bins.offsets, bins.tile, bins.record, bins.rank)
        arrays += (bins.sorted, bins.length, bins.start, bins.total, bins.chunks, bins.work, bins.emitted)
        return self._packer.nbytes() + sum(int(array.capacity) for array in arrays)
