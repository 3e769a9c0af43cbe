# SPDX-License-Identifier: Apache-2.0
"""Everything that casts shadow as it was received: named parts in frames of their own, and what of them the scene has.

A part is immutable. Whatever arrives becomes :class:`Changes`, which are applied whole or not at all; the scene follows
at the next frame, and only what differs from what it has is copied. No ROS here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Protocol

import numpy as np

from shadow_tracer import BoundsError, Scene
from shadow_tracer.ros.diagnostics import Missing
from shadow_tracer.ros.settings import FloatArray
from shadow_tracer.ros.wire.grid_map import GridPart
from shadow_tracer.ros.wire.parts import FILES, IDENTITY, Changes, Part, PartError
from shadow_tracer.scene.checks import LARGEST, unusable_vertices


class Places(Protocol):
    """Where frames are at the stamp of a depth image; see :class:`frames.Poses`."""

    @property
    def world(self) -> str:
        """Name of the fixed frame, "" where it has none."""

    def frame_to_world(self, frame: str, field: str, stamp: int | None = None) -> FloatArray:
        """(4, 4) transform of a frame at a stamp [ns], None being that of the image. Raises Missing."""


class MeshStore:
    """All parts, and the scene that follows them.

    Args:
        max_triangles: capacity of all parts together.

    Attributes:
        updates: how often a mesh of the scene was replaced ("put"), got new positions ("deform") and moved ("move").
        lacking: why the mesh that came last was refused, "" if it was good. Where there are no parts no mask is right
            then: what casts shadow exists and is not known.
    """

    def __init__(self, max_triangles: int) -> None:
        self.updates = {"put": 0, "deform": 0, "move": 0}
        self.lacking = ""
        self._max_triangles = max_triangles
        self._parts: dict[str, Part] = {}
        self._received: dict[str, int] = {}
        self._shown: dict[str, tuple[Part, FloatArray]] = {}  # what the scene has, and where
        self._fixed: dict[str, tuple[Part, str, FloatArray]] = {}

    @property
    def parts(self) -> Mapping[str, Part]:
        """The parts by key, read-only."""
        return MappingProxyType(self._parts)

    @property
    def triangle_count(self) -> int:
        """Triangles of all parts."""
        return sum(len(part.triangles) for part in self._parts.values())

    @property
    def vertex_count(self) -> int:
        """Vertices of all parts."""
        return sum(len(part.vertices) for part in self._parts.values())

    def commit(self, changes: Changes, now_ns: int) -> None:
        """Apply changes, whole or not at all.

        Args:
            now_ns: time of the node's clock [ns], from which the parts age.

        Raises:
            PartError: all parts together would exceed ``bounds.max_triangles``, or a coordinate of a triangle is beyond
                1e50.
        """
        parts = self._parts
        if changes.clear is not None:
            parts = {key: part for key, part in parts.items() if not key.startswith(changes.clear)}
        if changes.remove:
            removed = set(changes.remove)
            parts = {key: part for key, part in parts.items() if key not in removed}
        if changes.put:
            parts = parts | {part.key: part for part in changes.put}
            self._check(parts.values(), changes.put)
        self._parts = parts
        self._received = {key: self._received.get(key, now_ns) for key in parts}
        self._received |= {part.key: now_ns for part in changes.put}

    def _check(self, parts: Iterable[Part], new: Iterable[Part]) -> None:
        triangles, vertices = (sum(len(getattr(part, name)) for part in parts) for name in ("triangles", "vertices"))
        if triangles > self._max_triangles or vertices > 3 * self._max_triangles:
            raise PartError(
                f"bounds.max_triangles: all meshes together would have {triangles} triangles and {vertices} vertices; "
                f"at most {self._max_triangles} and three times as many fit"
            )
        for part in new:
            if isinstance(part, GridPart):  # checked as a surface, in which what has no height is NaN
                continue
            known = self._parts.get(part.key)
            if known is not None and known.vertices is part.vertices and known.triangles is part.triangles:
                continue
            bad = unusable_vertices(part.vertices, part.triangles)
            if len(bad):
                raise PartError(
                    f"vertices: expected finite coordinates of at most {LARGEST:g} m, got "
                    f"{part.vertices[bad[0]].tolist()} at vertex {bad[0]} of {part.key}"
                )

    def expire(self, now_ns: int) -> None:
        """Drop the parts whose lifetime is over at a time of the node's clock [ns]."""
        self._date(now_ns)
        gone = [key for key, part in self._parts.items() if part.expires is not None and part.expires <= now_ns]
        if gone:
            self.commit(Changes(remove=tuple(gone)), now_ns)

    def oldest(self, now_ns: int) -> tuple[str, float]:
        """Key and age [s] of the part that was received longest ago; ("", 0.0) if none can age. Files do not."""
        self._date(now_ns)
        ages = {key: now_ns - then for key, then in self._received.items() if not key.startswith(FILES)}
        if not ages:
            return "", 0.0
        key = max(ages, key=ages.__getitem__)
        return key, ages[key] * 1e-9

    def restart_age(self, now_ns: int) -> None:
        """Time has jumped to ``now_ns`` [ns]: every part counts as received now, lifetimes included. Parts that stay
        where their frame was once stay there: of that time nothing is known any more."""
        self._restart(tuple(self._parts), now_ns)

    def _date(self, now_ns: int) -> None:
        """What was received at 0, before the first /clock of a simulation, counts as received with it."""
        undated = tuple(key for key, then in self._received.items() if then == 0) if now_ns else ()
        if undated:
            self._restart(undated, now_ns)

    def _restart(self, keys: Iterable[str], now_ns: int) -> None:
        self._parts = dict(self._parts)  # snapshots stay what they are
        for key in keys:
            part = self._parts[key]
            if part.expires is not None:
                self._parts[key] = moved = replace(part, expires=now_ns + part.expires - self._received[key])
                if key in self._fixed and self._fixed[key][0] is part:
                    self._fixed[key] = (moved, *self._fixed[key][1:])
            self._received[key] = now_ns

    def snapshot(self) -> Mapping[str, Part]:
        """The parts of now, which later changes leave alone."""
        return MappingProxyType(self._parts)

    def update(
        self,
        scene: Scene,
        places: Places,
        mesh_frame: str,
        shown: bool = True,
        parts: Mapping[str, Part] | None = None,
        silent: Sequence[str] = (),
    ) -> None:
        """Bring the scene up to date, copying only what is new. Meshes of the scene that are not parts stay.

        Args:
            scene: the world of the tracer; nobody else changes the meshes named after parts.
            places: frames at the stamp of the depth image.
            mesh_frame: frame of parts without one.
            shown: False removes all parts from the scene.
            parts: a snapshot to be shown; None is the parts of now.
            silent: parts that cast no shadows; a name stands for all that begin with it and a slash.

        Raises:
            Missing: the frame of a part cannot be found; the scene is as before.
            BoundsError: with what else is in the scene it is too much.
        """
        wanted = (self._parts if parts is None else parts) if shown else {}
        poses = {key: self.place(part, places, mesh_frame) for key, part in wanted.items()}
        for key in self._shown.keys() - wanted.keys():
            if key in scene:
                scene.remove(key)
            del self._shown[key]
        self._fixed = {key: value for key, value in self._fixed.items() if key in self._parts}

        def growth(part: Part) -> int:
            return len(part.triangles) - (len(scene[part.key].triangles) if part.key in scene else 0)

        # Those that shrink come first, so that the sum never exceeds the larger of the sums before and after.
        try:
            for part in sorted(wanted.values(), key=growth):
                self._apply(scene, part, poses[part.key])
        except BoundsError:
            # Of vertices it may: fewer triangles can have more of them. Then all make room for all.
            for part in wanted.values():
                if part.key in scene:
                    scene.remove(part.key)
            for part in wanted.values():
                self._apply(scene, part, poses[part.key])
        for key in wanted:
            scene.cast_shadows(key, not is_named(key, silent))

    def placed(self, part: Part) -> tuple[str, FloatArray] | None:
        """World and (4, 4) pose in it of a part that stays where its frame was once; None until a frame needed it."""
        fixed = self._fixed.get(part.key)
        return None if fixed is None or fixed[0] is not part else fixed[1:]

    def place(self, part: Part, places: Places, mesh_frame: str) -> FloatArray:
        """(4, 4) transform of a part to the world; arguments as for :meth:`update`. Raises Missing."""
        frame = part.frame or mesh_frame
        if part.locked:
            return _product(places.frame_to_world(frame, part.field), part.pose)
        fixed = self._fixed.get(part.key)
        # An update in place (same frame and stamp) is looked up again too: its pose may be another.
        if fixed is not None and fixed[0] is part and fixed[1] == places.world:
            return fixed[2]
        try:
            pose = _product(places.frame_to_world(frame, part.field, part.stamp or None), part.pose)
        except Missing as missing:
            hint = "if that time is long past, publish it again, or call ~/clear_meshes"
            raise Missing(missing.status, f"{missing.text}; {hint}", missing.wait, missing.level) from missing
        self._fixed[part.key] = (part, places.world, pose)
        return pose

    def _apply(self, scene: Scene, part: Part, pose: FloatArray) -> None:
        shown, at = self._shown.get(part.key, (None, None))
        there = part.key in scene
        if isinstance(part, GridPart):
            self._apply_surface(scene, part, shown, pose)
        elif shown is None or not there or shown.triangles is not part.triangles:
            scene.put(part.key, part.vertices, part.triangles, pose)
            self.updates["put"] += 1
        elif shown.vertices is not part.vertices:
            if len(shown.vertices) != len(part.vertices):
                scene.put(part.key, part.vertices, part.triangles, pose)
                self.updates["put"] += 1
            else:
                scene.deform(part.key, part.vertices)
                self.updates["deform"] += 1
        if there and (at is None or not (pose is at or np.array_equal(pose, at))):  # a check that many parts pass by
            revision = scene[part.key].pose_revision
            scene.move(part.key, pose)
            self.updates["move"] += scene[part.key].pose_revision != revision
        self._shown[part.key] = part, pose

    def _apply_surface(self, scene: Scene, part: GridPart, shown: Part | None, pose: FloatArray) -> None:
        if part.key not in scene or scene[part.key].grid != part.surface.grid:
            scene.put_surface(part.key, part.surface, pose=pose)
            self.updates["put"] += 1
        elif not isinstance(shown, GridPart) or shown.surface is not part.surface:
            scene.deform_surface(part.key, part.surface)
            self.updates["deform"] += 1


def is_named(key: str, names: Iterable[str]) -> bool:
    """Whether one of the names is that of a part, or how it begins before a slash."""
    return any(key == name or key.startswith(f"{name}/") for name in names)


def _product(frame: FloatArray, pose: FloatArray) -> FloatArray:
    # The identity leaves the other as it is, bit by bit; it is the usual case.
    if (frame == IDENTITY).all():
        return pose
    return frame if (pose == IDENTITY).all() else frame @ pose
