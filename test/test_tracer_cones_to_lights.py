# SPDX-License-Identifier: Apache-2.0
"""Cones to lights, by any number of threads, and what a warm-up loads for them."""

from __future__ import annotations

import threading
from typing import Any

import cones
import geometry
import numpy as np
import probe
import pytest
import warp as wp

from shadow_tracer import Bounds, DirectionalLight, Outcome, PointLight, ShadowTracer, SphereLight, SunDisc
from shadow_tracer.gpu.accelerators import cones as device_cones
from shadow_tracer.gpu.accelerators.bvh.bvh import Bvh
from shadow_tracer.gpu.accelerators.kd_tree.kd_tree import KdTree

_FREE, _PARTLY, _BLOCKED = Outcome.FREE, Outcome.PARTLY, Outcome.BLOCKED
_BOUNDS = {"max_triangles": 2000, "max_rays": 1 << 14, "max_lights": 2, "queue_capacity": 2000, "grid_entries": 10_000}


def _tracer(device: str, threads: int = 1, pipeline: str = "bvh") -> ShadowTracer:
    tracer = ShadowTracer(pipeline, device=device, bounds=Bounds(**_BOUNDS), threads=threads)
    tracer.scene.put("ball", *geometry.icosphere(2, 0.7))
    tracer.scene.put("soup", *geometry.soup(np.random.default_rng(600), 60, 0.5, 1.5))
    return tracer


@pytest.mark.wide
def test_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """More cones and fewer, more than a piece holds, over a scene that moves, is empty, and is there again."""
    monkeypatch.setattr(device_cones, "SOME", 16)
    rng, tracers = np.random.default_rng(601), [_tracer("cpu", threads) for threads in (1, 2, 3, 7)]
    assert [tracer.threads for tracer in tracers] == [1] * 4  # cones are not cut as images are
    for step, count in enumerate((200, 1, 1000, 17, 300, 16, 333)):
        apices, (ends, share) = rng.uniform(-2, 2, (count, 3)), cones.some(rng, count, -2, 2)
        found = []
        for tracer in tracers:
            if step == 3:
                tracer.scene.clear()
            elif step == 4:
                tracer.scene.put("ball", *geometry.icosphere(2, 0.9))
            elif step > 4:
                tracer.scene.deform("ball", geometry.icosphere(2, 0.9)[0] + 0.2 * step - 1.0)
            outcomes = tracer.cones(apices, ends, half_angle=np.arctan(share), first=True)
            found.append([*outcomes, *tracer.cone_hits(apices, ends, 0.3, 5)])
        for others in found[1:]:
            for mine, other in zip(found[0], others, strict=True):
                np.testing.assert_array_equal(mine, other)
        assert step == 3 or count < 100 or len(np.unique(found[0][0])) == 3


@pytest.mark.wide
def test_threads_really_work_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device_cones, "SOME", 16)
    tracer, apices = _tracer("cpu", 2), np.random.default_rng(602).uniform(-2, 2, (32, 3))
    alone = _tracer("cpu").cones(apices, (3.0, 3.0, 3.0), 0.2)
    meeting, launch, names = threading.Barrier(2, timeout=20.0), wp.launch, set()

    def met(kernel: Any, *arguments: Any, **named: Any) -> Any:
        if kernel is Bvh.cones.find_outcomes:
            names.add(threading.current_thread().name)
            meeting.wait()
        return launch(kernel, *arguments, **named)

    monkeypatch.setattr(device_cones.wp, "launch", met)
    np.testing.assert_array_equal(tracer.cones(apices, (3.0, 3.0, 3.0), 0.2), alone)
    assert len(names) == 2


