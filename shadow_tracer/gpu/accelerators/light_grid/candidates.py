# SPDX-License-Identifier: Apache-2.0
"""The triangles that may lie between a light and the rays of a band, and their records, made when first asked for.

A robot's camera mostly sees a small part of what the mesh holds. The rays of a face of the light fill a pyramid: from
the least to the largest (u, v), no farther along the face's axis than the farthest start, and no farther along Z than
start and light. Whatever occludes one of them has a point in that pyramid, so sixteen triangles whose box lies beyond
one of its seven planes have nothing to do with them (``clusters.py``). Records are made for 128 triangles together,
when a band first wants one of them, and kept as long as the light stays, and those triangles; bands that work side by
side divide them.

Planes are float64 in the world. In units of the anchor's scale they are at fault by less than 2^-48 of the sum of
magnitudes in them; 2^-40 is allowed. What rays contribute is padded as in ``tiles.py``: (u, v) by 2^-20 (1 + |u|),
Z and the axis by 2^-20 of the ray's magnitude, of which float32 and set-up are at fault by 2^-24. For the CPU.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.interface import Context, Rays
from shadow_tracer.gpu.accelerators.light_grid.tiles import Tiles
from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.device.slices import Slices
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.exact.records import (
    BLOCK,
    FILTER_FACTOR,
    LARGEST_OFFSET,
    OFFSET_FACTOR,
    SETUP_ERROR,
    SLOPE_FACTOR,
    U32,
    prepare_block,
)
from shadow_tracer.gpu.occluders.clusters import CLUSTER, ClusterBoxes, Clusters, await_made, claim, make_boxes, publish
from shadow_tracer.gpu.occluders.slots import blocks

_CLUSTERS = BLOCK // CLUSTER  # of a block of records


@wp.struct
class Candidates:
    """What is made on demand, for all lights of a pass: light number ``place`` has its records ``stride``, and its
    blocks ``blocks``, behind those of the one before."""

    cull: int
    stride: int
    blocks: int
    records: wp.array2d(dtype=wp.vec4)
    corners: wp.array(dtype=float)  # see prepare_block
    made: wp.array(dtype=int)  # of each block
    silent: wp.array(dtype=wp.vec2i)  # see prepare_block


@native.func_native("accelerators/light_grid/candidates.h", calls="Candidates16::list", otherwise="return 0;")
def list_clusters(
    place: int,
    first: int,
    everything: int,
    frame: LightFrame,
    tiles: Tiles,
    clusters: Clusters,
    found: wp.array(dtype=int),
) -> int:
    """Store the clusters that may concern the rays of the light at ``place``, ascending, from ``first`` on; returns
    the end. With ``everything`` all of them."""
    ...


@wp.func
def divide(k: int, count: int, turn: wp.vec2i) -> int:
    """The k-th of ``count`` pieces of rays: each band begins elsewhere."""
    return (k + count * turn[0] // turn[1]) % count


@wp.func
def make_all_boxes(
    turn: wp.vec2i, vertices: wp.array(dtype=wp.vec3d), triangles: wp.array(dtype=wp.vec3i), clusters: Clusters
):
    """Boxes of all clusters, unless they are made."""
    items = (clusters.triangles + 255) // 256
    for k in range(items):
        item = divide(k, items, turn)
        if claim(clusters.made, item) != 0:
            make_boxes(item, clusters, vertices, triangles)
            publish(clusters.made, item)
    for item in range(items):
        await_made(clusters.made, item)


@wp.func
def make_block(
    place: int,
    block: int,
    count: int,
    light: LightFrame,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    candidates: Candidates,
):
    """Records and corners of a block of triangles for the light at ``place``, unless they are made or being made."""
    first = block * BLOCK
    row = place * candidates.blocks + block
    if claim(candidates.made, row) != 0:
        prepare_block(
            first,
            count,
            light,
            wp.float64(FILTER_FACTOR),
            wp.float64(SLOPE_FACTOR),
            wp.float64(OFFSET_FACTOR),
            wp.float64(U32),
            wp.float64(SETUP_ERROR),
            wp.float64(LARGEST_OFFSET),
            vertices,
            triangles,
            place * candidates.stride + first,
            candidates.records,
            row * BLOCK,
            candidates.corners,
            candidates.cull,
            row,
            candidates.silent,
        )
        publish(candidates.made, row)


@wp.kernel(enable_backward=False)
def find_candidates(
    lights: wp.array(dtype=LightFrame),
    turn: wp.vec2i,
    tiles: Tiles,
    wild: wp.array(dtype=int),
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    clusters: Clusters,
    candidates: Candidates,
    found: wp.array(dtype=int),
    ends: wp.array(dtype=int),
):
    """One thread, the ``turn[0]``-th of ``turn[1]`` bands that do so: boxes, the clusters of each light of the pass
    (``ends``: where those of each place end), and their records. Rays outside of the tiles ask
    for all triangles."""
    make_all_boxes(turn, vertices, triangles, clusters)
    everything = int(0)
    if wild[1] > 0:
        everything = 1
    first = int(0)
    for place in range(tiles.lights):
        end = list_clusters(place, first, everything, lights[place], tiles, clusters, found)
        ends[place] = end
        last = int(-1)
        for k in range(end - first):
            block = found[first + divide(k, end - first, turn)] // _CLUSTERS
            if block != last:
                make_block(place, block, clusters.triangles, lights[place], vertices, triangles, candidates)
            last = block
        for k in range(first, end):
            await_made(candidates.made, place * candidates.blocks + found[k] // _CLUSTERS)
        first = end


class CandidateRecords:
    """Records and corners made on demand, for all bands of a tracer: the records are those of the context, which
    nobody else must have made meanwhile (``TriangleRecords.forget``)."""

    def __init__(self, context: Context) -> None:
        self._scene, self._records = context.scene, context.records
        device, bounds = context.scene.device, context.samples.bounds
        self._boxes = ClusterBoxes(bounds.max_triangles, context.scene)
        self._corners = wp.empty(12 * (bounds.max_triangles + BLOCK * bounds.max_lights), dtype=float, device=device)
        self._made = wp.zeros(bounds.max_triangles // BLOCK + bounds.max_lights, dtype=int, device=device)
        self._slices = Slices()

    def follow(self) -> None:
        """The boxes are those of the scene as it is."""
        self._boxes.follow()

    def open(self, light: LightFrame) -> None:
        """Nothing is made yet for this light of what is not right any more."""
        stale, records = self._records.begin(light), self._records
        for first, last in blocks(stale.triangles, BLOCK, self._scene.triangle_count):
            self._slices(self._made, records.place(light.number) * records.blocks + first, last - first).zero_()
            self._slices(records.silent_of(light.number), first, last - first).zero_()

    def corners(self, rays: Rays) -> wp.array:
        """Corners for the lights of a pass, light after light, each on a multiple of ``BLOCK`` triangles."""
        size = 12 * BLOCK * self._records.blocks
        return self._slices(self._corners, self._records.place(rays.first) * size, len(rays.lights) * size)

    def structs(self, rays: Rays) -> tuple[Clusters, Candidates]:
        """As kernels see them, for the lights of a pass."""
        records, lights = self._records, len(rays.lights)
        candidates = Candidates()
        candidates.cull = int(records.front_face_culling)
        candidates.stride, candidates.blocks = records.stride, records.blocks
        candidates.records = records.of(rays.first, lights)
        candidates.corners = self.corners(rays)
        first = records.place(rays.first) * records.blocks
        candidates.made = self._slices(self._made, first, lights * records.blocks)
        candidates.silent = records.silent_of(rays.first, lights)
        return self._boxes.clusters(), candidates

    def nbytes(self) -> int:
        """Bytes on the device, records aside."""
        return self._boxes.nbytes() + int(self._corners.capacity + self._made.capacity)
