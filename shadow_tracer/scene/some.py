# SPDX-License-Identifier: Apache-2.0
"""Some of the meshes of a scene, such as those that cast shadows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from shadow_tracer.scene.mesh import Mesh, Scene

_Number = TypeVar("_Number", np.int32, np.int64)


class Some:
    """Some of the meshes of a scene.

    Args:
        revision: changes whenever one of them does, or which they are.
    """

    def __init__(self, meshes: Sequence[Mesh], revision: int) -> None:
        self._meshes = meshes
        self.revision = revision
        self.triangle_count = sum(mesh.triangle_count for mesh in meshes)
        self.vertex_count = sum(mesh.vertex_count for mesh in meshes)

    def __iter__(self) -> Iterator[Mesh]:
        return iter(self._meshes)


class Numbering:
    """Numbers of triangles: counted through all meshes of a scene, and through its occluders."""

    def __init__(self, scene: Scene) -> None:
        counts = np.array([mesh.triangle_count for mesh in scene], np.int64)
        casting = np.array([mesh.cast_shadows for mesh in scene], np.bool_)
        self._all = casting.all()
        self._count = counts[casting]
        self._whole = (np.cumsum(counts) - counts)[casting]  # where each occluder begins
        self._own = np.cumsum(self._count) - self._count

    def of_scene(self, numbers: npt.NDArray[_Number]) -> npt.NDArray[_Number]:
        """Of occluders' triangles, in the scene; those below 0 stay."""
        if self._all or not len(self._own):
            return numbers
        mesh = np.maximum(np.searchsorted(self._own, numbers, "right") - 1, 0)
        return np.where(numbers < 0, numbers, numbers - self._own[mesh] + self._whole[mesh]).astype(numbers.dtype)

    def of_occluders(self, numbers: npt.NDArray[_Number]) -> npt.NDArray[_Number]:
        """The last one of the occluders that is no later than each of the scene; below 0 if there is none."""
        if self._all:
            return numbers
        if not len(self._own):
            return np.full_like(numbers, -1)
        mesh = np.searchsorted(self._whole, numbers, "right") - 1
        place = np.maximum(mesh, 0)
        inside = np.minimum(numbers - self._whole[place], self._count[place] - 1)
        return np.where(mesh < 0, np.minimum(numbers, -1), self._own[place] + inside).astype(numbers.dtype)
