# SPDX-License-Identifier: Apache-2.0
"""Which rays of a pass go into a structure over light space, and what happens to the others.

Rays that do not fit into light space are *wild*: not finite, or so near to the light that their direction is lost in
the roundings of their coordinates. They are kept out of the structure and tested against every triangle. Directions of
the others are within 3 u of exact.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.accelerators.interface import Context, Rays
from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.device.counters import LEAF_TESTS
from shadow_tracer.gpu.device.launches import Launches
from shadow_tracer.gpu.exact.decision import NO, filter_pair, ray_magnitude
from shadow_tracer.gpu.exact.light_frame import LIT
from shadow_tracer.gpu.exact.light_space import WILD_RATIO
from shadow_tracer.gpu.visibility.answers import Answers, settle

ABSENT = wp.constant(0)
IN_TREE = wp.constant(1)
WILD = wp.constant(2)

_WILD_THREADS_CUDA = 16384
# Samples per thread on the CPU.
_BLOCK = wp.constant(256)
native.constants(ADMIT_BLOCK=_BLOCK, ABSENT=ABSENT, IN_TREE=IN_TREE, WILD=WILD, WILD_RATIO=WILD_RATIO)


@native.func_native("accelerators/admission.h", calls="Admission::one")
def admit_ray(
    ray: int,
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    groups: wp.array(dtype=wp.uint8),
    wild: wp.array(dtype=int),
    counts: wp.array(dtype=int),
):
    """ABSENT, IN_TREE or WILD; wild ones are listed."""
    ...


@wp.kernel(enable_backward=False)
def admit_rays(
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    groups: wp.array(dtype=wp.uint8),
    wild: wp.array(dtype=int),
    counts: wp.array(dtype=int),
):
    """One thread per ray."""
    admit_ray(wp.tid(), rays, states, groups, wild, counts)


@native.func_native("accelerators/admission.h", calls="Admission::block")
def admit_block(
    first: int,
    count: int,
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    groups: wp.array(dtype=wp.uint8),
    wild: wp.array(dtype=int),
    counts: wp.array(dtype=int),
):
    """``admit_ray`` for the rays from ``first`` on."""
    ...


@wp.kernel(enable_backward=False)
def admit_blocks(
    count: int,
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    groups: wp.array(dtype=wp.uint8),
    wild: wp.array(dtype=int),
    counts: wp.array(dtype=int),
):
    """``admit_rays`` on the CPU."""
    admit_block(_BLOCK * wp.tid(), count, rays, states, groups, wild, counts)


@wp.kernel(enable_backward=False)
def test_wild(
    stride: int,
    records_apart: int,
    triangle_count: int,
    rays: wp.array(dtype=wp.vec4),
    records: wp.array2d(dtype=wp.vec4),
    wild: wp.array(dtype=int),
    counts: wp.array(dtype=int),
    answers: Answers,
):
    """Every ray of the list ``wild`` against every triangle."""
    thread = wp.tid()
    tests = int(0)
    for k in range(counts[1]):
        i = wild[k]
        ray = rays[i]
        magnitude = ray_magnitude(ray)
        first = i // answers.samples * records_apart
        t = thread
        while t < triangle_count and answers.states[i] == wp.uint8(LIT):
            answer = filter_pair(ray, magnitude, records, first + t)
            tests += 1
            if answer != NO:
                settle(i, t, answer, answers)
            t += stride
    if tests > 0:
        wp.atomic_add(answers.counters, thread & 63, LEAF_TESTS, wp.int64(tests))


class Admission:
    """The rays of the current pass.

    Attributes:
        groups: uint8 per ray: ABSENT, IN_TREE or WILD.
        counts: int32 on the device: [0] is free for the structure to count its rays in, [1] is the number of wild ones.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        device, rays = context.samples.device, context.samples.bounds.max_rays
        self.groups = wp.empty(rays, dtype=wp.uint8, device=device)
        self.counts = wp.zeros(2, dtype=int, device=device)
        self._wild = wp.empty(rays, dtype=int, device=device)
        self._launch = Launches(device)

    def admit(self, rays: Rays) -> None:
        """Group the rays of a pass."""
        samples, lights = self._context.samples, len(rays.lights)
        wide, count = forms.wide(samples.device), lights * samples.count
        self.counts.zero_()

        def prepare() -> tuple[int, list[Any]]:
            inputs = [samples.rays, samples.states_of(rays.first, lights), self.groups, self._wild, self.counts]
            return (-(-count // int(_BLOCK)), [count, *inputs]) if wide else (count, inputs)

        self._launch(admit_blocks if wide else admit_rays, (rays.first, count, samples.count), prepare)

    @property
    def listed(self) -> tuple[wp.array, wp.array]:
        """The list of wild rays, and ``counts``."""
        return self._wild, self.counts

    def test_wild(self, rays: Rays) -> None:
        """Test the rays that are not in the structure."""
        samples, scene, records = self._context.samples, self._context.scene, self._context.records
        threads, lights = forms.tasks(samples.device, _WILD_THREADS_CUDA), len(rays.lights)

        def prepare() -> tuple[int, list[Any]]:
            inputs = [threads, records.stride, scene.triangle_count, samples.rays, records.of(rays.first, lights)]
            return threads, [*inputs, self._wild, self.counts, self._context.answers(rays)]

        self._launch(test_wild, self._context.key(rays), prepare)

    def nbytes(self) -> int:
        """Bytes on the device."""
        return sum(int(array.capacity) for array in (self.groups, self.counts, self._wild))
