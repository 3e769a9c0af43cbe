# SPDX-License-Identifier: Apache-2.0
"""Samples to rays: where each sample's biased start lies in the frame of a light, and its state before any triangle.

CUDA takes one sample per thread (``project_samples``). On the CPU Warp's loops are scalar, so there a thread takes a
block of samples and the compiler puts the loop over them into vector registers (``project_block``): no branches, the
same operations in the same order, none of them contracted, hence the same bits.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.counters import RAYS
from shadow_tracer.gpu.exact.determinant import ARITHMETIC
from shadow_tracer.gpu.exact.light_frame import (
    INVALID,
    LIT,
    PENDING,
    LightFrame,
    frame_coordinates,
    light_reaches,
    towards_light,
)
from shadow_tracer.gpu.samples.sample_set import FrameBuffers

# Values of `again`, see `project`.
FIRST_TIME = wp.constant(0)
PENDING_RAYS = wp.constant(1)
ONCE_MORE = wp.constant(2)


@wp.kernel(enable_backward=False)
def project_samples(
    light: wp.array(dtype=LightFrame),
    again: int,
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    counters: wp.array2d(dtype=wp.int64),
):
    """Ray of each sample in the light's frame (the biased start point), and its state before tracing."""
    i = wp.tid()
    frame = light[0]
    if again == PENDING_RAYS and states[i] != wp.uint8(PENDING):
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
            size = wp.abs(c[0]) + wp.abs(c[1]) + wp.abs(c[2]) + wp.abs(c[3])
            if bias * frame.inverse_scale > wp.float64(0.5) + size:
                # The sum above may cancel beyond the bound of the filter; infinity is a maybe for everything.
                rays[i] = wp.vec4(float(wp.inf), float(wp.inf), float(wp.inf), float(wp.inf))
            if again == FIRST_TIME:
                wp.atomic_add(counters, i & 63, RAYS, wp.int64(1))
    if again != PENDING_RAYS:
        states[i] = wp.uint8(state)


# Samples per thread of the vectorised loop.
_BLOCK = 256


# A light at infinity differs only in w = 0: the way to it is the same from everywhere, l - 0 p, and its distance has no
# end. States and rays of the block stay on the stack until it is known which of them are wanted.
@wp.func_native(
    ARITHMETIC
    + r"""
#if !defined(__CUDA_ARCH__)
    const int n = count - first < 256 ? count - first : 256;
    int pending = again != 1;
    for (int j = 0; j < n; ++j)
        pending |= states.data[first + j] == 4;
    if (!pending)
        return;
    const double lx = frame.light[0], ly = frame.light[1], lz = frame.light[2], lw = frame.light[3];
    const double ax = frame.axis[0], ay = frame.axis[1], az = frame.axis[2], cosine = frame.cosine;
    const double rx = frame.r[0], ry = frame.r[1], rz = frame.r[2];
    const double sx = frame.s[0], sy = frame.s[1], sz = frame.s[2];
    const double fx = frame.f[0], fy = frame.f[1], fz = frame.f[2];
    const double cx = frame.center[0], cy = frame.center[1], cz = frame.center[2];
    const double scale = frame.inverse_scale, w_constant = frame.w_constant, w_slope = frame.w_slope;
    const double endless = 1.7976931348623157e308, infinity = HUGE_VAL, nan = infinity - infinity;
    const double reach = lw != 0.0 ? frame.reach : infinity;
    const int bounded = lw != 0.0;
    typedef double Four[4];
    typedef float Ray[4];
    const Four* __restrict__ sample = (const Four*)(samples.data + first);
    const wp::uint8* __restrict__ good = valid.data + first;
    Ray* __restrict__ ray = (Ray*)(rays.data + first);
    wp::uint8 state[256];
    int traced = 0;
    for (int j = 0; j < n; ++j) {
        const double px = sample[j][0], py = sample[j][1], pz = sample[j][2], bias = sample[j][3];
        const double x = sub(lx, mul(lw, px)), y = sub(ly, mul(lw, py)), z = sub(lz, mul(lw, pz));
        const double length = norm(x, y, z);
        const double along = -add(add(mul(x, ax), mul(y, ay)), mul(z, az));
        const int out = bounded & ((length > reach) | (along < mul(cosine, length)));
        const double inverse = length > 0.0 ? 1.0 / length : 0.0;
        const double distance = bounded ? length : endless;
        const double qx = mul(add(sub(px, cx), mul(mul(x, inverse), bias)), scale);
        const double qy = mul(add(sub(py, cy), mul(mul(y, inverse), bias)), scale);
        const double qz = mul(add(sub(pz, cz), mul(mul(z, inverse), bias)), scale);
        double u = add(add(mul(rx, qx), mul(ry, qy)), mul(rz, qz));
        double v = add(add(mul(sx, qx), mul(sy, qy)), mul(sz, qz));
        double h = add(add(mul(fx, qx), mul(fy, qy)), mul(fz, qz));
        double w = sub(w_constant, mul(w_slope, h));
        const double size = add(add(add(absolute(u), absolute(v)), absolute(w)), absolute(h));
        const bool far = mul(bias, scale) > add(0.5, size);
        u = far ? infinity : u; v = far ? infinity : v; w = far ? infinity : w; h = far ? infinity : h;
        const int is = good[j] != 0;
        const int ray_ends = is & (1 - out) & (bias < distance);
        ray[j][0] = (float)(ray_ends ? u : nan);
        ray[j][1] = (float)v;
        ray[j][2] = (float)w;
        ray[j][3] = (float)h;
        state[j] = (wp::uint8)(is ? 2 * out : 3);
        traced += ray_ends;
    }
    if (again == 1)
        return;
    for (int j = 0; j < n; ++j)
        states.data[first + j] = state[j];
    if (again == 0)
        wp::atomic_add(&counters.data[((first / 256) & 63) * counters.shape[1] + column], (wp::int64)traced);
#endif
    """
)
def project_block(
    first: int,
    count: int,
    frame: LightFrame,
    again: int,
    column: int,
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    counters: wp.array2d(dtype=wp.int64),
):
    """``project_samples`` for up to 256 samples from ``first`` on. Samples without a ray get one that starts with NaN;
    if only pending rays are wanted, those of a whole block are made when any of it is pending."""
    ...


@wp.kernel(enable_backward=False)
def project_blocks(
    count: int,
    light: wp.array(dtype=LightFrame),
    again: int,
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    counters: wp.array2d(dtype=wp.int64),
):
    project_block(wp.tid() * _BLOCK, count, light[0], again, RAYS, samples, valid, rays, states, counters)


def project(buffers: FrameBuffers, light: int, place: int, again: int) -> None:
    """Rays of all samples and their states for light number ``light``, the one at ``place`` in its pass.

    ``again`` is ``FIRST_TIME``; ``PENDING_RAYS``: only the rays of samples whose tracing is not finished, and no
    states; or ``ONCE_MORE``: as the first time, but not counted."""
    wide = forms.wide(buffers.device)

    def prepare() -> tuple[int, list[Any]]:
        inputs = [
            buffers.light_frame_of[light],
            again,
            buffers.samples,
            buffers.valid,
            buffers.rays_of(place),
            buffers.states_of(light),
            buffers.counters,
        ]
        return (-(-buffers.count // _BLOCK), [buffers.count, *inputs]) if wide else (buffers.count, inputs)

    key = (light, place, int(again), buffers.count)
    buffers.launch(project_blocks if wide else project_samples, key, prepare)
