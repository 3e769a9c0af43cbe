# SPDX-License-Identifier: Apache-2.0
"""Least and largest (u, v) of rays, found by many threads: low u, low v, high u, high v in four consecutive floats, in
``STRIPES`` copies that threads spread over."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.device import native

STRIPES = wp.constant(64)
NOTHING = wp.constant(3.0)  # low values begin here, high ones at its negative: beyond any u and v


native.constants(EXTENT_BITS=0x7FFFFFFF)  # all but the sign of a float


@wp.func_native(native.snippet("device/extents.h", call="Extents::widen(extents.data + base, u, v);"))
def widen(extents: wp.array(dtype=float), base: int, u: float, v: float):
    """Take (u, v) into the four values from ``base`` on."""
    ...


@wp.func
def stripe(thread: int) -> int:
    """The copy for a thread: the same one for a warp, whose lanes then widen it once for all of them."""
    return (thread >> 5) & (STRIPES - 1)


@wp.func
def joined(extents: wp.array(dtype=float), base: int, stride: int, copies: int) -> wp.vec4:
    """The four values over all copies, the first at ``base``, each ``stride`` behind the one before."""
    box = wp.vec4(NOTHING, NOTHING, -NOTHING, -NOTHING)
    for k in range(copies):
        at = base + k * stride
        low_u = wp.min(box[0], extents[at])
        low_v = wp.min(box[1], extents[at + 1])
        high_u = wp.max(box[2], extents[at + 2])
        high_v = wp.max(box[3], extents[at + 3])
        box = wp.vec4(low_u, low_v, high_u, high_v)
    return box


@wp.kernel(enable_backward=False)
def clear_extents(extents: wp.array(dtype=float)):
    """No ray yet. One thread per element."""
    i = wp.tid()
    extents[i] = wp.where((i & 3) < 2, NOTHING, -NOTHING)
