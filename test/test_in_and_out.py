# SPDX-License-Identifier: Apache-2.0
"""Nothing that comes in is reinterpreted without a word, and nothing that is handed out can change what is kept."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import geometry
import numpy as np
import pytest

from shadow_tracer import (
    Bias,
    Bounds,
    Camera,
    DirectionalLight,
    PointLight,
    ShadowTracer,
    SphereLight,
    SpotLight,
    State,
    available_pipelines,
    render_depth,
)
from shadow_tracer.scene.depth_mesh import depth_mesh
from shadow_tracer.scene.mesh import Scene

_BOUNDS = Bounds(max_triangles=100, max_rays=3072, max_lights=4, queue_capacity=100, grid_entries=1000)
_CAMERA = Camera(64, 48, 50.0, 50.0, 31.5, 23.5)
_LIGHTS = [
    PointLight("lamp", (0.0, 0.0, 0.5)),
    DirectionalLight("sun", (0.1, 0.0, 1.0)),
    SphereLight("bulb", (0, 0, 1), 0.2),
]
_ROOF = np.array([(-1, -1, 2), (1, -1, 2), (0, 1, 2.0)]), np.array([(0, 1, 2)])


def _tracer(pipeline: str = "light_grid", graphs: bool | None = None) -> ShadowTracer:
    tracer = ShadowTracer(pipeline, device="cpu", bounds=_BOUNDS, graphs=graphs)
    tracer.scene.put("roof", *_ROOF)
    return tracer


def _depth() -> np.ndarray:
    depth = np.full((48, 64), 3, np.float32)
    depth[:5] = 0.0
    return depth


def _hidden_part() -> np.ndarray:
    hidden = np.zeros((48, 64), np.bool_)
    hidden[10:30, 20:50] = True
    return hidden


@pytest.mark.parametrize("dtype", [np.float32, np.uint16])
def test_masked_pixels_are_no_measurement(dtype: type) -> None:
    depth = np.full((48, 64), 3 if dtype == np.float32 else 3000, dtype)
    masked, plain = np.ma.masked_array(depth, _hidden_part()), depth.copy()
    plain[_hidden_part()] = 0
    tracer = _tracer()
    frame, expected = tracer.trace(masked, _CAMERA, _LIGHTS), tracer.trace(plain, _CAMERA, _LIGHTS)
    assert frame.differing(expected) == 0
    assert ((frame.state("lamp") == State.INVALID) == _hidden_part()).all()
    assert tracer.verify(masked, _CAMERA, _LIGHTS) == 0
    for mine, others in zip(depth_mesh(masked, _CAMERA, 1, 0.1), depth_mesh(plain, _CAMERA, 1, 0.1), strict=True):
        assert np.array_equal(mine, others)
    without_mask = tracer.trace(np.ma.masked_array(depth), _CAMERA, _LIGHTS)
    assert without_mask.differing(tracer.trace(depth, _CAMERA, _LIGHTS)) == 0
    if dtype == np.float32:
        assert (np.isnan(_CAMERA.unproject(masked)).any(axis=-1) == _hidden_part()).all()


def test_masked_points_are_invalid_or_refused() -> None:
    points = np.ma.masked_array(np.full((4, 3), 3.0), [[0, 0, 0], [0, 1, 0], [0, 0, 0], [1, 1, 1]])
    tracer = _tracer()
    assert (tracer.states_at(points, _LIGHTS[:1])[0] == State.INVALID).tolist() == [False, True, False, True]
    integers = np.ma.masked_array(np.full((2, 3), 3), [[0, 0, 0], [0, 1, 0]])
    assert (tracer.states_at(integers, _LIGHTS[:1])[0] == State.INVALID).tolist() == [False, True]
    with pytest.raises(ValueError, match=r"points: expected finite positions.* at index \(1,\) and 2 such points"):
        tracer.occluded(points, _LIGHTS[0])


_MASKED_ROW = np.ma.masked_array([1.0, 2.0, 3.0], [0, 1, 0])
_MASKED_POSE = np.ma.masked_array(np.eye(4), np.eye(4) == 0)


@pytest.mark.parametrize(
    ("field", "give"),
    [
        ("vertices", lambda: Scene().put("a", np.ma.masked_array(_ROOF[0], _ROOF[0] < 0), _ROOF[1])),
        ("vertices", lambda: _tracer().scene.deform("roof", np.ma.masked_array(_ROOF[0], _ROOF[0] < 0))),
        ("triangles", lambda: Scene().put("a", _ROOF[0], np.ma.masked_array(_ROOF[1], _ROOF[1] == 1))),
        ("pose", lambda: Scene().put("a", *_ROOF, pose=_MASKED_POSE)),
        ("pose", lambda: _tracer().scene.move("roof", _MASKED_POSE)),
        ("position", lambda: PointLight("a", _MASKED_ROW)),
        ("position", lambda: SphereLight("a", _MASKED_ROW, 1.0)),
        ("direction", lambda: DirectionalLight("a", _MASKED_ROW)),
        ("camera_to_world", lambda: Camera(2, 2, 1.0, 1.0, 0.0, 0.0, _MASKED_POSE)),
    ],
)
def test_masked_values_where_there_must_be_some(field: str, give: Callable[[], Any]) -> None:
    with pytest.raises(ValueError, match=f"^{field}: expected an array without masked values, got [0-9]+"):
        give()


class Quantity(np.ndarray):
    """As of astropy or pint: an array whose numbers mean something else without its unit."""


@pytest.mark.parametrize(
    ("field", "give"),
    [
        ("depth", lambda millimetres: _tracer().trace(millimetres(_depth()), _CAMERA, _LIGHTS)),
        ("points", lambda millimetres: _tracer().occluded(millimetres(_ROOF[0]), _LIGHTS[0])),
        ("vertices", lambda millimetres: Scene().put("a", millimetres(_ROOF[0]), _ROOF[1])),
        ("pose", lambda millimetres: Scene().put("a", *_ROOF, pose=millimetres(np.eye(4)))),
        ("position", lambda millimetres: PointLight("a", millimetres(np.ones(3)))),
        ("range", lambda millimetres: PointLight("a", (0, 0, 0), millimetres(np.array(1.0)))),
        ("fx", lambda millimetres: Camera(2, 2, millimetres(np.array(1.0)), 1.0, 0.0, 0.0)),
    ],
)
def test_a_unit_is_not_dropped(field: str, give: Callable[[Any], Any]) -> None:
    with pytest.raises(ValueError, match=f"^{field}: expected "):
        give(lambda array: array.view(Quantity))


def test_a_masked_array_without_a_mask_is_an_array() -> None:
    scene = Scene()
    scene.put("a", np.ma.masked_array(_ROOF[0]), np.ma.masked_array(_ROOF[1]), np.ma.masked_array(np.eye(4)))
    assert np.array_equal(scene["a"].vertices, _ROOF[0]) and type(scene["a"].vertices) is np.ndarray
    assert PointLight("a", np.ma.masked_array([1.0, 2.0, 3.0])).position.tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    "value", [["1", "2", "3"], [True, False, True], [1 + 1j, 0, 0], np.array([1j, 0, 0]), "abc", None, [[1, 2], [3]]]
)
def test_what_is_no_vector_is_not_made_one(value: Any) -> None:
    with pytest.raises(ValueError, match="^position: expected three finite numbers"):
        PointLight("a", value)
    with pytest.raises(ValueError, match="^direction: expected three finite numbers"):
        DirectionalLight("a", value)
    with pytest.raises(ValueError, match="^camera_to_world: expected a 4x4 rigid transform, got "):
        Camera(2, 2, 1.0, 1.0, 0.0, 0.0, value)


@pytest.mark.parametrize("value", ["1.5", b"1", True, np.True_, None, 1j, np.ma.masked, [1.0, 2.0]])
@pytest.mark.parametrize(
    ("field", "give"),
    [
        ("fx", lambda value: Camera(2, 2, value, 1.0, 0.0, 0.0)),
        ("cy", lambda value: Camera(2, 2, 1.0, 1.0, 0.0, value)),
        ("bias.constant", lambda value: Bias(value)),
        ("range", lambda value: PointLight("a", (0, 0, 0), value)),
        ("outer_angle", lambda value: SpotLight("a", (0, 0, 0), (0, 0, 1), value)),
        ("radius", lambda value: SphereLight("a", (0, 0, 0), value)),
    ],
)
def test_what_is_no_number_is_not_made_one(field: str, give: Callable[[Any], Any], value: Any) -> None:
    with pytest.raises(ValueError, match=f"^{field}: expected a "):
        give(value)


@pytest.mark.parametrize(
    "several", [list, tuple, iter, lambda lights: (light for light in lights), dict.fromkeys, lambda lights: {*lights}]
)
def test_any_iterable_of_lights(several: Callable[[list[Any]], Iterable[Any]]) -> None:
    """Read once; of a set the order is its own."""
    tracer, image = _tracer(), _depth()
    expected = tracer.trace(image, _CAMERA, _LIGHTS)
    frame = tracer.trace(image, _CAMERA, several(_LIGHTS))
    assert sorted(frame.names) == sorted(expected.names)
    assert all(np.array_equal(frame.state(name), expected.state(name)) for name in expected.names)
    assert tracer.verify(image, _CAMERA, several(_LIGHTS)) == 0
    points = np.full((5, 3), 3.0)
    assert np.array_equal(
        np.sort(tracer.states_at(points, several(_LIGHTS)), axis=0), np.sort(tracer.states_at(points, _LIGHTS), axis=0)
    )


@pytest.mark.parametrize("lights", [None, 3, "lamp", [3], ["lamp"], iter(()), [_LIGHTS]])
def test_what_is_no_light(lights: Any) -> None:
    with pytest.raises(ValueError, match="^lights"):
        _tracer().trace(_depth(), _CAMERA, lights)
    with pytest.raises(ValueError, match="^lights"):
        _tracer().states_at([0.0, 0.0, 0.0], lights)


def test_ragged_input_is_named() -> None:
    ragged = [[1.0, 2.0, 3.0], [1.0]]
    with pytest.raises(ValueError, match="^depth: expected an image"):
        _tracer().trace(ragged, _CAMERA, _LIGHTS)
    with pytest.raises(ValueError, match="^points: expected real numbers"):
        _tracer().occluded(ragged, _LIGHTS[0])
    with pytest.raises(ValueError, match="^vertices: expected"):
        Scene().put("a", ragged, _ROOF[1])


@pytest.mark.parametrize("graphs", [False, True])
@pytest.mark.parametrize("pipeline", available_pipelines())
def test_results_are_the_callers_own(pipeline: str, graphs: bool) -> None:
    """Whatever is written into a result changes no other result, and no later answer."""
    tracer, image = _tracer(pipeline, graphs), _depth()
    frame = tracer.trace(image, _CAMERA, _LIGHTS)

    def results() -> list[Any]:
        return [
            *(frame.state(name) for name in frame.names),
            *(frame.visibility(name) for name in frame.names),
            *(frame.light_bits(name) for name in frame.names),
            *(frame.mask(name, unknown=128) for name in (*frame.names, None)),
            frame.bits(),
        ]

    before = [result.copy() for result in results()]
    for result in results():
        if result.flags.writeable:
            result[...] = 7
    for mine, others in zip(results(), before, strict=True):
        np.testing.assert_array_equal(mine, others)
    assert tracer.verify(image, _CAMERA, _LIGHTS) == 0
    points = _CAMERA.unproject(np.full((48, 64), 3.0))
    states, hidden = tracer.states_at(points, _LIGHTS), tracer.occluded(points, _LIGHTS[0])
    kept = states.copy(), hidden.copy()
    states[...], hidden[...] = 7, True
    again = tracer.states_at(points, _LIGHTS), tracer.occluded(points, _LIGHTS[0])
    assert all(np.array_equal(mine, others) for mine, others in zip(again, kept, strict=True))


def test_depth_images_are_the_callers_own() -> None:
    scene = _tracer().scene
    first = [image.copy() for image in render_depth(scene, _CAMERA, "cpu")]
    held = render_depth(scene, _CAMERA, "cpu")
    for image in held:
        image[...] = 9
    assert all(
        np.array_equal(a, b, equal_nan=True) for a, b in zip(render_depth(scene, _CAMERA, "cpu"), first, strict=True)
    )


def test_what_a_tracer_keeps_cannot_be_written() -> None:
    """What is handed out and is still in use is read-only, as is every view of it; nothing follows what was given."""
    vertices, triangles, pose = _ROOF[0].copy(), _ROOF[1].copy(), np.eye(4)
    position, matrix = np.array([0.0, 0.0, 0.5]), geometry.pose_of(np.eye(3), (0.1, 0.0, 0.0))
    scene = Scene()
    mesh = scene.put("roof", vertices, triangles, pose)
    lamp, spot = PointLight("lamp", position), SpotLight("spot", position, position, 0.5)
    camera = Camera(64, 48, 50.0, 50.0, 31.5, 23.5, matrix)
    kept = [mesh.vertices, mesh.triangles, mesh.pose, lamp.position, spot.direction, camera.camera_to_world]
    for array in [*kept, camera.position, mesh.vertices[:1], camera.camera_to_world[:3]]:
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    before = [array.copy() for array in kept]
    for given in (vertices, triangles, pose, position, matrix):
        given[...] = 0
    assert all(np.array_equal(mine, others) for mine, others in zip(kept, before, strict=True))
    names = available_pipelines()
    names.clear()
    assert available_pipelines()
