# SPDX-License-Identifier: Apache-2.0
"""Capacities: what overflows a queue is done in further passes, what exceeds a bound is refused whole, nothing is
lost or grows."""

from __future__ import annotations

from functools import cache
from typing import Any

import geometry
import numpy as np
import oracle
import probe
import pytest

from shadow_tracer import Bounds, BoundsError, Camera, DirectionalLight, PointLight, ShadowTracer

_LIGHTS: list[Any] = [
    PointLight("lamp", (0.25, 0.5, 3.0)),
    PointLight("corner", (2.0, 2.0, 2.0)),
    DirectionalLight("sun", (1.0, 2.0, -4.0)),
]


@cache
def _uncertain() -> tuple[geometry.Geometry, Camera, np.ndarray]:
    """An image whose every sample lies on a lattice of coplanar, touching triangles: many pairs that float32 cannot
    decide."""
    lattice = geometry.join([geometry.square(axis, float(at), 2.0) for axis in range(3) for at in (-2, -1, 0, 1, 2)])
    camera = Camera(9, 7, 4.0, 4.0, 4.0, 3.0, geometry.pose_of(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 2.0)))
    depth = np.tile(np.array([1.0, 2.0, 4.0, 1.0, 2.0, 4.0, 3.0], np.float32)[:, None], (1, 9))
    return lattice, camera, depth


@cache
def _expected() -> np.ndarray:
    lattice, camera, depth = _uncertain()
    return np.stack(
        [oracle.occluded(camera.unproject(depth), light, *lattice).hidden.reshape(depth.shape) for light in _LIGHTS]
    )


@pytest.mark.parametrize("capacity", [1, 2, 3, 64, None])
def test_any_queue_capacity(tracer_case: tuple[str, str, str], capacity: int | None) -> None:
    """Down to a queue of one pair: the same bits, and the counter says that it was full; where there is one."""
    device, pipeline, variant = tracer_case
    lattice, camera, depth = _uncertain()
    bounds = Bounds(
        max_triangles=100, max_rays=100, max_lights=3, **({} if capacity is None else {"queue_capacity": capacity})
    )
    tracer = ShadowTracer(pipeline, variant, device, bounds)
    tracer.scene.put("lattice", *lattice)
    for _ in range(2):
        frame = tracer.trace(depth, camera, _LIGHTS, 0.0)
        for index, light in enumerate(_LIGHTS):
            np.testing.assert_array_equal(frame.state(light.name) == 1, _expected()[index], err_msg=light.name)
        passes = frame.counters["overflow_passes"]
        if capacity is None:
            assert passes == 0
        elif capacity <= 3 and (pipeline, variant) != ("brute_force", "float64"):
            queues = not probe.wide(device)
            assert (passes > 0) == queues, "this scene has more uncertain pairs than that"
    points = camera.unproject(depth)
    for index, light in enumerate(_LIGHTS):
        np.testing.assert_array_equal(tracer.occluded(points, light), _expected()[index])
    assert 0.2 < _expected().mean() < 0.98


