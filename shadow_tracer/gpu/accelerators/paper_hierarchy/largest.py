# SPDX-License-Identifier: Apache-2.0
"""The large occluders that two-pass variants trace first (section 3.4 of the paper).

The paper leaves open what makes a good occluder; here it is the solid angle seen from the light (in light space). A
histogram of its logarithm finds, on the device, the size that about 2 % of the triangles reach. Only the order of work
depends on it, no answer does, so it may be rough.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.paper_hierarchy.cone_test import is_never

# Eight bins per factor of two, 32 factors of two below 16 sr.
_BINS = 256
_BINS_PER_OCTAVE = 8.0
_SHARE = 50  # one in so many triangles is large


@wp.func
def solid_angle(a: wp.vec3, b: wp.vec3, c: wp.vec3) -> float:
    """Solid angle of a triangle seen from the origin (Van Oosterom and Strackee 1983)."""
    la = wp.length(a)
    lb = wp.length(b)
    lc = wp.length(c)
    volume = wp.abs(wp.dot(a, wp.cross(b - a, c - a)))
    rest = la * lb * lc + wp.dot(a, b) * lc + wp.dot(b, c) * la + wp.dot(c, a) * lb
    return 2.0 * wp.atan2(volume, rest)


@wp.kernel(enable_backward=False)
def measure_sizes(
    corners: wp.array(dtype=wp.vec4),
    triangles: wp.array(dtype=wp.vec3i),
    records: wp.array2d(dtype=wp.vec4),
    sizes: wp.array(dtype=wp.uint8),
    histogram: wp.array(dtype=int),
):
    """Bin of every triangle's solid angle, the smallest for those that cast nothing."""
    i = wp.tid()
    index = triangles[i]
    a = corners[index[0]]
    b = corners[index[1]]
    c = corners[index[2]]
    angle = solid_angle(wp.vec3(a[0], a[1], a[2]), wp.vec3(b[0], b[1], b[2]), wp.vec3(c[0], c[1], c[2]))
    size = int(0)
    if angle > 1.0e-9 and not is_never(records, i):  # not a number: the smallest, too
        octaves = wp.log2(angle) - 4.0
        size = wp.clamp(_BINS - 1 + int(_BINS_PER_OCTAVE * octaves), 0, _BINS - 1)
    sizes[i] = wp.uint8(size)
    wp.atomic_add(histogram, size, 1)


@wp.kernel(enable_backward=False)
def choose_threshold(wanted: int, histogram: wp.array(dtype=int), threshold: wp.array(dtype=int)):
    """The largest bin such that it and those above hold at least the wanted number of triangles."""
    size = int(_BINS - 1)
    found = histogram[size]
    while size > 0 and found < wanted:
        size -= 1
        found += histogram[size]
    threshold[0] = size


class LargeOccluders:
    """``sizes`` (uint8 per triangle) and ``threshold`` (int32, on the device): large are those with at least that
    size."""

    def __init__(self, max_triangles: int, device: wp.Device) -> None:
        self._device = device
        self.sizes = wp.zeros(max_triangles, dtype=wp.uint8, device=device)
        self.threshold = wp.zeros(1, dtype=int, device=device)
        self._histogram = wp.zeros(_BINS, dtype=int, device=device)

    def choose(self, count: int, corners: wp.array, triangles: wp.array, records: wp.array) -> None:
        """Size of the first ``count`` triangles, and the threshold."""
        self._histogram.zero_()
        inputs = [corners, triangles, records, self.sizes, self._histogram]
        wp.launch(measure_sizes, dim=count, inputs=inputs, device=self._device)
        wanted = -(-count // _SHARE)
        wp.launch(choose_threshold, dim=1, inputs=[wanted, self._histogram, self.threshold], device=self._device)

    def nbytes(self) -> int:
        """Bytes on the device."""
        return int(self.sizes.capacity + self.threshold.capacity + self._histogram.capacity)
