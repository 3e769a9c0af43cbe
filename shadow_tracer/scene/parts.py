# SPDX-License-Identifier: Apache-2.0
"""What a scene is made of: meshes, and the surfaces that depth images show, with revision numbers.

A revision number changes exactly when the thing it counts changes, so whoever mirrors the scene (the device buffers)
copies only what is new.
"""

from __future__ import annotations

import copy
import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.checks import FloatArray, rigid_pose
from shadow_tracer.scene.depth_mesh import depth_box, depth_cells
from shadow_tracer.scene.mesh_checks import IntArray, own
from shadow_tracer.scene.surface import BoolArray, Sampling

serial = itertools.count(1)
"""Numbers of revisions: each is given once."""


@dataclass(frozen=True)
class Positions:
    """What of a mesh can change while its triangles stay, in one object: a change is a single assignment, which has
    happened or not whenever an exception comes."""

    vertices: FloatArray
    pose: FloatArray
    vertices_revision: int
    pose_revision: int
    cast_shadows: bool


class Mesh:
    """A named triangle mesh, or an organised surface, with a rigid pose. Made and changed by :class:`Scene`; the arrays
    are read-only."""

    def __init__(
        self,
        name: str,
        vertices: FloatArray,
        triangles: IntArray,
        pose: FloatArray,
        sampling: Sampling | None = None,
        cast_shadows: bool = True,
    ) -> None:
        self.name = name
        """Name within its scene."""
        self.sampling = sampling
        """What a surface was given, and the level of detail that it has of that; None for any other mesh."""
        self.grid = None if sampling is None else sampling.grid
        """Rows and columns of a surface, whose vertices lie row by row and whose triangles are two to a quad
        (``surface.py``); None for any other mesh."""
        self._triangles = triangles
        self.topology_revision = next(serial)
        """Changes when the triangles change."""
        self._positions = Positions(vertices, pose, self.topology_revision, self.topology_revision, cast_shadows)
        self._degenerate: tuple[int, int] | None = None

    @property
    def triangles(self) -> IntArray:
        """(T, 3) int32 zero-based vertex indices."""
        return self._triangles

    @property
    def triangle_count(self) -> int:
        """T, without asking for the triangles."""
        return len(self._triangles)

    @property
    def vertex_count(self) -> int:
        """V, without asking for the vertices."""
        return len(self._positions.vertices)

    def snapshot(self) -> Mesh:
        """The same mesh, which no later change of the scene changes."""
        return copy.copy(self)

    @property
    def vertices(self) -> FloatArray:
        """(V, 3) float64 corner positions in the mesh's own frame [m]."""
        return self._positions.vertices

    @property
    def pose(self) -> FloatArray:
        """(4, 4) float64 rigid transform from the mesh's frame to the world."""
        return self._positions.pose

    @property
    def cast_shadows(self) -> bool:
        """Whether it is an occluder. If not, it is seen by depth cameras, has normals and receives a dose as before,
        but is in the way of nothing: neither of light nor of cones."""
        return self._positions.cast_shadows

    @property
    def vertices_revision(self) -> int:
        """Changes when the vertices change."""
        return self._positions.vertices_revision

    @property
    def pose_revision(self) -> int:
        """Changes when the pose changes."""
        return self._positions.pose_revision

    @property
    def valid(self) -> BoolArray:
        """(V,) vertices that are there, of a surface (R, C)."""
        return ~np.isnan(self.vertices[:, 0]).reshape(self.grid or (len(self.vertices),))

    @property
    def degenerate_count(self) -> int:
        """Triangles that cast nothing: zero area (in float64) or a corner that is not finite. Counted when first
        asked."""
        if self._degenerate is None or self._degenerate[0] != self.vertices_revision:
            a, b, c = (self.vertices[self.triangles[:, k]] for k in range(3))
            with np.errstate(invalid="ignore", over="ignore"):
                normal = np.cross(b - a, c - a)
                count = int((~(np.abs(normal).max(axis=1, initial=0.0) > 0.0)).sum())
            self._degenerate = (self.vertices_revision, count)
        return self._degenerate[1]

    def world_vertices(self) -> FloatArray:
        """Vertices in the world, shape (V, 3) [m]; the same operations in the same order as on the device."""
        x, y, z = self.vertices.T
        r = self.pose
        return np.stack([((r[i, 0] * x + r[i, 1] * y) + r[i, 2] * z) + r[i, 3] for i in range(3)], axis=-1)


class DepthSurface(Mesh):
    """The surface that a depth image shows; made by :meth:`Scene.put_depth`.

    Attributes:
        image: (H, W) float32 metres or uint16 millimetres; read-only.
        camera: intrinsics; where it was.
        step, max_jump: as for :meth:`Scene.put_depth`.
    """

    def __init__(
        self, name: str, image: npt.NDArray[Any], camera: Camera, step: int, max_jump: float, cast_shadows: bool = True
    ) -> None:
        pose = camera.camera_to_world
        super().__init__(
            name, np.empty((0, 3)), np.empty((0, 3), np.int32), rigid_pose(pose, "pose"), None, cast_shadows
        )
        self.pose.setflags(write=False)
        self.image = own(image, image.dtype)
        self.image.setflags(write=False)
        self.camera = camera
        self.step = int(step)
        self.max_jump = float(max_jump)
        self._made: tuple[FloatArray, IntArray] | None = None

    @property
    def corners(self) -> tuple[int, int]:
        """Rows and columns of corners."""
        height, width = self.image.shape
        return -(-height // self.step), -(-width // self.step)

    @property
    def triangles(self) -> IntArray:
        """(T, 3), two for each cell; those that are not there have corner (0, 0) of the cell three times."""
        return self._make()[1]

    @property
    def vertices(self) -> FloatArray:
        """(V, 3) in the optical frame [m]; corners without depth are at the origin."""
        return self._make()[0]

    @property
    def triangle_count(self) -> int:
        """T, without asking for the triangles."""
        rows, columns = self.corners
        return 2 * (rows - 1) * (columns - 1)

    @property
    def vertex_count(self) -> int:
        """V, without asking for the vertices."""
        rows, columns = self.corners
        return rows * columns

    def box(self) -> tuple[FloatArray, FloatArray]:
        """Two corners of a box in the optical frame that holds all vertices [m], without asking for them."""
        return depth_box(self.image, self.camera, self.step)

    def _make(self) -> tuple[FloatArray, IntArray]:
        if self._made is None:
            self._made = depth_cells(self.image, self.camera, self.step, self.max_jump)
        return self._made
