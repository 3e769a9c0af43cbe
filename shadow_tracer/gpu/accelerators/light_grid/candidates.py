# SPDX-License-Identifier: Apache-2.0
"""The triangles that may lie between a light and the rays of a band.

A robot's camera mostly sees a small part of what the mesh holds. The rays of a face of the light fill a pyramid: from
the least to the largest (u, v), no farther along the face's axis than the farthest start, and no farther along Z than
start and light. Whatever occludes one of them has a point in that pyramid, so sixteen triangles whose box lies beyond
one of its seven planes have nothing to do with them (``clusters.py``). What is left is set up where it reaches rays
(``cluster.h``), and nothing of it is kept. Rays outside of the tiles ask for records of all triangles, made for 128 of
them together by whichever band comes first, and kept as long as the light stays, and those triangles.

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
class AllRecords:
    """Of all lights of a pass: light number ``place`` has its records ``stride``, and its blocks ``blocks``, behind
    those of the one before."""

    cull: int
    stride: int
    blocks: int
    records: wp.array2d(dtype=wp.vec4)
    made: wp.array(dtype=int)  # of each block
    silent: wp.array(dtype=wp.vec2i)  # see prepare_block


@native.func_native("accelerators/light_grid/candidates.h", calls="Candidates16::list", otherwise="return 0;")
def list_clusters(
    place: int,
    first: int,
    frame: LightFrame,
    tiles: Tiles,
    clusters: Clusters,
    found: wp.array(dtype=int),
    faces: wp.array(dtype=wp.uint8),
) -> int:
    """Store the clusters that may concern the rays of the light at ``place``, ascending, from ``first`` on, and the
    faces on which each may, as bits; returns the end."""
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
def make_all_records(
    place: int,
    turn: wp.vec2i,
    count: int,
    light: LightFrame,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    all: AllRecords,
):
    """Records of all triangles for the light at ``place``, unless they are made."""
    blocks = (count + BLOCK - 1) // BLOCK
    for k in range(blocks):
        block = divide(k, blocks, turn)
        row = place * all.blocks + block
        if claim(all.made, row) != 0:
            prepare_block(
                block * BLOCK,
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
                place * all.stride + block * BLOCK,
                all.records,
                all.cull,
                row,
                all.silent,
            )
            publish(all.made, row)
    for block in range(blocks):
        await_made(all.made, place * all.blocks + block)


@wp.kernel(enable_backward=False)
def find_candidates(
    lights: wp.array(dtype=LightFrame),
    turn: wp.vec2i,
    tiles: Tiles,
    wild: wp.array(dtype=int),
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    clusters: Clusters,
    all: AllRecords,
    found: wp.array(dtype=int),
    faces: wp.array(dtype=wp.uint8),
    ends: wp.array(dtype=int),
):
    """One thread, the ``turn[0]``-th of ``turn[1]`` bands that do so: boxes, and the clusters of each light of the pass
    (``ends``: where those of each place end). Rays outside of the tiles ask for the records of all triangles."""
    make_all_boxes(turn, vertices, triangles, clusters)
    first = int(0)
    for place in range(tiles.lights):
        first = list_clusters(place, first, lights[place], tiles, clusters, found, faces)
        ends[place] = first
        if wild[1] > 0:
            make_all_records(place, turn, clusters.triangles, lights[place], vertices, triangles, all)


class Candidates:
    """Boxes of clusters, counts of what casts nothing in them, and records made on demand, for all bands of a tracer:
    the records are those of the context, which nobody else must have made meanwhile (``TriangleRecords.forget``)."""

    def __init__(self, context: Context) -> None:
        self._scene, self._records = context.scene, context.records
        device, bounds = context.scene.device, context.samples.bounds
        self._boxes = ClusterBoxes(bounds.max_triangles, context.scene)
        blocks = bounds.max_triangles // BLOCK + bounds.max_lights
        self._made = wp.zeros(blocks, dtype=int, device=device)
        self._silent = wp.zeros(2 * _CLUSTERS * blocks, dtype=wp.uint8, device=device)
        self._counted = self._silent.numpy()
        self._slices, self._clear = Slices(), context.samples.clear

    def follow(self) -> None:
        """The boxes are those of the scene as it is."""
        self._boxes.follow()

    def open(self, light: LightFrame) -> None:
        """Nothing is made yet for this light of what is not right any more."""
        stale, records = self._records.begin(light), self._records
        place = records.place(light.number) * records.blocks
        for first, last in blocks(stale.triangles, BLOCK, self._scene.triangle_count):
            self._clear(
                self._slices(self._made, place + first, last - first),
                self._slices(records.silent_of(light.number), first, last - first),
                self._slices(self._silent, 2 * _CLUSTERS * (place + first), 2 * _CLUSTERS * (last - first)),
            )

    def structs(self, rays: Rays) -> tuple[Clusters, AllRecords]:
        """As kernels see them, for the lights of a pass."""
        records, lights = self._records, len(rays.lights)
        found = AllRecords()
        found.cull = int(records.front_face_culling)
        found.stride, found.blocks = records.stride, records.blocks
        found.records = records.of(rays.first, lights)
        found.made = self._slices(self._made, records.place(rays.first) * records.blocks, lights * records.blocks)
        found.silent = records.silent_of(rays.first, lights)
        return self._boxes.clusters(), found

    def counts(self, rays: Rays) -> tuple[int, wp.array]:
        """Where clusters count what casts nothing, of the lights of a pass, and how many clusters these are apart."""
        apart = self._records.blocks * _CLUSTERS
        first = self._records.place(rays.first) * apart
        return apart, self._slices(self._silent, 2 * first, 2 * apart * len(rays.lights))

    def silent(self, light: LightFrame) -> tuple[int, int]:
        """Triangles that cast nothing for a light, degenerate ones and those culled: of clusters that have been set up,
        or of all if there are records of all."""
        records = self._records
        first = 2 * _CLUSTERS * records.blocks * records.place(light.number)
        some = self._counted[first : first + 2 * -(-self._scene.triangle_count // CLUSTER)]
        degenerate, culled = records.silent(light.number)
        if some.any():
            degenerate, culled = max(degenerate, int(some[::2].sum())), max(culled, int(some[1::2].sum()))
        return degenerate, culled

    def nbytes(self) -> int:
        """Bytes on the device, records aside."""
        return self._boxes.nbytes() + int(self._made.capacity + self._silent.capacity)
