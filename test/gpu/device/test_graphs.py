# SPDX-License-Identifier: Apache-2.0
"""Frames recorded once and replayed: the same bits as launched one by one, whatever changes between frames."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import probe
import pytest
import warp as wp

from shadow_tracer import Bounds, Camera, DirectionalLight, PointLight, ShadowTracer

_BOUNDS = Bounds(max_triangles=4000, max_rays=2500, max_lights=4, queue_capacity=4000)


# Pipelines, variants and forms that can be recorded on any device.
_PACKED, _LINEAR = ("light_grid", "packed"), ("cone_hierarchy", "linear")
_ways = probe.in_forms("way", [_PACKED], [_PACKED, _LINEAR])


def _tracer(way: tuple[str, str], device: str, graphs: bool | None) -> ShadowTracer:
    return ShadowTracer(*way, device=device, bounds=_BOUNDS, graphs=graphs)


def _camera(step: int, size: int = 40) -> Camera:
    pose = np.eye(4)
    pose[:3, 3] = 0.02 * step, -0.01 * step, 0.0
    return Camera(size, size, 0.8 * size, 0.8 * size, 0.5 * size - 0.5, 0.5 * size - 0.5, pose)


def _depth(rng: np.random.Generator, camera: Camera) -> np.ndarray:
    depth = rng.uniform(4.0, 6.0, (camera.height, camera.width)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = np.nan
    return depth


def _frames(tracer: ShadowTracer) -> list[np.ndarray]:
    """States of twelve frames in which camera, depth, lights and mesh move, stay, appear and go."""
    rng = np.random.default_rng(7)
    vertices, triangles = geometry.icosphere(3, 1.0, (0.0, 0.0, 3.0))
    tracer.scene.put("ball", vertices, triangles)
    states = []
    for step in range(12):
        camera = _camera(step)
        lights: list[Any] = [
            PointLight("lamp", (0.3 * step - 1.0, -2.0, 0.5)),
            DirectionalLight("sun", (0.1, 0.2, 1.0)),
        ]
        if step in (3, 4, 5):
            lights = lights[:1]  # another number of lights
        if step != 8:  # once with nothing changed but the depth image
            tracer.scene.deform("ball", vertices * (1.0 + 0.02 * step))
        if step == 6:
            tracer.scene.put("roof", *geometry.square(1, -1.5, 0.7, (0.0, 3.0)))
        frame = tracer.trace(_depth(rng, camera), camera, lights, bias=0.01)
        states += [frame.state(light.name) for light in lights]
    return states


@_ways
def test_replayed_frames_are_equal(way: tuple[str, str], any_device: str) -> None:
    plain, recording = _tracer(way, any_device, False), _tracer(way, any_device, True)
    expected = _frames(plain)
    got = _frames(recording)
    assert all(np.array_equal(a, b) for a, b in zip(expected, got, strict=True))
    assert any((state == 1).any() for state in expected) and any((state == 0).any() for state in expected)
    assert probe.recordings(recording) >= 2


@_ways
def test_a_replayed_frame_is_one_stage(way: tuple[str, str], any_device: str) -> None:
    tracer = _tracer(way, any_device, True)
    rng, camera = np.random.default_rng(1), _camera(0)
    tracer.scene.put("ball", *geometry.icosphere(2, 1.0, (0.0, 0.0, 3.0)))
    lamp = PointLight("lamp", (0.0, -2.0, 0.5))
    for _ in range(4):
        frame = tracer.trace(_depth(rng, camera), camera, [lamp])
    assert list(frame.stages) == ["upload", "graph", "download"]
    assert frame.counters["rays"] > 1000 and frame.counters["nodes_visited"] > 0


@probe.in_cuda_form
@pytest.mark.parametrize("pipeline", ["cone_hierarchy", "light_grid"])
def test_the_host_reads_only_what_it_has_fetched(
    pipeline: str, any_device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A frame of which everything is new, the way a GPU goes: to read an array of the device is to wait for it."""
    tracer = ShadowTracer(pipeline, device=any_device, bounds=_BOUNDS, graphs=True)
    probe.stage_uploads(tracer)
    host = probe.context(tracer).samples.host
    rng, (vertices, triangles) = np.random.default_rng(3), geometry.icosphere(2, 1.0, (0.0, 0.0, 3.0))
    lights = [PointLight("lamp", (0.0, -2.0, 0.5)), DirectionalLight("sun", (0.1, 0.2, 1.0))]
    tracer.scene.put("ball", vertices, triangles)
    read, numpy = [], wp.array.numpy
    monkeypatch.setattr(wp.array, "numpy", lambda array: read.append(array.ptr) or numpy(array))
    fetched = 0
    original = host.fetch

    def fetch(*args: Any) -> None:
        nonlocal fetched
        fetched += 1
        original(*args)

    monkeypatch.setattr(host, "fetch", fetch)
    for step in range(5):
        tracer.scene.deform("ball", vertices * (1.0 + 0.01 * step))
        camera = _camera(step)
        traced = tracer.trace(_depth(rng, camera), camera, lights)
    assert probe.recordings(tracer) == 1 and traced.counters["overflow_passes"] == 0
    assert fetched == 5
    assert read and set(read) <= probe.fetched(tracer)


