# SPDX-License-Identifier: Apache-2.0
"""Which rays take part in a pass, and their answers.

All rays take part in the first pass of a frame. Triangles visit rays in no particular order, so a ray that finds the
queue full cannot remember where it stopped; instead it counts its uncertain pairs to the end (``resume``) and becomes
PENDING. A further pass admits, from the front, as many pending rays as fit the queue together by these counts, and
shows them all triangles again. Passes of one frame count in the same place: where there are several, a pending ray
counts as one pair at first, the least there can be. If that was too little, or another tree shows a ray more uncertain
pairs than counted, it stays pending with the new count and fewer rays are admitted next time, down to a single one; if
even that one has more pairs than the queue has places, it is tested alone against one triangle after the other, and
goes on where it stopped. So every pass makes progress, at any capacity.

Rays that do not fit into light space (``light_space.is_wild``) are kept out of the tree and tested against every
triangle.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.accelerators.interface import Context
from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.device.counters import LEAF_TESTS
from shadow_tracer.gpu.device.launches import Launches
from shadow_tracer.gpu.exact.decision import NO, filter_pair, is_ray, ray_magnitude
from shadow_tracer.gpu.exact.light_frame import LIT, PENDING, SHADOWED
from shadow_tracer.gpu.exact.light_space import is_wild
from shadow_tracer.gpu.samples.passes import Pass
from shadow_tracer.gpu.visibility.answers import Answers, settle
from shadow_tracer.gpu.visibility.queue import test_everything

ABSENT = wp.constant(0)
IN_TREE = wp.constant(1)
WILD = wp.constant(2)

_WILD_THREADS_CUDA = 16384
# Samples per thread on the CPU.
_BLOCK = wp.constant(256)
native.constants(ADMIT_BLOCK=_BLOCK, IN_TREE=IN_TREE, WILD=WILD)


@wp.func
def admit(
    i: int, ray: wp.vec4, group: wp.array(dtype=wp.uint8), wild: wp.array(dtype=int), counts: wp.array(dtype=int)
):
    if is_wild(ray):
        group[i] = wp.uint8(WILD)
        wild[wp.atomic_add(counts, 1, 1)] = i
    else:
        group[i] = wp.uint8(IN_TREE)


@wp.kernel(enable_backward=False)
def admit_all(
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    resume: wp.array(dtype=int),
    group: wp.array(dtype=wp.uint8),
    wild: wp.array(dtype=int),
    counts: wp.array(dtype=int),
):
    """The first pass: every ray."""
    i = wp.tid()
    ray = rays[i]
    if is_ray(states[i], ray):
        resume[i] = 0
        admit(i, ray, group, wild, counts)
    else:
        group[i] = wp.uint8(ABSENT)


@native.func_native("accelerators/admit.h", calls="Admit::block")
def admit_block(
    first: int,
    count: int,
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    resume: wp.array(dtype=int),
    group: wp.array(dtype=wp.uint8),
    wild: wp.array(dtype=int),
    counts: wp.array(dtype=int),
):
    """``admit_all`` for the samples from ``first`` on."""
    ...


@wp.kernel(enable_backward=False)
def admit_blocks(
    count: int,
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    resume: wp.array(dtype=int),
    group: wp.array(dtype=wp.uint8),
    wild: wp.array(dtype=int),
    counts: wp.array(dtype=int),
):
    """``admit_all`` on the CPU."""
    admit_block(_BLOCK * wp.tid(), count, rays, states, resume, group, wild, counts)


@wp.kernel(enable_backward=False)
def count_demand(states: wp.array(dtype=wp.uint8), resume: wp.array(dtype=int), demand: wp.array(dtype=wp.int64)):
    """Places in the queue that each pending ray needs."""
    i = wp.tid()
    demand[i] = wp.int64(0)
    if states[i] == wp.uint8(PENDING):
        demand[i] = wp.int64(resume[i])


@wp.kernel(enable_backward=False)
def admit_pending(
    capacity: wp.int64,
    demand: wp.array(dtype=wp.int64),
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    resume: wp.array(dtype=int),
    group: wp.array(dtype=wp.uint8),
    wild: wp.array(dtype=int),
    counts: wp.array(dtype=int),
    alone: wp.array(dtype=int),
    deferred: wp.array(dtype=int),
):
    """A further pass: pending rays from the front that fit the queue together. ``demand`` holds inclusive sums.
    ``alone[0]`` becomes the first pending ray if it does not fit even by itself."""
    i = wp.tid()
    group[i] = wp.uint8(ABSENT)
    if states[i] != wp.uint8(PENDING):
        return
    if demand[i] <= capacity:
        states[i] = wp.uint8(LIT)
        resume[i] = 0
        admit(i, rays[i], group, wild, counts)
    else:
        deferred[0] = 1
        if demand[i] == wp.int64(resume[i]):
            alone[0] = i


@wp.kernel(enable_backward=False)
def test_alone(
    records_apart: int,
    triangle_count: int,
    rays: wp.array(dtype=wp.vec4),
    records: wp.array2d(dtype=wp.vec4),
    answers: Answers,
    alone: wp.array(dtype=int),
):
    """The ray ``alone[0]``, if any, against one triangle after the other; ``alone[1]`` is the ray for which
    ``alone[2]`` uncertain pairs have been on the queue in earlier passes."""
    i = alone[0]
    if i < 0:
        return
    queued = int(0)
    if alone[1] == i:
        queued = alone[2]
    ray = rays[i]
    first = i // answers.samples * records_apart
    found = test_everything(
        i, ray, ray_magnitude(ray), queued, first, triangle_count, records, answers.queue, answers.queue_count
    )
    answers.states[i] = wp.uint8(found[0])
    alone[1] = i
    alone[2] = found[1]
    wp.atomic_add(answers.counters, 0, LEAF_TESTS, wp.int64(found[2]))


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
        while t < triangle_count and answers.states[i] != wp.uint8(SHADOWED):
            answer = filter_pair(ray, magnitude, records, first + t)
            tests += 1
            if answer != NO:
                settle(i, t, answer, answers)
            t += stride
    if tests > 0:
        wp.atomic_add(answers.counters, thread & 63, LEAF_TESTS, wp.int64(tests))


class Participants:
    """The rays of the current pass.

    ``group`` (uint8 per ray) is ABSENT, IN_TREE or WILD. ``counts`` (int32 on the device): [0] is free for the tree
    to count its rays in, [1] is the number of wild rays.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        device, rays = context.frame.device, context.frame.bounds.max_rays
        self.group = wp.empty(rays, dtype=wp.uint8, device=device)
        self.counts = wp.zeros(2, dtype=int, device=device)
        self._wild = wp.empty(rays, dtype=int, device=device)
        self._demand = wp.empty(rays, dtype=wp.int64, device=device)
        self._alone = wp.empty(3, dtype=int, device=device)
        self._alone_now = self._alone[0:1]
        self._launch = Launches(device)

    def answers(self, work: Pass) -> Answers:
        """Where the answers of a pass go."""
        frame, light = self._context.frame, work.first
        answers = Answers()
        answers.samples = frame.count
        answers.states = frame.states_of(light, len(work.lights))
        answers.resume = frame.resume
        answers.queue = frame.queue
        answers.queue_count = frame.queue_count_of[light]
        answers.counters = frame.counters
        return answers

    def choose(self, work: Pass) -> None:
        """Decide which rays take part."""
        frame, attempt = self._context.frame, work.attempt
        device, count = frame.device, len(work.lights) * frame.count
        states = frame.states_of(work.first, len(work.lights))
        self.counts.zero_()
        if attempt == 0:

            def prepare() -> tuple[int, list[Any]]:
                inputs = [frame.rays, states, frame.resume, self.group, self._wild, self.counts]
                return (-(-count // int(_BLOCK)), [count, *inputs]) if forms.wide(device) else (count, inputs)

            self._launch(admit_blocks if forms.wide(device) else admit_all, (work.first, count, frame.count), prepare)
            return
        if attempt == 1:
            self._alone.fill_(-1)
        self._alone_now.fill_(-1)
        wp.launch(count_demand, dim=count, inputs=[states, frame.resume, self._demand], device=device)
        wp.utils.array_scan(self._demand[:count], self._demand[:count], inclusive=True)
        wp.launch(
            admit_pending,
            dim=count,
            inputs=[
                wp.int64(frame.bounds.queue_capacity),
                self._demand,
                frame.rays,
                states,
                frame.resume,
                self.group,
                self._wild,
                self.counts,
                self._alone,
                frame.deferred,
            ],
            device=device,
        )

    def choose_again(self, lights: int) -> None:
        """The same as in the first attempt before, for the same rays; on the CPU."""
        frame = self._context.frame
        frame.resume.numpy()[: lights * frame.count] = 0

    def finish(self, work: Pass) -> None:
        """Test the rays that are not in the tree. Once in an attempt, whatever its parts."""
        frame, scene = self._context.frame, self._context.scene
        threads, lights = forms.tasks(frame.device, _WILD_THREADS_CUDA), len(work.lights)

        def prepare() -> tuple[int, list[Any]]:
            records = self._context.records.of(work.first, lights)
            inputs = [
                threads,
                self._context.records.stride,
                scene.triangle_count,
                frame.rays,
                records,
                self._wild,
                self.counts,
            ]
            return threads, [*inputs, self.answers(work)]

        place, apart = self._context.records.place(work.first), self._context.records.stride
        self._launch(test_wild, (work.first, lights, frame.count, place, apart, scene.triangle_count), prepare)
        if work.attempt > 0:
            records = self._context.records.of(work.first, lights)
            inputs = [apart, scene.triangle_count, frame.rays, records, self.answers(work), self._alone]
            wp.launch(test_alone, dim=1, inputs=inputs, device=frame.device)

    def nbytes(self) -> int:
        """Bytes on the device."""
        arrays = (self.group, self.counts, self._wild, self._demand, self._alone)
        return sum(int(array.capacity) for array in arrays)
