# SPDX-License-Identifier: Apache-2.0
"""Samples to rays: where each sample's biased start lies in the frame of a light, and its state before any triangle.

CUDA takes one sample per thread (``project_samples``). On the CPU Warp's loops are scalar, so there a thread takes a
block of samples and the compiler puts the loop over them into vector registers (``project_block``): no branches, the
same operations in the same order, none of them contracted, hence the same bits.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.device.counters import RAYS
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
native.constants(FIRST_TIME=FIRST_TIME, PENDING_RAYS=PENDING_RAYS, PROJECT_BLOCK=_BLOCK)


@native.func_native("samples/project.h", calls="Project::block")
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
