# SPDX-License-Identifier: Apache-2.0
"""The mesh of the topic ``mesh``: what arrived last, what was refused, and what of it the scene already has."""

from __future__ import annotations

import time

from shadow_tracer import Scene
from shadow_tracer.ros.cdr import MeshMessage, MeshMessageError, parse_mesh
from shadow_tracer.ros.diagnostics import MESH, Complaint, Missing, RateMeter, Window
from shadow_tracer.ros.settings import FloatArray

NAME = "mesh"


class MeshInput:
    """Keeps the newest good mesh. A refused one changes nothing.

    Attributes:
        arrivals: meter of everything that arrives, good or not.
        refused: what was refused, and why.
        parsing: milliseconds of parsing good meshes.
        updates: how often the scene got a new mesh ("put") and new positions ("deform").
    """

    def __init__(self) -> None:
        self.arrivals = RateMeter()
        self.refused = Complaint()
        self.parsing = Window()
        self.updates = {"put": 0, "deform": 0}
        self._known: MeshMessage | None = None
        self._pending: MeshMessage | None = None
        self._in_scene: MeshMessage | None = None
        self._received: int | None = None
        self._shown_since: int | None = None

    @property
    def present(self) -> bool:
        """True once a good mesh has come, be it without triangles."""
        return self._known is not None

    @property
    def triangle_count(self) -> int:
        """Triangles of the newest good mesh."""
        return len(self._known.triangles) if self._known else 0

    @property
    def vertex_count(self) -> int:
        """Vertices of the newest good mesh."""
        return len(self._known.vertices) if self._known else 0

    def receive(self, data: bytes, max_triangles: int, now: float, now_ns: int) -> None:
        """Take a serialised shape_msgs/Mesh.

        Args:
            data: any bytes.
            max_triangles: capacity; a larger mesh is refused whole.
            now: steady time [s].
            now_ns: time of the node's clock [ns], from which the mesh ages.
        """
        self.arrivals.tick(now)
        start = time.perf_counter()
        try:
            mesh = parse_mesh(data, max_triangles, self._known)
        except MeshMessageError as error:
            self.refused.add(str(error), now)
            return
        self.parsing.add((time.perf_counter() - start) * 1e3)
        self._known = self._pending = mesh
        self._received = now_ns

    def age(self, now_ns: int) -> float:
        """Seconds since the newest good mesh on the node's clock; 0 before there is one."""
        return 0.0 if self._received is None else (now_ns - self._received) * 1e-9

    def restart_age(self, now_ns: int) -> None:
        """Time has jumped: the mesh counts as received now."""
        if self._received is not None:
            self._received = self._shown_since = now_ns

    def check_age(self, max_age: float, now_ns: int) -> None:
        """Raise Missing if the mesh is stale; ``max_age`` 0 never is."""
        age = self.age(now_ns)
        if max_age > 0.0 and age > max_age:
            raise Missing(
                MESH,
                f"the mesh is {age:.1f} s old and mesh.max_age is {max_age:g} s; restart its publisher, or set "
                "mesh.max_age to 0",
                wait=False,
            )

    def update(self, scene: Scene, frame_to_world: FloatArray, now: float) -> None:
        """Bring the scene up to date with the newest good mesh and its pose, copying only what is new."""
        mesh, self._pending = self._pending, None
        if mesh is not None:
            try:
                self._apply(scene, mesh, frame_to_world)
            except ValueError as error:
                self._known, self._received = self._in_scene, self._shown_since
                self.refused.add(str(error), now)
        if NAME in scene:
            scene.move(NAME, frame_to_world)

    def _apply(self, scene: Scene, mesh: MeshMessage, frame_to_world: FloatArray) -> None:
        shown = self._in_scene
        if len(mesh.triangles) == 0:
            if NAME in scene:
                scene.remove(NAME)
        elif NAME in scene and shown is not None and shown.same_topology(mesh.block, len(mesh.vertices)):
            scene.deform(NAME, mesh.vertices)
            self.updates["deform"] += 1
        else:
            scene.put(NAME, mesh.vertices, mesh.triangles, frame_to_world)
            self.updates["put"] += 1
        self._in_scene, self._shown_since = mesh, self._received
