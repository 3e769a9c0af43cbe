# SPDX-License-Identifier: Apache-2.0
"""Sphere lights: visibility is the share of the sphere's points that reach, each decided exactly; states, masks and
bits follow from it; however many lights there is room for."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import geometry
import numpy as np
import oracle
import probe
import pytest

from shadow_tracer import (
    Bounds,
    BoundsError,
    Camera,
    DirectionalLight,
    Frame,
    PointLight,
    ShadowTracer,
    SphereLight,
    SpotLight,
    State,
)

_WIDTH, _HEIGHT = 24, 18
_CAMERA = Camera(_WIDTH, _HEIGHT, 21.0, 22.0, 11.25, 8.75, geometry.look_at((-6.0, 0.5, 3.0), (0, 0, 0.5), (0, 0, 1)))
_LAMP = SphereLight("lamp", (0.5, 0.25, 3.0), 1.0, samples=13)
_NEAR = SphereLight("near", (-1.0, -0.5, 2.5), 0.75, range=4.5, samples=7)
_HARD: list[Any] = [
    PointLight("candle", (0.5, 0.2, 2.5), range=5.0),
    SpotLight("spot", (-3.0, 0.0, 4.0), (1.0, 0.0, -1.5), 0.6),
    DirectionalLight("sun", (0.2, 0.3, -0.9)),
]
_LIGHTS = [_HARD[0], _LAMP, _HARD[1], _NEAR, _HARD[2]]
_BIAS = 0.01


@cache
def _scene() -> geometry.Geometry:
    rng = np.random.default_rng(160)
    ball, rubble = geometry.icosphere(1, 0.6, (0.3, 0.2, 1.4)), geometry.soup(rng, 200, 0.3, 1.5)
    parts = [geometry.square(2, -1.5, 8.0), ball, rubble]
    return geometry.join(parts)


@cache
def _depth() -> np.ndarray:
    rng = np.random.default_rng(161)
    depth = rng.uniform(2.0, 11.0, (_HEIGHT, _WIDTH)).astype(np.float32)
    depth.reshape(-1)[rng.choice(depth.size, 20, replace=False)] = np.tile([0.0, np.nan, np.inf, -1.0], 5)
    return depth


def _valid() -> np.ndarray:
    return np.isfinite(_depth()) & (_depth() > 0)


@cache
def _points() -> np.ndarray:
    return _CAMERA.unproject(np.where(_valid(), _depth(), 1.0))


@cache
def _reached(light: SphereLight) -> np.ndarray:
    """(H, W) points of the sphere that reach, by the oracle, one after the other."""
    reached = np.zeros(_depth().shape, int)
    for number, position in enumerate(light.points):
        answer = oracle.occluded(_points(), PointLight(f"point {number}", position), *_scene(), _BIAS)
        assert not answer.tie.any()
        reached += ~answer.hidden.reshape(reached.shape)
    return reached


def _shines(light: SphereLight) -> np.ndarray:
    distance = np.linalg.norm(_points() - light.position, axis=-1)
    assert abs(distance[_valid()] - light.range).min() > 1e-9
    return (distance <= light.range) & _valid()


def _expected_state(light: SphereLight) -> np.ndarray:
    reached = _reached(light)
    state = np.where(reached == 0, State.SHADOWED, np.where(reached == light.samples, State.LIT, State.PENUMBRA))
    state[~_shines(light)] = State.OUTSIDE
    state[~_valid()] = State.INVALID
    return state


def _check(frame: Frame, light: SphereLight) -> None:
    np.testing.assert_array_equal(frame.state(light.name), _expected_state(light), err_msg=light.name)
    visible = np.where(_shines(light), _reached(light), 0) / light.samples
    got = frame.visibility(light.name)
    visible[~_valid()] = np.nan
    assert got.dtype == np.float32 and got.shape == (_HEIGHT, _WIDTH)
    np.testing.assert_array_equal(got, visible.astype(np.float32), err_msg=light.name)


def test_every_point_of_a_sphere_is_an_exact_shadow(tracer: Any) -> None:
    tracer.scene.put("scene", *_scene())
    frame = tracer.trace(_depth(), _CAMERA, _LIGHTS, _BIAS)
    assert frame.names == ("candle", "lamp", "spot", "near", "sun")
    hard = tracer.trace(_depth(), _CAMERA, _HARD, _BIAS)
    for light in (_LAMP, _NEAR):
        _check(frame, light)
    for light in _HARD:
        np.testing.assert_array_equal(frame.state(light.name), hard.state(light.name))
    for light in (_LAMP, _NEAR):
        counts = np.bincount(_expected_state(light).reshape(-1), minlength=5)
        assert counts[[State.LIT, State.SHADOWED, State.INVALID, State.PENUMBRA]].min() >= 10
    assert (_expected_state(_NEAR) == State.OUTSIDE).sum() >= 10


def test_masks_and_bits_of_soft_lights(tracer: Any) -> None:
    """255 where all points reach, 0 where none does, in between the share of 255 rounded down; together the largest."""
    tracer.scene.put("scene", *_scene())
    frame = tracer.trace(_depth(), _CAMERA, _LIGHTS, _BIAS)
    invalid = ~_valid()
    together = np.zeros(_depth().shape, np.uint8)
    bits = frame.bits()
    for number, light in enumerate(_LIGHTS):
        mask = frame.mask(light.name)
        if isinstance(light, SphereLight):
            reached = np.where(_shines(light), _reached(light), 0)
            np.testing.assert_array_equal(mask, reached * 255 // light.samples)
        else:
            np.testing.assert_array_equal(mask, np.where(frame.state(light.name) == State.LIT, 255, 0))
            share = np.where(invalid, np.nan, mask.astype(np.float32) / 255)
            np.testing.assert_array_equal(frame.visibility(light.name), share)
        assert mask.dtype == np.uint8 and not mask[invalid].any()
        np.testing.assert_array_equal(frame.mask(light.name, unknown=77), np.where(invalid, 77, mask))
        np.testing.assert_array_equal(bits >> number & 1, mask > 0)
        together = np.maximum(together, mask)
    np.testing.assert_array_equal(frame.mask(), together)
    np.testing.assert_array_equal(frame.mask(unknown=77), np.where(invalid, 77, together))
    assert ((together > 0) & (together < 255)).any()
    with pytest.raises(ValueError, match="^name:"):
        frame.visibility("moon")


def test_a_penumbra_is_never_black_or_white(any_device: str) -> None:
    """With more points than there are greys, one that reaches still shows, and one that does not, too."""
    tracer = ShadowTracer(
        "light_grid", device=any_device, bounds=Bounds(max_triangles=50, max_rays=4000, max_lights=16)
    )
    lamp = SphereLight("lamp", (0.0, 0.0, 3.0), 1.0, samples=1024)
    tracer.scene.put("edge", *geometry.square(2, 1.0, 50.0, (50.0, 0.0)))
    camera = Camera(1000, 1, 400.0, 400.0, 499.5, 0.0, geometry.pose_of(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 1.0)))
    frame = tracer.trace(np.full((1, 1000), 1.0, np.float32), camera, [lamp], 0.0)
    share, mask, state = frame.visibility("lamp")[0], frame.mask("lamp")[0], frame.state("lamp")[0]
    assert set(np.unique(state)) == {State.LIT, State.SHADOWED, State.PENUMBRA}
    soft = state == State.PENUMBRA
    assert mask[soft].min() == 1 and mask[soft].max() == 254 and (mask[state == State.LIT] == 255).all()
    assert share[soft].min() < 1 / 255 and share[soft].max() > 254 / 255
    assert (np.diff(share) <= 0).all(), "less and less of the lamp is seen past the edge"


@pytest.mark.parametrize("room", [1, 2, 3, 5, 8, 16, 64])
@probe.in_forms("way", ["light_grid/packed", "mesh_bvh/refit"], ["light_grid/packed"])
@pytest.mark.slow
def test_any_size_of_batches(any_device: str, way: str, room: int) -> None:
    """A sphere counts as one light of max_lights, however many points it has; with graphs as without."""
    for graphs in (False, True):
        bounds = Bounds(max_triangles=400, max_rays=1000, max_lights=room, queue_capacity=3000, grid_entries=20_000)
        tracer = ShadowTracer(*way.split("/"), device=any_device, bounds=bounds, graphs=graphs)
        tracer.scene.put("scene", *_scene())
        for _ in range(3):
            frame = tracer.trace(_depth(), _CAMERA, [_LAMP], _BIAS)
            _check(frame, _LAMP)
        if room >= 5:
            frame = tracer.trace(_depth(), _CAMERA, _LIGHTS, _BIAS)
            for light in (_LAMP, _NEAR):
                _check(frame, light)
        else:
            with pytest.raises(BoundsError, match=r"^bounds\.max_lights:.*5"):
                tracer.trace(_depth(), _CAMERA, _LIGHTS, _BIAS)


def test_memory_does_not_depend_on_the_number_of_points(any_device: str) -> None:
    tracer = ShadowTracer(
        "light_grid", device=any_device, bounds=Bounds(max_triangles=400, max_rays=1000, max_lights=3)
    )
    tracer.scene.put("scene", *_scene())
    before = tracer.device_bytes
    for samples in (2, 40, 300):
        tracer.trace(_depth(), _CAMERA, [SphereLight("lamp", (0.5, 0.25, 3.0), 0.5, samples=samples)], _BIAS)
        assert tracer.device_bytes == before


def test_counters_and_stages_are_of_all_points(any_device: str) -> None:
    bounds = Bounds(max_triangles=400, max_rays=1000, max_lights=3, queue_capacity=3000)
    tracer = ShadowTracer("light_grid", device=any_device, bounds=bounds, graphs=False)
    tracer.scene.put("scene", *_scene())
    frame = tracer.trace(_depth(), _CAMERA, [_LAMP, _HARD[2]], _BIAS)
    valid = int(_valid().sum())
    assert frame.counters["rays"] == valid * (_LAMP.samples + 1)
    assert frame.counters["triangles"] == len(_scene()[1]) and frame.counters["degenerate"] == 0
    assert 0 < frame.counters["largest_tile"] <= len(_scene()[1])
    # Another image: of the same one samples would not be made again.
    one = tracer.trace(1.0001 * _depth(), _CAMERA, [PointLight("lamp", (0.5, 0.25, 3.0))], _BIAS)
    assert list(frame.stages) == list(one.stages)
    assert frame.counters["leaf_tests"] > 5 * one.counters["leaf_tests"]


def test_states_at_knows_penumbrae(tracer: Any) -> None:
    tracer.scene.put("scene", *_scene())
    points = np.where(_valid()[..., None], _points(), np.nan)
    states = tracer.states_at(points, _LIGHTS, _BIAS)
    frame = tracer.trace(_depth(), _CAMERA, _LIGHTS, _BIAS)
    for light, got in zip(_LIGHTS, states, strict=True):
        np.testing.assert_array_equal(got, frame.state(light.name), err_msg=light.name)
    np.testing.assert_array_equal(states[1], _expected_state(_LAMP))


def test_occluded_says_what_to_use_instead(reference: Any) -> None:
    with pytest.raises(ValueError, match="^light: expected.*got SphereLight; states_at"):
        reference.occluded((0.0, 0.0, 0.0), _LAMP)
    with pytest.raises(ValueError, match="^lights: expected an iterable"):
        reference.trace(_depth(), _CAMERA, _LAMP)


def test_range_ends_inclusively_and_by_the_centre(any_device: str) -> None:
    tracer = ShadowTracer("light_grid", device=any_device, bounds=Bounds(max_triangles=400, max_rays=100, max_lights=4))
    lamp = SphereLight("lamp", (0.0, 0.0, 0.0), 2.0, range=5.0, samples=9)
    points = np.array([(3.0, 4.0, 0.0), (3.0, np.nextafter(4.0, 5.0), 0.0), (0.0, 0.0, -5.0), (0.0, 6.0, 0.0)])
    expected = [State.LIT, State.OUTSIDE, State.LIT, State.OUTSIDE]
    np.testing.assert_array_equal(tracer.states_at(points, [lamp])[0], expected)
    tracer.scene.put("shell", *geometry.icosphere(2, 4.0))
    expected = [State.SHADOWED, State.OUTSIDE, State.SHADOWED, State.OUTSIDE]
    np.testing.assert_array_equal(tracer.states_at(points, [lamp])[0], expected)


def test_far_from_the_origin(any_device: str) -> None:
    """At map coordinates points and range are still those of the sphere: nothing of it is cut off by a rounding."""
    tracer = ShadowTracer("light_grid", device=any_device, bounds=Bounds(max_triangles=400, max_rays=200, max_lights=4))
    shift = np.array([448_376.0, 5_411_234.0, 312.0])
    lamp = SphereLight("lamp", shift, 0.1, range=3.0, samples=32)
    around = shift + 2.999999 * geometry.directions(np.random.default_rng(162), 150)
    assert (tracer.states_at(around, [lamp]) == State.LIT).all()
    assert np.linalg.norm(lamp.points - shift, axis=1).max() == pytest.approx(0.1, abs=1e-8)


def test_verify_counts_visibilities(any_device: str) -> None:
    """A penumbra that is too dark by one point is a difference, though its state is the same."""
    tracer = ShadowTracer(
        "light_grid", device=any_device, bounds=Bounds(max_triangles=400, max_rays=1000, max_lights=5)
    )
    tracer.scene.put("scene", *_scene())
    frame = tracer.trace(_depth(), _CAMERA, _LIGHTS, _BIAS)
    assert tracer.verify(_depth(), _CAMERA, _LIGHTS, _BIAS) == 0
    bits = probe.light_bits(frame, "lamp")
    darker = np.argwhere(frame.state("lamp") == State.PENUMBRA)[:6]
    bits[tuple(darker.T)] &= bits[tuple(darker.T)] - np.uint64(1)  # one point less
    assert tracer.verify(_depth(), _CAMERA, _LIGHTS, _BIAS) == len(darker) == 6


def test_points_are_spread_evenly() -> None:
    """Their mean is the centre, their second moments those of the sphere; every cap of it has its share of them."""
    directions = geometry.directions(np.random.default_rng(163), 300)
    for samples in (2, 5, 32, 100, 1024):
        lamp = SphereLight("lamp", (1.0, -2.0, 3.0), 0.5, samples=samples)
        unit = (lamp.points - lamp.position) / 0.5
        assert unit.shape == (samples, 3)
        np.testing.assert_allclose(np.linalg.norm(unit, axis=1), 1.0, atol=1e-14)
        assert np.linalg.norm(unit.mean(axis=0)) <= 2.0 / samples + 1e-12
        if samples >= 32:
            np.testing.assert_allclose(unit.T @ unit / samples, np.eye(3) / 3, atol=1.0 / samples)
            above = (unit @ directions.T > 0.5).mean(axis=0)  # a quarter of the sphere lies in such a cap
            assert abs(above - 0.25).max() < 1.3 / math.sqrt(samples) / 2
    golden = math.pi * (3.0 - math.sqrt(5.0))
    unit = SphereLight("lamp", (0, 0, 0), 1.0, samples=1024).points
    turn = np.arctan2(unit[:, 1], unit[:, 0])
    np.testing.assert_allclose(np.exp(1j * turn), np.exp(1j * golden * np.arange(1024)), atol=1e-11)


_BAD: list[tuple[str, dict[str, Any]]] = [
    *[("radius", {"radius": value}) for value in (0.0, -1.0, math.nan, math.inf, "wide", None, 2e50)],
    *[("samples", {"samples": value}) for value in (1, 0, -3, 1025, 3.0, True, None)],
    *[("range", {"range": value}) for value in (0.0, -1.0, math.nan, "far")],
    ("position", {"position": (0.0, 1.0)}),
    ("position", {"position": (0.0, 1.0, math.nan)}),
    ("radius", {"position": (0.0, 1e50, 0.0), "radius": 1e49}),
    ("name", {"name": ""}),
]


@pytest.mark.parametrize("field,change", _BAD, ids=[f"{field}-{k}" for k, (field, _) in enumerate(_BAD)])
def test_errors_name_the_argument(field: str, change: dict[str, Any]) -> None:
    arguments: dict[str, Any] = {"name": "lamp", "position": (0.0, 0.0, 3.0), "radius": 0.5, **change}
    with pytest.raises(ValueError, match=f"^{field}: expected"):
        SphereLight(**arguments)


def test_defaults() -> None:
    lamp = SphereLight("lamp", (1, 2, 3), 0.25)
    assert (lamp.range, lamp.samples, lamp.points.shape) == (math.inf, 32, (32, 3))
    assert not lamp.position.flags.writeable