@_ways
def test_recordings_do_not_outlive_the_pipeline(way: tuple[str, str], any_device: str) -> None:
    tracer = _tracer(way, any_device, True)
    rng, camera = np.random.default_rng(2), _camera(0)
    tracer.scene.put("ball", *geometry.icosphere(2, 1.0, (0.0, 0.0, 3.0)))
    lamp = PointLight("lamp", (0.0, -2.0, 0.5))
    depth = _depth(rng, camera)
    first = [tracer.trace(depth, camera, [lamp]).state("lamp") for _ in range(4)][-1]
    tracer.select("brute_force")
    assert np.array_equal(tracer.trace(depth, camera, [lamp]).state("lamp"), first)
    tracer.select(*way)
    again = [tracer.trace(depth, camera, [lamp]).state("lamp") for _ in range(4)]
    assert all(np.array_equal(state, first) for state in again)


@_ways
@pytest.mark.parametrize("capacity", [1, 3])
def test_overflow_after_a_replay(way: tuple[str, str], any_device: str, capacity: int) -> None:
    """Rays on the surfaces of a ball without a bias: many pairs for a queue of one."""
    bounds = Bounds(max_triangles=100, max_rays=64, max_lights=1, queue_capacity=capacity)
    tracer = ShadowTracer(*way, device=any_device, bounds=bounds, graphs=True)
    oracle = ShadowTracer("brute_force", device=any_device, bounds=bounds)
    vertices, triangles = geometry.icosphere(1, 1.0, (0.0, 0.0, 3.0))
    lamp = PointLight("lamp", (0.3, -2.0, 0.5))
    for step in range(4):
        points = vertices[triangles].mean(axis=1)[:64] * (1.0 + 0.01 * step)
        for each in (tracer, oracle):
            each.scene.put("ball", vertices * (1.0 + 0.01 * step), triangles)
        assert np.array_equal(tracer.occluded(points, lamp), oracle.occluded(points, lamp))


@_ways
def test_a_frame_with_a_full_queue_is_recorded(way: tuple[str, str], any_device: str) -> None:
    """The queue of one place overflows in every frame; all frames but the first two are replays of one recording, and
    none needs a further pass by the host."""
    bounds = Bounds(max_triangles=100, max_rays=64, max_lights=1, queue_capacity=1)
    tracer = ShadowTracer(*way, device=any_device, bounds=bounds, graphs=True)
    oracle = ShadowTracer("brute_force", "float64", device=any_device, bounds=bounds)
    vertices, triangles = geometry.icosphere(1, 1.0, (0.0, 0.0, 3.0))
    lamp = PointLight("lamp", (0.3, -2.0, 0.5))
    for step in range(6):
        ball = vertices * (1.0 + 0.01 * step)
        for each in (tracer, oracle):
            each.scene.put("ball", ball, triangles)
        points = ball[triangles].mean(axis=1)[:64]
        traced = probe.trace_points(tracer, points, [lamp])
        assert np.array_equal(traced.states, probe.trace_points(oracle, points, [lamp]).states)
        queues = not probe.wide(any_device)
        assert traced.counters["overflow_passes"] == int(queues)
        assert traced.counters["peak_queue"] == int(queues)
    assert probe.recordings(tracer) == 1
