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
from shadow_tracer.gpu.device.counters import RAYS, add_to
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.samples.sample_set import SampleSet

# Samples per thread of the vectorised loop.
_BLOCK = 256
native.constants(PROJECT_BLOCK=_BLOCK)
_WITHOUT_RAYS = 4096  # samples per thread where no rays are made


@native.func_native("samples/project.h", calls="Project::one")
def project_sample(
    i: int,
    frame: LightFrame,
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
    counted: int,
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    counters: wp.array2d(dtype=wp.int64),
):
    i = wp.tid()
    if project_sample(i, light[0], samples, valid, rays, states) != 0 and counted == 0:
        add_to(counters, i & 63, RAYS, 1)


@native.func_native("samples/project_block.h", calls="ProjectBlock::block")
def project_block(
    first: int,
    count: int,
    frame: LightFrame,
    counted: int,
    column: int,
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    counters: wp.array2d(dtype=wp.int64),
):
    """``project_samples`` for up to 256 samples from ``first`` on. Samples without a ray get one that starts with
    NaN."""
    ...


@wp.kernel(enable_backward=False)
def project_blocks(
    count: int,
    light: wp.array(dtype=LightFrame),
    counted: int,
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    counters: wp.array2d(dtype=wp.int64),
):
    project_block(wp.tid() * _BLOCK, count, light[0], counted, RAYS, samples, valid, rays, states, counters)


@native.func_native("samples/states.h", calls="States::some")
def states_of_some(
    first: int,
    last: int,
    frame: LightFrame,
    counted: int,
    column: int,
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
    states: wp.array(dtype=wp.uint8),
    counters: wp.array2d(dtype=wp.int64),
):
    """States of some samples before tracing; those with a ray are added up, unless they are ``counted``."""
    ...


@wp.kernel(enable_backward=False)
def find_states(
    count: int,
    block: int,
    light: wp.array(dtype=LightFrame),
    counted: int,
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
    states: wp.array(dtype=wp.uint8),
    counters: wp.array2d(dtype=wp.int64),
):
    first = wp.tid() * block
    last = wp.min(first + block, count)
    states_of_some(first, last, light[0], counted, RAYS, samples, valid, states, counters)


def project_without_rays(buffers: SampleSet, light: int, counted: bool) -> None:
    """What ``project`` makes, but for the rays."""
    block = _WITHOUT_RAYS if forms.wide(buffers.device) else 1
    inputs = [buffers.count, block, buffers.light_frame_of[light], int(counted), buffers.positions, buffers.valid]
    inputs += [buffers.states_of(light), buffers.counters]
    wp.launch(find_states, dim=-(-buffers.count // block), inputs=inputs, device=buffers.device)


def project(buffers: SampleSet, light: int, place: int, counted: bool = False) -> None:
    """Rays of all samples and their states for light number ``light``, the one at ``place`` in its pass; ``counted``:
    they are made once more, and have been counted."""
    wide = forms.wide(buffers.device)

    def prepare() -> tuple[int, list[Any]]:
        inputs = [
            buffers.light_frame_of[light],
            int(counted),
            buffers.positions,
            buffers.valid,
            buffers.rays_of(place),
            buffers.states_of(light),
            buffers.counters,
        ]
        return (-(-buffers.count // _BLOCK), [buffers.count, *inputs]) if wide else (buffers.count, inputs)

    key = (light, place, counted, buffers.count)
    buffers.launch(project_blocks if wide else project_samples, key, prepare)
