# SPDX-License-Identifier: Apache-2.0
"""A depth image as an occluder: compared corner by corner with a slow loop, and by the shadow that it casts."""

from __future__ import annotations

import math
from dataclasses import replace

import data
import numpy as np
import pytest
from depth_image import render

from shadow_tracer import Bias, Bounds, Camera, PointLight, Scene, ShadowTracer, State
from shadow_tracer.scene import depth_mesh as module
from shadow_tracer.scene.depth_mesh import depth_mesh

CAMERA = Camera(64, 48, 60.0, 61.0, 31.3, 23.8)
BOTH = pytest.mark.parametrize("dtype", [np.float32, np.uint16])


def slow(depth: np.ndarray, camera: Camera, step: int, max_jump: float) -> tuple[np.ndarray, set[tuple[int, ...]]]:
    """The same by the text of the docstring, a cell at a time; triangles start at their least corner."""
    metres = depth.astype(np.float64) / 1000.0 if depth.dtype == np.uint16 else depth.astype(np.float64)
    rows, columns = range(0, camera.height, step), range(0, camera.width, step)
    with np.errstate(invalid="ignore"):
        samples = camera.unproject(metres)[::step, ::step].reshape(-1, 3)
    z = [float(value) for value in metres[::step, ::step].ravel()]
    rays = np.isfinite(camera.pixel_rays()[::step, ::step]).all(axis=2).ravel()
    valid = [math.isfinite(value) and value > 0.0 and ray for value, ray in zip(z, rays, strict=True)]
    found = set()

    def near(*corners: int) -> bool:
        depths = [z[k] for k in corners]
        return all(valid[k] for k in corners) and max(depths) <= min(depths) * (1.0 + max_jump)

    for row in range(len(rows) - 1):
        for column in range(len(columns) - 1):
            a = row * len(columns) + column
            b, c, d = a + 1, a + len(columns), a + len(columns) + 1
            falls, rises = near(a, d), near(b, c)
            if falls and rises:
                falls = abs(z[a] - z[d]) <= abs(z[b] - z[c])
            if falls:
                candidates = [(a, c, d), (a, d, b)]
            elif rises:
                candidates = [(a, c, b), (b, c, d)]
            else:
                candidates = []
            found |= {corners for corners in candidates if near(*corners)}
    samples[~np.array(valid)] = 0.0
    return samples, {rotated(corners) for corners in found}


def rotated(corners: tuple[int, ...]) -> tuple[int, ...]:
    least = corners.index(min(corners))
    return (*corners[least:], *corners[:least])


def as_set(triangles: np.ndarray) -> set[tuple[int, ...]]:
    found = [rotated(tuple(corners)) for corners in triangles.tolist()]
    assert len(set(found)) == len(found)
    return set(found)


def random_depth(rng: np.random.Generator, dtype: type, shape: tuple[int, int]) -> np.ndarray:
    """Smooth ground, boxes in front of it, holes, and every kind of value that is no measurement."""
    height, width = shape
    depth = 2.0 + 0.01 * rng.normal(size=shape) + np.linspace(0.0, rng.uniform(0.0, 2.0), height)[:, None]
    for _ in range(4):
        top, left = rng.integers(0, max(height - 2, 1)), rng.integers(0, max(width - 2, 1))
        depth[top : top + rng.integers(1, 12), left : left + rng.integers(1, 12)] *= rng.uniform(0.5, 1.04)
    depth[rng.random(shape) < 0.05] = 0.0
    if dtype is np.uint16:
        return np.round(depth * 1000.0).astype(np.uint16)
    with np.errstate(over="ignore"):
        return np.where(
            rng.random(shape) < 0.05, rng.choice([np.nan, np.inf, -np.inf, -1.0, 3e38, 1e-45], shape), depth
        ).astype(np.float32)


