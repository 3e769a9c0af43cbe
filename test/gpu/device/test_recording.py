# SPDX-License-Identifier: Apache-2.0
"""Recording of frames where something else goes on, or where it cannot be done: beside other threads, on a device that
cannot allocate meanwhile, and when an exception leaves a recording open."""

from __future__ import annotations

import logging
import sys
import threading
from types import SimpleNamespace
from typing import Any

import geometry
import numpy as np
import probe
import pytest
import warp as wp
from interrupts import Ring

from shadow_tracer import Bounds, Camera, PointLight, ShadowTracer, SphereLight, render_depth
from shadow_tracer.gpu.device import graphs
from shadow_tracer.gpu.engine import band, frame
from shadow_tracer.scene.mesh import Scene

_BOUNDS = Bounds(max_triangles=5000, max_rays=5000, max_lights=2, queue_capacity=10_000, grid_entries=100_000)
_DEPTH = np.full((64, 64), 6.0, np.float32)
_CAMERA = Camera(64, 64, 60.0, 60.0, 31.5, 31.5, geometry.pose_of(np.eye(3), (0.0, 0.0, -5.0)))
_recordable = probe.in_forms("names", ["light_grid/packed"], ["light_grid/packed", "cone_hierarchy/linear"])


def _mesh() -> geometry.Geometry:
    return geometry.soup(np.random.default_rng(0), 1500, 0.1, 1.5)


def _tracer(names: str, device: str, recorded: bool | None = True) -> ShadowTracer:
    return ShadowTracer(*names.split("/"), device=device, bounds=_BOUNDS, graphs=recorded, threads=1)


def _frame(tracer: ShadowTracer, step: int) -> bytes:
    """Frames of two kinds, each of which comes often enough to be recorded; mesh and lights move."""
    vertices, triangles = _mesh()
    tracer.scene.put("mesh", vertices + 0.01 * step, triangles[: 1500 - step % 2])
    lights = [PointLight("lamp", (0.1 * step, 0.3, -4.0)), PointLight("other", (0.0, -0.1 * step, -3.0))]
    frame = tracer.trace(_DEPTH, _CAMERA, lights, bias=0.01)
    return np.stack([frame.state(light.name) for light in lights]).tobytes()


def _expected(device: str, steps: int) -> list[bytes]:
    tracer = _tracer("mesh_bvh/refit", device, False)
    return [_frame(tracer, step) for step in range(steps)]


