# SPDX-License-Identifier: Apache-2.0
"""Real meshes and real depth frames: every pixel of subsampled images against the oracle, ties decided exactly,
none left out.

Views and lights are those the data's README recommends. Brute force gets fewer of the pixels, so that it stays in
seconds on a CPU.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import data
import geometry
import numpy as np
import oracle
import probe
import pytest
from scenario import compare, stride_for

from shadow_tracer import Bias, Camera, DirectionalLight, PointLight, State

_BIAS = Bias(0.02, 0.0)


@cache
def _rgbd(sequence: str, number: int, step: int) -> tuple[np.ndarray, Camera]:
    """Every `step`-th pixel of a frame; step is a power of two, so the camera of the smaller image is exact."""
    depth, k, pose = data.frame(sequence, number)
    turn = pose[:3, :3]
    u, _, vt = np.linalg.svd(turn)  # poses are printed with 8 digits
    small = np.ascontiguousarray(depth[::step, ::step])
    height, width = small.shape
    return small, Camera(
        width,
        height,
        k[0, 0] / step,
        k[1, 1] / step,
        k[0, 2] / step,
        k[1, 2] / step,
        geometry.pose_of(u @ vt, pose[:3, 3]),
    )


_FRAMES = [("redkitchen", 0), ("redkitchen", 250), ("livingroom1", 0), ("livingroom1", 50)]


def _room_lights(sequence: str, camera: Camera) -> list[Any]:
    """A lamp on the ceiling (y is down), a torch beside the camera, and the sun through the roof."""
    ceiling = (0.5, -1.1, 2.2) if sequence == "redkitchen" else (0.4, -1.0, 1.8)
    torch = camera.camera_to_world[:3, :3] @ [0.35, -0.2, 0.0] + camera.camera_to_world[:3, 3]
    return [PointLight("ceiling", ceiling), PointLight("torch", torch), DirectionalLight("sun", (0.3, 0.8, 0.2))]


@cache
def _rgbd_expected(sequence: str, number: int) -> tuple[np.ndarray, np.ndarray]:
    """(hidden, tie), each (lights, H, W)."""
    vertices, triangles = data.mesh(f"rgbd_{sequence}_fused")
    depth, camera = _rgbd(sequence, number, 8)
    points = camera.unproject(np.where(depth > 0, depth, 1000) / 1000.0)
    answers = [
        oracle.occluded(points, light, vertices, triangles, _BIAS.constant, cull=True)
        for light in _room_lights(sequence, camera)
    ]
    shape = (len(answers), *depth.shape)
    return np.stack([a.hidden for a in answers]).reshape(shape), np.stack([a.tie for a in answers]).reshape(shape)


@pytest.mark.slow
@pytest.mark.parametrize("sequence,number", _FRAMES)
def test_depth_frames_against_fused_meshes(tracer: Any, kernel_form: str, sequence: str, number: int) -> None:
    vertices, triangles = data.mesh(f"rgbd_{sequence}_fused")
    tracer.scene.put("room", vertices, triangles)
    coarser = 1
    if tracer.pipeline == "brute_force":
        coarser = 4 if tracer.variant == "filtered" and kernel_form == probe.USUAL else 16
    depth, camera = _rgbd(sequence, number, 8 * coarser)
    hidden, tie = _rgbd_expected(sequence, number)
    frame = tracer.trace(depth, camera, _room_lights(sequence, _rgbd(sequence, number, 8)[1]), _BIAS)
    points = camera.unproject(depth / 1000.0)
    for index, name in enumerate(frame.names):
        state = frame.state(name)
        np.testing.assert_array_equal(state == State.INVALID, depth == 0)
        some = depth > 0
        compare(
            state[some] == State.SHADOWED,
            hidden[index, ::coarser, ::coarser][some],
            tie[index, ::coarser, ::coarser][some],
            points[some],
        )
    valid = _rgbd(sequence, number, 8)[0] > 0
    assert (
        valid.mean() > 0.7
        and 0.02 < hidden[0][valid].mean() < 0.9
        and hidden[1][valid].mean() < hidden[2][valid].mean()
    )


_VIEWS: dict[str, tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]] = {
    # eye, target, light
    "sponza_dabrovic": ((-12, 3, 0), (5, 4, 0), (0, 12, 0)),
    "conference": ((1000, 450, 400), (200, 100, -300), (300, 550, -200)),
    "cornell_box": ((0, 1, 3.4), (0, 1, 0), (0, 1.5, 0)),
    "sibenik": ((-16, -13, 0), (0, -12, 0), (0, -4, 0)),
}


def _surface(
    vertices: np.ndarray, triangles: np.ndarray, eye: np.ndarray, target: np.ndarray, count: int
) -> np.ndarray:
    """Samples on the mesh, by area, within 60 degrees of the view direction. (What hides them from the eye does not
    matter to the light.)"""
    rng = np.random.default_rng(110)
    corners = vertices.astype(np.float64)[triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = corners[rng.choice(len(corners), 6 * count, p=area / area.sum())]
    points = (chosen * rng.dirichlet([1, 1, 1], len(chosen))[:, :, None]).sum(axis=1)
    way, view = points - eye, (target - eye) / np.linalg.norm(target - eye)
    return points[way @ view > 0.5 * np.linalg.norm(way, axis=1)][:count]


@cache
def _view(name: str, sun: bool) -> tuple[np.ndarray, Any, float, oracle.Answer]:
    vertices, triangles = data.mesh(name)
    eye, target, lamp = (np.asarray(v, np.float64) for v in _VIEWS[name])
    points = _surface(vertices, triangles, eye, target, 3000)
    light = DirectionalLight("sun", (0.3, -1.0, 0.2)) if sun else PointLight("lamp", lamp)
    bias = 1e-4 * float(np.ptp(vertices, axis=0).max())
    return points, light, bias, oracle.occluded(points, light, vertices, triangles, bias, cull=True)


@pytest.mark.slow
@pytest.mark.parametrize("sun", [False, True], ids=["lamp", "sun"])
@pytest.mark.parametrize("name", _VIEWS)
def test_architecture(tracer: Any, name: str, sun: bool) -> None:
    vertices, triangles = data.mesh(name)
    points, light, bias, answer = _view(name, sun)
    step = stride_for(tracer, len(points), len(triangles))
    tracer.scene.put("mesh", vertices, triangles)
    compare(tracer.occluded(points[::step], light, bias), answer.hidden[::step], answer.tie[::step], points[::step])
    assert len(points) > 1000 and 0.05 < answer.hidden.mean() <= 1.0


@pytest.mark.slow
def test_conference_has_the_degenerate_triangles_it_is_known_for(tracer: Any) -> None:
    """53,627 triangles of zero area. They cast nothing: without them the bits are the same."""
    vertices, triangles = data.mesh("conference")
    points, light, bias, answer = _view("conference", False)
    tracer.scene.put("mesh", vertices, triangles)
    assert tracer.scene["mesh"].degenerate_count == 53_627
    corners = vertices.astype(np.float64)[triangles]
    area = np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])).max(axis=1)
    kept = triangles[area > 0]
    assert len(triangles) - len(kept) == 53_627
    step = stride_for(tracer, len(points), len(triangles))
    tracer.scene.put("mesh", vertices, kept)
    compare(tracer.occluded(points[::step], light, bias), answer.hidden[::step], answer.tie[::step], points[::step])


@cache
def _robots(frame: int) -> tuple[np.ndarray, np.ndarray, oracle.Answer]:
    vertices = data.motion("bart_robots_t10")[frame]
    _, triangles = data.mesh("bart_robots_t10")
    points = _surface(
        vertices,
        triangles[np.linalg.norm(np.ptp(vertices[triangles], axis=1), axis=1) < 5.0],
        np.array([-7.0, 6.0, -140.0]),
        np.array([0.0, 3.0, -165.0]),
        1500,
    )
    return vertices, points, oracle.occluded(points, _ROBOT_LAMP, vertices, triangles, 0.01, cull=True)


_ROBOT_LAMP = PointLight("lamp", (0.0, 27.0, -165.0))


@pytest.mark.slow
def test_robots_in_motion(tracer: Any) -> None:
    """Five moments of the BART robots: the same triangles, 87 % of the vertices move, so a tree is refitted, not
    built."""
    _, triangles = data.mesh("bart_robots_t10")
    tracer.scene.put("robots", _robots(0)[0], triangles)
    topology = tracer.scene["robots"].topology_revision
    for frame in range(5):
        vertices, points, answer = _robots(frame)
        tracer.scene.deform("robots", vertices)
        step = stride_for(tracer, len(points), len(triangles))
        compare(
            tracer.occluded(points[::step], _ROBOT_LAMP, 0.01),
            answer.hidden[::step],
            answer.tie[::step],
            points[::step],
        )
        assert len(points) > 1000 and 0.05 < answer.hidden.mean() < 0.999
    assert tracer.scene["robots"].topology_revision == topology


@pytest.mark.parametrize("name", ["sponza_dabrovic", pytest.param("bart_robots_t10", marks=pytest.mark.slow)])
def test_pipelines_equal_brute_force_on_real_meshes(tracer: Any, tracers: Any, kernel_form: str, name: str) -> None:
    reference = "filtered"
    if (tracer.pipeline, tracer.variant) == ("brute_force", reference):
        if kernel_form == probe.USUAL:
            pytest.skip("this is what the others are compared with")
        reference = "float64"
    vertices, triangles = data.mesh(name)
    rng = np.random.default_rng(111)
    step = 15 if "float64" in (tracer.variant, reference) else 1
    points = vertices[rng.integers(0, len(vertices), 300)].astype(np.float64)[::step]
    low, high = vertices.min(axis=0).astype(float), vertices.max(axis=0).astype(float)
    brute = tracers(tracer.device, "brute_force", reference)
    for light in (PointLight("lamp", 0.5 * (low + high)), DirectionalLight("sun", (0.3, -1.0, 0.2))):
        for made in (brute, tracer):
            made.scene.put("mesh", vertices, triangles)
        np.testing.assert_array_equal(
            tracer.occluded(points, light),
            brute.occluded(points, light),
            err_msg="samples exactly on vertices, no bias",
        )
