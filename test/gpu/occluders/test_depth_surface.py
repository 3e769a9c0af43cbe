# SPDX-License-Identifier: Apache-2.0
"""The surface of a depth image, made on the device: the bits of the mesh that ``depth_mesh`` makes on the host."""

from __future__ import annotations

from typing import Any

import numpy as np
import probe
import probe_occluders
import pytest

from shadow_tracer import Bias, Bounds, BoundsError, Camera, DirectionalLight, PointLight, Scene, ShadowTracer
from shadow_tracer.scene.camera import RayTable
from shadow_tracer.scene.depth_mesh import depth_box, depth_mesh

pytestmark = probe.in_both_forms
BOUNDS = Bounds(max_triangles=8192, max_rays=4096, max_lights=2, queue_capacity=4096, grid_entries=65536)
LIGHTS = (PointLight("lamp", (0.5, -0.5, 0.0)), DirectionalLight("sun", (0.3, 0.2, 1.0)))
BIAS = Bias(0.01)


def depth_of(rng: np.random.Generator, shape: tuple[int, int], dtype: Any) -> np.ndarray:
    """Noise, a step, holes and all that is no measurement."""
    depth = 2.0 + 0.2 * rng.random(shape)
    depth[shape[0] // 4 : shape[0] // 2, shape[1] // 4 :] -= 1.0
    if dtype is np.uint16:
        return np.where(rng.random(shape) < 0.1, 0, depth * 1000.0).astype(np.uint16)
    odd = rng.choice([np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-44], shape)
    return np.where(rng.random(shape) < 0.1, odd, depth).astype(np.float32)


def camera_of(shape: tuple[int, int], rng: np.random.Generator, rays: bool = False) -> Camera:
    height, width = shape
    pose = np.eye(4)
    pose[:3, 3] = rng.random(3)
    table = None
    if rays:
        xy = rng.random((height, width, 2)) - 0.5
        xy[rng.random(shape) < 0.1] = np.nan
        table = RayTable(xy)
    return Camera(width, height, 60.0, 61.0, width / 2 - 0.3, height / 2 + 0.2, pose, table)


def check(tracer: ShadowTracer, depth: np.ndarray, camera: Camera, step: int, jump: float) -> int:
    """What is on the device is what the host makes; how many triangles there are."""
    mesh = tracer.scene.put_depth("depth", depth, camera, step, jump)
    tracer.occluded(np.zeros((1, 3)), LIGHTS[0])
    vertices, triangles = depth_mesh(depth, camera, step, jump)
    world, found = probe_occluders.corners_and_triangles(tracer, "depth")
    there = found[:, 0] >= 0
    assert ((found >= 0) == there[:, None]).all()
    assert set(map(tuple, found[there].tolist())) == set(map(tuple, triangles.tolist()))
    assert there.sum() == len(triangles) and len(found) == mesh.triangle_count
    np.testing.assert_array_equal(mesh.triangles[there], found[there])  # in the same places
    assert (mesh.triangles[~there] == mesh.triangles[~there][:, :1]).all()
    np.testing.assert_array_equal(mesh.vertices, vertices)
    np.testing.assert_array_equal(world, mesh.world_vertices())
    low, high = mesh.box()
    assert (low <= vertices.min(axis=0)).all() and (vertices.max(axis=0) <= high).all()
    return len(triangles)


def test_every_corner_and_triangle_in_sequences_of_unlike_images() -> None:
    rng, tracer, some = np.random.default_rng(0), ShadowTracer("brute_force", device="cpu", bounds=BOUNDS), 0
    shapes = [(24, 32), (3, 40), (40, 2), (1, 9), (9, 1), (1, 1), (32, 24), (48, 64)]
    for number in range(24):
        shape = shapes[number % len(shapes)]
        dtype = (np.float32, np.uint16)[int(rng.integers(2))]
        camera = camera_of(shape, rng, rays=number % 3 == 1)
        jump = float(rng.choice([1e-3, 0.05, 0.6, 1e6]))
        some += check(tracer, depth_of(rng, shape, dtype), camera, int(rng.integers(1, 4)), jump)
    assert some > 5000


def test_ties_jumps_to_the_last_bit_and_absurd_cameras() -> None:
    tracer = ShadowTracer("brute_force", device="cpu", bounds=BOUNDS)
    camera = Camera(2, 2, 1.0, 1.0, 0.5, 0.5)
    for jump in (0.25, 0.5):
        for far in (1.25, 1.5, np.nextafter(np.float32(1.25), np.float32(2)), np.nextafter(np.float32(1.5), 2)):
            for place in range(4):
                depth = np.ones((2, 2), np.float32)
                depth.flat[place] = far
                check(tracer, depth, camera, 1, jump)
    depth = np.array([[1.0, 1.2], [1.2, 1.0]], np.float32)
    assert check(tracer, depth, camera, 1, 0.5) == 2
    assert check(tracer, np.full((2, 2), 2.0, np.float32), camera, 1, 0.5) == 2
    steep = Camera(4, 4, 1e-30, 1.0, 1.5, 1.5)
    check(tracer, np.full((4, 4), 3e38, np.float32), steep, 1, 0.5)
    check(tracer, np.full((4, 4), 3e-44, np.float32), steep, 1, 0.5)


@pytest.mark.parametrize("pipeline", ["light_grid", "cone_hierarchy", "mesh_bvh", "bvh", "height_field"])
def test_masks_are_those_of_the_mesh(pipeline: str) -> None:
    """Beside another mesh, that comes and goes, with lights that ignore the one or the other; the camera moves."""
    rng = np.random.default_rng(1)
    tracer = ShadowTracer(pipeline, device="cpu", bounds=BOUNDS)
    truth = ShadowTracer("brute_force", device="cpu", bounds=BOUNDS)
    vertices, triangles = rng.random((30, 3)) + (-0.5, -0.5, 0.8), rng.integers(0, 30, (10, 3))
    lights = (*LIGHTS[:1], DirectionalLight("sun", (0.3, 0.2, 1.0), ignore=("depth",)))
    shadowed = 0
    for number in range(5):
        depth, camera = depth_of(rng, (24, 32), np.float32), camera_of((24, 32), rng)
        for each in (tracer, truth):
            if number in (1, 4):
                each.scene.put("plate", vertices + 0.1 * number, triangles)
            elif "plate" in each.scene:
                each.scene.remove("plate")
        tracer.scene.put_depth("depth", depth, camera, 1, 0.05)
        truth.scene.put("depth", *depth_mesh(depth, camera, 1, 0.05), camera.camera_to_world)
        if number == 3:
            for each in (tracer, truth):
                each.scene.move("depth", np.eye(4))
        chosen = lights if number % 2 else LIGHTS
        got, wanted = (each.trace(depth, camera, chosen, BIAS) for each in (tracer, truth))
        for light in chosen:
            np.testing.assert_array_equal(got.state(light.name), wanted.state(light.name))
            shadowed += int((got.mask(light.name) == 0).sum())
        if pipeline == "light_grid":
            assert tracer.verify(depth, camera, chosen, BIAS) == 0
    assert shadowed > 500


def test_a_mesh_takes_its_place_and_the_other_way_round() -> None:
    rng = np.random.default_rng(2)
    tracer = ShadowTracer("brute_force", device="cpu", bounds=BOUNDS)
    camera = camera_of((12, 16), rng)
    for number in range(6):
        depth = depth_of(rng, (12, 16), np.float32)
        vertices, triangles = depth_mesh(depth, camera, 1, 0.05)
        if number % 2:
            tracer.scene.put("depth", vertices, triangles, camera.camera_to_world)
            tracer.occluded(np.zeros((1, 3)), LIGHTS[0])
            world, found = probe_occluders.corners_and_triangles(tracer, "depth")
            np.testing.assert_array_equal(found, triangles)
            np.testing.assert_array_equal(world, tracer.scene["depth"].world_vertices())
        else:
            check(tracer, depth, camera, 1, 0.05)
    tracer.scene.put_depth("depth", depth, camera)
    with pytest.raises(ValueError, match="surface of a depth image"):
        tracer.scene.deform("depth", tracer.scene["depth"].vertices)
    tracer.scene.remove("depth")
    assert (tracer.scene.triangle_count, tracer.scene.vertex_count) == (0, 0)


def test_what_does_not_fit_or_is_malformed_changes_nothing() -> None:
    scene = Scene(Bounds(max_triangles=100))
    camera = Camera(8, 8, 8.0, 8.0, 4.0, 4.0)
    depth = np.ones((8, 8), np.float32)
    kept = scene.put_depth("depth", depth, camera)
    assert (kept.triangle_count, kept.vertex_count) == (98, 64)
    depth[:] = 7.0  # it was copied
    assert kept.vertices[0, 2] == 1.0
    revision = scene.revision
    with pytest.raises(BoundsError, match=r"^bounds.max_triangles: mesh 'other' has 98 triangles"):
        scene.put_depth("other", depth, camera)
    for arguments, text in (
        ((depth[:4], camera), "^depth: expected shape"),
        ((depth, camera, 0), "^step: "),
        ((depth, camera, 1, 0.0), "^max_jump: "),
    ):
        with pytest.raises(ValueError, match=text):
            scene.put_depth("depth", *arguments)
    assert scene.revision == revision and scene["depth"] is kept


def test_the_host_makes_no_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    from shadow_tracer.scene import parts

    def never(*_arguments: Any) -> Any:
        raise AssertionError("a mesh on the host")

    monkeypatch.setattr(parts, "depth_cells", never)
    rng = np.random.default_rng(3)
    for pipeline in ("light_grid", "cone_hierarchy", "height_field", "brute_force"):
        tracer = ShadowTracer(pipeline, device="cpu", bounds=BOUNDS)
        for _ in range(2):
            depth, camera = depth_of(rng, (24, 32), np.float32), camera_of((24, 32), rng)
            tracer.scene.put_depth("depth", depth, camera)
            tracer.trace(depth, camera, LIGHTS, BIAS)


def test_a_box_without_corners() -> None:
    low, high = depth_box(np.zeros((4, 4), np.uint16), Camera(4, 4, 4.0, 4.0, 2.0, 2.0), 1)
    assert low.tolist() == high.tolist() == [0.0, 0.0, 0.0]
