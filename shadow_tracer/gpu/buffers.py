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

from shadow_tracer.gpu.exact import transform_point
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
        if key not in self._made:
            if len(self._made) > 1000:
                self._made.clear()
            self._made[key] = array[first : first + count]
        return self._made[key]


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
        self._slices = Slices()

    def set_samples(self, count: int, width: int, first: int = 0) -> None:
        """Tell how many samples these buffers have of this frame, the width of the image they come from (0: a list of
        points), and which is the first."""
        self.count, self.width, self.first = count, width, first

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
    low: FloatArray  # bounding box of the finite vertices in the mesh's own frame
    high: FloatArray


class SceneBuffers:
    """The scene on the device: all meshes behind each other, vertices local and in the world (float64), corner
    indices."""

    def __init__(self, bounds: Bounds, device: Any) -> None:
        self.device = device
        vertices = 3 * bounds.max_triangles
        self.local = wp.empty(vertices, dtype=wp.vec3d, device=device)
        self.vertices = wp.empty(vertices, dtype=wp.vec3d, device=device)
        self.triangles = wp.empty(bounds.max_triangles, dtype=wp.vec3i, device=device)
        self.triangle_count = 0
        self.vertex_count = 0
        self.version = 0  # grows with every change
        self.low: FloatArray = np.zeros(3)  # bounding box in the world
        self.high: FloatArray = np.zeros(3)
        self._parts: dict[str, _Part] = {}
        self._revision = -1

    def sync(self, scene: Scene) -> Change:
        """Copy what changed in ``scene`` since the last call."""
        if scene.revision == self._revision:
            return Change.NOTHING
        change = Change.NOTHING
        parts: dict[str, _Part] = {}
        first_vertex = first_triangle = 0
        for mesh in scene:
            part, part_change = self._sync_part(mesh, first_vertex, first_triangle)
            parts[mesh.name] = part
            change = max(change, part_change)
            first_vertex += part.vertex_count
            first_triangle += part.triangle_count
        if first_triangle != self.triangle_count:
            change = Change.TOPOLOGY
        self._parts = parts
        self._revision = scene.revision
        self.triangle_count = first_triangle
        self.vertex_count = first_vertex
        if change != Change.NOTHING:
            self.version += 1
            self._update_box(scene)
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
        if old is not None and old.vertices == mesh.vertices_revision:
            low, high = old.low, old.high
        else:
            low, high = _finite_box(mesh.vertices)
        if not placed or old is None or old.vertices != mesh.vertices_revision:
            change = max(change, Change.POSITIONS)
            upload(self.local, mesh.vertices, first_vertex)
        if change != Change.NOTHING or old is None or old.pose != mesh.pose_revision:
            change = max(change, Change.POSITIONS)
            rows = [wp.vec4d(*row) for row in mesh.pose[:3]]
            wp.launch(
                transform_vertices,
                dim=len(mesh.vertices),
                inputs=[*rows, first_vertex, self.local, self.vertices],
                device=self.device,
            )
        part = _Part(
            first_vertex,
            first_triangle,
            len(mesh.vertices),
            len(mesh.triangles),
            mesh.topology_revision,
            mesh.vertices_revision,
            mesh.pose_revision,
            low,
            high,
        )
        return part, change

    def _update_box(self, scene: Scene) -> None:
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for mesh in scene:
            part = self._parts[mesh.name]
            if part.triangle_count == 0 or not np.all(part.low <= part.high):
                continue
            rotation, position = mesh.pose[:3, :3], mesh.pose[:3, 3]
            middle = rotation @ (0.5 * part.low + 0.5 * part.high) + position
            half = np.abs(rotation) @ (0.5 * part.high - 0.5 * part.low)
            # A few roundings either way: the box only has to hold, not to be tight.
            slack = 1e-14 * (np.abs(middle) + np.abs(half))
            low, high = np.minimum(low, middle - half - slack), np.maximum(high, middle + half + slack)
        if np.all(low <= high):
            self.low, self.high = low, high
        else:
            self.low, self.high = np.zeros(3), np.zeros(3)


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
