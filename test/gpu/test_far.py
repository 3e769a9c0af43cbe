# SPDX-License-Identifier: Apache-2.0
"""Far lights, far origins, far samples and other scales: distance costs no exactness."""

from __future__ import annotations

from functools import cache
from typing import Any

import geometry
import numpy as np
import oracle
import pytest
from scenario import Scenario

from shadow_tracer import Bias, Camera, DirectionalLight, PointLight, State

_TRAVEL = np.array([2.0, 1.0, -2.0])  # length 3, so that distances along it are exact


@cache
def _sweep(exponent: int | None) -> Scenario:
    """Ground and clutter; the light 3 * 10^exponent metres away, or infinitely far for None."""
    rng = np.random.default_rng(11)
    vertices, triangles = geometry.join([geometry.square(2, 0.0, 12.0), geometry.soup(rng, 150, 0.4, 3.0)])
    vertices[4:, 2] += 3.5
    points = np.concatenate(
        [np.column_stack([rng.uniform(-9, 9, (600, 2)), np.zeros(600)]), rng.uniform((-5, -5, 0), (5, 5, 7), (300, 3))]
    )
    if exponent is None:
        return Scenario(points, DirectionalLight("sun", _TRAVEL), vertices, triangles, 0.01)
    return Scenario(points, PointLight("lamp", -_TRAVEL * 10.0**exponent), vertices, triangles, 0.01)


@pytest.mark.parametrize("exponent", [None, *range(9)])
def test_light_distance_sweep(tracer: Any, exponent: int | None) -> None:
    _sweep(exponent).check(tracer)


def test_far_lights_converge_to_the_sun() -> None:
    """Of the oracle, and so of all pipelines: fewer samples differ with each step, and at 3e8 m only those at a
    shadow's very edge."""
    sun = _sweep(None)
    differing = [int((_sweep(k).answer.hidden != sun.answer.hidden).sum()) for k in range(9)]
    assert (
        differing[0] > 50
        and differing[8] <= 1
        and all(b <= a + 2 for a, b in zip(differing[1:], differing[2:], strict=False))
    ), differing
    margin = oracle.occluded_float64(sun.points, sun.light, sun.vertices, sun.triangles, sun.bias).margin
    changed = _sweep(6).answer.hidden != sun.answer.hidden
    assert (margin[changed] < 1e-3).all(), "at 3e6 m a shadow over 10 m moves by less than a tenth of a millimetre"


@pytest.mark.parametrize("exponent", [None, 0, 2, 4, 6, 8])
def test_no_acne_on_a_plane(tracer: Any, exponent: int | None) -> None:
    """Samples up to a millimetre below a large tilted plane, one centimetre of bias, no shadow anywhere, however
    far the light."""
    rng = np.random.default_rng(12)
    turn = geometry.rotation(rng)
    if (turn @ [0, 0, 1]) @ _TRAVEL > 0:
        turn = turn @ np.diag([1.0, -1.0, -1.0])
    vertices, triangles = geometry.square(2, 0.0, 200.0)
    points = np.column_stack([rng.uniform(-20, 20, (2000, 2)), rng.uniform(-1e-3, 0.0, 2000)])
    light = (
        DirectionalLight("sun", turn @ [0.3, 0.2, -1.0])
        if exponent is None
        else PointLight("lamp", turn @ [-0.3, -0.2, 1.0] * 10.0**exponent * 30.0)
    )
    tracer.scene.put("plane", vertices @ turn.T, triangles)
    assert tracer.occluded(points @ turn.T, light, 0.01).sum() == 0
    assert tracer.occluded(points @ turn.T - turn @ [0, 0, 0.02], light, 0.01).all(), (
        "two centimetres below there is nothing but shadow"
    )


@pytest.mark.parametrize(
    "offset", [(2.0**19, 0.0, 0.0), (-(2.0**22), 2.0**19, 2.0**21), (2.0**19, 5.0 * 2.0**20, 128.0)]
)
@pytest.mark.parametrize("kind", ["point", "sun"])
def test_translated_scenes_have_the_same_bits(tracer: Any, offset: tuple[float, float, float], kind: str) -> None:
    """Coordinates are multiples of 2^-24: adding the offset is exact, so the scene is the same scene."""
    rng = np.random.default_rng(13)
    vertices, triangles = geometry.join([geometry.soup(rng, 200, 0.3, 2.0), geometry.icosphere(2, 1.5)])
    vertices, points = (np.round(x * 2.0**24) / 2.0**24 for x in (vertices, rng.uniform(-4, 4, (800, 3))))
    points = np.concatenate([points, 2.0 * vertices[-162:]])

    def hidden(shift: np.ndarray) -> np.ndarray:
        light = (
            PointLight("lamp", np.array([0.25, 0.125, 0.5]) + shift)
            if kind == "point"
            else DirectionalLight("sun", (1, 2, -4))
        )
        tracer.scene.put("mesh", vertices + shift, triangles)
        return tracer.occluded((points + shift)[:: 1 if tracer.variant != "float64" else 3], light, 0.001)

    here = hidden(np.zeros(3))
    assert 0.1 < here.mean() < 0.999
    np.testing.assert_array_equal(hidden(np.asarray(offset)), here)


