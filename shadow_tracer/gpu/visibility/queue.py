# SPDX-License-Identifier: Apache-2.0
"""Pairs that the filter cannot decide, in the CUDA form: they wait in a bounded queue for the exact decision.

A ray that finds the queue full is left OPEN. When the queue has been decided, two more kernels take the open rays, if
there are any, against all triangles, and decide what is uncertain in place. They are always launched, so that the host
need not know, and return at once where the queue sufficed. So a full queue costs time, never an answer, at any
capacity, and such a frame can be recorded as any other.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import warp as wp

from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.counters import LEAF_TESTS, OVERFLOWS, PEAK_QUEUE
from shadow_tracer.gpu.device.launches import Launches
from shadow_tracer.gpu.exact.decision import NO, YES, filter_pair, ray_magnitude
from shadow_tracer.gpu.exact.light_frame import LIT, OPEN, SHADOWED
from shadow_tracer.gpu.visibility.answers import Answers, decide_pair

# Threads that share the queue, and the open rays: enough to fill a GPU.
_THREADS_CUDA = 65536


@wp.kernel(enable_backward=False)
def decide_queue(stride: int, answers: Answers, open_count: wp.array(dtype=int)):
    """Decide every queued pair of a pass."""
    thread = wp.tid()
    count = wp.min(answers.queue_count[0], answers.queue.shape[0])
    if thread == 0:
        wp.atomic_max(answers.counters, 0, PEAK_QUEUE, wp.int64(count))
        open_count[0] = 0
    for k in range(thread, count, stride):
        pair = answers.queue[k]
        if answers.states[pair[0]] != wp.uint8(SHADOWED):
            decide_pair(answers, pair[0], pair[1])


@wp.kernel(enable_backward=False)
def list_open(answers: Answers, open_rays: wp.array(dtype=int), open_count: wp.array(dtype=int)):
    """List the rays that found the queue full. One thread per ray."""
    if answers.queue_count[0] <= answers.queue.shape[0]:
        return
    i = wp.tid()
    if answers.states[i] == wp.uint8(OPEN):
        answers.states[i] = wp.uint8(LIT)
        open_rays[wp.atomic_add(open_count, 0, 1)] = i


@wp.kernel(enable_backward=False)
def decide_open(
    stride: int,
    records_apart: int,
    triangle_count: int,
    rays: wp.array(dtype=wp.vec4),
    records: wp.array2d(dtype=wp.vec4),
    open_rays: wp.array(dtype=int),
    open_count: wp.array(dtype=int),
    answers: Answers,
):
    """Every listed ray against every triangle, whose records lie light after light, so far apart."""
    thread = wp.tid()
    tests = int(0)
    for k in range(open_count[0]):
        i = open_rays[k]
        ray = rays[i]
        magnitude = ray_magnitude(ray)
        first = i // answers.samples * records_apart
        t = thread
        while t < triangle_count and answers.states[i] != wp.uint8(SHADOWED):
            answer = filter_pair(ray, magnitude, records, first + t)
            tests += 1
            if answer == YES:
                answers.states[i] = wp.uint8(SHADOWED)
            elif answer != NO:
                decide_pair(answers, i, t)
            t += stride
    if tests > 0:
        wp.atomic_add(answers.counters, thread & 63, LEAF_TESTS, wp.int64(tests))
    if thread == 0 and open_count[0] > 0:
        wp.atomic_add(answers.counters, 0, OVERFLOWS, wp.int64(1))


class Pending(NamedTuple):
    """A pass whose pairs wait: where its answers go, its rays, and the records of its triangles, those of a light so
    many behind those of the one before."""

    answers: Answers
    ray_count: int
    records_apart: int
    triangle_count: int
    rays: wp.array
    records: wp.array


class WaitingPairs:
    """Decides what a search has left undecided. For the CUDA form.

    Args:
        max_rays: the most rays of a pass.
        capacity: places on the queue.
    """

    def __init__(self, max_rays: int, capacity: int, device: Any) -> None:
        self._threads = forms.tasks(device, min(_THREADS_CUDA, capacity))
        self._sweepers = forms.tasks(device, _THREADS_CUDA)
        self._open = wp.empty(max_rays, dtype=int, device=device)
        self._open_count = wp.zeros(1, dtype=int, device=device)
        self._launch = Launches(device)

    def decide(self, key: tuple[Hashable, ...], ask: Callable[[], Pending]) -> None:
        """Launch what decides the pairs of a pass; ``key`` tells all that what ``ask`` returns depends on."""

        def queued() -> tuple[int, list[Any]]:
            return self._threads, [self._threads, ask().answers, self._open_count]

        def listed() -> tuple[int, list[Any]]:
            pending = ask()
            return pending.ray_count, [pending.answers, self._open, self._open_count]

        def swept() -> tuple[int, list[Any]]:
            pending, threads = ask(), self._sweepers
            inputs = [threads, pending.records_apart, pending.triangle_count, pending.rays, pending.records]
            return threads, [*inputs, self._open, self._open_count, pending.answers]

        self._launch(decide_queue, key, queued)
        self._launch(list_open, key, listed)
        self._launch(decide_open, key, swept)

    def nbytes(self) -> int:
        """Bytes on the device."""
        return int(self._open.capacity + self._open_count.capacity)
