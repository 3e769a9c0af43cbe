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

_HEADER = 4
_TRIANGLE_BYTES = 12
_VERTEX_BYTES = 24
_SLACK = 7  # transports may pad the end; more than that means another layout, which must not pass for an empty mesh
_ENDIAN = {b"\x00\x00": ">", b"\x00\x01": "<"}


class MeshMessageError(ValueError):
    """The bytes are not a usable mesh; the message says where and why. Nothing was kept of them."""


@dataclass(frozen=True)
class MeshMessage:
    """A parsed mesh.

    Attributes:
        triangles: (T, 3) int32 vertex indices, all in range.
        vertices: (V, 3) float64 [m], all finite.
        block: the triangle block as it came, (3 * T,) unsigned in the byte order of the message; tells a deformation
            from a new topology without converting it.
    """

    triangles: npt.NDArray[np.int32]
    vertices: npt.NDArray[np.float64]
    block: npt.NDArray[np.uint32]

    def same_topology(self, block: npt.NDArray[np.uint32], vertex_count: int) -> bool:
        """True if a mesh with this triangle block and number of vertices differs from this one in positions at most."""
        same_layout = len(self.vertices) == vertex_count and self.block.dtype == block.dtype
        # Another topology mostly differs from the first triangle on; that is told without reading all of them.
        return same_layout and np.array_equal(self.block[:192], block[:192]) and np.array_equal(self.block, block)


def _count(data: bytes, offset: int, order: str, what: str) -> int:
    if len(data) < offset + 4:
        raise MeshMessageError(f"{what}: expected a count at byte {offset}, but the message ends at byte {len(data)}")
    return int(np.frombuffer(data, order + "u4", 1, offset)[0])


def _fits(data: bytes, offset: int, count: int, size: int, what: str) -> int:
    end = offset + count * size
    if end > len(data):
        raise MeshMessageError(f"{what}: {count} of them need {count * size} bytes, but {len(data) - offset} are left")
    return end


def parse_mesh(data: bytes, max_triangles: int, known: MeshMessage | None = None) -> MeshMessage:
    """Parse the bytes of a shape_msgs/Mesh.

    Args:
        data: the serialised message, little or big endian; any bytes are survived.
        max_triangles: largest number of triangles accepted; vertices may be three times as many.
        known: a mesh whose triangles are taken over, unchecked and uncopied, if the triangle block has the same bytes.

    Raises:
        MeshMessageError: truncated, too large, index out of range, coordinate not finite, not plain CDR.
    """
    if len(data) < _HEADER:
        raise MeshMessageError(f"header: expected 4 bytes of encapsulation, got {len(data)}")
    order = _ENDIAN.get(bytes(data[:2]))
    if order is None:
        raise MeshMessageError(f"header: expected plain CDR (00 00 or 00 01), got {bytes(data[:2]).hex(' ')}")
    triangle_count = _count(data, _HEADER, order, "triangles")
    if triangle_count > max_triangles:
        raise MeshMessageError(
            f"bounds.max_triangles: the mesh has {triangle_count} triangles, the bound is {max_triangles}"
        )
    start = _HEADER + 4
    end = _fits(data, start, triangle_count, _TRIANGLE_BYTES, "triangles")
    vertex_count = _count(data, end, order, "vertices")
    if vertex_count > 3 * max_triangles:
        raise MeshMessageError(
            f"bounds.max_triangles: the mesh has {vertex_count} vertices, at most 3 * {max_triangles} fit"
        )
    first = end + 4
    if vertex_count:
        first += (_HEADER - first) % 8
    last = _fits(data, first, vertex_count, _VERTEX_BYTES, "vertices")
    if len(data) - last > _SLACK:
        raise MeshMessageError(
            f"vertices: {len(data) - last} bytes are left over after the last vertex: this is no shape_msgs/Mesh"
        )
    block = (
        np.frombuffer(data, order + "u4", 3 * triangle_count, start) if triangle_count else np.empty(0, order + "u4")
    )
    if known is not None and known.same_topology(block, vertex_count):
        triangles = known.triangles
    else:
        triangles = _triangles(block, vertex_count)
    return MeshMessage(triangles, _vertices(data, first, vertex_count, order), block)


def _triangles(block: npt.NDArray[np.uint32], vertex_count: int) -> npt.NDArray[np.int32]:
    if len(block) and int(block.max()) >= vertex_count:
        bad = int(np.flatnonzero(block >= vertex_count)[0])
        raise MeshMessageError(
            f"triangles: index {int(block[bad])} of triangle {bad // 3}, corner {bad % 3} is out of range, "
            f"the mesh has {vertex_count} vertices"
        )
    triangles = np.empty((len(block) // 3, 3), np.int32)
    triangles.reshape(-1)[:] = block
    triangles.setflags(write=False)  # the scene keeps a read-only array instead of copying it
    return triangles


def _vertices(data: bytes, first: int, count: int, order: str) -> npt.NDArray[np.float64]:
    if count == 0:
        return np.empty((0, 3))
    # The block starts at 4 modulo 8 in memory: copied, it is aligned and in native byte order.
    vertices = np.empty((count, 3))
    vertices.reshape(-1)[:] = np.frombuffer(data, order + "f8", 3 * count, first)
    if not (np.isfinite(vertices.min()) and np.isfinite(vertices.max())):  # NaN comes out of both
        bad = int(np.flatnonzero(~np.isfinite(vertices.ravel()))[0])
        raise MeshMessageError(
            f"vertices: coordinate {'xyz'[bad % 3]} of vertex {bad // 3} is {vertices.flat[bad]}, not finite"
        )
    vertices.setflags(write=False)
    return vertices


def encode_mesh(vertices: npt.ArrayLike, triangles: npt.ArrayLike, little: bool = True) -> bytes:
    """Bytes of a shape_msgs/Mesh, ready for ``publisher.publish(bytes)``.

    Args:
        vertices: (V, 3) coordinates [m].
        triangles: (T, 3) indices, 0 <= index < 2^32.
        little: byte order of the message.

    Raises:
        ValueError: a shape is not (N, 3).
    """
    order = "<" if little else ">"
    parts: dict[str, bytes] = {}
    counts: dict[str, bytes] = {}
    for name, value, kind in (("triangles", triangles, "u4"), ("vertices", vertices, "f8")):
        array = np.asarray(value)
        if array.ndim != 2 or array.shape[1] != 3:
            raise ValueError(f"{name}: expected shape (N, 3), got {array.shape}")
        counts[name] = np.array(len(array), order + "u4").tobytes()
        parts[name] = array.astype(order + kind).tobytes()
    body = counts["triangles"] + parts["triangles"] + counts["vertices"]
    if parts["vertices"]:
        body += bytes(-len(body) % 8) + parts["vertices"]
    return (b"\x00\x01" if little else b"\x00\x00") + b"\x00\x00" + body
