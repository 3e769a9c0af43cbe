# SPDX-License-Identifier: Apache-2.0
"""ShadowTracer.occluded: shapes, kinds of numbers, lights that end somewhere, errors by name."""

from __future__ import annotations

import math
from typing import Any

import geometry
import numpy as np
import oracle
import pytest

from shadow_tracer import (
    Bounds,
    BoundsError,
    Camera,
    DirectionalLight,
    PointLight,
    Scene,
    ShadowTracer,
    SpotLight,
    available_pipelines,
)

_LAMP = PointLight("lamp", (0.0, 0.0, 3.0))


def _put_square(tracer: Any) -> None:
    tracer.scene.put("square", *geometry.square(2, 0.0, 1.0))


@pytest.mark.parametrize("shape", [(), (1,), (11,), (1, 2, 3), (32, 14), (0,), (3, 0), (2, 1, 1, 5)])
def test_any_leading_shape(tracer: Any, shape: tuple[int, ...]) -> None:
    _put_square(tracer)
    points = np.random.default_rng(70).uniform(-3, 3, (*shape, 3))
    hidden = tracer.occluded(points, _LAMP)
    assert isinstance(hidden, np.ndarray) and hidden.shape == shape and hidden.dtype == np.bool_
    expected = oracle.occluded(points, _LAMP, *geometry.square(2, 0.0, 1.0)).hidden
    np.testing.assert_array_equal(hidden.reshape(-1), expected)


def test_any_kind_of_numbers(tracer: Any) -> None:
    _put_square(tracer)
    points = np.random.default_rng(71).integers(-3, 4, (60, 3))
    expected = tracer.occluded(points.astype(np.float64), _LAMP)
    assert expected.any() and not expected.all()
    wide = np.zeros((60, 6))
    wide[:, ::2] = points
    for given in (
        points,
        points.astype(np.int8),
        points.astype(np.float32),
        points.tolist(),
        np.asfortranarray(points.astype(float)),
        wide[:, ::2],
        points[::-1].astype(float)[::-1],
    ):
        np.testing.assert_array_equal(tracer.occluded(given, _LAMP), expected)


def test_float32_points_are_taken_exactly(tracer: Any) -> None:
    _put_square(tracer)
    edge = np.float32(2.0)
    points = np.array([(edge, 0, -3), (np.nextafter(edge, np.float32(3)), 0, -3)], np.float32)
    np.testing.assert_array_equal(tracer.occluded(points, _LAMP), [True, False])


_BAD_CALLS: list[tuple[str, Any, Any, Any]] = [
    ("points", (1.0, 2.0), _LAMP, 0.0),
    ("points", np.zeros((4, 2)), _LAMP, 0.0),
    ("points", 5.0, _LAMP, 0.0),
    ("points", [["a", "b", "c"]], _LAMP, 0.0),
    ("points", np.zeros((2, 3), complex), _LAMP, 0.0),
    ("points", [(0, 0, 0), (0, math.nan, 0)], _LAMP, 0.0),
    ("points", [(0, 0, 0), (0, 0, math.inf)], _LAMP, 0.0),
    ("light", (0, 0, 0), None, 0.0),
    ("light", (0, 0, 0), (0, 0, 3), 0.0),
    ("bias", (0, 0, 0), _LAMP, -0.1),
    ("bias", (0, 0, 0), _LAMP, math.nan),
    ("bias", (0, 0, 0), _LAMP, math.inf),
    ("bias", (0, 0, 0), _LAMP, "far"),
]


@pytest.mark.parametrize("field,points,light,bias", _BAD_CALLS)
def test_errors_name_the_argument(reference: Any, field: str, points: Any, light: Any, bias: Any) -> None:
    with pytest.raises(ValueError) as caught:
        reference.occluded(points, light, bias)
    assert str(caught.value).startswith(field), caught.value
    assert "expected" in str(caught.value)


