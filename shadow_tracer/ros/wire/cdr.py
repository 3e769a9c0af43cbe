# SPDX-License-Identifier: Apache-2.0
"""shape_msgs/Mesh as raw CDR bytes <-> numpy. No ROS here.

Layout after the 4 bytes of encapsulation, to which alignment refers: u32 triangle count, 3 u32 per triangle, u32 vertex
count, padding to 8 if there are vertices, 3 float64 per vertex. Python objects for the same message cost a thousand
times more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from shadow_tracer.ros.wire.cdr_reader import MeshMessageError, Reader, Writer
from shadow_tracer.scene.checks import LARGEST, unusable_vertices

__all__ = ["MeshMessage", "MeshMessageError", "encode_mesh", "parse_mesh"]


@dataclass(frozen=True)
class MeshMessage:
    """A parsed mesh.

    Attributes:
        triangles: (T, 3) int32 vertex indices, all in range.
        vertices: (V, 3) float64 [m]; those that a triangle uses are finite.
        block: the triangle block as it came, (T, 3) unsigned in the byte order of the message; tells a deformation
            from a new topology without converting it.
    """

    triangles: npt.NDArray[np.int32]
    vertices: npt.NDArray[np.float64]
    block: npt.NDArray[np.uint32]

    def same_topology(self, block: npt.NDArray[np.uint32], vertex_count: int) -> bool:
        """True if a mesh with this triangle block and number of vertices differs from this one in positions at most."""
        same_layout = len(self.vertices) == vertex_count and self.block.dtype == block.dtype
        # Another topology mostly differs from the first triangle on; that is told without reading all of them.
        return same_layout and np.array_equal(self.block[:64], block[:64]) and np.array_equal(self.block, block)


def parse_mesh(data: bytes, max_triangles: int, known: MeshMessage | None = None) -> MeshMessage:
    """Parse the bytes of a shape_msgs/Mesh.

    Args:
        data: the serialised message, little or big endian; any bytes are survived.
        max_triangles: largest number of triangles accepted; vertices may be three times as many.
        known: a mesh whose triangles are taken over, unchecked and uncopied, if the triangle block has the same bytes.

    Raises:
        MeshMessageError: truncated, too large, index out of range, a coordinate of a triangle not finite or beyond
            1e50, not plain CDR.
    """
    reader = Reader(data)
    triangle_count = reader.count("triangles")
    if triangle_count > max_triangles:
        raise MeshMessageError(
            f"bounds.max_triangles: the mesh has {triangle_count} triangles, the bound is {max_triangles}"
        )
    block = reader.array(triangle_count, 3, "u4", "triangles")
    vertex_count = reader.count("vertices")
    if vertex_count > 3 * max_triangles:
        raise MeshMessageError(
            f"bounds.max_triangles: the mesh has {vertex_count} vertices, at most 3 * {max_triangles} fit"
        )
    points = reader.array(vertex_count, 3, "f8", "vertices")
    reader.finish("vertices", "shape_msgs/Mesh")
    if known is not None and known.same_topology(block, vertex_count):
        triangles = known.triangles
    else:
        triangles = _triangles(block, vertex_count)
    return MeshMessage(triangles, _vertices(points, triangles), block)


def _triangles(block: npt.NDArray[np.uint32], vertex_count: int) -> npt.NDArray[np.int32]:
    if len(block) and int(block.max()) >= vertex_count:
        bad = int(np.flatnonzero(block >= vertex_count)[0])
        raise MeshMessageError(
            f"triangles: index {int(block.flat[bad])} of triangle {bad // 3}, corner {bad % 3} is out of range, "
            f"the mesh has {vertex_count} vertices"
        )
    triangles = np.empty(block.shape, np.int32)
    triangles[...] = block
    triangles.setflags(write=False)  # the scene keeps a read-only array instead of copying it
    return triangles


def _vertices(points: npt.NDArray[np.float64], triangles: npt.NDArray[np.int32]) -> npt.NDArray[np.float64]:
    # The block starts at 4 modulo 8 in memory: copied, it is aligned and in native byte order.
    vertices = np.empty(points.shape)
    vertices[...] = points
    check_coordinates(vertices, "vertices", "vertex", triangles)
    vertices.setflags(write=False)
    return vertices


def check_coordinates(
    vertices: npt.NDArray[np.float64], field: str, one: str, triangles: npt.NDArray[np.int32] | None = None
) -> None:
    """Refuse coordinates, (V, 3) [m], that are not finite or beyond what a scene takes.

    Args:
        field: what the text starts with.
        one: what one row is called.
        triangles: (T, 3) indices; what none of them uses may be anything. None: all rows are used.

    Raises:
        MeshMessageError: locates the first bad one.
    """
    rows = unusable_vertices(vertices, triangles)
    if not len(rows):
        return
    bad = 3 * int(rows[0]) + int(np.flatnonzero(~(np.abs(vertices[rows[0]]) <= LARGEST))[0])
    value = vertices.flat[bad]
    wrong = f"larger than {LARGEST:g} m" if np.isfinite(value) else "not finite"
    raise MeshMessageError(f"{field}: coordinate {'xyz'[bad % 3]} of {one} {bad // 3} is {value}, {wrong}")


def encode_mesh(vertices: npt.ArrayLike, triangles: npt.ArrayLike, little: bool = True) -> bytes:
    """Bytes of a shape_msgs/Mesh, ready for ``publisher.publish(bytes)``.

    Args:
        vertices: (V, 3) coordinates [m].
        triangles: (T, 3) indices, 0 <= index < 2^32.
        little: byte order of the message.

    Raises:
        ValueError: a shape is not (N, 3).
    """
    writer = Writer(little)
    for name, value, kind in (("triangles", triangles, "u4"), ("vertices", vertices, "f8")):
        array = np.asarray(value)
        if array.ndim != 2 or array.shape[1] != 3:
            raise ValueError(f"{name}: expected shape (N, 3), got {array.shape}")
        writer.array(array, kind)
    return writer.message()