@pytest.mark.parametrize("power", [-180, -130, -40, -20, 20, 40, 90])
def test_scaled_scenes_have_the_same_bits(tracer: Any, power: int) -> None:
    """A power of two scales everything exactly: atoms or galaxies, the same answer."""
    rng = np.random.default_rng(14)
    vertices, triangles = geometry.join([geometry.soup(rng, 150, 0.3, 2.0), geometry.square(2, -2.0, 5.0)])
    points = np.concatenate([rng.uniform(-3, 3, (500, 3)), vertices[:60]])
    answers = []
    for scale in (1.0, 2.0**power):
        tracer.scene.put("mesh", vertices * scale, triangles)
        answers.append(
            tracer.occluded(points * scale, PointLight("lamp", np.array([0.3, 0.4, 1.9]) * scale), 0.01 * scale)
        )
    np.testing.assert_array_equal(answers[0], answers[1])
    assert 0.1 < answers[0].mean() < 0.99


@cache
def _far_samples(distance: float) -> Scenario:
    rng = np.random.default_rng(15)
    vertices, triangles = geometry.join(
        [
            geometry.icosphere(3, 1e-3, (0.9, 0.1, 0.0)),
            geometry.icosphere(2, 0.5, (0.5, 4.0, 0.0)),
            geometry.soup(rng, 60, 0.02, 1.0),
        ]
    )
    light = np.array([1.5, 0.2, 0.1])
    ways = np.concatenate([vertices - light, rng.normal(size=(200, 3))])
    return Scenario(
        light + ways / np.linalg.norm(ways, axis=1, keepdims=True) * distance,
        PointLight("lamp", light),
        vertices,
        triangles,
    )


@pytest.mark.parametrize("distance", [1e3, 1e6, 1e9, 1e12, 1e15])
@pytest.mark.slow
def test_far_samples_of_a_small_scene(tracer: Any, distance: float) -> None:
    """The samples are far away, light and triangles small and together: the walk to the scene must not lose its aim."""
    scenario = _far_samples(distance)
    scenario.check(tracer)
    assert 0.3 < scenario.answer.hidden.mean() < 0.97


@cache
def _teapot_in_stadium(inside: bool) -> Scenario:
    """Five-millimetre triangles in a bowl of 300 m."""
    rng = np.random.default_rng(16)
    bowl_vertices, bowl = geometry.icosphere(3, 150.0)
    small_vertices, small = geometry.icosphere(4, 0.1, (1.0, 2.0, -3.0))
    vertices, triangles = geometry.join(
        [(bowl_vertices, bowl[bowl_vertices[bowl].mean(axis=1)[:, 2] < 20.0]), (small_vertices, small)]
    )
    light = np.array((1.3, 2.5, -2.4) if inside else (90.0, 80.0, 200.0))
    near = (1.0, 2.0, -3.0) + geometry.directions(rng, 600) * rng.uniform(0.099, 0.4, (600, 1))
    behind = light + (near - light) * rng.uniform(1.0, 1.5, (600, 1))
    return Scenario(
        np.concatenate([near, behind, geometry.directions(rng, 600) * 149.0]),
        PointLight("lamp", light),
        vertices,
        triangles,
        0.001,
    )


@pytest.mark.slow
@pytest.mark.parametrize("inside", [True, False], ids=["near", "outside"])
def test_teapot_in_stadium(tracer: Any, inside: bool) -> None:
    scenario = _teapot_in_stadium(inside)
    scenario.check(tracer)
    assert 0.05 < scenario.answer.hidden.mean() < 0.95


_ABSURD = [1e20, 1e35, 1e40, 1e50, 1e100, 1e120, 1e200, 1e300]


