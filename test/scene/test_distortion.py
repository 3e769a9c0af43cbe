# SPDX-License-Identifier: Apache-2.0
"""Rays of distorted images: the inverse of the models, what is refused, and cameras that hold a table of rays."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from shadow_tracer import Camera
from shadow_tracer.scene import distortion as module
from shadow_tracer.scene.camera import RayTable
from shadow_tracer.scene.distortion import ERROR, undistorted_rays

# Those of real cameras, and some that go far.
_AZURE = (5.7, 3.6, 1e-4, -5e-5, 0.19, 6.0, 5.4, 1.0)  # K, time of flight, unrectified
_D405 = (-0.05176, 0.05644, -0.00081, 0.00137, -0.01871)
_T265 = (-0.0037, 0.0388, -0.0368, 0.0062)
_MODELS: dict[str, tuple[str, tuple[float, ...], float]] = {
    "time of flight": ("rational_polynomial", _AZURE, 504.0),
    "colour": ("plumb_bob", _D405, 653.8),
    "four coefficients": ("plumb_bob", (-0.2, 0.03, 0.01, -0.02), 500.0),
    "strong barrel": ("plumb_bob", (-0.1, 0.004, 0.0, 0.0, 0.0), 300.0),
    "pincushion": ("plumb_bob", (0.4, 0.1, 0.003, 0.002, 0.1), 300.0),
    "tangential alone": ("plumb_bob", (0.0, 0.0, 0.03, -0.02, 0.0), 400.0),
    "thin prism": ("rational_polynomial", (*_AZURE, 0.001, -0.02, 0.03, 0.01), 504.0),
    "thin prism, no tilt": ("rational_polynomial", (*_AZURE, 0.001, -0.02, 0.03, 0.01, 0.0, 0.0), 504.0),
    "fisheye": ("equidistant", _T265, 286.0),
    "ideal fisheye": ("equidistant", (0.0, 0.0, 0.0, 0.0), 330.0),
}
_SIZE, _CENTRE = (640, 480), (311.25, 247.5)


def distort(model: str, d: Sequence[float], x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where rays with these x and y at z = 1 are seen, in the plane z = 1."""
    s = x * x + y * y
    if model == "equidistant":
        theta = np.arctan(np.sqrt(s))
        theta_d = theta * (1 + d[0] * theta**2 + d[1] * theta**4 + d[2] * theta**6 + d[3] * theta**8)
        scale = np.where(s > 0.0, theta_d / np.where(s > 0.0, np.sqrt(s), 1.0), 1.0)
        return x * scale, y * scale
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = [*d, *[0.0] * 12][:12]
    f = (1 + k1 * s + k2 * s**2 + k3 * s**3) / (1 + k4 * s + k5 * s**2 + k6 * s**3)
    return (
        x * f + 2 * p1 * x * y + p2 * (s + 2 * x * x) + s1 * s + s2 * s * s,
        y * f + p1 * (s + 2 * y * y) + 2 * p2 * x * y + s3 * s + s4 * s * s,
    )


def _rays(model: str, d: Sequence[float], focal: float, size: tuple[int, int] = _SIZE) -> np.ndarray:
    rays = undistorted_rays(model, d, size, (focal, 1.1 * focal), _CENTRE)
    assert rays is not None
    return rays


def _seen(focal: float, size: tuple[int, int] = _SIZE) -> tuple[np.ndarray, np.ndarray]:
    """Where the pixels lie in the plane z = 1."""
    u, v = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    return (u - _CENTRE[0]) / focal, (v - _CENTRE[1]) / (1.1 * focal)


@pytest.mark.parametrize("name", _MODELS)
def test_a_ray_is_seen_where_its_pixel_is(name: str) -> None:
    model, d, focal = _MODELS[name]
    rays, (xd, yd) = _rays(model, d, focal), _seen(focal)
    there = ~np.isnan(rays[..., 0])
    assert there.all() or model == "equidistant"
    limit = ERROR * (1.0 + np.hypot(xd, yd).max())
    for got, wanted in zip(distort(model, d, *np.moveaxis(rays, 2, 0)), (xd, yd), strict=True):
        assert np.abs(got - wanted)[there].max() <= limit
    assert np.hypot(rays[..., 0] - xd, rays[..., 1] - yd)[there].max() > 0.005, "hardly distorted at all"


