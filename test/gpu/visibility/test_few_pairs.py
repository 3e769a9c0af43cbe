# SPDX-License-Identifier: Apache-2.0
"""Few points and triangles, of which every pair is asked about in one launch: the bits of ``brute_force``, whatever
comes in between, and nothing of a frame is touched."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import geometry
import numpy as np
import probe
import pytest

from shadow_tracer import (
    Bounds,
    BoundsError,
    Camera,
    DirectionalLight,
    PointLight,
    ShadowTracer,
    SphereLight,
    SpotLight,
)
from shadow_tracer.gpu.visibility.few_pairs import FewPairs, are_few

_BOUNDS = Bounds(max_triangles=600, max_rays=20_000, max_lights=4)
_LAMP = PointLight("lamp", (0.25, -0.5, 3.0))
_LIGHTS = [
    _LAMP,
    PointLight("near", (0.0, 0.0, 1.0), 2.5),
    SpotLight("spot", (1.0, 2.0, 3.0), (-0.25, -0.5, -1.0), 0.6, 6.0),
    DirectionalLight("sun", (0.25, 0.5, -1.0)),
]


@pytest.fixture(params=[probe.EVERY_PAIR])
def kernel_form(request: pytest.FixtureRequest) -> Iterator[str]:
    with probe.form(request.param):
        yield request.param


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many points were asked about all triangles, call by call."""
    counts: list[int] = []
    ask = FewPairs.ask

    def counted(self: FewPairs, points: Any, *rest: Any) -> Any:
        counts.append(len(points))
        return ask(self, points, *rest)

    monkeypatch.setattr(FewPairs, "ask", counted)
    return counts


def _tracer(names: str = "light_grid", **more: Any) -> ShadowTracer:
    return ShadowTracer(*names.split("/"), device="cpu", bounds=_BOUNDS, threads=1, **more)


def _pair() -> tuple[ShadowTracer, ShadowTracer]:
    return _tracer(), _tracer("brute_force")


def _points(rng: np.random.Generator, count: int, reach: float = 3.0) -> np.ndarray:
    """Some of them on a raster, where much is undecided."""
    points = rng.uniform(-reach, reach, (count, 3))
    points[::3] = np.round(4.0 * points[::3]) / 4.0
    return points


def _raster(rng: np.random.Generator, count: int) -> np.ndarray:
    """Corners of triangles, of multiples of a quarter."""
    corners = rng.integers(-8, 9, (count, 1, 3)) + rng.integers(-6, 7, (count, 3, 3))
    return corners.reshape(-1, 3) / 4.0


def _put(tracers: Any, vertices: np.ndarray) -> None:
    for tracer in tracers:
        tracer.scene.put("mesh", vertices, np.arange(len(vertices), dtype=np.int32).reshape(-1, 3))


# Sixteen lanes, 64 triangles, 512 points: below, at and beyond.
@pytest.mark.parametrize("triangles", [1, 15, 16, 17, 63, 64, 65, 129, 600])
@pytest.mark.parametrize("count", [1, 2, 15, 16, 17, 511, 512, 513, 1100])
def test_the_bits_of_brute_force(asked: list[int], triangles: int, count: int) -> None:
    rng = np.random.default_rng(1000 * triangles + count)
    ours, right = tracers = _pair()
    for bias in (0.0, 0.25, 1e-12):
        _put(tracers, _raster(rng, triangles))
        points = _points(rng, count)
        for tracer in tracers:
            tracer.front_face_culling = bias == 0.25
        np.testing.assert_array_equal(ours.states_at(points, _LIGHTS, bias), right.states_at(points, _LIGHTS, bias))
        for light in _LIGHTS:
            np.testing.assert_array_equal(ours.occluded(points, light, bias), right.occluded(points, light, bias))
    assert asked == [count] * 15


def test_each_point_gets_its_own_answer() -> None:
    """Those that are left come together: what is found out of a ray is about its point. Every second point lies under a
    triangle; of the others every second one exactly under corners of further ones, or a little beside, which float32
    cannot decide."""
    rng = np.random.default_rng(5)
    corners = [(-1.0, -1.0, 1.0), (1.0, -1.0, 1.0), (0.0, 1.0, 1.0)]
    roofs = np.array([[(2 * k + x, y, z) for x, y, z in corners] for k in range(200)])
    _put(tracers := _pair(), np.concatenate([roofs, roofs[::4] + (0.0, 1.0, 1.0)]).reshape(-1, 3))
    sun = DirectionalLight("sun", (0.0, 0.0, -1.0))
    for _ in range(5):
        number = rng.permutation(400)
        x = number + 2.0**-40 * (number % 16 == 9)
        hidden = [tracer.occluded(np.stack([x, 0.0 * x, 0.0 * x], axis=1), sun) for tracer in tracers]
        under = (number % 16 == 1) | ((number % 8 == 7) & (number < 399))
        np.testing.assert_array_equal(hidden[0], (number % 2 == 0) | under)
        np.testing.assert_array_equal(*hidden)


