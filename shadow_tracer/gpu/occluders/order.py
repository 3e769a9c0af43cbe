# SPDX-License-Identifier: Apache-2.0
"""Another order of a mesh's triangles and vertices, for those who look at sixteen triangles at once (``clusters.py``).

In many files triangles that follow each other lie far apart: boxes around sixteen of them then hold little but air, and
their corners are in as many lines of the cache as there are. Along a curve through space (Morton 1966), with vertices
in the order in which triangles come to them, boxes are small and corners lie together. That costs a frame or two of
what it spares, so it is done for triangles that have stayed for a second frame, and where boxes become a good deal
smaller: in the files of scans, and of programs that write things by their kind, not in grids and strips.

Triangles and vertices have other numbers then. Nobody but the scene's copy on the device knows them; who says which
triangle it was takes ``MeshOrder.numbers``. No answer depends on the order, as what hides a ray hides it whenever it is
looked at.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import warp as wp

from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.device.sort import KeySort
from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.mesh import Mesh
from shadow_tracer.scene.parts import DepthSurface

GROUP = 16  # triangles
# Meshes of fewer are left as they are: they cost little whatever their order.
LEAST = 4096
# What the boxes' sizes come to has to be below this share of what it was. Measured: from 0.04 to 0.78 a frame takes
# 0.44 to 0.96 of the time, at 0.9 as long, above 1 longer (docs/performance.md).
WORTH = 0.85
_CELLS = 2.0**20  # along the longest side
_BITS = 30  # of a place on the curve that are sorted by at once


@native.func_native("occluders/order.h", calls="MeshOrder::make_keys")
def keys_of(
    count: int, shift: int, low: wp.vec3d, cells: wp.float64, vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i), numbers: wp.array(dtype=int), keys: wp.array(dtype=int),
):  # fmt: skip
    """Half the bits of the triangles' places on the curve."""
    ...


@native.func_native("occluders/order.h", calls="MeshOrder::looseness", otherwise="return 0.0;")
def looseness_of(
    count: int, group: int, vertices: wp.array(dtype=wp.vec3d), triangles: wp.array(dtype=wp.vec3i),
    numbers: wp.array(dtype=int),
) -> wp.float64:  # fmt: skip
    """How large the boxes of groups are together."""
    ...


@native.func_native("occluders/order.h", calls="MeshOrder::arrange")
def arrange_in(
    count: int, vertex_count: int, triangles: wp.array(dtype=wp.vec3i), numbers: wp.array(dtype=int),
    names: wp.array(dtype=int), order: wp.array(dtype=int), arranged: wp.array(dtype=wp.vec3i),
):  # fmt: skip
    """The triangles in their order, of vertices in theirs."""
    ...


@wp.kernel(enable_backward=False)
def make_keys(
    count: int, shift: int, low: wp.vec3d, cells: wp.float64, vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i), numbers: wp.array(dtype=int), keys: wp.array(dtype=int),
):  # fmt: skip
    """Keys to sort by. One thread."""
    keys_of(count, shift, low, cells, vertices, triangles, numbers, keys)


@wp.kernel(enable_backward=False)
def look(
    count: int, vertices: wp.array(dtype=wp.vec3d), triangles: wp.array(dtype=wp.vec3i), numbers: wp.array(dtype=int),
    loose: wp.array(dtype=wp.float64),
):  # fmt: skip
    """How loose triangles are in an order. One thread."""
    loose[0] = looseness_of(count, GROUP, vertices, triangles, numbers)


@wp.kernel(enable_backward=False)
def arrange(
    count: int, vertex_count: int, triangles: wp.array(dtype=wp.vec3i), numbers: wp.array(dtype=int),
    names: wp.array(dtype=int), order: wp.array(dtype=int), arranged: wp.array(dtype=wp.vec3i),
):  # fmt: skip
    """One thread."""
    arrange_in(count, vertex_count, triangles, numbers, names, order, arranged)


@dataclass(frozen=True)
class MeshOrder:
    """Where a mesh's triangles and vertices stand.

    Attributes:
        triangles: (T, 3) of new vertices.
        vertices: (V,) on the device: which vertex of the mesh each is.
        numbers: (T,) which triangle of the mesh each is.
    """

    triangles: npt.NDArray[np.int32]
    vertices: wp.array
    numbers: npt.NDArray[np.int32]

    def nbytes(self) -> int:
        """Bytes that it takes."""
        return int(self.triangles.nbytes + self.vertices.capacity + self.numbers.nbytes)


def find_order(mesh: Mesh, find_box: Callable[[], tuple[FloatArray, FloatArray]], device: Any) -> MeshOrder | None:
    """An order in which the mesh's triangles lie together, if they do not as they are; for the CPU.

    Args:
        mesh: as it is now; surfaces stay as they are, their triangles follow from rows and columns.
        find_box: around its finite vertices, in its frame.
        device: the CPU.
    """
    count = mesh.triangle_count
    if isinstance(mesh, DepthSurface) or mesh.grid is not None or count < LEAST:
        return None
    low, high = find_box()
    extent = float((high - low).max())
    if not 0.0 < extent < np.inf:
        return None
    vertices = wp.array(ptr=mesh.vertices.ctypes.data, dtype=wp.vec3d, shape=(mesh.vertex_count,), device=device)
    triangles = wp.array(ptr=mesh.triangles.ctypes.data, dtype=wp.vec3i, shape=(count,), device=device)
    sort, loose = KeySort(count, device), wp.zeros(1, dtype=wp.float64, device=device)
    numbers = sort.values.numpy()[:count]
    numbers[:] = np.arange(count, dtype=np.int32)
    looked_at, sizes = [count, vertices, triangles, sort.values, loose], []
    wp.launch(look, dim=1, inputs=looked_at, device=device)
    sizes.append(float(loose.numpy()[0]))
    for shift in (0, _BITS // 3):
        inputs = [
            count,
            shift,
            wp.vec3d(*low),
            wp.float64(_CELLS / extent),
            vertices,
            triangles,
            sort.values,
            sort.keys,
        ]
        wp.launch(make_keys, dim=1, inputs=inputs, device=device)
        sort.sort(count, 0, _BITS)
    wp.launch(look, dim=1, inputs=looked_at, device=device)
    sizes.append(float(loose.numpy()[0]))
    if not sizes[1] < WORTH * sizes[0]:
        return None
    names, order = (wp.empty(mesh.vertex_count, dtype=int, device=device) for _ in range(2))
    arranged = wp.empty(count, dtype=wp.vec3i, device=device)
    inputs = [count, mesh.vertex_count, triangles, sort.values, names, order, arranged]
    wp.launch(arrange, dim=1, inputs=inputs, device=device)
    return MeshOrder(arranged.numpy(), order, numbers.copy())
