# SPDX-License-Identifier: Apache-2.0
"""Bands of the rays at their edges: without pixels, without a scene, and what they say about themselves."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

import geometry
import numpy as np
import probe
import probe_accelerators
import pytest

from shadow_tracer import Bias, Bounds, Camera, PointLight, ShadowTracer, State
from shadow_tracer.gpu.device import sort
from shadow_tracer.gpu.device.workers import Workers
from shadow_tracer.gpu.engine import band
from shadow_tracer.gpu.engine.bands import image_bands

_SIDE_BY_SIDE = ["light_grid/packed", "cone_hierarchy/linear", "brute_force/filtered", "mesh_bvh/refit"]
_BOUNDS = Bounds(max_triangles=2000, max_rays=131072, max_lights=2, queue_capacity=4096, grid_entries=8192)
_CAMERA = Camera(256, 128, 128.0, 128.0, 127.5, 63.5)
_LIGHTS = [PointLight("left", (-0.5, 0.0, 0.0)), PointLight("right", (0.5, 0.1, 0.0))]


def _tracer(names: str, threads: int = 2, bounds: Bounds = _BOUNDS) -> ShadowTracer:
    return ShadowTracer(*names.split("/"), device="cpu", bounds=bounds, threads=threads)


def _with_a_ball(tracer: ShadowTracer) -> ShadowTracer:
    tracer.scene.put("ball", *geometry.icosphere(1, 0.7, (0.0, 0.0, 2.0)))
    return tracer


def _states(tracer: ShadowTracer, depth: np.ndarray, camera: Camera = _CAMERA) -> np.ndarray:
    frame = tracer.trace(depth, camera, _LIGHTS)
    return np.stack([frame.state(light.name) for light in _LIGHTS])


def _depth() -> np.ndarray:
    return np.full((128, 256), 3.0, np.float32)


def _in_time(function: Any, *arguments: Any) -> Any:
    """What the function returns; if it hangs, this fails and does not."""
    found: list[Any] = []
    thread = threading.Thread(target=lambda: found.append(function(*arguments)), daemon=True)
    thread.start()
    thread.join(60.0)
    assert found, "it hangs, or has raised"
    return found[0]


def _passes(names: str) -> int:
    """Lights together or one by one."""
    return 1 if names.startswith("light_grid") else len(_LIGHTS)


@pytest.mark.parametrize("names", _SIDE_BY_SIDE)
@pytest.mark.parametrize("case", ["a row", "top rows"])
def test_bands_without_pixels_have_nothing_to_do(names: str, case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """All pixels of an image of one row belong to one band; and a few rows with measurements to a few."""
    if case == "a row":
        camera, threads = Camera(40000, 1, 2e4, 2e4, 2e4, 0.0), 2
        depth = np.full((1, 40000), 3.0, np.float32)
    else:
        camera, threads = Camera(640, 480, 320.0, 320.0, 319.5, 2.0), 16
        depth = np.zeros((480, 640), np.float32)
        depth[:5] = 3.0
    bounds = replace(_BOUNDS, max_rays=2 * depth.size)
    cuts, _ = image_bands(depth, np.arange(1, threads) / threads, bounds.max_rays // threads)
    assert any(first == end for first, end in cuts) and sum(end - first for first, end in cuts) == depth.size
    one, two = (_with_a_ball(_tracer(names, n, bounds)) for n in (1, threads))
    counts: list[int] = []
    project = band.Band.project
    monkeypatch.setattr(
        band.Band, "project", lambda this, *rest: counts.append(this.samples.count) or project(this, *rest)
    )
    points = np.linspace((-1.0, -1.0, 3.0), (1.0, 1.0, 3.0), 16384 * threads)
    for _ in range(2):
        found = _in_time(_states, two, depth, camera)
        assert np.array_equal(found, _states(one, depth, camera))
        assert (found == State.SHADOWED).any() and found.shape[1:] == depth.shape
        # And the bands that had nothing to do take part again.
        assert np.array_equal(_in_time(two.occluded, points, _LIGHTS[0]), one.occluded(points, _LIGHTS[0]))
    assert min(counts) > 0


def test_a_tree_of_no_rays_is_built() -> None:
    tracer = _with_a_ball(_tracer("cone_hierarchy/linear", 1))
    small = Camera(8, 8, 8.0, 8.0, 3.5, 3.5)
    _states(tracer, np.full((8, 8), 3.0, np.float32), small)
    probe.context(tracer).samples.set_samples(0, 8, 0)
    _in_time(probe_accelerators.build_again, tracer, 0)
    assert probe_accelerators.levels(tracer) == 1


class _Ways:
    """How the bands of each launch were run: side by side, by threads, or one after the other."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.by_threads = 0
        run = Workers.run

        def counted(this: Workers, jobs: Any) -> None:
            self.by_threads += len(jobs)
            run(this, jobs)

        monkeypatch.setattr(Workers, "run", counted)


