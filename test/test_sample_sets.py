# SPDX-License-Identifier: Apache-2.0
"""Sets of samples: cameras in turn on one tracer keep what can be used again, each its own, over one scene."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import probe
import pytest
from interrupts import Ring, Steps

from shadow_tracer import Bounds, BoundsError, Camera, DirectionalLight, PointLight, ShadowTracer, SphereLight

_BOUNDS = {"max_triangles": 2000, "max_rays": 40_000, "max_lights": 3, "queue_capacity": 1000, "grid_entries": 50_000}
_CAMERAS = {
    "left": Camera(200, 160, 150.0, 150.0, 99.5, 79.5),
    "right": Camera(90, 120, 100.0, 90.0, 44.5, 59.5, geometry.pose_of(np.eye(3), (0.7, 0.1, -2.0))),
}
_LIGHTS: list[Any] = [
    PointLight("lamp", (0.2, -0.9, 0.3)),
    DirectionalLight("sun", (0.2, 0.3, 0.9)),
    SphereLight("bulb", (-0.5, 0.2, 0.4), 0.1, samples=5),
]


def _depth(name: str, seed: int = 1) -> np.ndarray:
    camera, rng = _CAMERAS[name], np.random.default_rng(seed)
    depth = np.full((camera.height, camera.width), 4.0 if name == "left" else 60.0, np.float32)
    depth[::9] += rng.uniform(0.0, 0.5, depth[::9].shape).astype(np.float32)
    depth[: camera.height // 3] = np.nan if name == "left" else 30.0
    return depth


def _tracer(pipeline: str = "light_grid", device: str = "cpu", sets: int = 2, **more: Any) -> ShadowTracer:
    tracer = ShadowTracer(pipeline, device=device, bounds=Bounds(**_BOUNDS, max_sample_sets=sets), **more)
    tracer.scene.put("ball", *geometry.icosphere(2, 0.6, (0.0, 0.0, 2.0)))
    return tracer


def _states(frame: Any) -> np.ndarray:
    return np.stack([frame.state(light.name) for light in _LIGHTS])


@pytest.mark.slow
def test_cameras_in_turn_give_what_each_gives_alone(tracer_case: tuple[str, str, str]) -> None:
    """Frames of two cameras and points in turn, while the scene, the lights and the images change or rest."""
    device, pipeline, variant = tracer_case
    bounds = Bounds(**_BOUNDS, max_sample_sets=3)
    tracer = ShadowTracer(pipeline, variant, device, bounds, threads=2)
    alone = ShadowTracer("brute_force", device=device, bounds=Bounds(**_BOUNDS), threads=1)
    points = np.random.default_rng(4).uniform(-2, 4, (500, 3))
    for step in range(6):
        ball = geometry.icosphere(2, 0.6, (0.1 * (step // 2), 0.0, 2.0))
        for each in (tracer, alone):
            each.scene.put("ball", *ball)
            if step == 3:
                each.scene.put("marker", *geometry.square(2, 1.0, 0.2))
            elif step == 4:
                each.scene.remove("marker")
        if step == 5:
            # More revisions of the scene than are remembered, which one set alone sees.
            for number in range(70):
                tracer.scene.put("marker", *geometry.square(2, 1.0 + 0.01 * number, 0.2))
                tracer.occluded(points[:1], _LIGHTS[0], samples="points")
            alone.scene.put("marker", *geometry.square(2, 1.0 + 0.01 * number, 0.2))
        for name, camera in _CAMERAS.items():
            if name == "right" and step in (3, 4):
                continue  # this set misses what comes and goes meanwhile
            depth = _depth(name, step // 3)
            frame = tracer.trace(depth, camera, _LIGHTS, 0.01, samples=name)
            assert np.array_equal(_states(frame), _states(alone.trace(depth, camera, _LIGHTS, 0.01))), (step, name)
        states = tracer.states_at(points, _LIGHTS, samples="points")
        assert np.array_equal(states, alone.states_at(points, _LIGHTS)), step
    assert tracer.sample_sets == ("left", "right", "points")
    assert tracer.verify(depth, camera, _LIGHTS, 0.01, samples="right") == 0


@pytest.mark.wide
def test_each_set_keeps_its_rays_cuts_and_anchor() -> None:
    """Images and lights rest, a mesh moves: nothing is made of the images again, though the cameras take turns."""
    tracer = _tracer(threads=2)
    lights = _LIGHTS[:1]  # of several in a pass each, the last one alone is kept
    for _ in range(8):  # until the cuts rest
        for name, camera in _CAMERAS.items():
            tracer.trace(_depth(name), camera, lights, samples=name)
    before = {name: probe.kept(tracer, name) for name in _CAMERAS}
    assert before["left"][0] != before["right"][0]
    for step in range(3):
        tracer.scene.put("ball", *geometry.icosphere(2, 0.6, (0.05 * step, 0.0, 2.0)))
        for name, camera in _CAMERAS.items():
            frame = tracer.trace(_depth(name), camera, lights, samples=name)
            assert not {"unproject", "project"} & set(frame.stages), frame.stages
    assert {name: probe.kept(tracer, name) for name in _CAMERAS} == before
    # With one set both images are unprojected in every frame.
    one = _tracer(sets=1, threads=2)
    for _ in range(2):
        for name, camera in _CAMERAS.items():
            assert {"unproject", "project"} <= set(one.trace(_depth(name), camera, lights).stages)


def test_the_scene_stands_once(any_device: str) -> None:
    one, three = _tracer(device=any_device, sets=1), _tracer(device=any_device, sets=3)
    scene = probe.scene_bytes(one)
    assert three.device_bytes == scene + 3 * (one.device_bytes - scene)
    assert scene > 2000 * (24 + 12)


@pytest.mark.parametrize("pipeline", ["mesh_bvh", "uniform_grid", "hierarchical_grid"])
def test_what_rays_walk_through_is_built_once(pipeline: str, any_device: str) -> None:
    """By the first that asks after a change, for all sets; and again when a set is to forget."""
    tracer, alone = _tracer(pipeline, any_device), _tracer("brute_force", any_device, sets=1)

    def built(name: str) -> bool:
        frame = tracer.trace(_depth(name), _CAMERAS[name], _LIGHTS, samples=name)
        assert np.array_equal(_states(frame), _states(alone.trace(_depth(name), _CAMERAS[name], _LIGHTS)))
        return "build" in frame.stages

    for step in range(3):
        for each in (tracer, alone):
            each.scene.put("ball", *geometry.icosphere(2, 0.6, (0.1 * step, 0.0, 2.0)))
        assert [built(name) for name in ("left", "right", "left")] == [True, False, False]
    probe.forget(tracer, "right")
    assert [built("left"), built("right")] == [True, False]


def test_each_set_judges_a_refitted_tree_by_its_own_frames(monkeypatch: pytest.MonkeyPatch, any_device: str) -> None:
    """One camera's rays meet many triangles, the other's none: that wears no tree out."""
    tracer = _tracer("mesh_bvh", any_device)
    vertices, triangles = geometry.soup(np.random.default_rng(3), 1900, 0.02, 1.5)
    vertices = vertices + (0.0, 0.0, 2.0)
    tracer.scene.put("ball", vertices, triangles)
    away = Camera(90, 120, 100.0, 90.0, 44.5, 59.5, geometry.pose_of(np.eye(3), (50.0, 0.0, 0.0)))
    tests = {"left": 0.0, "away": 0.0}
    rebuilt = probe.tree_builds(tracer, monkeypatch)
    for step in range(6):
        tracer.scene.deform("ball", vertices + (0.001 * step, 0.0, 0.0))
        for name, camera in {"away": away, "left": _CAMERAS["left"]}.items():
            counters = tracer.trace(np.full((camera.height, camera.width), 4.0, np.float32), camera, _LIGHTS[:1],
                                    samples=name).counters  # fmt: skip
            tests[name] = counters["leaf_tests"] / counters["rays"]
    assert tests["left"] > 2.0 * max(1.0, tests["away"])
    assert rebuilt == [True, False, False, False, False, False]


def test_one_set_too_many_is_refused(any_device: str) -> None:
    tracer, camera = _tracer(device=any_device), _CAMERAS["left"]
    tracer.warm_up()  # which needs no set
    expected = {name: _states(tracer.trace(_depth(name), _CAMERAS[name], _LIGHTS, samples=name)) for name in _CAMERAS}
    points = np.zeros((1, 3))
    for act in (
        lambda: tracer.trace(_depth("left"), camera, _LIGHTS, samples="third"),
        lambda: tracer.trace(_depth("left"), camera, _LIGHTS),
        lambda: tracer.verify(_depth("left"), camera, _LIGHTS, samples="third"),
        lambda: tracer.states_at(points, _LIGHTS, samples="third"),
        lambda: tracer.occluded(points, _LIGHTS[0], samples="third"),
    ):
        before = tracer.device_bytes
        with pytest.raises(BoundsError, match=r"^bounds\.max_sample_sets: .* 'left', 'right', but the bound is 2"):
            act()
        assert tracer.device_bytes == before, "nothing was allocated for what was refused"
    with pytest.raises(ValueError, match="^samples: expected a string, got 7"):
        tracer.trace(_depth("left"), camera, _LIGHTS, samples=7)  # type: ignore[arg-type]
    assert tracer.sample_sets == ("left", "right")
    for name in _CAMERAS:
        frame = tracer.trace(_depth(name), _CAMERAS[name], _LIGHTS, samples=name)
        assert np.array_equal(_states(frame), expected[name])
    tracer.release_samples("right")
    tracer.release_samples("nobody")
    frame = tracer.trace(_depth("left"), camera, _LIGHTS, samples="third")
    assert np.array_equal(_states(frame), expected["left"]) and tracer.sample_sets == ("left", "third")


@pytest.mark.slow
@pytest.mark.parametrize("pipeline", ["light_grid", "mesh_bvh", "auto"])
def test_an_interrupt_in_one_set_leaves_the_others_right(pipeline: str) -> None:
    """At steps of a frame of either camera, while the scene changes; sphere lights among the lights."""
    tracer, alone, steps = _tracer(pipeline, threads=2), _tracer("brute_force", sets=1, threads=1), Steps()
    names = list(_CAMERAS)

    def trace(name: str, seed: int) -> np.ndarray:
        return _states(tracer.trace(_depth(name, seed), _CAMERAS[name], _LIGHTS, 0.01, samples=name))

    for name in names:
        trace(name, 0)
    total = steps.count(lambda: trace("left", 1))
    assert total > 300
    for number, at in enumerate(np.random.default_rng(9).integers(1, total, 12)):
        ball = geometry.icosphere(2, 0.6, (0.05 * number, 0.0, 2.0))
        for each in (tracer, alone):
            each.scene.put("ball", *ball)
        try:
            steps.run(lambda name=names[number % 2], seed=number: trace(name, seed), int(at))
        except Ring:
            pass
        for name in reversed(names):
            expected = _states(alone.trace(_depth(name, number), _CAMERAS[name], _LIGHTS, 0.01))
            assert np.array_equal(trace(name, number), expected), (number, at, name)
        assert tracer.sample_sets == ("left", "right")


def test_all_sets_follow_what_is_set_between_frames(any_device: str) -> None:
    """Pipeline, culling, and a frame that failed in one of them."""
    tracer = _tracer(device=any_device)
    frames: dict[str, list[np.ndarray]] = {name: [] for name in _CAMERAS}

    def trace() -> None:
        for name, camera in _CAMERAS.items():
            frames[name].append(_states(tracer.trace(_depth(name), camera, _LIGHTS, samples=name)))

    trace()
    tracer.select("mesh_bvh")
    trace()
    with pytest.raises(ZeroDivisionError):
        probe.fail_in_a_frame(tracer)
    trace()
    tracer.front_face_culling = True
    trace()
    tracer.select("light_grid")
    trace()
    for name in _CAMERAS:
        assert all(np.array_equal(frame, frames[name][0]) for frame in frames[name][:3])
        assert np.array_equal(*frames[name][3:])
        assert tracer.verify(_depth(name), _CAMERAS[name], _LIGHTS, samples=name) == 0
