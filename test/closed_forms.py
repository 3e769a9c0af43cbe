# SPDX-License-Identifier: Apache-2.0
"""Irradiance of whole lights of even radiance, in closed form.

Arrays of samples are (3, N): x, y and z apart. Normals are unit vectors. What is returned is the integral of
``cos_sample cos_light / distance^2`` over the light [sr], zero below the plane of the sample: times the radiance
[W/m2/sr] it is the irradiance [W/m2].
"""

from __future__ import annotations

import math

import numpy as np

from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.patterns import across

_DISC_CORNERS = 64


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Of (3, N) or (3,) vectors, summed in the order x, y, z."""
    product: FloatArray = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Of (3, N) vectors."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def polygon(corners: FloatArray, points: FloatArray, normals: FloatArray) -> FloatArray:
    """(N,) of a flat convex polygon with (K, 3) corners, seen from either side (Lambert 1760): half the sum over its
    edges of the angle that each spans, times the cosine between the normal and the plane of edge and sample. What is
    below the sample's plane is cut off first."""
    total = np.zeros(points.shape[1])
    leaves, enters = np.zeros_like(points), np.zeros_like(points)
    first = corners[0][:, None] - points
    a, above_a = first, dot(first, normals)
    for corner in [*corners[1:], None]:
        b = first if corner is None else corner[:, None] - points
        above_b = dot(b, normals)
        goes, comes = (above_a >= 0.0) & (above_b < 0.0), (above_a < 0.0) & (above_b >= 0.0)
        part = np.where(goes | comes, above_a / np.where(goes | comes, above_a - above_b, 1.0), 0.0)
        cut = a + part * (b - a)
        np.copyto(leaves, cut, where=goes)
        np.copyto(enters, cut, where=comes)
        edge = _edge(np.where(comes, cut, a), np.where(goes, cut, b), normals)
        total += np.where((above_a >= 0.0) | (above_b >= 0.0), edge, 0.0)
        a, above_a = b, above_b
    total += _edge(leaves, enters, normals)
    return 0.5 * np.abs(total)


def _edge(a: FloatArray, b: FloatArray, normals: FloatArray) -> FloatArray:
    axis = cross(a, b)
    length = np.sqrt(dot(axis, axis))
    angle = np.arctan2(length, dot(a, b))
    return np.where(length > 0.0, angle * dot(axis, normals) / np.where(length > 0.0, length, 1.0), 0.0)


def disc(centre: FloatArray, normal: FloatArray, radius: float, points: FloatArray, normals: FloatArray) -> FloatArray:
    """(N,) of a disc, seen from either side. Where all of it is above the sample's plane the integral along its rim is
    elementary; where the plane cuts it, it is taken for the regular polygon of the same area with 64 corners."""
    v = centre[:, None] - points
    height = dot(v, normal)  # negative on the side it shines to
    radial = v - height * normal[:, None]
    a2, h2, r2 = dot(radial, radial), height * height, radius * radius
    far = a2 - h2 - r2
    root = np.sqrt((a2 + h2 - r2) ** 2 + 4.0 * h2 * r2)
    both = (r2 + a2 + h2) + root
    # both - 2 a2 = root - far, without a difference of nearly equal numbers
    up = np.where(far > 0.0, 4.0 * a2 * h2 / np.where(far > 0.0, root + far, 1.0), root - far)
    scale = math.pi * r2 / np.where(root * both > 0.0, root * both, 1.0)
    upright = np.where(height > 0.0, 1.0, -1.0) * dot(normals, normal) * up
    total = scale * (upright + 2.0 * np.abs(height) * dot(normals, radial))
    middle = dot(v, normals)
    reach = radius * np.sqrt(np.maximum(0.0, 1.0 - dot(normals, normal) ** 2))
    cut = np.flatnonzero(np.abs(middle) < reach)
    if len(cut):
        _, x, y = across(*normal.tolist())
        turn = np.arange(_DISC_CORNERS)[:, None] * (2.0 * math.pi / _DISC_CORNERS)
        corner = radius * math.sqrt(2.0 * math.pi / (_DISC_CORNERS * math.sin(2.0 * math.pi / _DISC_CORNERS)))
        rim = centre + corner * (np.cos(turn) * x + np.sin(turn) * y)
        total[cut] = polygon(rim, points[:, cut], normals[:, cut])
    return np.maximum(total, 0.0)  # negative where all of it is below


class Line:
    """A line from ``start`` along the unit vector ``axis``, seen from samples (3, N)."""

    def __init__(self, start: FloatArray, axis: FloatArray, points: FloatArray, normals: FloatArray) -> None:
        v = start[:, None] - points
        self.begin = dot(v, axis)  # where the line starts, from the foot of the sample's perpendicular [m]
        foot = v - self.begin * axis[:, None]
        self.distance = np.sqrt(dot(foot, foot))
        # Cosines of the normal; on the line itself none but along it.
        self.up = np.where(self.distance > 0.0, dot(normals, foot) / self.distance, 0.0)
        self.along = dot(normals, axis)
        # Above the sample's plane are places on the line between these.
        meets = -self.distance * self.up / np.where(self.along == 0.0, 1.0, self.along)
        level = np.where(self.up > 0.0, np.inf, -np.inf)
        self._low = np.where(self.along > 0.0, meets, -np.inf)
        self._high = np.where(self.along < 0.0, meets, np.where(self.along == 0.0, level, np.inf))

    def _cut(self, at: float) -> FloatArray:
        return np.minimum(np.maximum(self.begin + at, self._low), self._high)

    def lambert(self, begin: float, end: float) -> FloatArray:
        """(N,) of the piece between two distances from the start [m], for the law of a tube of even radiance: intensity
        goes with the sine of the angle to the axis. The integral of ``sine cos_sample / distance^2`` [1/m] (Keitz 1971
        has it for the whole tube, from the place opposite its end)."""
        s, e, h = self._cut(begin), self._cut(end), self.distance
        h2, piece = h * h, e - s
        both = (h2 + s * s) * (h2 + e * e)
        turn = np.arctan2(h * piece, h2 + s * e)
        rest = self.up * piece * (h2 - s * e) + h * self.along * piece * (s + e)
        found = 0.5 * (self.up * turn / h + rest / both)
        return np.where(piece > 0.0, np.maximum(found, 0.0), 0.0)

    def isotropic(self, begin: float, end: float) -> FloatArray:
        """(N,) the same where intensity is alike in all directions: the integral of ``cos_sample / distance^2``."""
        s, e, h = self._cut(begin), self._cut(end), self.distance
        to_s, to_e = np.sqrt(h * h + s * s), np.sqrt(h * h + e * e)
        found = np.where(h > 0.0, self.up / h, 0.0) * (e / to_e - s / to_s) + self.along * (1.0 / to_s - 1.0 / to_e)
        return np.where(e > s, np.maximum(found, 0.0), 0.0)
