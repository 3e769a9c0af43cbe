# SPDX-License-Identifier: Apache-2.0
"""Samples to rays: where each sample's biased start lies in the frame of a light, and its state before any triangle.

CUDA takes one sample per thread (``project_samples``). On the CPU Warp's loops are scalar, so there a thread takes a
block of samples and the compiler puts the loop over them into vector registers (``project_block``). Both use one text
(``view.h``), which has no branches.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.device.counters import RAYS
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.samples.sample_set import FrameBuffers

# Values of `again`, see `project`.
FIRST_TIME = wp.constant(0)
PENDING_RAYS = wp.constant(1)
ONCE_MORE = wp.constant(2)


# Samples per thread of the vectorised loop.
_BLOCK = 256
native.constants(FIRST_TIME=FIRST_TIME, PENDING_RAYS=PENDING_RAYS, PROJECT_BLOCK=_BLOCK)


@native.func_native("samples/project.h", calls="Project::one")
def project_sample(
    i: int,
    frame: LightFrame,
    again: int,
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
) -> int:
    """Ray of sample ``i`` in the light's frame (the biased start; NaN if it has none), and its state before tracing.
    Returns 1 if that is a ray to be counted."""
    ...


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
    i = wp.tid()
    if project_sample(i, light[0], again, samples, valid, rays, states) != 0:
        wp.atomic_add(counters, i & 63, RAYS, wp.int64(1))


@native.func_native("samples/project_block.h", calls="ProjectBlock::block")
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