@_recordable
def test_a_recording_that_fails_is_replaced_by_launches(
    names: str, any_device: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """As on a GPU without memory pools, where a scan allocates: right frames, said once."""
    tracer, failures = _tracer(names, any_device), [0]
    trace = band.Band.trace

    def fails_while_recorded(this: Any, work: Any) -> None:
        trace(this, work)
        if _recording(any_device):
            failures[0] += 1
            raise RuntimeError("no memory to be had while recording")

    monkeypatch.setattr(band.Band, "trace", fails_while_recorded)
    with caplog.at_level(logging.WARNING):
        assert [_frame(tracer, step) for step in range(8)] == _expected(any_device, 8)
    assert failures[0] == 2 and probe.recordings(tracer) == 0, "one attempt for each kind of frame"
    (said,) = [record.getMessage() for record in caplog.records]
    assert said.startswith(f"{any_device}: ") and "no memory to be had while recording" in said


def _recording(device: str) -> bool:
    runtime: Any = wp._src.context.runtime
    return bool(runtime._apic_graph is not None or wp.get_device(device).is_capturing)


@_recordable
def test_an_exception_while_a_frame_is_recorded(names: str, any_device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The recording does not stay open: what is launched afterwards is executed."""
    tracer = _tracer(names, any_device)
    expected = _expected(any_device, 8)
    assert [_frame(tracer, step) for step in range(2)] == expected[:2]
    trace = band.Band.trace

    def interrupted(this: Any, work: Any) -> None:
        trace(this, work)
        raise Ring

    with monkeypatch.context() as patch:
        patch.setattr(band.Band, "trace", interrupted)
        patch.setattr(wp.ScopedCapture, "__exit__", lambda *_: None)  # between the end of one step and the next
        with pytest.raises(Ring):
            _frame(tracer, 2)
        assert _recording(any_device)
    assert [_frame(tracer, step) for step in range(2, 8)] == expected[2:]
    assert not _recording(any_device) and probe.recordings(tracer) == 2


@pytest.mark.slow
@probe.in_cuda_form
def test_recording_beside_another_thread(any_device: str) -> None:
    """A tracer that records a new kind of frame all the time, depth images and another tracer in two other threads,
    threads changed as often as Python can."""
    expected = _expected(any_device, 4)
    scene = Scene(_BOUNDS)
    scene.put("mesh", *_mesh())
    image = render_depth(scene, _CAMERA, any_device)[0]
    over, wrong = threading.Event(), []

    def render() -> None:
        while not over.is_set():
            scene.deform("mesh", _mesh()[0])
            if not np.array_equal(render_depth(scene, _CAMERA, any_device)[0], image, equal_nan=True):
                wrong.append("image")

    def trace() -> None:
        while not over.is_set():
            other = _tracer("light_grid/packed", any_device, False)  # allocates, too
            if [_frame(other, step) for step in range(4)] != expected:
                wrong.append("frame of the other tracer")

    def watched(work: Any) -> None:
        try:
            work()
        except Exception as error:
            wrong.append(repr(error))

    threads = [threading.Thread(target=watched, args=(work,)) for work in (render, trace)]
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        for thread in threads:
            thread.start()
        for _ in range(12):
            tracer = _tracer("light_grid/packed", any_device)
            assert [_frame(tracer, step) for _ in range(3) for step in range(4)] == 3 * expected
            assert probe.recordings(tracer) == 2 and not wrong
    finally:
        over.set()
        for thread in threads:
            thread.join()
        sys.setswitchinterval(interval)
    assert wrong == []


def test_kernels_are_loaded_while_nobody_else_is_at_work(any_device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two threads that load the same kernels at once lose them: the first frame of a kind is alone on the device."""
    tracers = [_tracer("light_grid/packed", any_device, False) for _ in range(3)]
    expected = _expected(any_device, 1)[0]
    loaded = probe.loaded(tracers[0])
    loaded.clear()  # as if nobody had launched anything: whoever needs it loads it, and finds it there
    inside: list[int] = []
    entered, alone = threading.Event(), []
    trace = frame.FrameTracer.trace_depth

    def watched(this: Any, *arguments: Any) -> Any:
        inside.append(1)
        if len(inside) > 1:
            entered.set()
        if not loaded:  # nobody may come in while these are loaded, however long that takes
            alone.append(not entered.wait(0.5))
        try:
            return trace(this, *arguments)
        finally:
            inside.pop()

    monkeypatch.setattr(frame.FrameTracer, "trace_depth", watched)
    answers: list[bytes] = []
    threads = [threading.Thread(target=lambda each=each: answers.append(_frame(each, 0))) for each in tracers]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert answers == 3 * [expected] and alone == [True] and loaded


def test_devices_without_memory_pools_are_not_recorded() -> None:
    for supported, enabled in ((False, False), (True, False), (True, True)):
        device = SimpleNamespace(is_cpu=False, is_mempool_supported=supported, is_mempool_enabled=enabled)
        assert graphs.can_record(device) == enabled
    assert graphs.can_record(wp.get_device("cpu"))


@pytest.mark.parametrize("names", ["mesh_bvh/refit", "light_grid/packed"])
def test_kernels_for_sphere_lights_are_loaded_alone_and_by_warm_up(any_device: str, names: str) -> None:
    """A first sphere light may need more than all frames before it: then that frame is alone on the device, too."""
    tracer = _tracer(names, any_device, False)
    tracer.scene.put("wall", *geometry.square(2, 2.0, 1.0))
    loaded = probe.loaded(tracer)
    points, sphere = np.array([[0.0, 0.0, 4.0]]), SphereLight("bulb", (0.2, 0.0, 0.1), 0.1, samples=3)
    loaded.clear()
    tracer.states_at(points, [PointLight("lamp", (0.0, 0.0, 0.1))])
    before = set(loaded)
    assert all(kinds[1] != "points of lights" for kinds in before)
    tracer.states_at(points, [sphere])
    # Where bundles of points cost more, the grid traces them.
    apart = {(("light_grid", "packed"), None, True)} if names == "mesh_bvh/refit" else set()
    assert loaded - before == {(tuple(names.split("/")), "points of lights", True)} | apart
    loaded.clear()
    tracer.warm_up()
    after = set(loaded)
    tracer.states_at(points, [sphere])
    assert loaded == after and (tuple(names.split("/")), "points of lights", True) in after
