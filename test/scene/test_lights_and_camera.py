# SPDX-License-Identifier: Apache-2.0
"""Lights, camera, bounds and bias say what they accept, and name the field when they do not."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from shadow_tracer import Bias, Bounds, BoundsError, Camera, DirectionalLight, PointLight, SpotLight, State

_GOOD: dict[type, dict[str, Any]] = {
    PointLight: {"name": "lamp", "position": (1, 2, 3)},
    SpotLight: {"name": "spot", "position": (1, 2, 3), "direction": (0, 0, -2), "outer_angle": 0.5},
    DirectionalLight: {"name": "sun", "direction": (0, 0, -2)},
    Camera: {"width": 4, "height": 3, "fx": 2.0, "fy": 2.5, "cx": 1.5, "cy": 1.0},
    Bounds: {},
    Bias: {},
}
_MIRROR = np.diag([1.0, 1.0, -1.0, 1.0])
_NAN3, _INF3 = (0, math.nan, 0), (0, 0, math.inf)
_NO_POSITION = (_NAN3, _INF3, (1, 2), (1, 2, 3, 4), [[1, 2, 3]], "abc", None, 1.0)
_NO_DIRECTION = ((0, 0, 0), _NAN3, _INF3, (1, 0), "up", None)
_NO_RANGE = (0.0, -1.0, math.nan, -math.inf, "far", None)
_NO_POSE = (
    *(np.eye(3), np.full((4, 4), np.nan), np.zeros((4, 4)), 2.0 * np.eye(4), np.diag([2.0, 1, 1, 1])),
    *(_MIRROR, "pose", None),
)
_NO_BOUND = (0, -1, 1.5, True, "many", None, 2**40)
_NO_BIAS = (-1e-9, math.nan, math.inf, "small", None)
_BAD: list[tuple[type, str, Any]] = [
    *[(kind, "name", value) for kind in (PointLight, SpotLight, DirectionalLight) for value in ("", None, 3, b"lamp")],
    *[(kind, "position", value) for kind in (PointLight, SpotLight) for value in _NO_POSITION],
    *[(kind, "direction", value) for kind in (SpotLight, DirectionalLight) for value in _NO_DIRECTION],
    *[(kind, "range", value) for kind in (PointLight, SpotLight) for value in _NO_RANGE],
    *[(SpotLight, "outer_angle", value) for value in (0.0, -0.1, math.nan, math.inf, 3.15, "wide", None)],
    *[(Camera, field, value) for field in ("width", "height") for value in (0, -1, 2.5, True, "4", None)],
    *[(Camera, field, value) for field in ("fx", "fy") for value in (0.0, -1.0, math.nan, math.inf, "wide", None)],
    *[(Camera, field, value) for field in ("cx", "cy") for value in (math.nan, math.inf, "centre", None)],
    *[(Camera, "camera_to_world", value) for value in _NO_POSE],
    *[(Bounds, field.name, value) for field in dataclasses.fields(Bounds) for value in _NO_BOUND],
    *[(Bias, field, value) for field in ("constant", "quadratic", "normal") for value in _NO_BIAS],
]


@pytest.mark.parametrize(
    "kind,field,value", _BAD, ids=[f"{kind.__name__}.{field}={str(value)[:20]!r}" for kind, field, value in _BAD]
)
def test_refused_by_name(kind: type, field: str, value: Any) -> None:
    start = {Bounds: "bounds.", Bias: "bias."}.get(kind, "") + field + ":"
    with pytest.raises(ValueError) as caught:
        kind(**{**_GOOD[kind], field: value})
    message = str(caught.value)
    assert message.startswith(start), message
    assert "expected" in message, f"what is allowed: {message}"


@pytest.mark.parametrize("kind", _GOOD)
def test_accepted_and_frozen(kind: type) -> None:
    made = kind(**_GOOD[kind])
    for field in dataclasses.fields(made):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(made, field.name, 1)


def test_arrays_are_copied_and_read_only() -> None:
    given = np.array([1.0, 2.0, 3.0])
    lamp, spot, sun = PointLight("a", given), SpotLight("b", given, given, 0.3), DirectionalLight("c", given)
    camera = Camera(2, 2, 1, 1, 0, 0, pose := np.eye(4))
    given[:] = 9.0
    pose[0, 3] = 9.0
    for array in (lamp.position, spot.position, spot.direction, sun.direction):
        np.testing.assert_array_equal(array, [1.0, 2.0, 3.0])
        assert array.dtype == np.float64
        with pytest.raises(ValueError):
            array[0] = 5.0
    np.testing.assert_array_equal(camera.camera_to_world, np.eye(4))
    with pytest.raises(ValueError):
        camera.camera_to_world[0, 0] = 2.0


def test_defaults_of_the_contract() -> None:
    assert (
        PointLight("a", (0, 0, 0)).range == math.inf and SpotLight("b", (0, 0, 0), (1, 0, 0), math.pi).range == math.inf
    )
    bounds = Bounds()
    assert (bounds.max_triangles, bounds.max_rays, bounds.max_lights, bounds.queue_capacity, bounds.grid_entries) == (
        1_000_000,
        1_310_720,
        16,
        1_048_576,
        4_194_304,
    )
    assert (Bias().constant, Bias().quadratic, Bias().normal) == (0.01, 0.0, 0.0)
    states = [("LIT", 0), ("SHADOWED", 1), ("OUTSIDE", 2), ("INVALID", 3), ("PENUMBRA", 4)]
    assert [(s.name, s.value) for s in State] == states
    assert issubclass(BoundsError, ValueError)
    np.testing.assert_array_equal(Camera(2, 2, 1, 1, 0, 0).camera_to_world, np.eye(4))


def test_unproject_is_the_pinhole_formula() -> None:
    rng = np.random.default_rng(60)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, (1e5, -3.0, 0.25)
    camera = Camera(5, 4, 3.0, 3.5, 1.75, 2.25, pose)
    depth = rng.uniform(0.5, 9.0, (4, 5)).astype(np.float32)
    points = camera.unproject(depth)
    assert points.shape == (4, 5, 3) and points.dtype == np.float64
    for v in range(4):
        for u in range(5):
            z = float(depth[v, u])
            x, y = (u - 1.75) / 3.0 * z, (v - 2.25) / 3.5 * z
            for k in range(3):
                assert points[v, u, k] == ((pose[k, 0] * x + pose[k, 1] * y) + pose[k, 2] * z) + pose[k, 3]
    np.testing.assert_array_equal(camera.position, (1e5, -3.0, 0.25))
    with pytest.raises(ValueError, match="^depth:"):
        camera.unproject(depth.T)