@pytest.mark.wide
def test_a_thread_that_fails_leaves_nothing_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device_cones, "SOME", 16)
    tracer, apices = _tracer("cpu", 3), np.random.default_rng(603).uniform(-2, 2, (400, 3))
    lamp = PointLight("lamp", (3.0, 3.0, 3.0), ignore=["ball"])
    true = _tracer("cpu").cones(apices, lamp, 0.2), _tracer("cpu").cones(apices, lamp.position, 0.2)
    assert (true[0] != true[1]).any()
    launch, count = wp.launch, [0]

    def broken(*arguments: Any, **named: Any) -> Any:
        count[0] += 1
        if count[0] == 9:
            raise MemoryError("no more")
        return launch(*arguments, **named)

    tracer.cones(apices, lamp, 0.2)
    with monkeypatch.context() as patch:
        patch.setattr(device_cones.wp, "launch", broken)
        with pytest.raises(MemoryError):
            tracer.cones(apices, lamp, 0.2)
    np.testing.assert_array_equal(tracer.cones(apices, lamp.position, 0.2), true[1])
    np.testing.assert_array_equal(tracer.cones(apices, lamp, 0.2), true[0])


@pytest.mark.parametrize("pipeline", ["light_grid", "bvh", "kd_tree"])
def test_a_warm_up_launches_what_cones_need(any_device: str, pipeline: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """If asked to, and only then. Scenes that are new, move and change need no other kernel."""
    tracer, launch, launched = _tracer(any_device, 2, pipeline), wp.launch, set()
    kernels = KdTree.cones if pipeline == "kd_tree" else Bvh.cones
    needs = ("cones", ("kd_tree" if pipeline == "kd_tree" else "bvh", "sah"))

    def noted(kernel: Any, *arguments: Any, **named: Any) -> Any:
        launched.add(kernel)
        return launch(kernel, *arguments, **named)

    monkeypatch.setattr(wp, "launch", noted)
    probe.loaded(tracer).discard(needs)
    tracer.warm_up()
    assert kernels.find_outcomes not in launched and needs not in probe.loaded(tracer)
    tracer.warm_up(cones=True)
    assert {kernels.find_outcomes, kernels.find_hits} <= launched and needs in probe.loaded(tracer)
    before = set(launched)
    for step in range(3):
        tracer.cones(np.zeros((20, 3)), (3.0, 3.0, 3.0), 0.2, first=True)
        tracer.cone_hits(np.zeros((20, 3)), (3.0, 3.0, 3.0), 0.2, 20)
        tracer.scene.deform("ball", geometry.icosphere(2, 0.7)[0] + 0.1 * step)
        if step:
            tracer.scene.put("more", *geometry.soup(np.random.default_rng(step), 40 + step, 0.5, 1.5))
    assert launched == before


def test_a_warm_up_is_asked_for_by_yes_or_no(any_device: str) -> None:
    with pytest.raises(ValueError, match="cones: expected True or False, got 1"):
        _tracer(any_device).warm_up(cones=1)  # type: ignore[arg-type]


@probe.in_both_forms
def test_a_light_stands_for_its_middle(any_device: str, kernel_form: str) -> None:
    rng, tracer = np.random.default_rng(604), _tracer(any_device)
    apices, radii = rng.uniform(-2, 2, (300, 3)), rng.uniform(0.01, 0.6, 300)
    for light in (PointLight("lamp", (1.5, -2.0, 2.0), range=0.1), SphereLight("bulb", (1.5, -2.0, 2.0), 0.3)):
        found = tracer.cones(apices, light, radii)
        np.testing.assert_array_equal(found, tracer.cones(apices, (1.5, -2.0, 2.0), radii))
        assert len(np.unique(found)) == 3
        near = tracer.cones(apices, light, half_angle=0.1, length=0.5)
        np.testing.assert_array_equal(near, tracer.cones(apices, (1.5, -2.0, 2.0), half_angle=0.1, length=0.5))


@probe.in_both_forms
@pytest.mark.parametrize("offset", [0.0, 1e5])
def test_a_light_at_infinity(any_device: str, kernel_form: str, offset: float) -> None:
    """Never wrong beside 64 rays, and as cones that end behind all of the scene."""
    rng, tracer, toward = np.random.default_rng(605), _tracer(any_device), np.array([0.25, -0.5, 1.0])
    for name in ("ball", "soup"):
        tracer.scene.move(name, geometry.pose_of(np.eye(3), (offset, 0.0, 0.0)))
    apices = rng.uniform(-2, 2, (400, 3)) + (offset, 0.0, 0.0)
    several = np.array([0.003, 0.05, 0.3])
    angles, sun = several[np.arange(400) % 3], DirectionalLight("sun", -toward)
    found = tracer.cones(apices, sun, half_angle=angles)
    np.testing.assert_array_equal(found, tracer.cones(apices, SunDisc("disc", -toward), half_angle=angles))
    np.testing.assert_array_equal(found, tracer.cones(apices, apices + 16.0 * toward, half_angle=angles))
    np.testing.assert_array_equal(found, tracer.cones(apices, sun, half_angle=angles, length=20.0))
    assert (np.bincount(found, minlength=3) > 20).all()
    ways = cones.ends_of_rays(np.zeros((3, 3)), np.tile(toward, (3, 1)), 1.14 * np.tan(several), 16)
    for number in range(48):
        mine = angles == several[number % 3]
        hidden = tracer.occluded(apices[mine], DirectionalLight("ray", -ways[number % 3, number // 3]))
        assert not hidden[found[mine] == _FREE].any() and hidden[found[mine] == _BLOCKED].all()


def test_a_ray_to_a_light_at_infinity(any_device: str) -> None:
    tracer, sun = _tracer(any_device), DirectionalLight("sun", (0.3, 0.2, -1.0))
    apices = np.random.default_rng(606).uniform(-2, 2, (500, 3))
    hidden = tracer.occluded(apices, sun)
    assert hidden.any() and not hidden.all()
    np.testing.assert_array_equal(tracer.cones(apices, sun, half_angle=0.0), np.where(hidden, _BLOCKED, _FREE))


@probe.in_both_forms
def test_what_the_light_ignores_does_not_count(any_device: str, kernel_form: str) -> None:
    """And does for all that are asked next, whoever asks."""
    tracer, without = _tracer(any_device), _tracer(any_device)
    without.scene.remove("ball")
    apices, place = np.random.default_rng(607).uniform(-2, 2, (300, 3)), (0.0, 0.0, 0.3)
    bare, lamp = PointLight("bare", place, ignore=["ball", "no such mesh"]), PointLight("lamp", place)
    for step in range(4):
        for asked in (bare, lamp, bare):
            other = without if asked is bare else tracer
            mine = tracer.cones(apices, asked, 0.1, first=True)
            theirs = other.cones(apices, place, 0.1, first=True)
            np.testing.assert_array_equal(mine[0], theirs[0])
            np.testing.assert_array_equal(mine[2], theirs[2])
            np.testing.assert_array_equal(tracer.occluded(apices, asked), tracer.cones(apices, asked, 0.0) == _BLOCKED)
        assert (tracer.cones(apices, lamp, 0.1) != tracer.cones(apices, bare, 0.1)).any()
        if step == 2:
            tracer.scene.remove("soup")
            without.scene.remove("soup")
        tracer.scene.deform("ball", geometry.icosphere(2, 0.8 + 0.1 * step)[0])


def test_a_radius_has_no_meaning_at_infinity(any_device: str) -> None:
    tracer, sun = _tracer(any_device), DirectionalLight("sun", (0.3, 0.2, -1.0))
    with pytest.raises(ValueError, match="radius: expected half_angle for cones to a light at infinity"):
        tracer.cones((0, 0, 0), sun, 0.1)
    with pytest.raises(ValueError, match="target: expected points other than the apices"):
        tracer.cones((1, 2, 3), PointLight("lamp", (1, 2, 3)), 0.1)
    with pytest.raises(ValueError, match="half_angle: expected numbers from 0 to 1.5"):
        tracer.cones((1, 2, 3), sun, half_angle=1.6)
