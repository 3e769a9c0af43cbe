# SPDX-License-Identifier: Apache-2.0
"""One homogeneous frame for near, far and directional lights.

With an anchor (centre C and scale S near the samples), f the unit vector from C to the light, r and s orthogonal to
it, R the distance to the light and H = max(R, S), a point x gets::

    x' = (x - C) / S      U = r.x'    V = s.x'    Z = f.x'    W = R/H - (S/H) Z

(U, V, W) is, up to a positive scale per axis, the position seen from the light, so planes through the light are linear
in it without a constant; (U, V, Z) is the position itself, for the triangle's own plane. For a directional light R/H =
1 and S/H = 0: the same formulas, no loss of precision however far the light is. Only this frame is float32; it feeds
the filter of ``decision.py``, whose bounds account for every rounding here (``docs/exactness.md``). The exact
decision never uses it. ``rays.py`` brings samples into it, ``records.py`` triangles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import warp as wp

from shadow_tracer.gpu.device import native
from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.lights import HardLight

# Values of the state image; shadow_tracer.visibility.State is the public name. OPEN (``visibility/queue.py``) never
# leaves the device.
LIT = wp.constant(0)
SHADOWED = wp.constant(1)
OUTSIDE = wp.constant(2)
INVALID = wp.constant(3)
OPEN = wp.constant(8)
native.constants(LIT=LIT, SHADOWED=SHADOWED, OUTSIDE=OUTSIDE, INVALID=INVALID, OPEN=OPEN)


@wp.struct
class LightFrame:
    """A light and the frame around it, as kernels see it."""

    number: int  # of the light within its frame
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

    def covers(self, center: Sequence[float], radius: float) -> bool:
        """Whether this anchor serves samples within ``radius`` of ``center`` well, so that nothing needs to be set up
        again."""
        return math.dist(center, self.center) + radius <= self.scale <= 8.0 * radius


def make_anchor(center: FloatArray | Sequence[float], radius: float, previous: Anchor | None) -> Anchor:
    """Anchor for samples within about ``radius`` of ``center``; the previous one while it still serves."""
    radius = min(max(radius, 1e-30), 1e30)
    x, y, z = (float(v) for v in center)
    if previous is not None and previous.covers((x, y, z), radius):
        return previous
    return Anchor((x, y, z), 1.5 * radius)


def make_light_frame(light: HardLight, anchor: Anchor, number: int = 0) -> LightFrame:
    """Frame of ``light``, the ``number``-th of its frame, over the samples at ``anchor``. Not to be changed: a light
    that stays where it is gets the same one again."""
    return _make(*look(light), anchor, number)


@lru_cache(maxsize=256)
def look(light: HardLight) -> tuple[tuple[float, ...], tuple[float, ...], float, float]:
    """What frames of a light depend on; lights are not changed either."""
    axis, cosine = light.cone
    return tuple(light.homogeneous.tolist()), tuple(axis.tolist()), cosine, light.range


@lru_cache(maxsize=256)
def _make(
    homogeneous: tuple[float, ...], axis: tuple[float, ...], cosine: float, reach: float, anchor: Anchor, number: int
) -> LightFrame:
    center = np.asarray(anchor.center)
    place = np.asarray(homogeneous[:3])
    if homogeneous[3] == 0.0:
        f = place / np.linalg.norm(place)
        w_constant, w_slope = 1.0, 0.0
    else:
        offset = place - center
        distance = float(np.linalg.norm(offset))
        f = offset / distance if distance > 0.0 else np.array([0.0, 0.0, 1.0])
        reference = max(distance, anchor.scale)
        w_constant, w_slope = distance / reference, anchor.scale / reference
    f = f / np.linalg.norm(f)
    # The axis least aligned with f gives a well-conditioned orthonormal basis.
    r = np.cross(np.eye(3)[int(np.argmin(np.abs(f)))], f)
    r /= np.linalg.norm(r)
    frame = LightFrame()
    frame.number = number
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
    frame.reach = reach
    return frame


@native.func_native("exact/light.h", calls="LightSide::towards")
def towards_light(p: wp.vec3d, light: wp.vec4d) -> wp.vec4d:
    """(unit direction to the light, distance to it; the largest float64 for a light at infinity)."""
    ...