def test_the_counter_of_a_full_queue_stops(tracer_case: tuple[str, str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """It would come round to valid places if it counted more pairs than there are integers."""
    from shadow_tracer.gpu.engine import band

    device, pipeline, variant = tracer_case
    lattice, camera, depth = _uncertain()
    tracer = ShadowTracer(
        pipeline, variant, device, Bounds(max_triangles=100, max_rays=100, max_lights=3, queue_capacity=2)
    )
    tracer.scene.put("lattice", *lattice)
    seen: list[int] = []
    finish = band.Band.finish

    def look(self: band.Band, *arguments: object) -> int:
        seen.extend(self.samples.queue_counts.numpy())
        return finish(self, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(band.Band, "finish", look)
    tracer.trace(depth, camera, _LIGHTS, 0.0)
    # Threads that asked before they could see it full.
    late = 0 if device == "cpu" else 100 * 100
    waits = not probe.wide(device) and (pipeline, variant) != ("brute_force", "float64")
    assert 2 < max(seen) <= 3 + late if waits else max(seen) == 0


def test_more_uncertain_pairs_than_any_queue(tracer_case: tuple[str, str, str]) -> None:
    """Closed sphere, rays exactly through its vertices, a queue of five pairs: still no leak."""
    device, pipeline, variant = tracer_case
    vertices, triangles = geometry.icosphere(2, 4.0)
    tracer = ShadowTracer(
        pipeline, variant, device, Bounds(max_triangles=400, max_rays=500, max_lights=1, queue_capacity=5)
    )
    tracer.scene.put("sphere", vertices, triangles)
    assert tracer.occluded(np.concatenate([2.0 * vertices, 1.5 * vertices]), PointLight("lamp", (0, 0, 0))).all()


def _full_tracer(case: tuple[str, str, str]) -> tuple[Any, np.ndarray]:
    device, pipeline, variant = case
    tracer = ShadowTracer(
        pipeline, variant, device, Bounds(max_triangles=320, max_rays=63, max_lights=2, queue_capacity=1000)
    )
    tracer.scene.put("sphere", *geometry.icosphere(2, 1.0))
    return tracer, tracer.occluded(_PROBES, _LIGHTS[0])


_PROBES = np.random.default_rng(90).uniform(-2, 2, (63, 3))


def test_what_exceeds_a_bound_is_refused_whole(tracer_case: tuple[str, str, str]) -> None:
    tracer, expected = _full_tracer(tracer_case)
    assert expected.any() and not expected.all()
    revision = tracer.scene.revision
    lattice, camera, depth = _uncertain()
    one = [[0, 1, 2]]
    for act, bound in (
        (lambda: tracer.scene.put("one more", np.eye(3), one), r"^bounds\.max_triangles:.*320"),
        (lambda: tracer.scene.put("sphere", *geometry.icosphere(3, 1.0)), r"^bounds\.max_triangles:.*320"),
        (lambda: tracer.scene.put("points only", np.zeros((3 * 320 + 1, 3)), np.zeros((0, 3), int)), r"^bounds\.max_"),
        (
            lambda: tracer.trace(np.ones((8, 8), np.float32), Camera(8, 8, 1, 1, 0, 0), _LIGHTS[:1]),
            r"^bounds\.max_rays:.*63",
        ),
        (lambda: tracer.trace(depth, camera, _LIGHTS), r"^bounds\.max_lights:.*2"),
    ):
        with pytest.raises(BoundsError, match=bound):
            act()
        assert (tracer.scene.revision, tracer.scene.names) == (revision, ("sphere",))
        np.testing.assert_array_equal(tracer.occluded(_PROBES, _LIGHTS[0]), expected)


def test_exactly_full_works(tracer_case: tuple[str, str, str]) -> None:
    tracer, expected = _full_tracer(tracer_case)
    _, camera, depth = _uncertain()
    assert depth.size == 63 and tracer.scene.triangle_count == 320
    frame = tracer.trace(depth, camera, _LIGHTS[:2], 0.0)
    for light in _LIGHTS[:2]:
        expected_state = oracle.occluded(camera.unproject(depth), light, *geometry.icosphere(2, 1.0)).hidden.reshape(
            depth.shape
        )
        np.testing.assert_array_equal(frame.state(light.name) == 1, expected_state)


def test_every_vertex_of_its_own(tracer_case: tuple[str, str, str]) -> None:
    """A soup without shared vertices fills both bounds at once."""
    tracer, expected = _full_tracer(tracer_case)
    tracer.scene.put("sphere", *geometry.split(*geometry.icosphere(2, 1.0)))
    np.testing.assert_array_equal(tracer.occluded(_PROBES, _LIGHTS[0]), expected)


def test_buffers_do_not_grow(tracer_case: tuple[str, str, str]) -> None:
    """Memory reserved on the device is the same after a hundred frames of changing meshes as after the first few."""
    tracer, _ = _full_tracer(tracer_case)
    rng = np.random.default_rng(91)
    _, camera, depth = _uncertain()
    chooser = probe.chooser(tracer)

    def work(frames: int) -> int:
        for k in range(frames):
            tracer.scene.put("sphere", *geometry.soup(rng, 100 + 10 * (k % 5), 0.3, 1.0))
            if chooser:  # all in turn: a tree is as large as the mesh was when it was last built
                chooser.forced = chooser.candidates[k % 3]
            tracer.trace(depth, camera, _LIGHTS[:2])
        return int(tracer.device_bytes)

    assert work(15) == work(45)
