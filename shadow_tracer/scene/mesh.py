# SPDX-License-Identifier: Apache-2.0
"""Scene: named triangle meshes that move and deform, checked on entry.

Every check runs before anything is stored: after an error the scene is what it was.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.checks import BoundsError, FloatArray, name_of, rigid_pose, truth
from shadow_tracer.scene.depth_mesh import checked_depth
from shadow_tracer.scene.mesh_checks import IntArray, equal, triangles_of, usable, vertices_of
from shadow_tracer.scene.parts import DepthSurface, Positions, serial
from shadow_tracer.scene.parts import Mesh as Mesh  # for those who import it from here
from shadow_tracer.scene.some import Some
from shadow_tracer.scene.surface import Sampling, organised


class Scene:
    """Named meshes. Names are unique; the order of insertion is kept and does not matter to any result.

    Args:
        bounds: capacities; a mesh that would exceed them is refused whole.
    """

    def __init__(self, bounds: Bounds | None = None) -> None:
        self.bounds = bounds or Bounds()
        self._meshes: dict[str, Mesh] = {}
        self._revision = next(serial)  # always changed before the meshes: no change goes unnoticed
        self._counts = (0, 0, 0)  # a revision, and what triangles and vertices there were
        self._occluders: Some | None = None

    @property
    def revision(self) -> int:
        """Grows with every change of any mesh; never the same for two scenes."""
        return self._revision

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all meshes."""
        return tuple(self._meshes)

    @property
    def triangle_count(self) -> int:
        """Triangles of all meshes, degenerate ones included."""
        return self._counted()[1]

    @property
    def vertex_count(self) -> int:
        """Vertices of all meshes."""
        return self._counted()[2]

    @property
    def occluders(self) -> Some:
        """The meshes that cast shadows, in their order."""
        if self._occluders is None or self._occluders.revision != self._revision:
            self._occluders = Some([mesh for mesh in self if mesh.cast_shadows], self._revision)
        return self._occluders

    def __contains__(self, name: object) -> bool:
        return name in self._meshes

    def __len__(self) -> int:
        return len(self._meshes)

    def __iter__(self) -> Iterator[Mesh]:
        return iter(self._meshes.values())

    def __getitem__(self, name: str) -> Mesh:
        try:
            return self._meshes[name]
        except KeyError:
            raise ValueError(f"name: expected one of {list(self._meshes)}, got {name!r}") from None

    def put(
        self,
        name: str,
        vertices: Any,
        triangles: Any,
        pose: Any = None,
        nonfinite: str = "refuse",
        cast_shadows: bool = True,
    ) -> Mesh:
        """Add a mesh or replace the one of that name.

        Replacing with equal triangles is a deformation: what depends only on topology is kept.

        Args:
            name: non-empty string.
            vertices: (V, 3) real numbers [m]. Copied, unless it is a read-only float64 array that owns its memory.
            triangles: (T, 3) integers from 0 to V - 1; T may be 0. Copied, unless a read-only int32 array likewise.
            pose: (4, 4) rigid transform to the world; identity if None.
            nonfinite: "refuse" triangles at vertices with NaN, infinity or coordinates beyond 1e50, or "skip": such
                triangles cast nothing. Such vertices are stored as NaN; one that no triangle uses never matters.
            cast_shadows: whether it is an occluder; see :meth:`cast_shadows`.

        Raises:
            ValueError: an argument is malformed; the message names it and the first fault's position.
            BoundsError: the scene would exceed ``bounds.max_triangles``.
        """
        name_of(name, "name")
        new_vertices = vertices_of(vertices)
        new_triangles = triangles_of(triangles, len(new_vertices))
        new_vertices = usable(new_vertices, new_triangles, nonfinite)
        return self._put(name, new_vertices, new_triangles, pose, None, cast_shadows)

    def put_surface(
        self,
        name: str,
        positions: Any,
        valid: Any = None,
        pose: Any = None,
        cast_shadows: bool = True,
        level: int = 0,
    ) -> Mesh:
        """Add an organised surface or replace what has that name: the two triangles of each quad between neighbouring
        rows and columns; ``scene/surface.py`` says along which diagonal quads are cut.

        A quad casts the shadow of its valid corners: of three their triangle, of fewer nothing. Several charts share
        one surface where rows or columns between them are not valid.

        Args:
            name: non-empty string.
            positions: (R, C, 3) real numbers [m], R and C at least 1, or a :class:`HeightField`. Copied.
            valid: (R, C) truth values: which positions count; None is all, of a height field all that have a height.
            pose: (4, 4) rigid transform to the world; identity if None.
            cast_shadows: whether it is an occluder; see :meth:`cast_shadows`.
            level: of detail: the surface has every 2**level-th row and column, and the last ones. That is another
                surface, which all pipelines agree about: where it lies below the finer one it casts less, where above
                more. Positions in between are not looked at, but for whether they are valid: one that has another
                between it and the next one that is kept is not there, so that nothing reaches over gutters and holes.

        Raises:
            ValueError: an argument is malformed; the message names it and the first fault's position.
            BoundsError: the scene would exceed ``bounds.max_triangles``.
        """
        name_of(name, "name")
        surface = organised(positions, valid, level=level)
        self._check_capacity(name, len(surface.vertices), surface.triangle_count)
        return self._put(name, surface.vertices, surface.triangles(), pose, surface.sampling, cast_shadows)

    def deform_surface(self, name: str, positions: Any, valid: Any = None) -> None:
        """Give a surface new positions, and a new mask.

        Args:
            positions: (R, C, 3) real numbers [m], or a :class:`HeightField`, of the shape that it was put with; its
                level of detail stays.
            valid: (R, C) truth values; None: the mask stays, that of a height field comes with it.

        Raises:
            ValueError: no surface of that name, another shape, or a valid position that is not finite.
        """
        mesh = self[name]
        if mesh.sampling is None:
            raise ValueError(f"name: {name!r} is no surface; use deform()")
        known, had = mesh.valid, mesh.sampling
        surface = organised(positions, valid, known, had.level)
        if surface.sampling != had:
            got = surface.sampling.rows, surface.sampling.columns, 3
            raise ValueError(
                f"positions: expected shape {(had.rows, had.columns, 3)} as surface {name!r} has, got {got}; "
                "use put_surface() to replace it"
            )
        if np.array_equal(surface.valid, known):
            self._position(mesh, vertices=surface.vertices, vertices_revision=next(serial))
        else:
            self._put(name, surface.vertices, surface.triangles(), mesh.pose, had, mesh.cast_shadows)

    def put_depth(
        self, name: str, depth: Any, camera: Camera, step: int = 1, max_jump: float = 0.05, cast_shadows: bool = True
    ) -> Mesh:
        """Add the surface that a depth image shows, or replace what has that name: the triangles between neighbouring
        pixels that do not jump in depth (``scene/depth_mesh.py`` says which), in the pose of the camera.

        The triangles are found where they are used, on the device; :attr:`Mesh.triangles` and :attr:`Mesh.vertices` are
        computed when somebody asks for them. Each cell between four corners counts as two triangles, of which those
        that are not there have zero area.

        Args:
            name: non-empty string.
            depth: (H, W) float32 metres along the optical axis (zero, negative and non-finite values are no
                measurement) or uint16 millimetres (0 is none); masked pixels are no measurement. Copied.
            camera: intrinsics and pose.
            step: every so many pixels a corner, at least 1.
            max_jump: the largest relative difference of depth within a triangle, above 0 and at most 1e6.
            cast_shadows: whether it is an occluder; see :meth:`cast_shadows`.

        Raises:
            ValueError: an argument is malformed; the message names it.
            BoundsError: the scene would exceed ``bounds.max_triangles``.
        """
        name_of(name, "name")
        casts, image = truth(cast_shadows, "cast_shadows"), checked_depth(depth, camera, step, max_jump)
        surface = DepthSurface(name, image, camera, step, max_jump, casts)
        totals = self._check_capacity(name, surface.vertex_count, surface.triangle_count)
        revision = self._revision = next(serial)
        self._meshes[name] = surface
        self._counts = (revision, *totals)
        return surface

    def _put(
        self,
        name: str,
        vertices: FloatArray,
        triangles: IntArray,
        pose: Any,
        sampling: Sampling | None,
        cast_shadows: bool,
    ) -> Mesh:
        """Store what has been checked; pose, flag and capacity are checked here."""
        casts = truth(cast_shadows, "cast_shadows")
        new_pose = rigid_pose(np.eye(4) if pose is None else pose, "pose")
        new_pose.setflags(write=False)
        totals = self._check_capacity(name, len(vertices), len(triangles))
        old = self._meshes.get(name)
        revision = self._revision = next(serial)
        same = type(old) is Mesh and old.sampling == sampling and old.vertex_count == len(vertices)
        if old is not None and same and equal(old.triangles, triangles):
            moved = not np.array_equal(old.pose, new_pose)
            pose, pose_revision = (new_pose, revision) if moved else (old.pose, old.pose_revision)
            old._positions = Positions(vertices, pose, revision, pose_revision, casts)
        else:
            self._meshes[name] = Mesh(name, vertices, triangles, new_pose, sampling, casts)
        self._counts = (revision, *totals)
        return self._meshes[name]

    def move(self, name: str, pose: Any) -> None:
        """Give a mesh a new rigid pose, (4, 4). Vertices are not copied again.

        Raises:
            ValueError: no mesh of that name, or the pose is not rigid.
        """
        mesh = self[name]
        new_pose = rigid_pose(pose, "pose")
        if np.array_equal(mesh.pose, new_pose):
            return
        new_pose.setflags(write=False)
        self._position(mesh, pose=new_pose, pose_revision=next(serial))

    def cast_shadows(self, name: str, casts: bool) -> None:
        """Let a mesh cast shadows, or not: a lamp's glass, a net, a mark on the floor. What does not is in the way of
        nothing, and is seen by depth cameras and receives a dose as before. ``ignore`` of a light is for what casts
        none in that light alone.

        Raises:
            ValueError: no mesh of that name, or not a truth value.
        """
        mesh, wanted = self[name], truth(casts, "casts")
        if mesh.cast_shadows != wanted:
            self._position(mesh, cast_shadows=wanted)

    def deform(self, name: str, vertices: Any, nonfinite: str = "refuse") -> None:
        """Give a mesh new vertex positions, (V, 3) [m], with the triangles it has.

        Raises:
            ValueError: no mesh of that name, another number of vertices, or (unless "skip") a triangle at a vertex
                that is not finite.
        """
        mesh = self[name]
        if mesh.grid is not None:
            raise ValueError(f"name: {name!r} is a surface; use deform_surface()")
        new_vertices = vertices_of(vertices)
        if type(mesh) is not Mesh:
            raise ValueError(f"name: {name!r} is the surface of a depth image; use put_depth() to replace it")
        if len(new_vertices) != len(mesh.vertices):
            raise ValueError(
                f"vertices: expected {len(mesh.vertices)} as mesh {name!r} has, got {len(new_vertices)}; "
                "use put() to replace it"
            )
        good = usable(new_vertices, mesh.triangles, nonfinite)
        self._position(mesh, vertices=good, vertices_revision=next(serial))

    def remove(self, name: str) -> None:
        """Remove a mesh. Raises ValueError if there is none of that name."""
        mesh = self[name]
        triangles, vertices = self.triangle_count - mesh.triangle_count, self.vertex_count - mesh.vertex_count
        revision = self._revision = next(serial)
        del self._meshes[mesh.name]
        self._counts = (revision, triangles, vertices)

    def clear(self) -> None:
        """Remove every mesh."""
        if self._meshes:
            self._revision = next(serial)
            self._meshes = {}

    def _position(self, mesh: Mesh, **changes: Any) -> None:
        totals = self._counted()[1:]
        revision = self._revision = next(serial)
        mesh._positions = replace(mesh._positions, **changes)
        self._counts = (revision, *totals)

    def _counted(self) -> tuple[int, int, int]:
        if self._counts[0] != self._revision:  # an exception came in the middle of a change
            triangles = sum(mesh.triangle_count for mesh in self)
            self._counts = (self._revision, triangles, sum(mesh.vertex_count for mesh in self))
        return self._counts

    def _check_capacity(self, name: str, vertex_count: int, triangle_count: int) -> tuple[int, int]:
        """Triangles and vertices that the scene would have."""
        old = self._meshes.get(name)
        triangles = self.triangle_count + triangle_count - (old.triangle_count if old else 0)
        vertices = self.vertex_count + vertex_count - (old.vertex_count if old else 0)
        limit = self.bounds.max_triangles
        if triangles > limit:
            raise BoundsError(
                f"bounds.max_triangles: mesh {name!r} has {triangle_count} triangles and the scene would have "
                f"{triangles}, but the bound is {limit}"
            )
        if vertices > 3 * limit:
            raise BoundsError(
                f"bounds.max_triangles: mesh {name!r} has {vertex_count} vertices and the scene would have {vertices}, "
                f"but at most 3 * {limit} fit"
            )
        return triangles, vertices