@pytest.mark.wide
@pytest.mark.parametrize("names", _SIDE_BY_SIDE)
def test_kernels_are_loaded_in_one_thread(names: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first frame of its kind in one thread, be the scene empty or not; those that follow in several."""
    tracer, ways = _tracer(names), _Ways(monkeypatch)

    def by_threads(bias: Bias | None = None, nearer: float = 0.0) -> bool:
        ways.by_threads = 0
        tracer.trace(_depth() - np.float32(nearer), _CAMERA, _LIGHTS, bias)
        assert ways.by_threads in (0, 2 * _passes(names))
        return ways.by_threads > 0

    assert [by_threads() for _ in range(3)] == [False, True, True], "an empty scene"
    _with_a_ball(tracer)
    assert [by_threads() for _ in range(3)] == [False, True, True], "a scene"
    by_threads(nearer=0.1)  # samples are made of it
    assert [by_threads(Bias(normal=1.0)) for _ in range(3)] == [False, True, True], "samples moved along normals"
    tracer.scene.clear()
    assert by_threads(), "an empty scene has been there before"


@pytest.mark.wide
@pytest.mark.parametrize("names", _SIDE_BY_SIDE)
def test_a_warm_up_loads_what_threads_need(names: str, monkeypatch: pytest.MonkeyPatch) -> None:
    tracer = _with_a_ball(_tracer(names))
    tracer.warm_up()
    ways = _Ways(monkeypatch)
    for depth in (_depth(), (1000.0 * _depth()).astype(np.uint16)):
        for bias in (Bias(), Bias(normal=1.0)):
            tracer.trace(depth, _CAMERA, _LIGHTS, bias)
    assert ways.by_threads == 2 * 4 * _passes(names)


@pytest.mark.wide
@pytest.mark.parametrize("count", [0, 1])
def test_a_first_frame_loads_the_sorting_kernel_whatever_it_holds(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else the second frame, whose bands work side by side, would load it in several threads at once."""
    launched: list[str] = []
    launch = sort.wp.launch

    def noted(kernel: Any, *arguments: Any, **named: Any) -> Any:
        launched.append(kernel.key)
        return launch(kernel, *arguments, **named)

    depth = np.zeros((128, 256), np.float32)
    depth.reshape(-1)[20000 : 20000 + count] = 3.0
    tracer = _with_a_ball(_tracer("cone_hierarchy/linear"))
    with monkeypatch.context() as patch:
        patch.setattr(sort.wp, "launch", noted)
        _states(tracer, depth)
    assert "sort_pairs_cpu" in launched


@pytest.mark.wide
def test_a_stage_that_one_share_does_for_all_is_not_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of bands side by side those of the slowest, and of what only others did."""
    tracer = _with_a_ball(_tracer("brute_force"))
    _states(tracer, _depth())
    first, second = (one.stages for one in probe.bands(tracer))
    monkeypatch.setattr(first, "read", lambda: {"setup": 3.0, "project": 1.0, "trace": 2.0})
    monkeypatch.setattr(second, "read", lambda: {"unproject": 1.0, "project": 4.0, "trace": 8.0})
    stages = tracer.trace(_depth(), _CAMERA, _LIGHTS).stages
    assert {name: stages[name] for name in ("setup", "unproject", "project", "trace")} == {
        "setup": 3.0,
        "unproject": 1.0,
        "project": 4.0,
        "trace": 8.0,
    }
    assert list(stages)[0] == "upload" and list(stages)[-1] == "download"


@probe.in_cuda_form  # the other makes no records of triangles that concern no ray
def test_counters_are_those_of_the_last_light_even_after_further_passes() -> None:
    """One place for records: the further pass of the first light makes its records there again. The last light reaches
    no sample, and so needs none."""
    vertices, triangles = geometry.icosphere(1, 0.7, (0.0, 0.0, 2.0))
    counters = []
    for entries in (8192, 1):
        bounds = replace(_BOUNDS, max_triangles=len(triangles) + 10, grid_entries=entries)
        tracer = ShadowTracer("light_grid", device="cpu", bounds=bounds, threads=1, front_face_culling=True)
        tracer.scene.put("ball", vertices, triangles)
        lights = [PointLight("inside", (0.0, 0.0, 2.0)), PointLight("last", (0.0, 3.0, 2.0), range=0.01)]
        # Samples on corners: none of them is decided by the filter.
        traced = probe.trace_points(tracer, np.asarray(vertices, float), lights)
        counters.append(traced.counters)
    assert counters[0]["overflow_passes"] == 0 < counters[1]["overflow_passes"]
    assert counters[0]["culled"] == counters[1]["culled"] > 0
    assert counters[0]["degenerate"] == counters[1]["degenerate"]