@BOTH
@pytest.mark.parametrize("tabled", [False, True])
@pytest.mark.parametrize("step", [1, 2, 3, 7, 16, 100])
def test_equals_a_slow_loop(dtype: type, step: int, tabled: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng([step, dtype is np.uint16])
    for band, shape in ((1, (48, 64)), (200, (48, 64)), (10**6, (48, 64)), (100, (1, 64)), (100, (48, 1)), (9, (2, 2))):
        monkeypatch.setattr(module, "_BAND", band)
        camera = Camera(shape[1], shape[0], 60.0, 61.0, 31.3, 23.8)
        if tabled:
            rays = camera.pixel_rays()[..., :2] + rng.normal(0.0, 0.01, (*shape, 2))
            rays[rng.random(shape) < 0.05] = np.nan
            camera = replace(camera, rays=rays)
        depth = random_depth(rng, dtype, shape)
        max_jump = float(rng.choice([0.01, 0.05, 0.5, 1e6]))
        vertices, triangles = depth_mesh(depth, camera, step, max_jump)
        wanted_vertices, wanted_triangles = slow(depth, camera, step, max_jump)
        np.testing.assert_array_equal(vertices, wanted_vertices)
        assert as_set(triangles) == wanted_triangles
        assert vertices.dtype == np.float64 and triangles.dtype == np.int32
        for array in (vertices, triangles):  # so the scene takes them over without a copy
            assert array.flags.owndata and array.flags.c_contiguous and not array.flags.writeable


def test_a_strided_view_is_taken_as_it_is() -> None:
    depth = random_depth(np.random.default_rng(5), np.float32, (48, 128))[:, ::2]
    vertices, triangles = depth_mesh(depth, CAMERA, 2, 0.05)
    again = depth_mesh(np.ascontiguousarray(depth), CAMERA, 2, 0.05)
    np.testing.assert_array_equal(vertices, again[0])
    np.testing.assert_array_equal(triangles, again[1])


def test_triangles_are_counter_clockwise_seen_from_the_camera() -> None:
    vertices, triangles = depth_mesh(random_depth(np.random.default_rng(1), np.float32, (48, 64)), CAMERA, 1, 0.05)
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    assert len(triangles) > 1000
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0.0).all()


def test_a_whole_image_becomes_two_triangles_a_cell_and_a_hole_takes_those_at_its_pixel() -> None:
    depth = np.full((48, 64), 2.0, np.float32)
    assert len(depth_mesh(depth, CAMERA, 1, 0.05)[1]) == 2 * 47 * 63
    depth[20, 30] = np.nan
    triangles = depth_mesh(depth, CAMERA, 1, 0.05)[1]
    assert len(triangles) == 2 * 47 * 63 - 4  # of four cells, each, the half that the hole is a corner of
    assert 20 * 64 + 30 not in triangles
    assert len(depth_mesh(np.zeros((48, 64), np.uint16), CAMERA, 2, 0.05)[1]) == 0


@BOTH
def test_the_largest_jump_is_kept_and_the_next_depth_is_not(dtype: type) -> None:
    camera = Camera(2, 2, 1.0, 1.0, 0.0, 0.0)
    scale = 1000 if dtype is np.uint16 else 1
    depth = (np.array([[1.0, 1.0], [1.0, 1.25]]) * scale).astype(dtype)
    assert len(depth_mesh(depth, camera, 1, 0.25)[1]) == 2
    depth[1, 1] = 1251 if dtype is np.uint16 else np.nextafter(np.float32(1.25), np.float32(2.0))
    vertices, triangles = depth_mesh(depth, camera, 1, 0.25)
    np.testing.assert_array_equal(triangles, [[0, 2, 1]])


def test_absurd_focal_lengths_lose_corners_instead_of_making_infinite_ones() -> None:
    camera = Camera(3, 2, 1e-30, 1e-30, 0.0, 0.0)
    depth = np.array([[1e25, 1e25, 1.0], [1e25, 1e25, 1.0]], np.float32)
    vertices, triangles = depth_mesh(depth, camera, 1, 0.5)
    assert np.abs(vertices).max() <= 1e50
    assert len(triangles) == 0 and (vertices[1] == 0.0).all() and vertices[0, 2] > 0.0
    Scene().put("depth", vertices, triangles)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"depth": np.ones((48, 64))}, r"^depth: expected dtype float32 .* got float64"),
        ({"depth": np.ones((64, 48), np.float32)}, r"^depth: expected shape \(48, 64\) .* got \(64, 48\)"),
        ({"depth": np.ones(5, np.float32)}, r"^depth: expected shape"),
        ({"step": 0}, "^step: expected an integer of at least 1, got 0"),
        ({"step": 2.0}, "^step: "),
        ({"step": True}, "^step: "),
        ({"max_jump": 0.0}, "^max_jump: expected a number above 0 and at most 1e[+]06, got 0.0"),
        ({"max_jump": math.nan}, "^max_jump: "),
        ({"max_jump": math.inf}, "^max_jump: "),
    ],
)
def test_errors_name_the_argument(change: dict, text: str) -> None:
    arguments = {"depth": np.ones((48, 64), np.float32), "camera": CAMERA, "step": 1, "max_jump": 0.05} | change
    with pytest.raises(ValueError, match=text):
        depth_mesh(**arguments)


# The shadow. One tracer for all of them: making one costs more than tracing.


@pytest.fixture(scope="module")
def tracer() -> ShadowTracer:
    return ShadowTracer(device="cpu", bounds=Bounds(max_triangles=200_000, max_rays=320 * 240, max_lights=2))


