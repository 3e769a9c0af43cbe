# SPDX-License-Identifier: Apache-2.0
"""ShadowTracer.trace: from depth images to states, masks and bits, every pixel against the oracle."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import geometry
import numpy as np
import oracle
import pytest

from shadow_tracer import Bias, Camera, DirectionalLight, PointLight, SpotLight, State

_WIDTH, _HEIGHT = 40, 30
_LIGHTS: list[Any] = [
    PointLight("lamp", (0.5, 0.2, 2.5)),
    PointLight("candle", (0.5, 0.2, 2.5), range=6.0),
    SpotLight("spot", (-3.0, 0.0, 4.0), (1.0, 0.0, -1.5), 0.6),
    DirectionalLight("sun", (0.2, 0.3, -0.9)),
]


@cache
def _street() -> geometry.Geometry:
    return geometry.street(np.random.default_rng(80), 150)


def _camera() -> Camera:
    return Camera(
        _WIDTH, _HEIGHT, 35.0, 36.0, 19.25, 14.75, geometry.look_at((-8.0, 0.3, 2.0), (0.0, 0.0, 1.0), (0, 0, 1))
    )


@cache
def _depth() -> np.ndarray:
    """Random depth, so that samples are everywhere in space, with pixels of each invalid kind among them."""
    rng = np.random.default_rng(81)
    depth = rng.uniform(0.5, 16.0, (_HEIGHT, _WIDTH)).astype(np.float32)
    flat = depth.reshape(-1)
    flat[rng.choice(flat.size, 60, replace=False)] = np.tile([0.0, np.nan, np.inf, -np.inf, -1.0, -0.0], 10)
    return depth


def _expected(depth: np.ndarray, camera: Camera, light: Any, mesh: geometry.Geometry, bias: Bias) -> np.ndarray:
    """State image by the oracle: own unprojection, own cone and range, exact shadow."""
    metres = depth.astype(np.float64) / (1000.0 if depth.dtype == np.uint16 else 1.0)
    valid = np.isfinite(metres) & (metres > 0)
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
    z = np.where(valid, metres, 1.0)
    x, y = (columns - camera.cx) / camera.fx * z, (rows - camera.cy) / camera.fy * z
    pose = camera.camera_to_world
    points = np.stack([((pose[k, 0] * x + pose[k, 1] * y) + pose[k, 2] * z) + pose[k, 3] for k in range(3)], axis=-1)
    answer = oracle.occluded(points, light, *mesh, (bias.constant + bias.quadratic * z * z).reshape(-1), cull=True)
    assert not answer.tie.any()
    state = np.where(answer.hidden.reshape(z.shape), State.SHADOWED, State.LIT).astype(np.uint8)
    if not isinstance(light, DirectionalLight):
        way = points - light.position
        distance = np.linalg.norm(way, axis=-1)
        outside = distance > light.range
        assert abs(distance[valid] - light.range).min() > 1e-9
        if isinstance(light, SpotLight):
            angle = np.arctan2(np.linalg.norm(np.cross(way, light.direction), axis=-1), way @ light.direction)
            assert abs(angle[valid] - light.outer_angle).min() > 1e-9
            outside |= angle > light.outer_angle
        state[outside] = State.OUTSIDE
    state[~valid] = State.INVALID
    return state


@cache
def _expected_street(index: int) -> np.ndarray:
    return _expected(_depth(), _camera(), _LIGHTS[index], _street(), Bias(0.01, 0.0005))


def test_every_pixel_of_every_light(tracer: Any) -> None:
    tracer.scene.put("street", *_street())
    depth = _depth().copy()
    frame = tracer.trace(depth, _camera(), _LIGHTS, Bias(0.01, 0.0005))
    assert frame.names == ("lamp", "candle", "spot", "sun")
    np.testing.assert_array_equal(depth, _depth(), err_msg="the input is not written to")
    for index, light in enumerate(_LIGHTS):
        state = frame.state(light.name)
        assert state.shape == (_HEIGHT, _WIDTH) and state.dtype == np.uint8
        np.testing.assert_array_equal(state, _expected_street(index), err_msg=light.name)
    states = np.concatenate([_expected_street(k).reshape(-1) for k in range(len(_LIGHTS))])
    assert (np.bincount(states, minlength=4) > 100).all(), "a scene in which every state occurs"


def test_masks_states_and_bits_agree(tracer: Any) -> None:
    tracer.scene.put("street", *_street())
    frame = tracer.trace(_depth(), _camera(), _LIGHTS)
    invalid = frame.state("lamp") == State.INVALID
    assert invalid.sum() == 60
    bits = frame.bits()
    assert bits.dtype == np.uint16 and bits.shape == (_HEIGHT, _WIDTH)
    anywhere = np.zeros((_HEIGHT, _WIDTH), bool)
    for index, light in enumerate(_LIGHTS):
        lit = frame.state(light.name) == State.LIT
        anywhere |= lit
        np.testing.assert_array_equal((bits >> index & 1).astype(bool), lit)
        for unknown in (0, 128, 255):
            mask = frame.mask(light.name, unknown=unknown)
            assert mask.dtype == np.uint8
            np.testing.assert_array_equal(mask, np.where(invalid, unknown, np.where(lit, 255, 0)))
    assert not bits[invalid].any() and (bits < 16).all()
    np.testing.assert_array_equal(frame.mask(), np.where(anywhere, 255, 0))
    np.testing.assert_array_equal(frame.mask(unknown=7), np.where(invalid, 7, np.where(anywhere, 255, 0)))
    for call in (lambda: frame.mask("moon"), lambda: frame.state("moon")):
        with pytest.raises(ValueError, match="^name:.*lamp.*moon"):
            call()
    for unknown in (-1, 256):
        with pytest.raises(ValueError, match="^unknown:"):
            frame.mask("lamp", unknown=unknown)


def test_sixteen_lights_have_sixteen_bits(tracer: Any) -> None:
    tracer.scene.put("street", *_street())
    rng = np.random.default_rng(82)
    lights = [PointLight(f"lamp {k}", rng.uniform((-9, -4, 0.1), (9, 4, 3))) for k in range(16)]
    camera = Camera(_WIDTH // 2, _HEIGHT // 2, 17.5, 18.0, 9.625, 7.375, _camera().camera_to_world)
    frame = tracer.trace(_depth()[::2, ::2].copy(), camera, lights)
    bits = frame.bits()
    for index in range(16):
        np.testing.assert_array_equal((bits >> index & 1) == 1, frame.state(f"lamp {index}") == State.LIT)
    assert len(np.unique(bits)) > 5


def test_trace_equals_occluded(tracer: Any) -> None:
    """The samples of trace() are Camera.unproject, bit for bit, also far from the origin."""
    rng = np.random.default_rng(83)
    shift = np.array([148376.0, 1234.0, -223423.0])
    vertices, triangles = geometry.icosphere(2, 1.0, shift)
    pose = geometry.pose_of(geometry.rotation(rng), shift)
    camera = Camera(20, 15, 3.3, 3.1, 9.4, 7.2, pose)
    tracer.scene.put("sphere", vertices, triangles[rng.random(len(triangles)) < 0.7])
    depth = rng.uniform(0.05, 3.0, (15, 20)).astype(np.float32)
    lamp = PointLight("lamp", shift + (0.1, 0.2, -0.15))
    hidden = tracer.occluded(camera.unproject(depth), lamp, 0.003)
    np.testing.assert_array_equal(tracer.trace(depth, camera, [lamp], 0.003).state("lamp") == State.SHADOWED, hidden)
    assert 0.1 < hidden.mean() < 0.9


@pytest.mark.parametrize("millimetres", [False, True])
def test_samples_are_right_to_the_last_bit(tracer: Any, millimetres: bool) -> None:
    """A tile exactly at a sample's own coordinate does not hide it, a tile one ulp towards the light does, along each
    axis: trace() cannot place a sample one ulp from where Camera.unproject has it."""
    rng = np.random.default_rng(87)
    camera = Camera(7, 5, 3.3, 3.1, 2.9, 2.2, geometry.pose_of(geometry.rotation(rng), (1.7, -0.3, 5.2)))
    depth = rng.uniform(0.7, 5.0, (5, 7)).astype(np.float32)
    if millimetres:
        depth = (depth * 1000).astype(np.uint16)
    points = camera.unproject(depth / 1000.0 if millimetres else depth).reshape(-1, 3)
    for axis in range(3):
        direction = np.zeros(3)
        direction[axis] = -1.0
        sun = DirectionalLight("sun", direction)
        for hides in (False, True):
            at = np.nextafter(points[:, axis], np.inf) if hides else points[:, axis]
            tiles = [geometry.square(axis, h, 1e-4, tuple(np.delete(p, axis))) for h, p in zip(at, points, strict=True)]
            tracer.scene.put("tiles", *geometry.join(tiles))
            state = tracer.trace(depth, camera, [sun], 0.0).state("sun").reshape(-1)
            np.testing.assert_array_equal(state, State.SHADOWED if hides else State.LIT)


@pytest.mark.parametrize("value", [0.0, -0.0, np.nan, np.inf, -np.inf, -1.0, -1e-30])
def test_invalid_pixels_change_nobody_else(tracer: Any, value: float) -> None:
    tracer.scene.put("street", *_street())
    full = np.where(np.isfinite(_depth()) & (_depth() > 0), _depth(), np.float32(3.0))
    rng = np.random.default_rng(84)
    before = tracer.trace(full, _camera(), _LIGHTS)
    for fraction in (0.02, 0.5, 0.99):
        holes = rng.random(full.shape) < fraction
        depth = np.where(holes, np.float32(value), full)
        frame = tracer.trace(depth, _camera(), _LIGHTS)
        for light in _LIGHTS:
            expected = np.where(holes, State.INVALID, before.state(light.name))
            np.testing.assert_array_equal(frame.state(light.name), expected)


def test_extreme_depths_change_nobody_else(tracer: Any) -> None:
    """Valid but absurd depths are samples like any other, and a neighbour of theirs is traced as without them."""
    tracer.scene.put("street", *_street())
    depth = np.where(np.isfinite(_depth()) & (_depth() > 0), _depth(), np.float32(3.0))
    before = tracer.trace(depth, _camera(), _LIGHTS, 0.01)
    absurd = depth.copy()
    places = np.zeros(depth.shape, bool)
    for k, value in enumerate((3.4e38, 1e30, 1e12, 1e-45, 1e-38, 1e-12)):
        absurd[k * 4 + 1, 3::7] = value
        places[k * 4 + 1, 3::7] = True
    frame = tracer.trace(absurd, _camera(), _LIGHTS, 0.01)
    for light in _LIGHTS:
        np.testing.assert_array_equal(frame.state(light.name)[~places], before.state(light.name)[~places])
        assert not (frame.state(light.name)[places] == State.INVALID).any()
    assert (frame.state("candle")[1, 3::7] == State.OUTSIDE).all() and (
        frame.state("lamp")[1, 3::7] != State.OUTSIDE
    ).all()


def test_no_valid_pixel(tracer: Any) -> None:
    tracer.scene.put("street", *_street())
    for empty in (np.full((_HEIGHT, _WIDTH), np.nan, np.float32), np.zeros((_HEIGHT, _WIDTH), np.uint16)):
        frame = tracer.trace(empty, _camera(), _LIGHTS)
        assert all((frame.state(light.name) == State.INVALID).all() for light in _LIGHTS)
        assert (frame.mask() == 0).all() and (frame.mask(unknown=99) == 99).all() and not frame.bits().any()
        assert frame.counters["rays"] == 0


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1), (1, 7), (513, 2), (2, 513)])
def test_tiny_and_odd_images(tracer: Any, shape: tuple[int, int]) -> None:
    tracer.scene.put("sphere", *geometry.icosphere(2, 0.5, (0, 0, 1.2)))
    height, width = shape
    depth = np.random.default_rng(85).uniform(0.2, 3.0, shape).astype(np.float32)
    camera = Camera(width, height, 0.6 * width + 2, 0.6 * height + 2, (width - 1) / 2, (height - 1) / 2)
    light = PointLight("lamp", (0.1, 0.05, 0.01))
    expected = _expected(depth, camera, light, geometry.icosphere(2, 0.5, (0, 0, 1.2)), Bias(0.0))
    np.testing.assert_array_equal(tracer.trace(depth, camera, [light], 0.0).state("lamp"), expected)


def test_no_mesh_means_lit(tracer: Any) -> None:
    frame = tracer.trace(_depth(), _camera(), _LIGHTS[::3])
    for light in _LIGHTS[::3]:
        assert set(np.unique(frame.state(light.name))) == {State.LIT, State.INVALID}


def test_millimetres(tracer: Any) -> None:
    """uint16 is millimetres, 0 no measurement, 65535 a valid 65.535 m; where a float holds the same metres the bits
    are the same."""
    tracer.scene.put("street", *_street())
    millimetres = np.random.default_rng(86).integers(1, 130, (_HEIGHT, _WIDTH)).astype(np.uint16) * np.uint16(125)
    millimetres[3, ::4] = 0
    metres = (millimetres / 1000.0).astype(np.float32)
    assert (metres.astype(np.float64) * 1000.0 == millimetres).all()
    whole, real = tracer.trace(millimetres, _camera(), _LIGHTS), tracer.trace(metres, _camera(), _LIGHTS)
    for light in _LIGHTS:
        np.testing.assert_array_equal(whole.state(light.name), real.state(light.name))
        assert (whole.state(light.name)[3, ::4] == State.INVALID).all()
    millimetres[5, :] = 65535
    frame = tracer.trace(millimetres, _camera(), _LIGHTS)
    np.testing.assert_array_equal(frame.state("lamp"), _expected(millimetres, _camera(), _LIGHTS[0], _street(), Bias()))
    assert not (frame.state("lamp")[5] == State.INVALID).any()


def test_bias_quadratic_in_depth(tracer: Any) -> None:
    """A plane a little above the samples: hidden where constant + quadratic z^2 is less than the way through it."""
    camera = Camera(8, 1, 1.0, 1.0, 3.5, 0.0, np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]))
    depth = np.array([[1.0, 2, 3, 4, 5, 6, 7, 8]], np.float32)
    sun = DirectionalLight("sun", (0, 0, -1))
    for k in range(8):
        tracer.scene.put("plane", *geometry.square(2, -float(depth[0, k]) + 0.17, 100.0))
        state = tracer.trace(depth, camera, [sun], Bias(0.01, 0.01)).state("sun")[0]
        assert state[k] == (State.SHADOWED if 0.01 + 0.01 * (k + 1) ** 2 < 0.17 else State.LIT), k
        assert tracer.trace(depth, camera, [sun], Bias(0.16, 0.0)).state("sun")[0, k] == State.SHADOWED
        assert tracer.trace(depth, camera, [sun], 0.18).state("sun")[0, k] == State.LIT
        assert tracer.trace(depth, camera, [sun]).state("sun")[0, k] == State.SHADOWED, "the default is a centimetre"


_IMAGE = np.ones((_HEIGHT, _WIDTH), np.float32)
_BAD_CALLS: list[tuple[str, dict[str, Any]]] = [
    *[
        ("depth", {"depth": _IMAGE.astype(dtype)})
        for dtype in (np.float64, np.float16, np.int16, np.uint8, np.int32, bool, complex)
    ],
    *[
        ("depth", {"depth": _IMAGE.reshape(shape)})
        for shape in ((-1,), (_HEIGHT, _WIDTH, 1), (_WIDTH, _HEIGHT), (_HEIGHT // 2, 2 * _WIDTH))
    ],
    ("depth", {"depth": None}),
    ("depth", {"depth": np.zeros((0, 0), np.float32)}),
    ("depth", {"camera": Camera(_WIDTH + 1, _HEIGHT, 1, 1, 0, 0)}),
    ("camera", {"camera": None}),
    ("camera", {"camera": np.eye(3)}),
    ("lights", {"lights": []}),
    ("lights", {"lights": _LIGHTS[0]}),
    ("lights", {"lights": [_LIGHTS[0], PointLight("lamp", (9, 9, 9))]}),
    ("lights[1]", {"lights": [_LIGHTS[0], "sun"]}),
    ("bias", {"bias": -0.01}),
    ("bias", {"bias": math.nan}),
    ("bias", {"bias": "thick"}),
]


@pytest.mark.parametrize("field,change", _BAD_CALLS, ids=[f"{field}-{k}" for k, (field, _) in enumerate(_BAD_CALLS)])
def test_errors_name_the_argument(reference: Any, field: str, change: dict[str, Any]) -> None:
    arguments = {"depth": _IMAGE, "camera": _camera(), "lights": _LIGHTS, "bias": 0.01, **change}
    with pytest.raises(ValueError) as caught:
        reference.trace(**arguments)
    assert str(caught.value).startswith(field), caught.value
    assert "expected" in str(caught.value), caught.value


def test_any_memory_layout(reference: Any) -> None:
    reference.scene.put("street", *_street())
    expected = reference.trace(_depth(), _camera(), _LIGHTS[:1]).state("lamp")
    wide = np.zeros((_HEIGHT, 2 * _WIDTH), np.float32)
    wide[:, ::2] = _depth()
    for layout in (np.asfortranarray(_depth()), wide[:, ::2], _depth()[::-1].copy()[::-1]):
        np.testing.assert_array_equal(reference.trace(layout, _camera(), _LIGHTS[:1]).state("lamp"), expected)


def test_frames_stay_valid_after_further_calls(tracer: Any) -> None:
    tracer.scene.put("street", *_street())
    first = tracer.trace(_depth(), _camera(), _LIGHTS)
    kept = [first.state(light.name).copy() for light in _LIGHTS]
    tracer.trace(np.full((_HEIGHT, _WIDTH), 2.0, np.float32), _camera(), _LIGHTS[::-1])
    for light, state in zip(_LIGHTS, kept, strict=True):
        np.testing.assert_array_equal(first.state(light.name), state)


def test_stages_and_counters(tracer: Any) -> None:
    tracer.scene.put("street", *_street())
    frame = tracer.trace(_depth(), _camera(), _LIGHTS)
    assert frame.stages and all(isinstance(name, str) and name for name in frame.stages)
    assert all(isinstance(ms, float) and math.isfinite(ms) and ms >= 0.0 for ms in frame.stages.values())
    assert sum(frame.stages.values()) > 0.0
    counters = frame.counters
    assert {"rays", "triangles", "leaf_tests", "retested", "exact", "overflow_passes", "degenerate"} <= set(counters)
    assert all(isinstance(count, int) and count >= 0 for count in counters.values()), counters
    assert counters["triangles"] == len(_street()[1]) and counters["overflow_passes"] == 0
    traced = sum(int(np.isin(frame.state(light.name), (State.LIT, State.SHADOWED)).sum()) for light in _LIGHTS)
    assert counters["rays"] == traced, "one ray per light and sample that the light can reach"
    assert counters["leaf_tests"] + counters["retested"] > 0
    if tracer.pipeline == "mesh_bvh":
        assert counters["leaf_tests"] < traced * len(_street()[1]) / 10, "a tree that looks at everything is no tree"


def test_order_of_lights_does_not_matter(tracer: Any) -> None:
    tracer.scene.put("street", *_street())
    together = tracer.trace(_depth(), _camera(), _LIGHTS)
    backwards = tracer.trace(_depth(), _camera(), _LIGHTS[::-1])
    assert backwards.names == tuple(light.name for light in _LIGHTS[::-1])
    for light in _LIGHTS:
        np.testing.assert_array_equal(backwards.state(light.name), together.state(light.name))
        np.testing.assert_array_equal(
            tracer.trace(_depth(), _camera(), [light]).state(light.name), together.state(light.name)
        )
