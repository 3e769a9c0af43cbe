# SPDX-License-Identifier: Apache-2.0
"""Points that somebody asks about: which lights reach them. No ROS here."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer import ShadowTracer, State
from shadow_tracer.ros.diagnostics import ERROR, PROCESSING, Complaint, Missing
from shadow_tracer.ros.node.cone_bits import MOST, Bits, cone_bits
from shadow_tracer.ros.node.processing import check_meshes, forget_surface
from shadow_tracer.ros.settings import FloatArray, Settings
from shadow_tracer.ros.wire.clouds import cloud_cones, cloud_normals, cloud_points, visibility_cloud
from shadow_tracer.ros.wire.messages import stamp_ns
from shadow_tracer.ros.wire.parts import PartError
from shadow_tracer.ros.world.frames import Frames
from shadow_tracer.ros.world.lighting import Lighting
from shadow_tracer.ros.world.mesh_store import MeshStore
from shadow_tracer.scene.checks import all_three

MOST_LIGHTS = 32
_CAPACITY = 8
_SHORTEST_WAIT = 0.1
_FAILED = "if it stays so, set another pipeline, or restart the node"


@dataclass(frozen=True, eq=False)
class _Query:
    message: Any
    points: FloatArray
    normals: FloatArray | None
    cones: tuple[str, FloatArray] | None  # how wide those are that it asks about
    arrived: float


class Queries:
    """Waiting queries, a bounded number of them; answered in the order in which they came.

    Attributes:
        answered, unknown: how many got an answer, and how many of those that nothing is known.
        dropped: queries that found the queue full.
        refused: messages that cannot be used.
    """

    def __init__(self, frames: Frames, meshes: MeshStore, lighting: Lighting) -> None:
        self.answered = self.unknown = self.dropped = 0
        self.refused = Complaint()
        self.missing: Missing | None = None
        self._frames = frames
        self._meshes = meshes
        self._lighting = lighting
        self._waiting: deque[_Query] = deque()

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def about_cones(self) -> bool:
        """Whether one that waits is about cones."""
        return any(query.cones is not None for query in self._waiting)

    def put(self, message: Any, max_points: int, now: float) -> None:
        """Take a sensor_msgs/PointCloud2 with fields x, y, z [m], normal_x, normal_y, normal_z or none of them, and
        radius [m], half_angle [rad] or neither.

        Args:
            max_points: capacity; a larger cloud is refused.
            now: steady time [s].
        """
        try:
            points = cloud_points(message)
            if len(points) > max_points:
                raise PartError(f"bounds.max_rays: the query has {len(points)} points, the bound is {max_points}")
            normals = cloud_normals(message)
            cones = cloud_cones(message, MOST)
        except PartError as error:
            self.refused.add(str(error), now)
            return
        if len(self._waiting) == _CAPACITY:
            self._waiting.popleft()
            self.dropped += 1
        self._waiting.append(_Query(message, points, normals, cones, now))

    def clear(self) -> None:
        """Drop all waiting queries."""
        self.dropped += len(self._waiting)
        self._waiting.clear()

    def step(
        self, settings: Settings, tracer: ShadowTracer, camera_frame: str, now: float, now_ns: int,
        publish: Callable[[Any], None],
    ) -> None:  # fmt: skip
        """Answer the queries that have all they need, or have waited long enough to be told that nothing is known.

        Args:
            camera_frame: optical frame of the depth images, "" if none has come.
            now: steady time [s].
            now_ns: time of the node's clock [ns].
            publish: called with each answer.
        """
        while self._waiting:
            query = self._waiting[0]
            last_chance = now - query.arrived >= max(settings.tf_timeout, _SHORTEST_WAIT)
            known = all_three(np.isfinite(query.points))
            if query.cones is not None:
                known &= np.isfinite(query.cones[1])
            answers = np.zeros((1 if query.cones is None else 3, len(query.points)), np.uint32)
            try:
                if known.any():
                    answers[:, known] = self._bits(settings, tracer, query, camera_frame, last_chance, now_ns, known)
                self.missing = None
            except Missing as missing:
                if missing.wait and not last_chance:
                    return
                self._nothing_known(missing, known)
            except Exception as error:  # whatever it is, the same query must not come again for ever
                self._nothing_known(Missing(PROCESSING, f"the query failed: {error}; {_FAILED}", False, ERROR), known)
            self._waiting.popleft()
            certain = None if query.cones is None else (answers[1], answers[2])
            publish(visibility_cloud(query.message, query.points, answers[0], known, certain))
            self.answered += 1

    def _nothing_known(self, missing: Missing, known: npt.NDArray[np.bool_]) -> None:
        self.missing = missing
        self.unknown += 1
        known[:] = False

    def _bits(
        self, settings: Settings, tracer: ShadowTracer, query: _Query, camera_frame: str, last_chance: bool,
        now_ns: int, known: npt.NDArray[np.bool_],
    ) -> Sequence[Bits]:  # fmt: skip
        """Of known points the lights that reach them; of cones also those that they are free and blocked to."""
        header = query.message.header
        stamp = stamp_ns(header.stamp)
        check_meshes(self._meshes, settings, now_ns)
        if not camera_frame and settings.pose_source == "tf" and not settings.fixed_frame:
            camera_frame = header.frame_id  # no image has come: the world is where the query is
        poses = self._frames.at(settings, camera_frame, stamp, last_chance)
        to_world = poses.frame_to_world(header.frame_id, "header.frame_id of query")
        lit = self._lighting.at(settings, poses, stamp)
        forget_surface(tracer.scene, settings)
        self._meshes.update(
            tracer.scene, poses, settings.mesh_frame, settings.uses_meshes, silent=settings.mesh_cast_no_shadows
        )
        points = query.points[known] @ to_world[:3, :3].T + to_world[:3, 3]
        bits = np.zeros(len(points), np.uint32)
        if not lit.lights:
            return [bits] if query.cones is None else [bits] * 3
        tracer.front_face_culling = settings.front_face_culling
        if query.normals is not None:  # a normal of zeros moves nothing
            away = settings.bias_normal * settings.bias_constant
            points += away * (query.normals[known] @ to_world[:3, :3].T)
        states = tracer.states_at(points, lit.lights, settings.bias_constant, settings.samples)
        names = [light.name for light in settings.lights]
        placed = [(names.index(light.name), light) for light in lit.lights]
        for (place, _), state in zip(placed, states, strict=True):
            if place < MOST_LIGHTS:
                reached = (state != State.SHADOWED) & (state != State.OUTSIDE) & (state != State.INVALID)
                bits |= reached.astype(np.uint32) << np.uint32(place)
        if query.cones is None:
            return [bits]
        name, sizes = query.cones
        placed = [(place, light) for place, light in placed if place < MOST_LIGHTS]
        return bits, *cone_bits(tracer, points, (name, sizes[known]), placed, settings.bias_constant)