# cv2.projectPoints and cv2.fisheye.projectPoints of OpenCV 5.0 for the points (0.3, -0.2, 1) and (-0.5, 0.4, 1).
_OPENCV = {
    "time of flight": ((0.28857118627889505, -0.19237212418593005), (-0.4458323116225241, 0.35669044929801935)),
    "colour": ((0.298777079039, -0.19917128602600004), (-0.491917526045, 0.393651280836)),
    "four coefficients": ((0.28495210000000004, -0.1904014), (-0.48372149999999997, 0.3845172)),
    "thin prism": ((0.28836318627889507, -0.18830312418593007), (-0.4487843116225241, 0.3706714492980193)),
    "fisheye": ((0.28794324861790765, -0.19196216574527178), (-0.4454857372315969, 0.35638858978527754)),
}


@pytest.mark.parametrize("name", _OPENCV)
def test_the_models_are_those_of_opencv(name: str) -> None:
    model, d, _ = _MODELS[name]
    seen = distort(model, d, np.array([0.3, -0.5]), np.array([-0.2, 0.4]))
    np.testing.assert_allclose(np.column_stack(seen), _OPENCV[name], rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("radius", [0.99, 1.01])
def test_a_radial_model_is_taken_up_to_where_it_turns_back(radius: float) -> None:
    """xd = x (1 + k1 r^2) is farthest out at r^2 = -1 / (3 k1), at two thirds of r."""
    farthest = radius * math.hypot(0.5, 0.5)
    k1 = -1.0 / (3.0 * (1.5 * farthest) ** 2)
    size, focal, centre = (101, 101), (100.0, 100.0), (50.0, 50.0)
    if radius > 1.0:
        rays = undistorted_rays("plumb_bob", (k1, 0, 0, 0), size, focal, centre)
        assert rays is not None and 1.2 * farthest < np.hypot(*rays[0, 0]) < 1.5 * farthest
    else:
        with pytest.raises(ValueError, match=r"^d: expected coefficients of plumb_bob that give every pixel one ray"):
            undistorted_rays("plumb_bob", (k1, 0, 0, 0), size, focal, centre)


def test_random_models_are_refused_or_one_to_one() -> None:
    """Neighbouring rays keep their order, and are those of their pixels: no two pixels share one."""
    rng = np.random.default_rng(7)
    taken = 0
    for _ in range(300):
        model = str(rng.choice(["plumb_bob", "rational_polynomial", "equidistant"]))
        count = int(rng.choice({"plumb_bob": [4, 5], "rational_polynomial": [8, 12], "equidistant": [4]}[model]))
        d = rng.normal(0.0, rng.choice([0.02, 0.3, 3.0]), count)
        size, focal, centre = (40, 30), (30.0, 30.0), tuple(rng.uniform(0.0, 30.0, 2))
        try:
            rays = undistorted_rays(model, d, size, focal, centre)
        except ValueError as error:
            assert "the image folds" in str(error)
            continue
        assert rays is not None
        taken += 1
        xd, yd = (np.arange(40) - centre[0]) / 30.0, (np.arange(30)[:, None] - centre[1]) / 30.0
        there = ~np.isnan(rays[..., 0])
        for got, wanted in zip(distort(model, d, *np.moveaxis(rays, 2, 0)), (xd, yd), strict=True):
            assert np.abs(got - wanted)[there].max(initial=0.0) <= ERROR * 4.0
        right, down = np.diff(rays, axis=1)[:-1], np.diff(rays, axis=0)[:, :-1]
        turn = right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0]
        assert (turn[~np.isnan(turn)] > 0.0).all()
    assert 60 < taken < 240


