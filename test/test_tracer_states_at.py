# SPDX-License-Identifier: Apache-2.0
"""ShadowTracer.states_at: what trace() says of pixels, of any points."""

from __future__ import annotations

import math
from typing import Any

import geometry
import numpy as np
import oracle
import pytest

from shadow_tracer import Bounds, BoundsError, Camera, DirectionalLight, PointLight, ShadowTracer, SpotLight, State

_LIGHTS: list[Any] = [
    PointLight("lamp", (0.5, 0.2, 2.5)),
    PointLight("candle", (0.5, 0.2, 2.5), range=6.0),
    SpotLight("spot", (-3.0, 0.0, 4.0), (1.0, 0.0, -1.5), 0.6),
    DirectionalLight("sun", (0.2, 0.3, -0.9)),
]


def _street() -> geometry.Geometry:
    return geometry.street(np.random.default_rng(80), 50)


def _points(shape: tuple[int, ...]) -> np.ndarray:
    return np.random.default_rng(110).uniform((-9, -4, 0.1), (9, 4, 3), (*shape, 3))


def test_every_state_of_every_light(tracer: Any) -> None:
    """Shadows against the oracle, cones and ranges against their definition."""
    tracer.scene.put("street", *_street())
    points = _points((300,))
    states = tracer.states_at(points, _LIGHTS, 0.01)
    assert states.shape == (4, 300) and states.dtype == np.uint8
    for light, got in zip(_LIGHTS, states, strict=True):
        answer = oracle.occluded(points, light, *_street(), 0.01)
        assert not answer.tie.any()
        expected = np.where(answer.hidden, State.SHADOWED, State.LIT)
        if not isinstance(light, DirectionalLight):
            way = points - light.position
            expected[np.linalg.norm(way, axis=-1) > light.range] = State.OUTSIDE
            if isinstance(light, SpotLight):
                angle = np.arctan2(np.linalg.norm(np.cross(way, light.direction), axis=-1), way @ light.direction)
                expected[angle > light.outer_angle] = State.OUTSIDE
        np.testing.assert_array_equal(got, expected, err_msg=light.name)
    assert set(np.unique(states)) == {State.LIT, State.SHADOWED, State.OUTSIDE}


@pytest.mark.parametrize("shape", [(), (1,), (7,), (2, 3, 4), (0,), (3, 0)])
def test_any_leading_shape(tracer: Any, shape: tuple[int, ...]) -> None:
    tracer.scene.put("street", *_street())
    states = tracer.states_at(_points(shape), _LIGHTS)
    assert states.shape == (4, *shape) and states.dtype == np.uint8
    one_by_one = [tracer.states_at(point, _LIGHTS) for point in _points(shape).reshape(-1, 3)]
    if one_by_one:
        np.testing.assert_array_equal(states.reshape(4, -1), np.stack(one_by_one, axis=1))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1.1e50, -1e300])
def test_points_that_are_not_finite_are_invalid_and_change_nobody_else(tracer: Any, value: float) -> None:
    tracer.scene.put("street", *_street())
    rng = np.random.default_rng(111)
    points = _points((200,))
    before = tracer.states_at(points, _LIGHTS, 0.01)
    for fraction in (0.02, 0.6, 1.0):
        bad = rng.random(200) < fraction
        spoilt = points.copy()
        spoilt[bad, rng.integers(0, 3, int(bad.sum()))] = value
        given = spoilt.copy()
        states = tracer.states_at(given, _LIGHTS, 0.01)
        np.testing.assert_array_equal(given, spoilt, err_msg="the input is not written to")
        np.testing.assert_array_equal(states, np.where(bad, State.INVALID, before))


def test_one_point_of_many_moves(tracer: Any) -> None:
    """What comes is compared with what came before: everywhere, and whether points are valid, too."""
    tracer.scene.put("square", *geometry.square(2, 0.0, 1.0))
    lamp = PointLight("lamp", (0.0, 0.0, 3.0))
    points = np.tile((9.0, 9.0, -1.0), (3000, 1))
    for index in (0, 1, 500, 1498, 1500, 2999):
        moved = points.copy()
        moved[index] = 0.1, 0.2, -1.0
        spoilt = points.copy()
        spoilt[index, 2] = np.nan
        for given, state in ((points, None), (moved, State.SHADOWED), (points, None), (spoilt, State.INVALID)):
            states = tracer.states_at(given, [lamp])[0]
            expected = np.full(3000, State.LIT, np.uint8)
            expected[index] = expected[index] if state is None else state
            np.testing.assert_array_equal(states, expected, err_msg=str(index))


def test_equals_trace_and_occluded(tracer: Any) -> None:
    tracer.scene.put("street", *_street())
    camera = Camera(12, 9, 10.0, 11.0, 5.4, 4.2, geometry.look_at((-8.0, 0.3, 2.0), (0.0, 0.0, 1.0), (0, 0, 1)))
    depth = np.random.default_rng(112).uniform(0.5, 16.0, (9, 12)).astype(np.float32)
    states = tracer.states_at(camera.unproject(depth), _LIGHTS, 0.01)
    frame = tracer.trace(depth, camera, _LIGHTS, 0.01)
    for light, got in zip(_LIGHTS, states, strict=True):
        np.testing.assert_array_equal(got, frame.state(light.name))
        np.testing.assert_array_equal(
            got == State.SHADOWED, tracer.occluded(camera.unproject(depth), light, 0.01), err_msg=light.name
        )


@pytest.mark.parametrize("rays", [1, 7, 199, 200, 201])
def test_more_points_than_one_piece(any_device: str, rays: int) -> None:
    points = _points((200,))
    points[3::50] = np.nan
    whole = ShadowTracer("mesh_bvh", device=any_device, bounds=Bounds(max_triangles=4000, max_rays=1000))
    pieces = ShadowTracer("mesh_bvh", device=any_device, bounds=Bounds(max_triangles=4000, max_rays=rays))
    some = points if rays > 1 else points[:20]
    answers = []
    for tracer in (whole, pieces):
        tracer.scene.put("street", *_street())
        answers.append(tracer.states_at(some, _LIGHTS, 0.01))
    np.testing.assert_array_equal(*answers)


def test_errors_name_the_argument(reference: Any) -> None:
    lamp = _LIGHTS[0]
    bad: list[tuple[str, Any, Any, Any]] = [
        ("points", (1.0, 2.0), [lamp], 0.0),
        ("points", 5.0, [lamp], 0.0),
        ("points", [["a", "b", "c"]], [lamp], 0.0),
        ("lights", (0, 0, 0), lamp, 0.0),
        ("lights", (0, 0, 0), [], 0.0),
        ("lights", (0, 0, 0), [lamp, lamp], 0.0),
        ("lights[0]", (0, 0, 0), ["sun"], 0.0),
        ("bias", (0, 0, 0), [lamp], -0.1),
    ]
    for field, points, lights, bias in bad:
        with pytest.raises(ValueError) as caught:
            reference.states_at(points, lights, bias)
        assert str(caught.value).startswith(field) and "expected" in str(caught.value), caught.value
    lamps = [PointLight(f"lamp {k}", (k, 0, 3)) for k in range(17)]
    with pytest.raises(BoundsError, match=r"^bounds\.max_lights:.*17.*16"):
        reference.states_at((0.0, 0.0, 0.0), lamps)
