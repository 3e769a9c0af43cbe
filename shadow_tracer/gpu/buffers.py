# SPDX-License-Identifier: Apache-2.0
"""Device buffers, allocated once from the declared bounds, and the device's copy of the scene.

Live counts are host integers where the host knows them (samples, triangles) and device integers where only the device
does (queue length, counters). Nothing here allocates per frame.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import numpy as np
import warp as wp

from shadow_tracer.gpu.exact import ARITHMETIC, transform_point
from shadow_tracer.gpu.launches import Launches
from shadow_tracer.gpu.light_frame import LightFrame
from shadow_tracer.gpu.pinhole import Pinhole
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.mesh import Mesh, Scene

# Columns of the counter array. Each has 64 rows that threads spread over, so that they do not queue for one address.
COUNTERS = ("rays", "nodes_visited", "leaf_tests", "retested", "exact", "accepted", "passes", "peak_queue")
COUNTERS += ("entries", "largest_tile", "splits", "overflows")
RAYS = wp.constant(0)
NODES_VISITED = wp.constant(1)
LEAF_TESTS = wp.constant(2)
RETESTED = wp.constant(3)
EXACT = wp.constant(4)
ACCEPTED = wp.constant(5)
PASSES = wp.constant(6)
PEAK_QUEUE = wp.constant(7)
ENTRIES = wp.constant(8)
LARGEST_TILE = wp.constant(9)
SPLITS = wp.constant(10)
OVERFLOWS = wp.constant(11)  # further passes that a pipeline did by itself
LARGEST = ("peak_queue", "largest_tile")  # of these the largest value of any row counts, not the sum
_ROWS = 64


class Change(IntEnum):
    """What happened to the scene since the last synchronisation, worst last."""

    NOTHING = 0
    POSITIONS = 1
    TOPOLOGY = 2


def upload(destination: wp.array, source: np.ndarray, offset: int = 0) -> None:
    """Copy ``source`` (C-contiguous, elements of ``destination``'s dtype) into ``destination`` from element ``offset``
    on."""
    count = len(source)
    if count == 0:
        return
    if destination.device.is_cpu:
        destination.numpy()[offset : offset + count] = source
    else:
        host = wp.array(source, dtype=destination.dtype, device="cpu", copy=False)
        wp.copy(destination, host, dest_offset=offset, count=count)


class HostValues:
    """A few structs that the host writes and kernels read: from memory and not as arguments, so that recorded launches
    see new values."""

    def __init__(self, dtype: Any, capacity: int, device: Any) -> None:
        self.array = wp.zeros(capacity, dtype=dtype, device=device)
        self.staging = self.array if device.is_cpu else wp.zeros(capacity, dtype=dtype, device="cpu", pinned=True)

    def write(self, values: Sequence[Any]) -> None:
        """Make the first elements of ``array`` equal to ``values``."""
        # The bytes as they are: through a numpy value, Warp's other way, a struct takes twenty times longer.
        begin, size = int(self.staging.ptr or 0), self.staging.strides[0]
        for index, value in enumerate(values):
            ctypes.memmove(begin + index * size, ctypes.byref(value.__ctype__()), size)
        if self.staging is not self.array:
            wp.copy(self.array, self.staging, count=len(values))


class Slices:
    """Parts of arrays, kept: making one takes as long as a launch."""

    def __init__(self) -> None:
        self._made: dict[tuple[int, int, int], wp.array] = {}

    def __call__(self, array: wp.array, first: int, count: int) -> wp.array:
        """Elements ``first`` to ``first + count`` of an array that lives as long as this object."""
        key = (int(array.ptr or 0), first, count)
        made = self._made.get(key)
        if made is None:
            if len(self._made) > 1000:
                self._made.clear()
            # Not read back: another thread may clear meanwhile.
            self._made[key] = made = array[first : first + count]
        return made


def share_of(bounds: Bounds, shares: int) -> Bounds:
    """Capacities of one of several shares of the rays; of each list at least one place."""
    return replace(
        bounds,
        max_rays=-(-bounds.max_rays // shares),
        queue_capacity=max(1, bounds.queue_capacity // shares),
        grid_entries=max(1, bounds.grid_entries // shares),
    )


class FrameBuffers:
    """Everything a frame needs on the device: samples, rays, states, queue, triangle records, counters.

    Args:
        bounds: capacities.
        shares: the number of shares that the buffers can be cut into.
        whole: buffers in whose memory these are to lie, as share number ``number``; records are not cut.
    """

    def __init__(
        self, bounds: Bounds, device: Any, shares: int = 1, whole: FrameBuffers | None = None, number: int = 0
    ) -> None:
        if whole is not None:
            bounds = share_of(bounds, shares)
        self.bounds = bounds
        self.device = device
        self.number, self.shares = (number, shares) if whole is not None else (0, 1)

        def take(name: str, count: int, dtype: Any) -> wp.array:
            if whole is None:
                return wp.empty(count, dtype=dtype, device=device)
            return getattr(whole, name)[number * count : (number + 1) * count]

        rays = bounds.max_rays if whole else shares * share_of(bounds, shares).max_rays
        self.depth_metres = take("depth_metres", rays, wp.float32)
        self.depth_millimetres = take("depth_millimetres", rays, wp.uint16)
        self.samples = take("samples", rays, wp.vec4d)
        self.valid = take("valid", rays, wp.uint8)
        self.rays = take("rays", rays, wp.vec4)
        self._pinhole = HostValues(Pinhole, 1, device)
        self._light_frames = HostValues(LightFrame, bounds.max_lights, device)
        self.pinhole = self._pinhole.array
        self.light_frame_of = [self._light_frames.array[k : k + 1] for k in range(bounds.max_lights)]
        self._lights_from = [self._light_frames.array[k:] for k in range(bounds.max_lights)]
        self.states = take("states", rays * bounds.max_lights, wp.uint8)  # light after light
        self.records: wp.array = (
            whole.records if whole else wp.empty((bounds.max_triangles, 4), dtype=wp.vec4, device=device)
        )
        self.queue = take("queue", bounds.queue_capacity, wp.vec2i)
        self.queue_counts = wp.zeros(bounds.max_lights, dtype=int, device=device)
        self.queue_count_of = [self.queue_counts[k : k + 1] for k in range(bounds.max_lights)]
        self.parts = wp.zeros(bounds.max_lights, dtype=int, device=device)  # see Pass.part, by first light
        self.parts_of = [self.parts[k : k + 1] for k in range(bounds.max_lights)]
        self.resume = take("resume", rays, int)
        self.deferred = wp.zeros(1, dtype=int, device=device)  # whether a pass left rays for the next one
        self.counters = wp.zeros((_ROWS, len(COUNTERS)), dtype=wp.int64, device=device)
        self.count = 0  # samples of the current frame
        self.width = 0  # of the image they come from; 0 if they are a list of points
        self.first = 0  # of all samples of the frame, the number of the first of these
        self.revision = 0  # see renew
        self._slices = Slices()
        self.launch = Launches(device)

    def set_samples(self, count: int, width: int, first: int = 0) -> None:
        """Tell how many samples these buffers have of this frame, the width of the image they come from (0: a list of
        points), and which is the first."""
        self.count, self.width, self.first = count, width, first

    def renew(self) -> None:
        """Samples or rays are about to be others than in the frame before: ``revision`` is one there has not been."""
        self.revision += 1

    def lights_from(self, light: int) -> wp.array:
        """Frames of the lights from number ``light`` on."""
        return self._lights_from[light]

    def states_of(self, light: int, lights: int = 1) -> wp.array:
        """States of all samples for ``lights`` lights from number ``light`` on, light after light."""
        return self._slices(self.states, light * self.count, lights * self.count)

    def rays_of(self, place: int) -> wp.array:
        """Rays of the light at ``place`` in its pass."""
        return self._slices(self.rays, place * self.count, self.count)

    def set_camera(self, pinhole: Pinhole) -> None:
        """Tell kernels the camera of this frame."""
        self._pinhole.write([pinhole])

    def set_lights(self, frames: Sequence[LightFrame]) -> None:
        """Tell kernels the lights of this frame; the ``number`` of each is its place."""
        self._light_frames.write(frames)

    def read_counters(self) -> dict[str, int]:
        """Counter sums by name. Waits for the device."""
        rows = self.counters.numpy()
        totals = rows.sum(axis=0)
        for column in map(COUNTERS.index, LARGEST):
            totals[column] = rows[:, column].max()
        return dict(zip(COUNTERS, (int(v) for v in totals), strict=True))

    def nbytes(self) -> int:
        """Bytes reserved on the device."""
        return sum(a.capacity for a in vars(self).values() if isinstance(a, wp.array))


@wp.kernel(enable_backward=False)
def transform_vertices(
    row0: wp.vec4d,
    row1: wp.vec4d,
    row2: wp.vec4d,
    first: int,
    local: wp.array(dtype=wp.vec3d),
    world: wp.array(dtype=wp.vec3d),
):
    """world = pose * local."""
    i = first + wp.tid()
    world[i] = transform_point(row0, row1, row2, local[i])


_BLOCK = wp.constant(1024)


# transform_point in a loop for the CPU's compiler to put into vector registers; the same bits.
@wp.func_native(
    ARITHMETIC
    + r"""
#if !defined(__CUDA_ARCH__)
    const double* __restrict__ from = (const double*)(local.data + begin);
    double* __restrict__ to = (double*)(world.data + first + begin);
    for (int j = 0; j < end - begin; ++j) {
        const double x = from[3 * j], y = from[3 * j + 1], z = from[3 * j + 2];
        to[3 * j] = add(add(add(mul(row0[0], x), mul(row0[1], y)), mul(row0[2], z)), row0[3]);
        to[3 * j + 1] = add(add(add(mul(row1[0], x), mul(row1[1], y)), mul(row1[2], z)), row1[3]);
        to[3 * j + 2] = add(add(add(mul(row2[0], x), mul(row2[1], y)), mul(row2[2], z)), row2[3]);
    }
#endif
    """
)
def transform_block(
    row0: wp.vec4d,
    row1: wp.vec4d,
    row2: wp.vec4d,
    first: int,
    begin: int,
    end: int,
    local: wp.array(dtype=wp.vec3d),
    world: wp.array(dtype=wp.vec3d),
):
    """Vertices ``begin`` to ``end`` of a mesh, whose first is number ``first`` of ``world``."""
    ...


@wp.kernel(enable_backward=False)
def transform_blocks(
    row0: wp.vec4d,
    row1: wp.vec4d,
    row2: wp.vec4d,
    first: int,
    local: wp.array(dtype=wp.vec3d),
    world: wp.array(dtype=wp.vec3d),
):
    """``transform_vertices`` for a mesh whose vertices are read where the host has them."""
    begin = wp.tid() * _BLOCK
    transform_block(row0, row1, row2, first, begin, wp.min(begin + _BLOCK, local.shape[0]), local, world)


@dataclass
class _Part:
    """Where a mesh lies in the buffers, and which of its revisions is there."""

    first_vertex: int
    first_triangle: int
    vertex_count: int
    triangle_count: int
    topology: int
    vertices: int
    pose: int
    mesh_vertices: FloatArray  # (V, 3) in the mesh's own frame
    mesh_pose: FloatArray


class SceneBuffers:
    """The scene on the device: all meshes behind each other, vertices local and in the world (float64), corner
    indices."""

    def __init__(self, bounds: Bounds, device: Any) -> None:
        self.device = device
        vertices = 3 * bounds.max_triangles
        # The CPU reads them where the meshes have them.
        self.local = wp.empty(0 if device.is_cpu else vertices, dtype=wp.vec3d, device=device)
        self.vertices = wp.empty(vertices, dtype=wp.vec3d, device=device)
        self.triangles = wp.empty(bounds.max_triangles, dtype=wp.vec3i, device=device)
        self.triangle_count = 0
        self.vertex_count = 0
        self.version = 0  # grows with every change
        self._box: tuple[int, FloatArray, FloatArray] | None = None
        self._parts: dict[str, _Part] = {}
        self._revision = -1

    def sync(self, scene: Scene) -> Change:
        """Copy what changed in ``scene`` since the last call; all of it after a call that raised."""
        if scene.revision == self._revision:
            return Change.NOTHING
        try:
            return self._copy(scene)
        except BaseException:
            self._parts, self._revision = {}, -1
            raise

    def _copy(self, scene: Scene) -> Change:
        change = Change.NOTHING
        parts: dict[str, _Part] = {}
        first_vertex = first_triangle = 0
        for mesh in scene:
            part, part_change = self._sync_part(mesh, first_vertex, first_triangle)
            parts[mesh.name] = part
            change = max(change, part_change)
            first_vertex += part.vertex_count
            first_triangle += part.triangle_count
        # A mesh that is gone leaves the others in their places if it was the last, be it vertices without triangles.
        if (first_vertex, first_triangle) != (self.vertex_count, self.triangle_count):
            change = Change.TOPOLOGY
        self._parts = parts
        self._revision = scene.revision
        self.triangle_count = first_triangle
        self.vertex_count = first_vertex
        if change != Change.NOTHING:
            self.version += 1
        return change

    def nbytes(self) -> int:
        """Bytes reserved on the device."""
        return int(self.local.capacity + self.vertices.capacity + self.triangles.capacity)

    def _sync_part(self, mesh: Mesh, first_vertex: int, first_triangle: int) -> tuple[_Part, Change]:
        old = self._parts.get(mesh.name)
        change = Change.NOTHING
        placed = (
            old is not None
            and old.topology == mesh.topology_revision
            and (old.first_vertex, old.first_triangle) == (first_vertex, first_triangle)
        )
        if not placed:
            change = Change.TOPOLOGY
            upload(self.triangles, mesh.triangles + np.int32(first_vertex), first_triangle)
        moved = not placed or old is None or old.vertices != mesh.vertices_revision
        if moved and not self.device.is_cpu:
            upload(self.local, mesh.vertices, first_vertex)
        if moved or old is None or old.pose != mesh.pose_revision:
            change = max(change, Change.POSITIONS)
            self._place(mesh, first_vertex)
        part = _Part(
            first_vertex,
            first_triangle,
            len(mesh.vertices),
            len(mesh.triangles),
            mesh.topology_revision,
            mesh.vertices_revision,
            mesh.pose_revision,
            mesh.vertices,
            mesh.pose,
        )
        return part, change

    def _place(self, mesh: Mesh, first: int) -> None:
        """A mesh's vertices in the world, from vertex ``first`` on."""
        count = len(mesh.vertices)
        rows = [wp.vec4d(*row) for row in mesh.pose[:3]]
        if self.device.is_cpu:
            local = wp.array(ptr=mesh.vertices.ctypes.data, dtype=wp.vec3d, shape=(count,), device=self.device)
            inputs, blocks = [*rows, first, local, self.vertices], -(-count // int(_BLOCK))
            wp.launch(transform_blocks, dim=blocks, inputs=inputs, device=self.device)
        else:
            inputs = [*rows, first, self.local, self.vertices]
            wp.launch(transform_vertices, dim=count, inputs=inputs, device=self.device)

    def box(self) -> tuple[FloatArray, FloatArray]:
        """Low and high corner of a box in the world around all finite vertices; zeros if there are none."""
        if self._box is None or self._box[0] != self.version:
            self._box = (self.version, *self._find_box())
        return self._box[1], self._box[2]

    def _find_box(self) -> tuple[FloatArray, FloatArray]:
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for part in self._parts.values():
            least, most = _finite_box(part.mesh_vertices)
            if part.triangle_count == 0 or not np.all(least <= most):
                continue
            rotation, position = part.mesh_pose[:3, :3], part.mesh_pose[:3, 3]
            middle = rotation @ (0.5 * least + 0.5 * most) + position
            half = np.abs(rotation) @ (0.5 * most - 0.5 * least)
            # A few roundings either way: the box only has to hold, not to be tight.
            slack = 1e-14 * (np.abs(middle) + np.abs(half))
            low, high = np.minimum(low, middle - half - slack), np.maximum(high, middle + half + slack)
        return (low, high) if np.all(low <= high) else (np.zeros(3), np.zeros(3))


def _finite_box(vertices: FloatArray) -> tuple[FloatArray, FloatArray]:
    if len(vertices) == 0:
        return np.full(3, np.inf), np.full(3, -np.inf)
    # A column at a time: numpy reduces a long strided column several times faster than an axis of length three.
    low = np.array([vertices[:, k].min() for k in range(3)])
    high = np.array([vertices[:, k].max() for k in range(3)])
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        finite = vertices[np.isfinite(vertices).all(axis=1)]
        return _finite_box(finite)
    return low, high
