# SPDX-License-Identifier: Apache-2.0
"""Meshes that cast no shadows are in the way of nothing, in every pipeline, and are there for all else."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import pytest

from shadow_tracer import (
    Bias,
    Bounds,
    Camera,
    DirectionalLight,
    DoseMap,
    NormalSource,
    PointLight,
    Scene,
    ShadowTracer,
    SphereLight,
    Strength,
    render_depth,
)
from shadow_tracer.scene.some import Numbering

_BOUNDS = {"max_triangles": 2000, "max_rays": 1200, "max_lights": 8, "queue_capacity": 2000, "grid_entries": 20_000}
_CAMERA = Camera(20, 15, 18.0, 18.0, 9.5, 7.0, geometry.look_at((-4.0, 0.5, 2.5), (0, 0, 0.5), (0, 0, 1)))
_MESHES: dict[str, geometry.Geometry] = {
    "floor": geometry.square(2, -1.5, 8.0),
    "shade": geometry.box((0.2, -0.1, 2.8), (0.8, 0.6, 3.2)),  # all around the lamp
    "ball": geometry.icosphere(1, 0.6, (0.3, 0.2, 1.4)),
    "rubble": geometry.soup(np.random.default_rng(210), 150, 0.4, 1.5),
}
_LIGHTS: list[Any] = [
    PointLight("lamp", (0.5, 0.25, 3.0), strength=Strength(power=10.0)),
    SphereLight("bulb", (-1.0, 0.25, 2.0), 0.125, samples=3, ignore=["ball"]),
    DirectionalLight("sun", (0.25, 0.375, -1.0)),
]
_RIDGE = np.stack([*np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9)), np.zeros((9, 9))], axis=-1)
_RIDGE[..., 2] = 1.0 - np.abs(_RIDGE[..., 0])


def _depth(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(1.0, 7.0, (15, 20)).astype(np.float32)


def _put(tracer: Any, without: Any = ()) -> None:
    tracer.scene.clear()
    for name, mesh in _MESHES.items():
        if name not in without:
            tracer.scene.put(name, *mesh)
    if "ridge" not in without:
        tracer.scene.put_surface("ridge", _RIDGE)


@pytest.fixture
def oracle() -> ShadowTracer:
    return ShadowTracer("brute_force", device="cpu", bounds=Bounds(**_BOUNDS), threads=1)


def test_frames_between_which_meshes_begin_and_cease_to_cast(tracer: Any, oracle: ShadowTracer) -> None:
    """The bits are those of a scene without them, in images and for points: one mesh after the other, a surface, all
    of them, none; and what moves or changes its size while it casts nothing is where it belongs afterwards."""
    _put(tracer)
    steps: list[tuple[str, ...]] = [(), ("shade",), ("shade", "floor"), ("ridge",), (*_MESHES, "ridge"), ("ball",), ()]
    for step, silent in enumerate(steps):
        for mesh in list(tracer.scene):
            tracer.scene.cast_shadows(mesh.name, mesh.name not in silent)
        _put(oracle, silent)
        if step >= 3:
            for each in (tracer, oracle):
                if "shade" in each.scene:
                    each.scene.move("shade", geometry.look_at((0.1 * step, 0.0, 0.0), (1.0, 0.0, 0.0), (0, 0, 1)))
                if "ball" in each.scene:
                    each.scene.put(
                        "ball", *geometry.icosphere(0, 0.7, (0.3, 0.2, 1.4)), cast_shadows="ball" not in silent
                    )
        depth = _depth(211 + step % 2)
        frame = tracer.trace(depth, _CAMERA, _LIGHTS, Bias(0.01))
        points = _CAMERA.unproject(depth).reshape(-1, 3)
        true = oracle.light_bits(points, _LIGHTS, 0.01)
        for light, bits in zip(_LIGHTS, true, strict=True):
            np.testing.assert_array_equal(
                frame.light_bits(light.name).reshape(-1), bits, err_msg=f"{step} {light.name}"
            )
        np.testing.assert_array_equal(tracer.light_bits(points, _LIGHTS, 0.01), true)
    assert frame.counters["triangles"] == tracer.scene.triangle_count


def test_what_casts_nothing_is_seen_has_normals_and_receives_a_dose(reference: ShadowTracer) -> None:
    reference.scene.put("table", *geometry.square(2, 0.0, 1.0), cast_shadows=False)
    reference.scene.put("net", *geometry.square(2, 0.5, 1.0), cast_shadows=False)
    lamp = PointLight("lamp", (0.0, 0.0, 1.0), strength=Strength(power=10.0))
    camera = Camera(8, 6, 10.0, 10.0, 3.5, 2.5, geometry.look_at((0, -0.1, 2.0), (0, 0, 0), (0, 1, 0)))
    depth, triangle = render_depth(reference.scene, camera, reference.device)
    assert (triangle >= 2).all(), "of the net, which is nearer"
    frame = reference.trace(depth, camera, [lamp])
    assert frame.counters["triangles"] == 0 and (frame.mask() == 255).all()
    assert (frame.normal_source() == NormalSource.MESH).all() and (frame.irradiance() > 0.0).all()
    dose_map = DoseMap(reference, "table", 0.5)
    free = dose_map.irradiance_by([lamp])
    assert (free > 0.0).all()
    reference.scene.cast_shadows("net", True)
    assert (dose_map.irradiance_by([lamp]) == 0.0).all()
    reference.scene.cast_shadows("net", False)
    assert np.array_equal(dose_map.irradiance_by([lamp]), free)


def test_cones_pass_and_numbers_are_those_of_the_scene(oracle: ShadowTracer) -> None:
    """Also where a mesh that casts nothing gets more triangles, and where a list goes on behind a triangle."""
    rng, silent = np.random.default_rng(213), ("floor", "ball")
    apex, axis = rng.uniform(-2.0, 2.0, (60, 3)), rng.normal(size=(60, 3))
    other = ShadowTracer("brute_force", device="cpu", bounds=Bounds(**_BOUNDS), threads=1)
    _put(other, silent)
    _put(oracle)
    for name in silent:
        oracle.scene.cast_shadows(name, False)
    for count in (None, 3, 40):
        if count is not None:
            oracle.scene.put("floor", *geometry.soup(rng, count, 0.4, 1.5), cast_shadows=False)
        begins, begin = [], 0
        for mesh in oracle.scene:
            begins += list(range(begin, begin + len(mesh.triangles))) * mesh.cast_shadows
            begin += len(mesh.triangles)
        into = np.array([*begins, -1], np.int32)  # -1 stays
        np.testing.assert_array_equal(oracle.cones(apex, axis, radius=0.2), other.cones(apex, axis, radius=0.2))
        first = oracle.cones(apex, axis, radius=0.2, first=True)
        np.testing.assert_array_equal(first[1], into[other.cones(apex, axis, radius=0.2, first=True)[1]])
        numbers, distances = oracle.cone_hits(apex, axis, 0.3, n=6)
        expected = other.cone_hits(apex, axis, 0.3, n=6)
        np.testing.assert_array_equal(numbers, into[expected[0]])
        np.testing.assert_array_equal(distances, expected[1])
        assert (numbers >= 0).sum() > 60
        after = distances[:, 2], numbers[:, 2]
        rest = oracle.cone_hits(apex, axis, 0.3, n=3, after=after)
        known = np.isfinite(after[0])
        np.testing.assert_array_equal(rest[0][known], numbers[known, 3:])
    for mesh in list(oracle.scene):
        oracle.scene.cast_shadows(mesh.name, False)
    assert (oracle.cone_hits(apex, axis, 0.3, after=after)[0] == -1).all()
    assert (oracle.cones(apex, axis, radius=0.2) == 0).all()


def test_numbers_of_all_triangles_and_of_occluders() -> None:
    """Both ways, empty meshes among them; a triangle that is no occluder becomes the last one before it."""
    scene = Scene()
    for name, count, casts in (("a", 2, False), ("b", 3, True), ("c", 0, True), ("d", 2, False), ("e", 1, True)):
        scene.put(name, np.zeros((3, 3)), np.zeros((count, 3), np.int32), cast_shadows=casts)
    numbering = Numbering(scene)
    own = np.array([-1, 0, 1, 2, 3])
    np.testing.assert_array_equal(numbering.of_scene(own), [-1, 2, 3, 4, 7])
    np.testing.assert_array_equal(
        numbering.of_occluders(np.array([-1, 0, 1, 2, 3, 4, 5, 6, 7, 8])), [-1, -1, -1, 0, 1, 2, 2, 2, 3, 3]
    )
    assert scene.occluders.triangle_count == 4 and [mesh.name for mesh in scene.occluders] == ["b", "c", "e"]


def test_the_flag_stays_until_it_is_set_or_the_mesh_replaced() -> None:
    scene = Scene()
    mesh = scene.put("table", *geometry.square(2, 0.0, 1.0), cast_shadows=False)
    scene.put_surface("ground", _RIDGE, cast_shadows=False)
    before = scene.revision
    scene.cast_shadows("table", False)
    assert scene.revision == before, "nothing has changed"
    scene.move("table", geometry.look_at((0, 0, 1), (1, 0, 1), (0, 0, 1)))
    scene.deform("table", geometry.square(2, 1.0, 1.0)[0])
    scene.deform_surface("ground", _RIDGE, valid=np.arange(81).reshape(9, 9) != 40)
    assert not mesh.cast_shadows and not scene["ground"].cast_shadows and scene.occluders.triangle_count == 0
    scene.put("table", *geometry.square(2, 0.0, 1.0))
    assert scene["table"] is mesh and mesh.cast_shadows
    for wrong in (1, None, "no"):
        with pytest.raises(ValueError, match="casts: expected True or False, got"):
            scene.cast_shadows("table", wrong)  # type: ignore[arg-type]
        with pytest.raises(ValueError, match="cast_shadows: expected True or False, got"):
            scene.put("table", *geometry.square(2, 3.0, 1.0), cast_shadows=wrong)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="name: expected one of"):
        scene.cast_shadows("chair", True)
    assert mesh.cast_shadows and mesh.vertices[0, 2] == 0.0