def looking_down(height: float) -> np.ndarray:
    """A camera above the floor z = 0: x right, image rows towards -y."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = 0.3, -0.2, height
    return pose


@BOTH
@pytest.mark.parametrize("step", [1, 2])
def test_a_plate_over_a_floor_casts_the_shadow_that_geometry_says(tracer: ShadowTracer, dtype: type, step: int) -> None:
    """A square plate, half a metre over a floor, both of them only in the depth image; the light stands to the side, so
    that the camera sees the shadow. It is the plate seen from the light, projected on the floor."""
    camera = Camera(320, 240, 280.0, 280.0, 159.5, 119.5, looking_down(2.5))
    height, half = 0.5, 0.2
    corners = np.array([(-half, -half, height), (half, -half, height), (half, half, height), (-half, half, height)])
    floor = np.array([(-9.0, -9.0, 0.0), (9.0, -9.0, 0.0), (9.0, 9.0, 0.0), (-9.0, 9.0, 0.0)])
    square = np.array([(0, 1, 2), (0, 2, 3)])
    depth = render(camera, np.concatenate([corners, floor]), np.concatenate([square, square + 4]))
    lamp = np.array([-1.5, 0.4, 2.0])
    points = camera.unproject(depth)
    if dtype is np.uint16:
        depth = np.round(depth * 1000.0).astype(np.uint16)
    vertices, triangles = depth_mesh(depth, camera, step, 0.05)
    tracer.scene.clear()
    tracer.scene.put("depth", vertices, triangles, camera.camera_to_world)
    frame = tracer.trace(depth, camera, [PointLight("lamp", lamp)], bias=Bias(constant=0.02))
    shadowed = frame.state("lamp") == State.SHADOWED

    on_plate = points[..., 2] > height / 2
    share = (height - points[..., 2]) / (lamp[2] - points[..., 2])
    meeting = points + share[..., None] * (lamp - points)  # where the way to the lamp crosses the plane of the plate
    outside = np.abs(meeting[..., :2]).max(axis=-1) - half
    # The seen plate is as large as the pixels on it say: up to a cell smaller than the plate.
    cell = step * 2.0 / 280.0
    inner, outer = ~on_plate & (outside < -1.1 * cell), ~on_plate & (outside > 1e-3)
    assert inner.sum() > 500 and outer.sum() > 10_000
    assert shadowed[inner].all()
    assert not shadowed[outer].any()
    assert not shadowed[on_plate].any()


def test_without_bias_a_sample_at_a_corner_does_not_shadow_itself(tracer: ShadowTracer) -> None:
    """Vertices are the samples themselves, bit for bit, so each lies exactly on all triangles around it: of a surface
    bent towards the light nothing is in shadow, whatever the pose of the camera, and with no bias at all."""
    quarter = 0.4
    pose = np.eye(4)
    pose[:3, :3] = [
        [math.cos(quarter), -math.sin(quarter), 0.0],
        [math.sin(quarter), math.cos(quarter), 0.0],
        [0.0, 0.0, 1.0],
    ]
    pose[:3, 3] = 431_000.3, 5_400_000.7, 12.1
    camera = Camera(160, 120, 140.0, 141.0, 80.2, 59.1, pose)
    u, v = np.meshgrid(np.arange(160.0), np.arange(120.0))
    bowl = (2.0 - ((u - 80.2) / 140.0) ** 2 - ((v - 59.1) / 141.0) ** 2).astype(np.float32)
    vertices, triangles = depth_mesh(bowl, camera, 1, 0.2)
    tracer.scene.clear()
    tracer.scene.put("depth", vertices, triangles, pose)
    np.testing.assert_array_equal(tracer.scene["depth"].world_vertices(), camera.unproject(bowl).reshape(-1, 3))
    frame = tracer.trace(bowl, camera, [PointLight("lamp", camera.position)], bias=Bias(constant=0.0))
    assert (frame.state("lamp") == State.LIT).all()


def test_a_real_depth_image_shadows_itself(tracer: ShadowTracer) -> None:
    """A kitchen from a hand-held camera: a light where the camera is shadows nothing that the camera sees, one beside
    it throws the shadows of chairs and table."""
    depth, k, pose = data.frame("redkitchen", 0)
    depth = np.ascontiguousarray(depth[::2, ::2])
    camera = Camera(320, 240, k[0, 0] / 2, k[1, 1] / 2, k[0, 2] / 2, k[1, 2] / 2)
    vertices, triangles = depth_mesh(depth, camera, 1, 0.05)
    tracer.scene.clear()
    tracer.scene.put("depth", vertices, triangles)
    lamps = [PointLight("eye", (0.0, 0.0, 0.0)), PointLight("side", (0.6, -0.3, 0.0))]
    frame = tracer.trace(depth, camera, lamps, Bias(constant=0.02, quadratic=0.01))
    invalid = depth == 0
    for name in ("eye", "side"):
        assert ((frame.state(name) == State.INVALID) == invalid).all()
    assert not (frame.state("eye") == State.SHADOWED).any()
    share = (frame.state("side") == State.SHADOWED).sum() / (~invalid).sum()
    assert 0.1 < share < 0.2
