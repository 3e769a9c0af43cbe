# SPDX-License-Identifier: Apache-2.0
"""What a reader finds in a mesh file, and how it says that it cannot read one."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

MOST_INDICES = 2**31 - 1  # what int32 holds


class ReadError(ValueError):
    """A file cannot be read as it is. The text is the reason and, where there is one, the cure; whoever knows the name
    of the file puts it in front."""


@dataclass(frozen=True, eq=False)
class Content:
    """All triangles of a file.

    Attributes:
        vertices: (V, 3) float64 in units of the file.
        triangles: (T, 3) int64, in range.
        left_out: what the file holds besides and nothing can be made of, as "lines (3)"; none of it casts shadow.
        unit: metres per unit as far as the format knows.
        stated: names of units that are written into the file besides, such as "mm".
    """

    vertices: FloatArray
    triangles: IntArray
    left_out: tuple[str, ...] = ()
    unit: float = 1.0
    stated: frozenset[str] = frozenset()


@dataclass
class Collector:
    """Gathers meshes at their places."""

    vertices: list[FloatArray] = field(default_factory=list)
    triangles: list[IntArray] = field(default_factory=list)
    count: int = 0

    def add(self, vertices: FloatArray, triangles: IntArray, transform: FloatArray | None = None) -> None:
        """Take a mesh, (V, 3) and (T, 3), where ``transform`` (4, 4) puts it; None leaves it where it is."""
        if not len(triangles):
            return
        if self.count + len(vertices) > MOST_INDICES:
            raise ReadError(f"it has more than {MOST_INDICES} vertices with all instances")
        if transform is not None and not np.array_equal(transform, np.eye(4)):
            vertices = vertices @ transform[:3, :3].T + transform[:3, 3]
            if np.linalg.det(transform[:3, :3]) < 0.0:
                triangles = triangles[:, ::-1]  # a mirrored mesh would be inside out
        self.vertices.append(vertices)
        self.triangles.append(triangles + self.count)
        self.count += len(vertices)

    def content(
        self, left_out: tuple[str, ...] = (), unit: float = 1.0, stated: frozenset[str] = frozenset()
    ) -> Content:
        """All that was added, as one mesh."""
        vertices = np.concatenate([np.zeros((0, 3)), *self.vertices])
        triangles = np.concatenate([np.zeros((0, 3), np.int64), *self.triangles])
        return Content(vertices, triangles, left_out, unit, stated)


def parse_numbers(words: Sequence[str], dtype: Any) -> npt.NDArray[Any]:
    """Numbers of words without white space in them. Raises ValueError or OverflowError if one is no number."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            numbers = np.fromstring(" ".join(words), dtype, sep=" ")  # many times as fast, but it stops at a fault
    except (ValueError, DeprecationWarning):
        return np.array(words, dtype)
    return numbers if len(numbers) == len(words) else np.array(words, dtype)


def check_indices(indices: npt.NDArray[np.integer], count: int, what: str = "it") -> None:
    """Refuse indices of vertices that are not from 0 to ``count - 1``; ``what`` names the mesh that has them."""
    if indices.size and (int(indices.min()) < 0 or int(indices.max()) >= count):
        low, high = int(indices.min()), int(indices.max())
        raise ReadError(f"{what} has vertex indices from {low} to {high}, counted from 0, but {count} vertices")


def strip_triangles(corners: IntArray) -> IntArray:
    """(n - 2, 3) triangles of a strip of n corners, all wound as the first one."""
    triangles = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    triangles[1::2] = triangles[1::2][:, [1, 0, 2]]
    return triangles


def fan_triangles(corners: IntArray) -> IntArray:
    """(n - 2, 3) triangles of a fan of n corners."""
    return np.stack([np.full(max(len(corners) - 2, 0), corners[0]), corners[1:-1], corners[2:]], axis=1)


def counted(numbers: dict[str, int]) -> tuple[str, ...]:
    """Texts such as "lines (3)" of those that are not 0."""
    return tuple(f"{name} ({number})" for name, number in numbers.items() if number)
