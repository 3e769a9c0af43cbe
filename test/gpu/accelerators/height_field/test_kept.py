# SPDX-License-Identifier: Apache-2.0
"""What height fields keep from frame to frame, charts and the sweep of a sun: whatever comes in between (other suns,
other samples, meshes that a sun ignores, culling, a second tracer, an exception), answers are those of brute_force."""

from __future__ import annotations

from typing import Any

import numpy as np
import probe
import pytest
import surfaces
from interrupts import Ring, Steps
from surfaces import sun

from shadow_tracer import DirectionalLight, HeightField, PointLight, Scene
from shadow_tracer.gpu.engine import bands
from shadow_tracer.gpu.engine import frame as frame_tracer

_ROCK = np.array([(5.0, -5.0, 4.0), (9.0, -5.0, 4.0), (7.0, -9.0, 5.0)])
_FIELDS = [HeightField(surfaces.terrain(np.random.default_rng(seed), 24, 24), 1.0) for seed in range(3)]


@pytest.fixture(autouse=True)
def _small_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (bands, frame_tracer):
        monkeypatch.setattr(module, "LEAST", 64)


def _build(scene: Scene) -> None:
    scene.put_surface("ground", _FIELDS[0])
    scene.put_surface("hill", HeightField(3.0 + surfaces.terrain(np.random.default_rng(5), 12, 12), 1.0, (9, -9, 0)))
    scene.put("rock", _ROCK, [(0, 1, 2)])


def _points(rng: np.random.Generator, count: int) -> np.ndarray:
    ground = _FIELDS[0].positions().reshape(-1, 3)
    near = ground[rng.integers(0, len(ground), count)] + rng.choice([0.0, 0.3, 2.0], (count, 1)) * (0, 0, 1)
    return np.concatenate([near, rng.uniform((-2, -26, -3), (26, 2, 6), (count, 3))])


@pytest.mark.parametrize("threads", [1, 3])
@probe.in_both_forms
def test_frames_in_any_order_by_two_tracers_with_two_sets_of_samples(any_device: str, threads: int) -> None:
    rng = np.random.default_rng(threads)
    ours = [surfaces.tracer(any_device, "height_field", threads=threads, max_sample_sets=2) for _ in range(2)]
    theirs, swept = surfaces.tracer(any_device, "brute_force"), []
    for tracer in (*ours, theirs):
        _build(tracer.scene)
    morning, evening = sun(6.0, 100.0).direction, sun(11.0, 255.0).direction
    lights: list[Any] = [
        DirectionalLight("morning", morning),
        DirectionalLight("evening", evening),
        DirectionalLight("without rock", morning, ignore=["rock"]),
        DirectionalLight("without ground", morning, ignore=["ground"]),
        PointLight("lamp", (8.0, -8.0, 9.0)),
    ]
    for _ in range(40):
        field, what = _FIELDS[rng.integers(0, 3)], rng.integers(0, 12)
        pose = np.eye(4)
        pose[0, 3] = rng.choice([0.0, 2.5])
        for tracer in (*ours, theirs):
            if what == 0:
                tracer.scene.deform_surface("ground", field)
            elif what == 1:
                tracer.scene.move("ground", pose)
            elif what == 2:
                tracer.scene.put("rock", _ROCK + pose[0, 3], [(0, 1, 2)])
            elif what == 3:
                tracer.scene.put_surface("ground", field, pose=pose)
            tracer.front_face_culling = what == 4
        chosen = [lights[k] for k in rng.permutation(len(lights))[: rng.integers(1, 4)]]
        points, samples = _points(rng, int(rng.choice([12, 300, 300]))), str(rng.choice(["", "b"]))
        tracer = ours[rng.integers(0, 2)]
        found = probe.trace_points(tracer, points, chosen, samples=samples)
        expected = probe.trace_points(theirs, points, chosen)
        assert np.array_equal(found.states, expected.states)
        for name in ("triangles", "degenerate", "culled"):
            assert found.counters[name] == expected.counters[name], name
        swept.append(probe.charts(tracer)[1] >= 0)
    assert 3 < sum(swept) < 37


@probe.in_both_forms
def test_what_is_damaged_is_made_once_more(any_device: str) -> None:
    """``verify`` promises it: after a difference nothing is used that was kept."""
    tracer, light = surfaces.tracer(any_device, "height_field"), sun(6.0, 100.0)
    _build(tracer.scene)
    points = _points(np.random.default_rng(1), 300)
    right = probe.trace_points(tracer, points, [light]).states
    probe.spoil_charts(tracer)
    assert not np.array_equal(probe.trace_points(tracer, points, [light]).states, right), "it was kept, and is used"
    probe.forget(tracer, "")
    assert np.array_equal(probe.trace_points(tracer, points, [light]).states, right)


@pytest.mark.parametrize("threads", [1, 16])
def test_many_threads_sweep_what_one_does(any_device: str, threads: int) -> None:
    """A sweep is worth what all bands of the samples ask together."""
    field = HeightField(surfaces.terrain(np.random.default_rng(3), 64, 64), 1.0)
    tracer = surfaces.tracer(any_device, "height_field", threads=threads)
    tracer.scene.put_surface("ground", field)
    tracer.states_at(field.positions().reshape(-1, 3) + (0.0, 0.0, 0.2), [sun(10.0, 123.0)])
    assert probe.charts(tracer)[1] == 0


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 2])
@probe.in_both_forms
def test_an_exception_at_any_step(any_device: str, threads: int) -> None:
    """Charts outlive what is thrown away then, as another set of samples has them too."""
    tracer = surfaces.tracer(any_device, "height_field", threads=threads, max_sample_sets=2)
    theirs, steps = surfaces.tracer(any_device, "brute_force"), Steps()
    for each in (tracer, theirs):
        _build(each.scene)
    points = _points(np.random.default_rng(2), 300)
    lights = [sun(6.0, 100.0), DirectionalLight("late", sun(11.0, 255.0).direction, ignore=["rock"])]

    def ask(samples: str = "") -> np.ndarray:
        return np.array(probe.trace_points(tracer, points, lights, samples=samples).states)

    right, raised = np.array(probe.trace_points(theirs, points, lights).states), 0
    assert np.array_equal(ask(), right) and np.array_equal(ask("b"), right)
    tracer.scene.put_surface("ground", _FIELDS[1])
    total = steps.count(ask)
    for number, at in enumerate(np.random.default_rng(7).integers(1, total, 25)):
        tracer.scene.put_surface("ground", _FIELDS[1 + number % 2])
        try:
            steps.run(ask, int(at))
        except Ring:
            raised += 1
        tracer.scene.put_surface("ground", _FIELDS[0])
        assert np.array_equal(ask("b"), right) and np.array_equal(ask(), right), at
    assert raised > 15