@pytest.mark.parametrize("scale", [1e-12, 1e-3, 1e9, 1e15])
@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_anywhere_and_any_size(scale: float, offset: float) -> None:
    rng = np.random.default_rng(6)
    tracers = _pair()
    for distance in (0.0, 2.0, 1e3, 1e12):
        place = offset * scale * np.array([1.0, -1.0, 0.5])
        _put(tracers, scale * _raster(rng, 40) + place)
        points = scale * _points(rng, 300) + place
        light = PointLight("lamp", scale * distance * np.array([0.5, 1.0, 0.25]) + place)
        hidden = [tracer.occluded(points, light, 0.01 * scale) for tracer in tracers]
        np.testing.assert_array_equal(*hidden)


def test_points_far_apart_at_the_light_and_in_one_place() -> None:
    tracers = _pair()
    _put(tracers, _raster(np.random.default_rng(7), 50))
    far = np.array([(1e50, -1e50, 1e50), (0.0, 0.0, 0.0), (1e-50, 0.0, 0.0), (-1e50, 3.0, 1.0), (0.25, -0.5, 3.0)])
    for points in (far, far[4:], far[1:2], np.repeat(far[1:2], 600, axis=0)):
        for light in _LIGHTS:
            for bias in (0.0, 0.5, 1e40):
                np.testing.assert_array_equal(*(tracer.occluded(points, light, bias) for tracer in tracers))


def test_what_casts_nothing(asked: list[int]) -> None:
    """Degenerate triangles, corners that are no numbers, meshes that cast nothing, and gaps where one has been."""
    rng = np.random.default_rng(8)
    ours, right = tracers = _pair()
    points = _points(rng, 700)
    for tracer in tracers:
        tracer.scene.put("first", *geometry.icosphere(1, 0.5))
        vertices, triangles = geometry.soup(np.random.default_rng(9), 60, 1.0, 2.0)
        vertices[::7] = np.nan
        vertices[1::30] = vertices[2::30]
        tracer.scene.put("second", vertices, triangles, nonfinite="skip")
        tracer.scene.put("quiet", *geometry.square(2, 1.0, 9.0), cast_shadows=False)
    np.testing.assert_array_equal(*(tracer.occluded(points, _LAMP) for tracer in tracers))
    for tracer in tracers:
        tracer.scene.remove("first")
    np.testing.assert_array_equal(*(tracer.occluded(points, _LAMP) for tracer in tracers))
    assert right.occluded(points, _LAMP).any()
    for tracer in tracers:
        tracer.scene.clear()
    assert not ours.occluded(points, _LAMP).any() and asked == [700, 700]


def test_who_is_asked(asked: list[int]) -> None:
    """The pipeline where the question is another one, or the pipeline was chosen to be asked."""
    points = _points(np.random.default_rng(10), 50)
    nowhere = np.where(np.arange(50)[:, None] == 3, np.nan, points)
    bulb = SphereLight("bulb", (0.0, 0.0, 3.0), 0.25, samples=4)
    some = PointLight("lamp", _LAMP.position, ignore=("b",))
    tracer, right = tracers = _pair()
    for each in tracers:
        each.scene.put("a", *geometry.square(2, 1.0, 1.0))
        each.scene.put("b", *geometry.square(2, 0.5, 2.0))
    for count, (where, lights) in enumerate(
        [(points, [_LAMP]), (nowhere, [_LAMP]), (points, [_LAMP, bulb]), (points, [some]), (points[:0], [_LAMP])]
    ):
        np.testing.assert_array_equal(tracer.states_at(where, lights), right.states_at(where, lights))
        assert asked == [50], count
    for names in ("cone_hierarchy", "mesh_bvh", "light_grid/spherical", "brute_force"):
        tracer.select(*names.split("/"))
        tracer.occluded(points, _LAMP)
    assert asked == [50]
    tracer.select("auto")
    np.testing.assert_array_equal(tracer.occluded(points, _LAMP), right.occluded(points, _LAMP))
    assert asked == [50, 50]


