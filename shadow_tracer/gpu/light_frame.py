# SPDX-License-Identifier: Apache-2.0
"""One homogeneous frame for near, far and directional lights, and what samples and triangles look like in it.

With an anchor (centre C and scale S near the samples), f the unit vector from C to the light, r and s orthogonal to
it, R the distance to the light and H = max(R, S), a point x gets::

    x' = (x - C) / S      U = r.x'    V = s.x'    Z = f.x'    W = R/H - (S/H) Z

(U, V, W) is, up to a positive scale per axis, the position seen from the light, so planes through the light are linear
in it without a constant; (U, V, Z) is the position itself, for the triangle's own plane. For a directional light R/H =
1 and S/H = 0: the same formulas, no loss of precision however far the light is. Only this frame is float32; it feeds
the filter of ``shadow_test.py``, whose bounds account for every rounding here (``docs/exactness.md``). The exact
decision never uses it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from shadow_tracer.gpu.buffers import RAYS
from shadow_tracer.gpu.exact import ARITHMETIC, determinant_sign
from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.lights import Light

# Values of the state image; shadow_tracer.tracer.State is the public name. PENDING never leaves the device.
LIT = wp.constant(0)
SHADOWED = wp.constant(1)
OUTSIDE = wp.constant(2)
INVALID = wp.constant(3)
PENDING = wp.constant(4)

# Unit roundoff of float32, and the factor in front of it: the filter's evaluation chain has at most 6 roundings, 8 are
# allowed.
_U32 = 2.0**-24
FILTER_FACTOR = 8.0
# Bound of the float64 errors of frame coordinates and of products of them, relative to the magnitudes involved.
_SETUP_ERROR = 2.0**-46


@wp.struct
class LightFrame:
    """A light and the frame around it, as kernels see it."""

    light: wp.vec4d  # homogeneous: position and 1, or direction to the light (any length) and 0
    center: wp.vec3d
    r: wp.vec3d
    s: wp.vec3d
    f: wp.vec3d
    inverse_scale: wp.float64
    w_constant: wp.float64
    w_slope: wp.float64
    axis: wp.vec3d  # of the lit cone
    cosine: wp.float64  # of its half angle; -2 admits everything
    reach: wp.float64  # range [m]


@dataclass(frozen=True)
class Anchor:
    """Centre [m] and scale [m] of the samples. Any values are correct; close ones keep the float32 filter sharp."""

    center: tuple[float, float, float]
    scale: float

    def covers(self, center: FloatArray, radius: float) -> bool:
        """Whether this anchor serves samples within ``radius`` of ``center`` well, so that nothing needs to be set up
        again."""
        distance = float(np.linalg.norm(center - np.asarray(self.center)))
        return distance + radius <= self.scale <= 8.0 * radius


def make_anchor(center: FloatArray, radius: float, previous: Anchor | None) -> Anchor:
    """Anchor for samples within about ``radius`` of ``center``; the previous one while it still serves."""
    radius = min(max(radius, 1e-30), 1e30)
    if previous is not None and previous.covers(center, radius):
        return previous
    x, y, z = (float(v) for v in center)
    return Anchor((x, y, z), 1.5 * radius)


def make_light_frame(light: Light, anchor: Anchor) -> LightFrame:
    """Frame of ``light`` over the samples at ``anchor``."""
    homogeneous = light.homogeneous
    center = np.asarray(anchor.center)
    if homogeneous[3] == 0.0:
        f = homogeneous[:3] / np.linalg.norm(homogeneous[:3])
        w_constant, w_slope = 1.0, 0.0
    else:
        offset = homogeneous[:3] - center
        distance = float(np.linalg.norm(offset))
        f = offset / distance if distance > 0.0 else np.array([0.0, 0.0, 1.0])
        reference = max(distance, anchor.scale)
        w_constant, w_slope = distance / reference, anchor.scale / reference
    f = f / np.linalg.norm(f)
    # The axis least aligned with f gives a well-conditioned orthonormal basis.
    r = np.cross(np.eye(3)[int(np.argmin(np.abs(f)))], f)
    r /= np.linalg.norm(r)
    axis, cosine = light.cone
    frame = LightFrame()
    frame.light = wp.vec4d(*homogeneous)
    frame.center = wp.vec3d(*anchor.center)
    frame.r = wp.vec3d(*r)
    frame.s = wp.vec3d(*np.cross(f, r))
    frame.f = wp.vec3d(*f)
    frame.inverse_scale = 1.0 / anchor.scale
    frame.w_constant = w_constant
    frame.w_slope = w_slope
    frame.axis = wp.vec3d(*axis)
    frame.cosine = cosine
    frame.reach = light.range
    return frame


# State of a sample before any triangle is looked at. Without contraction, so that the border of the cone has the same
# bits everywhere.
@wp.func_native(
    ARITHMETIC
    + r"""
    if (light[3] == 0.0)
        return 0;
    double x = sub(p[0], light[0]), y = sub(p[1], light[1]), z = sub(p[2], light[2]);
    double distance = norm(x, y, z);
    if (distance > reach)
        return 2;
    double along = add(add(mul(x, axis[0]), mul(y, axis[1])), mul(z, axis[2]));
    return along < mul(cosine, distance) ? 2 : 0;
    """
)
def light_reaches(p: wp.vec3d, light: wp.vec4d, axis: wp.vec3d, cosine: wp.float64, reach: wp.float64) -> int:
    """LIT if the light shines towards ``p`` and far enough, else OUTSIDE."""
    ...


# Unit vector to the light and the distance to it (the largest float64 for a light at infinity), the same bits as the
# exact decision uses.
@wp.func_native(
    ARITHMETIC
    + r"""
    double x = light[0], y = light[1], z = light[2];
    if (light[3] != 0.0) {
        x = sub(x, p[0]); y = sub(y, p[1]); z = sub(z, p[2]);
    }
    double length = norm(x, y, z);
    double scale = length > 0.0 ? 1.0 / length : 0.0;
    return wp::vec4d(mul(x, scale), mul(y, scale), mul(z, scale), light[3] != 0.0 ? length : 1.7976931348623157e308);
    """
)
def towards_light(p: wp.vec3d, light: wp.vec4d) -> wp.vec4d:
    """(unit direction to the light, distance to it; the largest float64 for a light at infinity)."""
    ...


@wp.func
def frame_coordinates(frame: LightFrame, offset: wp.vec3d) -> wp.vec4d:
    """(U, V, W, Z) of the point ``center + offset``."""
    x = offset * frame.inverse_scale
    z = wp.dot(frame.f, x)
    return wp.vec4d(wp.dot(frame.r, x), wp.dot(frame.s, x), frame.w_constant - frame.w_slope * z, z)


@wp.kernel(enable_backward=False)
def project_samples(
    frame: LightFrame,
    again: int,
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    counters: wp.array2d(dtype=wp.int64),
):
    """Ray of each sample in the light's frame (the biased start point), and its state before tracing. With ``again``,
    only the rays of samples whose tracing is not finished, and no state."""
    i = wp.tid()
    if again != 0 and states[i] != wp.uint8(PENDING):
        return
    if valid[i] == wp.uint8(0):
        states[i] = wp.uint8(INVALID)
        return
    sample = samples[i]
    p = wp.vec3d(sample[0], sample[1], sample[2])
    bias = sample[3]
    state = light_reaches(p, frame.light, frame.axis, frame.cosine, frame.reach)
    if state == LIT:
        way = towards_light(p, frame.light)
        start = p - frame.center + wp.vec3d(way[0], way[1], way[2]) * bias
        if bias >= way[3]:
            # Nothing lies between the biased start and the light. A start beyond the light would turn the filter's
            # planes around, so there is no ray: NaN says so (is_ray), and the sample stays lit as the exact decision
            # has it.
            rays[i] = wp.vec4(float(wp.nan), 0.0, 0.0, 0.0)
        else:
            c = frame_coordinates(frame, start)
            rays[i] = wp.vec4(float(c[0]), float(c[1]), float(c[2]), float(c[3]))
            if bias * frame.inverse_scale > wp.float64(0.5):
                # The sum above may cancel beyond the bound of the filter; infinity is a maybe for everything.
                rays[i] = wp.vec4(float(wp.inf), float(wp.inf), float(wp.inf), float(wp.inf))
            if again == 0:
                wp.atomic_add(counters, i & 63, RAYS, wp.int64(1))
    if again == 0:
        states[i] = wp.uint8(state)


@wp.func
def largest(v: wp.vec3d) -> wp.float64:
    return wp.max(wp.max(wp.abs(v[0]), wp.abs(v[1])), wp.abs(v[2]))


@wp.func
def edge_plane(a: wp.vec4d, e: wp.vec4d) -> wp.vec4d:
    """Plane through the light and an edge from ``a`` along ``e``: a x e in (U, V, W), scaled to largest component 1,
    and its relative error. ``e`` is a difference taken before rounding: a x (b - a), never a x b."""
    n = wp.cross(wp.vec3d(a[0], a[1], a[2]), wp.vec3d(e[0], e[1], e[2]))
    size = largest(n)
    reach = wp.float64(1.0) + wp.abs(a[0]) + wp.abs(a[1]) + wp.abs(a[2]) + wp.abs(a[3])
    length = wp.abs(e[0]) + wp.abs(e[1]) + wp.abs(e[2]) + wp.abs(e[3])
    n = n / size
    return wp.vec4d(n[0], n[1], n[2], wp.float64(_SETUP_ERROR) * reach * length / size)


@wp.func
def edge_difference(frame: LightFrame, e: wp.vec3d) -> wp.vec4d:
    """Difference of the frame coordinates of two points whose difference in the world is ``e``."""
    x = e * frame.inverse_scale
    z = wp.dot(frame.f, x)
    return wp.vec4d(wp.dot(frame.r, x), wp.dot(frame.s, x), -frame.w_slope * z, z)


@wp.func
def never_record(triangle: int, records: wp.array2d(dtype=wp.vec4)):
    """A record whose plane test is a certain no: g = 0 - 1 < -0."""
    zero = wp.vec4(0.0, 0.0, 0.0, 0.0)
    records[triangle, 0] = zero
    records[triangle, 1] = zero
    records[triangle, 2] = zero
    records[triangle, 3] = wp.vec4(0.0, 0.0, 0.0, 1.0)


@wp.kernel(enable_backward=False)
def prepare_triangles(
    frame: LightFrame,
    factor: wp.float64,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    records: wp.array2d(dtype=wp.vec4),
    degenerate: wp.array(dtype=int),
):
    """Four planes and their error bounds per triangle, float64 rounded once: (n_ab, s_e) (n_bc, s_N) (n_ca, s_D) (N,
    D)."""
    i = wp.tid()
    corners = triangles[i]
    a = vertices[corners[0]]
    b = vertices[corners[1]]
    c = vertices[corners[2]]
    if not (wp.isfinite(a) and wp.isfinite(b) and wp.isfinite(c)):
        never_record(i, records)
        wp.atomic_add(degenerate, i & 63, 1)
        return
    side = determinant_sign(frame.light, b, c, a)
    if side == 0:
        # Zero area, or seen exactly edge-on from the light.
        never_record(i, records)
        wp.atomic_add(degenerate, i & 63, 1)
        return
    ab = b - a
    ac = c - a
    va = frame_coordinates(frame, a - frame.center)
    vb = frame_coordinates(frame, b - frame.center)
    vc = frame_coordinates(frame, c - frame.center)
    eab = edge_difference(frame, ab)
    eac = edge_difference(frame, ac)
    p0 = edge_plane(va, eab)
    p1 = edge_plane(vb, edge_difference(frame, c - b))
    p2 = edge_plane(vc, edge_difference(frame, a - c))
    sign = wp.float64(1.0)
    if side < 0:
        sign = wp.float64(-1.0)
    u32 = wp.float64(_U32)
    edge_error = wp.max(wp.max(p0[3], p1[3]), p2[3])
    s_edge = factor * u32 + wp.float64(2.0) * edge_error

    e1 = wp.vec3d(eab[0], eab[1], eab[3])
    e2 = wp.vec3d(eac[0], eac[1], eac[3])
    n = wp.cross(e1, e2)
    size = largest(n)
    l1 = wp.abs(e1[0]) + wp.abs(e1[1]) + wp.abs(e1[2])
    l2 = wp.abs(e2[0]) + wp.abs(e2[1]) + wp.abs(e2[2])
    n_error = wp.float64(_SETUP_ERROR) * l1 * l2 / size
    # The frame (r, s, f) is right-handed, so det[U V Z] keeps the sign; the light's side of the plane becomes negative.
    n = n * (-sign / size)
    d = n[0] * va[0] + n[1] * va[1] + n[2] * va[3]
    extent = wp.float64(1.0) + wp.abs(va[0]) + wp.abs(va[1]) + wp.abs(va[3])
    s_plane = factor * u32 + wp.float64(2.0) * n_error
    s_offset = factor * u32 * wp.abs(d) + wp.float64(2.0) * (n_error + wp.float64(_SETUP_ERROR)) * extent
    records[i, 0] = wp.vec4(float(sign * p0[0]), float(sign * p0[1]), float(sign * p0[2]), float(s_edge))
    records[i, 1] = wp.vec4(float(sign * p1[0]), float(sign * p1[1]), float(sign * p1[2]), float(s_plane))
    records[i, 2] = wp.vec4(float(sign * p2[0]), float(sign * p2[1]), float(sign * p2[2]), float(s_offset))
    records[i, 3] = wp.vec4(float(n[0]), float(n[1]), float(n[2]), float(d))