def test_error_says_which_point(reference: Any) -> None:
    points = np.zeros((4, 5, 3))
    points[2, 3, 1] = np.nan
    with pytest.raises(ValueError, match=r"\(2, 3\)"):
        reference.occluded(points, _LAMP)


def test_error_counts_all_bad_points_and_names_the_first(reference: Any) -> None:
    points = np.random.default_rng(73).uniform(-3, 3, (40, 50, 3))
    bad = [(3, 7, 2, np.inf), (3, 8, 0, np.nan), (20, 0, 1, -np.inf), (39, 49, 2, 1.0000001e50), (39, 48, 0, -1e300)]
    for i, j, k, value in bad:
        points[i, j, k] = value
    points[39, 49] = np.nan
    points[0, 0] = 1e50, -1e50, 0.0  # large, and allowed
    for given in (points, np.asfortranarray(points), points[:, ::-1][:, ::-1]):
        with pytest.raises(ValueError) as caught:
            reference.occluded(given, _LAMP)
        expected = (
            f"points: expected finite positions of at most 1e+50, got {points[3, 7].tolist()} at index (3, 7) "
            "and 5 such points in all; select the finite ones first"
        )
        assert str(caught.value) == expected


def test_more_points_than_one_piece(any_device: str) -> None:
    """occluded() works in pieces of max_rays: any number of points, the same answers."""
    points = np.random.default_rng(72).uniform(-3, 3, (1000, 3))
    expected = oracle.occluded(points, _LAMP, *geometry.square(2, 0.0, 1.0)).hidden
    for rays in (1, 7, 999, 1000, 1001):
        tracer = ShadowTracer(
            "mesh_bvh", device=any_device, bounds=Bounds(max_triangles=10, max_rays=rays, queue_capacity=50)
        )
        _put_square(tracer)
        some = points if rays > 1 else points[:40]
        np.testing.assert_array_equal(tracer.occluded(some, _LAMP), expected[: len(some)])


def test_range_ends_inclusively(tracer: Any) -> None:
    """A sample at exactly the range is reached; farther ones are outside, not in shadow, whatever hangs in between."""
    tracer.scene.put("sphere", *geometry.icosphere(1, 0.5, (0.0, 0.0, 0.0)))
    lamp = PointLight("lamp", (0.0, 0.0, 0.0), range=5.0)
    points = np.array(
        [(3.0, 4.0, 0.0), (3.0, np.nextafter(4.0, 5.0), 0.0), (0.0, 0.0, -5.0), (0.0, 6.0, 0.0), (2.0, 0.0, 0.0)]
    )
    np.testing.assert_array_equal(tracer.occluded(points, lamp), [True, False, True, False, True])


def test_cone_of_a_spot(tracer: Any) -> None:
    """Only samples inside the cone can be in shadow. Both sides of the border by a millionth, and the axis, apex
    and back."""
    tracer.scene.put("sphere", *geometry.icosphere(1, 0.1))
    for angle in (0.05, 0.5, math.pi / 2, 2.0, 3.1):
        spot = SpotLight("spot", (0.0, 0.0, 0.0), (0.0, 0.0, 5.0), angle)
        turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
        for shift, inside in ((-1e-6, True), (1e-6, False)):
            polar = angle + shift
            rim = 2.0 * np.stack(
                [np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.full(12, np.cos(polar))], axis=1
            )
            np.testing.assert_array_equal(
                tracer.occluded(rim, spot), np.full(12, inside), err_msg=f"angle {angle} {shift:+}"
            )
        assert tracer.occluded((0, 0, 2.0), spot), "on the axis"
        assert not tracer.occluded((0, 0, -2.0), spot), "behind"
        assert not tracer.occluded((0, 0, 0), spot), "at the light"
    everywhere = SpotLight("spot", (0.0, 0.0, 0.0), (0.3, -0.2, 5.0), math.pi)
    around = np.concatenate(
        [geometry.directions(np.random.default_rng(73), 200), [(-0.3, 0.2, -5.0), (0.0, 0.0, -1.0)]]
    )
    assert tracer.occluded(around * 3.0, everywhere).all(), "half an angle of pi is all of space"