@pytest.mark.parametrize(
    ("model", "d", "message"),
    [
        ("fisheye", (0.1,) * 4, "distortion_model: expected one of plumb_bob, rational_polynomial, equidistant, got"),
        (None, (0.1,) * 4, "distortion_model: expected one of"),
        ("plumb_bob", (0.1,) * 8, "d: expected 4 or 5 coefficients of plumb_bob, got 8"),
        ("plumb_bob", (), "d: expected 4 or 5 coefficients of plumb_bob, got 0"),
        ("plumb_bob", 0.1, "d: expected a sequence of numbers, got float"),
        ("plumb_bob", ("0.1",) * 4, "d: expected finite numbers of at most 1e+09, got"),
        ("rational_polynomial", (0.1,) * 5, "d: expected 8 or 12 or 14 coefficients of rational_polynomial, got 5"),
        ("rational_polynomial", (*_AZURE, 0, 0, 0, 0, 0.01, 0), "d: expected no tilt of the sensor"),
        ("equidistant", (0.1,) * 5, "d: expected 4 coefficients of equidistant, got 5"),
        ("equidistant", (0.1, 0.1, math.nan, 0.1), "d: expected finite numbers of at most 1e+09, got"),
        ("plumb_bob", (math.inf, 0, 0, 0, 0), "d: expected finite numbers of at most 1e+09, got"),
        ("plumb_bob", (1e10, 0, 0, 0, 0), "d: expected finite numbers of at most 1e+09, got"),
        ("plumb_bob", (-1e9, 1e9, 1e9, 1e9, -1e9), "with which the image folds; calibrate the camera with fewer"),
        ("plumb_bob", (0, 0, 0.5, 0, 0), "with which the image folds"),
        ("rational_polynomial", (0, 0, 0, 0, 0, 3, 0, 0), "with which the image folds"),
        ("equidistant", (-0.3, 0, 0, 0), "with which the image folds"),
    ],
)
def test_what_is_refused(model: Any, d: Any, message: str) -> None:
    with pytest.raises(ValueError) as caught:
        Camera.distorted(640, 480, 300, 300, 320, 240, model, d)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("model", "d", "centre"),
    [
        # Every pixel has a ray that is seen there, but between them and the axis there are two of a kind.
        ("plumb_bob", (2.87, -0.36, -1.01, 0.28, 0.0), (25.0, 29.0)),
        # Numerator and denominator are the same, and 0 at r = 1.88.
        ("rational_polynomial", (0, -0.08, 0, 0, 0, 0, -0.08, 0), (38.0, 19.0)),
    ],
)
def test_folds_and_poles_on_the_way_to_a_pixel(model: str, d: Any, centre: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="with which the image folds"):
        undistorted_rays(model, d, (40, 30), (20.0, 20.0), centre)


def test_a_pole_that_no_ray_reaches_does_not_matter() -> None:
    """xd = x / (1 - 4 r^2) is all of the plane on this side of the pole, and is inverted close to it."""
    rays = undistorted_rays("rational_polynomial", (0, 0, 0, 0, 0, -4, 0, 0), (640, 480), (3.0, 3.0), (320.0, 240.0))
    assert rays is not None
    assert 0.49 < np.hypot(rays[..., 0], rays[..., 1]).max() < 0.5


def test_an_image_turned_round_is_not_taken_for_one_that_is_not() -> None:
    """xd = x (1 - r^2) at r = 100 / 31, the first place that is looked at on the way, and beyond."""
    assert not module._Polynomial((-1.0, 0.0, 0.0, 0.0)).leads_to(np.array([[100.0, 0.0]]))


def test_without_distortion_a_camera_is_a_pinhole() -> None:
    pinhole = Camera(64, 48, 60, 61, 31, 23)
    for model, count in (("plumb_bob", 5), ("plumb_bob", 4), ("rational_polynomial", 14)):
        camera = Camera.distorted(64, 48, 60, 61, 31, 23, model, [0.0] * count)
        assert camera.rays is None and camera == pinhole
    # That of a fisheye without corrections is none: the angle grows evenly with the distance.
    fisheye = Camera.distorted(64, 48, 60, 60, 31, 23, "equidistant", [0.0] * 4).pixel_rays()
    np.testing.assert_allclose(np.arctan(fisheye[23, :, 0]), (np.arange(64) - 31) / 60, rtol=1e-6)


def test_rays_of_90_degrees_and_more_are_none() -> None:
    camera = Camera.distorted(301, 3, 90, 90, 150, 1, "equidistant", [0.0] * 4)
    rays = camera.pixel_rays()
    angle = np.abs(np.arange(301) - 150) / 90
    np.testing.assert_array_equal(np.isnan(rays[1, :, 0]), angle >= 0.5 * math.pi)
    np.testing.assert_array_equal(np.isnan(rays[..., 0]), np.isnan(rays[..., 1]))
    assert np.isnan(camera.unproject(np.ones((3, 301), np.float32))[1, 0]).all()