def test_many_are_not_few(asked: list[int]) -> None:
    tracer, right = tracers = _pair()
    _put(tracers, _raster(np.random.default_rng(11), 20))
    points = _points(np.random.default_rng(12), 240)
    with probe.few_pairs(1000):  # and 150 for each triangle
        for count in (200, 201, 100, 200):
            np.testing.assert_array_equal(*(each.occluded(points[:count], _LAMP) for each in tracers))
        for lights in (_LIGHTS[:2], _LIGHTS[:3]):
            np.testing.assert_array_equal(*(each.states_at(points[:100], lights) for each in tracers))
    assert asked == [200, 100, 200, 100]


def test_nothing_of_a_frame_is_touched(asked: list[int]) -> None:
    """Frames, few points and many in turn; the image is still there, and so is what verify knows of its frame."""
    rng = np.random.default_rng(13)
    ours, right = tracers = _pair()
    camera = Camera(40, 30, 30.0, 30.0, 19.5, 14.5)
    for step in range(6):
        if step % 2 == 0:
            _put(tracers, _raster(rng, int(rng.integers(1, 300))))
        depth = rng.uniform(1.0, 5.0, (30, 40)).astype(np.float32)
        frames = [tracer.trace(depth, camera, _LIGHTS) for tracer in tracers]
        points = _points(rng, int(rng.integers(1, 900)))
        with probe.few_pairs(1 << 60 if step % 3 else 0):
            np.testing.assert_array_equal(*(tracer.states_at(points, _LIGHTS) for tracer in tracers))
        for name in frames[0].names:
            np.testing.assert_array_equal(*(frame.state(name) for frame in frames))
        assert ours.verify(depth, camera, _LIGHTS) == 0
        again = ours.trace(depth, camera, _LIGHTS)
        np.testing.assert_array_equal(again.state("lamp"), frames[1].state("lamp"))
    assert len(asked) == 4


def test_a_set_of_samples_has_to_be_free(asked: list[int]) -> None:
    tracer = ShadowTracer(device="cpu", bounds=Bounds(max_triangles=100, max_rays=1000, max_sample_sets=1), threads=1)
    tracer.scene.put("square", *geometry.square(2, 1.0, 1.0))
    tracer.occluded(np.zeros((5, 3)), _LAMP, samples="here")
    assert tracer.sample_sets == ("here",)
    with pytest.raises(BoundsError, match="there"):
        tracer.occluded(np.zeros((5, 3)), _LAMP, samples="there")
    with pytest.raises(ValueError, match="samples"):
        tracer.occluded(np.zeros((5, 3)), _LAMP, samples=3)
    assert asked == [5]


def test_more_points_than_rays(asked: list[int]) -> None:
    """Pieces of as many as there may be rays, each few enough."""
    tracer = ShadowTracer(device="cpu", bounds=Bounds(max_triangles=600, max_rays=100), threads=1)
    _, right = _pair()
    _put((tracer, right), _raster(np.random.default_rng(14), 30))
    points = _points(np.random.default_rng(15), 250)
    np.testing.assert_array_equal(tracer.occluded(points, _LAMP), right.occluded(points, _LAMP))
    assert asked == [100, 100, 50]


@pytest.mark.parametrize("kernel_form", [probe.CUDA], indirect=True)
def test_the_cuda_form_has_none(asked: list[int]) -> None:
    tracer = _tracer()
    tracer.scene.put("square", *geometry.square(2, 1.0, 1.0))
    assert tracer.occluded(np.zeros((5, 3)), _LAMP).all() and not asked


@pytest.mark.parametrize("kernel_form", [probe.USUAL], indirect=True)
def test_counts_say_what_is_few(kernel_form: str) -> None:
    """Pairs of all lights together; and triangles, of which other ways make something first, as far as that goes."""
    assert are_few(1_000, 1_000, [_LAMP]) and not are_few(1_000, 1_000, [_LAMP] * 2)
    for triangles, most in ((1, 32_767), (36, 32_094), (1_000, 1_300), (2_000, 725), (4_000, 437), (400_000, 4)):
        assert are_few(most, triangles, [_LAMP]) and not are_few(most + 1, triangles, [_LAMP])
    assert not are_few(0, 1_000, [_LAMP]) and not are_few(1_000, 0, [_LAMP]) and not are_few(1_000, 1_000, [])
    assert not are_few(10, 10, [SphereLight("bulb", (0.0, 0.0, 0.0), 0.1)])
    assert not are_few(10, 10, [PointLight("lamp", (0.0, 0.0, 0.0), ignore=("mesh",))])