def test_names_of_pipelines_variants_and_devices(reference: Any) -> None:
    assert {"mesh_bvh", "brute_force"} <= set(available_pipelines())
    assert {"filtered", "float64"} <= set(available_pipelines()["brute_force"])
    assert {"refit", "rebuild"} <= set(available_pipelines()["mesh_bvh"])
    wrong: list[tuple[dict[str, Any], str, str]] = [
        ({"pipeline": "cone"}, "pipeline", "mesh_bvh"),
        ({"pipeline": "mesh_bvh", "variant": "float64"}, "variant", "refit"),
        ({"device": "cuda:77"}, "device", "cpu"),
        ({"device": "tpu"}, "device", "cpu"),
    ]
    for arguments, field, known in wrong:
        with pytest.raises(ValueError, match=f"^{field}:.*{known}"):
            ShadowTracer(**arguments)
    before = reference.pipeline, reference.variant
    for names in (("cone", None), ("mesh_bvh", "float64")):
        with pytest.raises(ValueError, match="^(pipeline|variant):"):
            reference.select(*names)
    assert (reference.pipeline, reference.variant) == before
    _put_square(reference)
    assert reference.occluded((0.0, 0.0, -1.0), _LAMP)


def test_attributes(tracer: Any, tracer_case: tuple[str, str, str]) -> None:
    assert (tracer.device, tracer.pipeline, tracer.variant) == tracer_case
    assert isinstance(tracer.scene, Scene) and tracer.bounds.max_rays == 80_000


def test_warm_up_leaves_the_scene_alone(tracer: Any) -> None:
    _put_square(tracer)
    before = tracer.scene.revision, tracer.scene.names
    expected = tracer.occluded((0.0, 0.0, -1.0), _LAMP)
    assert tracer.warm_up() >= 0.0
    assert (tracer.scene.revision, tracer.scene.names) == before
    assert tracer.occluded((0.0, 0.0, -1.0), _LAMP) == expected and expected


@pytest.mark.parametrize("changes", range(5))
def test_warm_up_and_other_scenes_leave_nothing_behind(any_device: str, changes: int) -> None:
    """Whatever was traced before, also of a scene as often changed as this one: only the scene as it is now counts."""
    tracer = ShadowTracer("mesh_bvh", device=any_device, bounds=Bounds(max_triangles=100, max_rays=100))
    for k in range(changes):
        tracer.scene.put(f"square {k}", *geometry.square(2, k / 8.0, 1.0))
    tracer.warm_up()
    assert tracer.occluded((0.0, 0.0, -1.0), _LAMP) == (changes > 0)
    other = Scene(tracer.bounds)
    for k in range(changes):
        other.put(f"square {k}", *geometry.square(2, k / 8.0, 1.0, (5.0, 0.0)))
    tracer.scene = other
    assert not tracer.occluded((0.0, 0.0, -1.0), _LAMP)


def test_two_tracers_at_once(tracers: Any, any_device: str) -> None:
    """Tracers share nothing: scenes with the same names stay apart, answers alternate."""
    one, two = tracers(any_device, "mesh_bvh", "refit"), tracers(any_device, "mesh_bvh", "rebuild")
    one.scene.put("mesh", *geometry.square(2, 0.0, 1.0))
    two.scene.put("mesh", *geometry.square(2, 2.0, 1.0))
    for _ in range(3):
        assert one.occluded((0, 0, 1.0), _LAMP) != two.occluded((0, 0, 1.0), _LAMP)


def test_bounds_error_is_for_images_only(reference: Any) -> None:
    side = 300
    camera = Camera(side, side, 100.0, 100.0, 0.0, 0.0)
    with pytest.raises(BoundsError, match=r"^bounds\.max_rays:.*80000"):
        reference.trace(np.ones((side, side), np.float32), camera, [_LAMP])
    assert reference.occluded(np.zeros((side * side, 3)), DirectionalLight("sun", (0, 0, -1))).shape == (side * side,)