def test_a_table_is_rounded_once_and_taken_as_exact() -> None:
    camera = Camera.distorted(64, 48, 60, 61, 31, 23, "plumb_bob", _D405)
    exact = undistorted_rays("plumb_bob", _D405, (64, 48), (60.0, 61.0), (31.0, 23.0))
    assert exact is not None and camera.rays.xy.dtype == np.float32
    np.testing.assert_array_equal(camera.rays.xy, exact.astype(np.float32))
    depth = np.random.default_rng(1).uniform(0.5, 9.0, (48, 64)).astype(np.float32)
    x, y = camera.rays.xy[..., 0].astype(np.float64), camera.rays.xy[..., 1].astype(np.float64)
    z = depth.astype(np.float64)
    np.testing.assert_array_equal(camera.unproject(depth), np.stack([x * z, y * z, z], axis=-1))


def test_cameras_are_compared_by_value() -> None:
    def made(rays: Any = None, fx: float = 60.0, pose: Any = None) -> Camera:
        return Camera(4, 3, fx, 60, 1, 1, np.eye(4) if pose is None else pose, rays)

    rays = np.random.default_rng(2).uniform(-1.0, 1.0, (3, 4, 2))
    other, moved, holes, zero = rays.copy(), np.eye(4), rays.copy(), np.eye(4)
    other[2, 3, 1], moved[0, 3], holes[0, 0], zero[0, 3] = 0.5, 1.0, np.nan, -0.0
    kinds = [made(), made(fx=61.0), made(pose=moved), made(rays), made(other), made(holes)]
    same = [made(pose=zero), made(fx=61), made(pose=moved.copy()), made(rays.copy()), made(other.tolist()), made(holes)]
    for number, camera in enumerate(kinds):
        assert [camera == each for each in same] == [number == k for k in range(len(same))]
        assert hash(camera) == hash(same[number])
    assert len({*kinds, *same}) == len(kinds)
    assert made() != "camera" and made(rays).rays != "rays"


def test_another_pose_keeps_the_table() -> None:
    camera = Camera.distorted(64, 48, 60, 61, 31, 23, "plumb_bob", _D405)
    pose = np.eye(4)
    pose[0, 3] = 2.0
    moved = dataclasses.replace(camera, camera_to_world=pose)
    assert moved.rays is camera.rays and moved.position[0] == 2.0 and "64 x 48" in repr(moved.rays)
    with pytest.raises(ValueError, match="read-only"):
        camera.rays.xy[0, 0] = 1.0


@pytest.mark.parametrize(
    ("rays", "message"),
    [
        (np.zeros((3, 4)), "rays: expected real numbers of shape (height, width, 2), got shape (3, 4)"),
        (np.zeros((3, 4, 3)), "rays: expected real numbers of shape"),
        (np.zeros((0, 4, 2)), "rays: expected real numbers of shape"),
        (np.zeros((3, 4, 2), complex), "rays: expected real numbers of shape (height, width, 2), got shape (3, 4, 2)"),
        ([[[0, 0]], [[0, 0, 0]]], "rays: expected shape (height, width, 2), got list"),
        (np.zeros((4, 3, 2)), "rays: expected shape (3, 4, 2) as the camera has, got (4, 3, 2)"),
        (np.full((3, 4, 2), np.inf), "rays: expected finite float32 numbers, or NaN for both"),
        (np.full((3, 4, 2), 1e39), "rays: expected finite float32 numbers, or NaN for both"),
        (np.full((3, 4, 2), (np.nan, 0.0)), "rays: expected finite float32 numbers, or NaN for both"),
        (np.ma.masked_greater(np.ones((3, 4, 2)), 0), "rays: expected an array without masked values"),
    ],
)
def test_bad_tables_are_refused(rays: Any, message: str) -> None:
    with pytest.raises(ValueError) as caught:
        Camera(4, 3, 60, 60, 1, 1, rays=rays)
    assert str(caught.value).startswith(message)
    assert RayTable(np.zeros((3, 4, 2))) == RayTable(np.zeros((3, 4, 2), np.int8))
