# SPDX-License-Identifier: Apache-2.0
"""Boxes around sixteen triangles each, made again only when the scene has changed, and how threads divide among them
what several need. For the CPU.

Triangles that follow each other in a mesh mostly lie together, so a box says no for sixteen of them at once; in a soup
of triangles it says no to nothing, and costs little.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.occluders.world import SceneBuffers

CLUSTER = 16  # triangles
_BOXES = 16  # clusters whose boxes are made, and looked at, together


@wp.struct
class Clusters:
    """Boxes in the world, [sixteen][low x y z, high x y z][16] float32, rounded outwards; those of clusters that are
    not there, and of triangles without any finite corner, reach everywhere or hold nothing: it does not matter."""

    triangles: int
    boxes: wp.array(dtype=float)
    made: wp.array(dtype=int)  # of each sixteen: see claim


# Work that several threads need and one of them does: 0 not begun, 1 begun, 2 done.
@wp.func_native(
    r"""
#if !defined(__CUDA_ARCH__)
    int none = 0;
    return __atomic_compare_exchange_n(made.data + item, &none, 1, false, __ATOMIC_ACQUIRE, __ATOMIC_RELAXED);
#else
    return 0;
#endif
    """
)
def claim(made: wp.array(dtype=int), item: int) -> int:
    """Whether the item is for the caller to make; then ``publish`` it."""
    ...


@wp.func_native(
    r"""
#if !defined(__CUDA_ARCH__)
    __atomic_store_n(made.data + item, 2, __ATOMIC_RELEASE);
#endif
    """
)
def publish(made: wp.array(dtype=int), item: int):
    """Let others know that the item is made."""
    ...


# Who has claimed an item is making it at this moment: some microseconds.
@wp.func_native(
    r"""
#if !defined(__CUDA_ARCH__)
    while (__atomic_load_n(made.data + item, __ATOMIC_ACQUIRE) != 2) {
    }
#endif
    """
)
def await_made(made: wp.array(dtype=int), item: int):
    """Return when an item that somebody has claimed is made."""
    ...


# A comparison with NaN fails, so a corner that is not a number moves nothing; its triangle casts nothing either.
@wp.func_native(
    r"""
#if !defined(__CUDA_ARCH__)
    float* box = clusters.boxes.data + 96 * (size_t)item;
    const int count = clusters.triangles;
    for (int lane = 0; lane < 16; ++lane) {
        const int first = 256 * item + 16 * lane, last = first + 16 < count ? first + 16 : count;
        double low[3] = { 3.0e38, 3.0e38, 3.0e38 }, high[3] = { -3.0e38, -3.0e38, -3.0e38 };
        for (int t = first; t < last; ++t) {
            const wp::vec3i& corners = triangles.data[t];
            for (int k = 0; k < 3; ++k) {
                const wp::vec3d& p = vertices.data[corners[k]];
                for (int c = 0; c < 3; ++c) {
                    low[c] = p[c] < low[c] ? p[c] : low[c];
                    high[c] = p[c] > high[c] ? p[c] : high[c];
                }
            }
        }
        for (int c = 0; c < 3; ++c) {
            const float down = (float)low[c], up = (float)high[c];
            box[16 * c + lane] = down - 0x1p-23f * fabsf(down) - 1.0e-37f;
            box[16 * (3 + c) + lane] = up + 0x1p-23f * fabsf(up) + 1.0e-37f;
        }
    }
#endif
    """
)
def make_boxes(item: int, clusters: Clusters, vertices: wp.array(dtype=wp.vec3d), triangles: wp.array(dtype=wp.vec3i)):
    """Boxes of sixteen clusters, those from ``16 * item`` on."""
    ...


class ClusterBoxes:
    """Owns the memory of ``Clusters``."""

    def __init__(self, max_triangles: int, scene: SceneBuffers) -> None:
        self._scene = scene
        items = -(-max_triangles // (CLUSTER * _BOXES))
        self._boxes = wp.empty(6 * _BOXES * items, dtype=float, device=scene.device)
        self._made = wp.zeros(items, dtype=int, device=scene.device)

    def forget(self) -> None:
        """The scene has changed."""
        self._made.zero_()

    def clusters(self) -> Clusters:
        """As kernels see them: ``claim`` and make what is needed."""
        clusters = Clusters()
        clusters.triangles, clusters.boxes, clusters.made = self._scene.triangle_count, self._boxes, self._made
        return clusters

    def nbytes(self) -> int:
        """Bytes on the device."""
        return int(self._boxes.capacity + self._made.capacity)