@cache
def _absurd(size: float) -> Scenario:
    rng = np.random.default_rng(17)
    vertices, triangles = geometry.soup(rng, 20, 1.0, 2.0)
    vertices[0], vertices[4] = (size, -0.3 * size, 0.2 * size), (-size, 0.3 * size, 0.0)
    return Scenario(rng.uniform(-4, 4, (200, 3)), PointLight("lamp", (0.1, 0.2, 0.3)), vertices, triangles)


@pytest.mark.parametrize("size", _ABSURD)
def test_absurd_vertices_are_refused_or_exact(tracer: Any, size: float) -> None:
    """A finite number that can be no length is no licence to shade everything: an error by name, or the right bits."""
    scenario = _absurd(size)
    tracer.scene.put("before", *geometry.square(2, -1.0, 1.0))
    try:
        tracer.scene.put("mesh", scenario.vertices, scenario.triangles)
    except ValueError as error:
        assert str(error).startswith("vertices:") and "vertex 0" in str(error) and tracer.scene.names == ("before",)
        return
    tracer.scene.remove("before")
    with np.errstate(over="ignore", invalid="ignore"):
        scenario.check(tracer)


@pytest.mark.parametrize("size", _ABSURD)
def test_absurd_samples_are_refused_or_exact(tracer: Any, size: float) -> None:
    """Outside a closed sphere around the light everything is in shadow, at any distance, for all in the call."""
    tracer.scene.put("sphere", *geometry.icosphere(1, 1.0))
    points = np.array([(size, 0.1 * size, 0.0), (0.0, 0.0, 2.0), (0.3, -size, size), (0.0, 0.0, 0.5)])
    try:
        hidden = tracer.occluded(points, PointLight("lamp", (0.0, 0.0, 0.0)))
    except ValueError as error:
        assert str(error).startswith("points:")
        return
    np.testing.assert_array_equal(hidden, [True, True, True, False])


@pytest.mark.parametrize("size", _ABSURD)
def test_absurd_lights_are_refused_or_exact(tracer: Any, size: float) -> None:
    tracer.scene.put("square", *geometry.square(2, 0.0, 2.0))
    points = np.array([(0.25, 0.5, -1.0), (0.25, 0.5, 1.0), (7.0, 0.0, -1.0)])
    try:
        light = PointLight("lamp", (0.0, 0.0, size))
    except ValueError as error:
        assert str(error).startswith("position:")
        return
    np.testing.assert_array_equal(tracer.occluded(points, light, 0.01), [True, False, False])


def test_a_few_pixels_at_the_end_of_the_world_blind_nobody(tracer: Any) -> None:
    """Measurements far beyond all others do not push the rest into the exact decision."""
    rng = np.random.default_rng(5)
    camera = Camera(48, 48, 40.0, 40.0, 23.5, 23.5)
    depth = rng.uniform(4.0, 5.0, (48, 48)).astype(np.float32)
    depth[1::16, 3::16] = 1e30
    tracer.scene.put("ball", *geometry.icosphere(3, 0.5, (0.0, 0.0, 3.0)))
    frame = tracer.trace(depth, camera, [PointLight("lamp", (0.3, -1.0, 0.2))], bias=0.01)
    assert 0.05 < (frame.state("lamp") == State.SHADOWED).mean() < 0.5
    if tracer.variant != "float64":
        assert frame.counters["retested"] < 20


@pytest.mark.parametrize("roof", [True, False])
def test_a_pixel_whose_bias_dwarfs_the_scene(tracer: Any, roof: bool) -> None:
    """A measurement far behind the others begins its ray hundreds of metres away, where float32 sees nothing of it; a
    roof farther on decides all the same."""
    camera = Camera(16, 16, 20.0, 20.0, 7.5, 7.5)
    depth = np.random.default_rng(5).uniform(4.0, 5.0, (16, 16)).astype(np.float32)
    depth[3, 3] = 300.0  # 30 times what nearly all have are left out of the frame that float32 works in
    tracer.scene.put("ball", *geometry.icosphere(1, 0.5, (0.0, 0.0, 3.0)))
    if roof:
        tracer.scene.put("roof", *geometry.square(1, -1500.0, 30.0, (-67.5, 300.0)))
    sun = DirectionalLight("sun", (0.0, 1.0, 0.0))
    frame = tracer.trace(depth, camera, [sun], bias=Bias(0.01, 0.01))  # 900 m
    assert frame.state("sun")[3, 3] == (State.SHADOWED if roof else State.LIT)
    assert frame.state("sun")[12, 12] == State.LIT
