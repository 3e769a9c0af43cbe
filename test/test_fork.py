# SPDX-License-Identifier: Apache-2.0
"""Tracers and depth cameras in forked processes, which have none of the parent's threads: they answer, or say why not,
and never wait for somebody who is not there."""

from __future__ import annotations

import multiprocessing
import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import probe
import pytest

from shadow_tracer import Bounds, Camera, PointLight, ShadowTracer, depth_camera, render_depth
from shadow_tracer.gpu.device import seats
from shadow_tracer.gpu.device.workers import Workers

_BOUNDS = Bounds(max_triangles=1000, max_rays=400_000, max_lights=2, queue_capacity=4096, grid_entries=65536)
_CAMERA = Camera(320, 240, 262.5, 262.5, 159.5, 119.5)
_DEPTH = np.full((240, 320), 3.0, np.float32)
_LIGHTS = [PointLight("lamp", (0.0, 0.0, 0.5))]
_PATIENCE = 60.0  # seconds: only a child that hangs takes so long


def _tracer(threads: int, **more: Any) -> ShadowTracer:
    tracer = ShadowTracer(device="cpu", bounds=_BOUNDS, threads=threads, **more)
    tracer.scene.put("roof", [(-1, -1, 2), (1, -1, 2), (0, 1, 2.0)], [(0, 1, 2)])
    return tracer


def _lit(tracer: ShadowTracer) -> int:
    return int((tracer.trace(_DEPTH, _CAMERA, _LIGHTS).mask() == 255).sum())


def _in_child(function: Callable[[], Any]) -> Any:
    """What ``function`` returns in a forked process."""
    context = multiprocessing.get_context("fork")
    receive, send = context.Pipe(duplex=False)
    child = context.Process(target=lambda: send.send(function()))
    child.start()
    try:
        assert receive.poll(_PATIENCE), "the child hangs"
        return receive.recv()
    finally:
        child.kill()
        child.join()


@pytest.mark.parametrize("threads", [1, 2, 4, 8])
@pytest.mark.parametrize("graphs", [False, True])
def test_a_tracer_answers_in_a_child(threads: int, graphs: bool) -> None:
    tracer = _tracer(threads, graphs=graphs)
    expected = [_lit(tracer) for _ in range(3)][0]
    assert 0 < expected < _DEPTH.size

    def child() -> list[int]:
        answers = [_lit(tracer) for _ in range(3)]
        tracer.scene.clear()
        return [*answers, _lit(tracer), tracer.verify(_DEPTH, _CAMERA, _LIGHTS)]

    assert _in_child(child) == [expected] * 3 + [_DEPTH.size, 0]
    assert _lit(tracer) == expected, "the parent's own is as it was"


@pytest.mark.parametrize("threads", [1, 2])
def test_a_fork_in_the_middle_of_a_frame(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another thread of the parent is tracing; in the child its frame never ends."""
    tracer, inside, may_end = _tracer(threads), threading.Event(), threading.Event()
    expected = _lit(tracer)

    def waits() -> None:
        inside.set()
        assert may_end.wait(2 * _PATIENCE)

    thread = threading.Thread(target=_lit, args=(tracer,))
    try:
        with monkeypatch.context() as patch:
            probe.before_launches(patch, waits)
            thread.start()
            assert inside.wait(_PATIENCE)
        assert _in_child(lambda: _lit(tracer)) == expected
    finally:
        may_end.set()
        thread.join()
    assert _lit(tracer) == expected


def test_depth_images_in_a_child() -> None:
    tracer = _tracer(1)
    expected = render_depth(tracer.scene, _CAMERA, "cpu")[0]
    with depth_camera._one_at_a_time:  # as if another thread were rendering
        found = _in_child(lambda: render_depth(tracer.scene, _CAMERA, "cpu")[0])
    assert np.array_equal(found, expected, equal_nan=True)


def test_workers_are_started_in_the_child() -> None:
    workers = Workers(3)
    workers.run([lambda: None] * 3)

    def child() -> list[str]:
        names: list[str] = []
        together = threading.Barrier(3, timeout=_PATIENCE)

        def job() -> None:
            together.wait()
            names.append(threading.current_thread().name)

        workers.run([job] * 3)
        return sorted(names)

    assert _in_child(child) == ["MainThread", "shadow_tracer", "shadow_tracer"]


def test_a_gpu_is_refused_in_a_child() -> None:
    """CUDA cannot be used in a process that was forked after its start: an error that names the cure."""
    seat = seats.Seat(SimpleNamespace(is_cpu=False, is_cuda=True, __str__=lambda: "pretended"), records=True)
    assert seat.run(lambda: 1) == 1

    def child() -> str:
        try:
            seat.run(lambda: 1)
        except RuntimeError as error:
            return str(error)
        return "no error"

    said = _in_child(child)
    assert said.startswith("device: ") and "fork" in said and "get_context('spawn')" in said
