# SPDX-License-Identifier: Apache-2.0
"""Meshes that a light ignores cast nothing in it, and all that they did in others: in every pipeline the answers are
those of a scene without them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import geometry
import numpy as np
import probe
import pytest
from interrupts import Ring, Steps

from shadow_tracer import Bias, Bounds, Camera, DirectionalLight, PointLight, RectangleLight, ShadowTracer, SphereLight
from shadow_tracer.gpu.engine import bands
from shadow_tracer.gpu.engine import frame as frame_tracer

_BOUNDS = {"max_triangles": 2000, "max_rays": 1200, "max_lights": 8, "queue_capacity": 2000, "grid_entries": 20_000}
_CAMERA = Camera(20, 15, 18.0, 18.0, 9.5, 7.0, geometry.look_at((-4.0, 0.5, 2.5), (0, 0, 0.5), (0, 0, 1)))
_MESHES: dict[str, geometry.Geometry] = {
    "floor": geometry.square(2, -1.5, 8.0),
    "shade": geometry.box((0.2, -0.1, 2.8), (0.8, 0.6, 3.2)),  # all around the lamp
    "ball": geometry.icosphere(1, 0.6, (0.3, 0.2, 1.4)),
    "rubble": geometry.soup(np.random.default_rng(190), 150, 0.4, 1.5),
}
_LIGHTS: list[Any] = [
    PointLight("bare", (0.5, 0.25, 3.0), ignore=["shade"]),
    PointLight("shaded", (0.5, 0.25, 3.0)),
    SphereLight("bulb", (0.5, 0.25, 3.0), 0.125, samples=3, ignore=["shade", "nobody"]),
    DirectionalLight("sun", (0.25, 0.375, -1.0), ignore=["ball"]),
    RectangleLight("panel", (0.5, 0.25, 3.0), (0.0, 0.25, 0.0), (0.25, 0.0, 0.0), samples=4, ignore=list(_MESHES)),
    PointLight("other", (-1.0, 0.25, 2.0), ignore=["shade"]),
]


@pytest.fixture
def small_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    """Several threads have work in a hundred samples."""
    for module in (bands, frame_tracer):
        monkeypatch.setattr(module, "LEAST", 32)


def _depth(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(1.0, 7.0, (15, 20)).astype(np.float32)


def _put(tracer: Any, meshes: dict[str, geometry.Geometry], without: Any = ()) -> None:
    tracer.scene.clear()
    for name, mesh in meshes.items():
        if name not in without:
            tracer.scene.put(name, *mesh)


def _expected(
    device: str, points: np.ndarray, lights: list[Any], meshes: dict[str, geometry.Geometry], bias: float
) -> np.ndarray:
    """(L, N) bits, each light in a scene of only what it does not ignore."""
    tracer = ShadowTracer("brute_force", device=device, bounds=Bounds(**_BOUNDS), threads=1)
    bits = []
    for light in lights:
        _put(tracer, meshes, light.ignore)
        bits.append(tracer.light_bits(points, [light], bias)[0])
    return np.array(bits)


def _points(depth: np.ndarray) -> np.ndarray:
    return _CAMERA.unproject(depth).reshape(-1, 3)


def test_a_light_does_not_see_what_it_ignores(tracer: Any) -> None:
    """In every pipeline, in images and for points, twice."""
    depth = _depth(191)
    true = _expected(tracer.device, _points(depth), _LIGHTS, _MESHES, 0.01)
    assert not true[1].any() and 0.1 < (true[0] > 0).mean() < 0.9 and (true[4] != true[2]).any()
    _put(tracer, _MESHES)
    for _ in range(2):
        frame = tracer.trace(depth, _CAMERA, _LIGHTS, Bias(0.01))
        for light, bits in zip(_LIGHTS, true, strict=True):
            np.testing.assert_array_equal(frame.light_bits(light.name).reshape(-1), bits, err_msg=light.name)
        np.testing.assert_array_equal(tracer.light_bits(_points(depth), _LIGHTS, 0.01), true)
    for light, bits in zip(_LIGHTS[:2], true, strict=False):
        np.testing.assert_array_equal(tracer.occluded(_points(depth), light, 0.01), bits == 0)


@pytest.mark.usefixtures("small_bands")
@pytest.mark.parametrize("graphs", [False, True])
@pytest.mark.parametrize("cull", [False, True])
@probe.in_forms(
    "names",
    ["light_grid/packed", "light_grid/spherical", "cone_hierarchy/linear", "cone_hierarchy/precise", "mesh_bvh/refit"]
    + ["bvh/sah", "height_field/pyramid", "light_buffer/cube", "ray_classification/lazy", "kd_tree/sah"]
    + ["uniform_grid/dda", "hierarchical_grid/nested", "brute_force/float64", "auto/measured"],
    ["light_grid/packed", "cone_hierarchy/linear", "brute_force/filtered"],
)
@pytest.mark.slow
def test_sequences_in_which_everything_changes(any_device: str, names: str, cull: bool, graphs: bool) -> None:
    """Meshes come, go, move and change their size, and what lights ignore does; nothing of that stays behind."""
    bounds = Bounds(**_BOUNDS)
    tracer = ShadowTracer(
        *names.split("/"), device=any_device, bounds=bounds, front_face_culling=cull, graphs=graphs, threads=2
    )
    oracle = ShadowTracer("brute_force", device=any_device, bounds=bounds, front_face_culling=cull, threads=1)
    rng = np.random.default_rng(192)
    meshes = dict(_MESHES)
    depth = _depth(193)
    for step in range(14):
        if step % 3 == 1:
            name = str(rng.choice(list(_MESHES)))
            mesh = geometry.soup(rng, int(rng.choice([2, 130, 300])), 0.5, 1.5)
            meshes[name] = mesh
            tracer.scene.put(name, *mesh)
        elif step % 3 == 2:
            name = str(rng.choice(list(meshes)))
            del meshes[name]
            tracer.scene.remove(name)
        elif step == 0:
            _put(tracer, meshes)
        if step % 4 == 3:
            depth = _depth(194 + step)
        number = int(rng.choice([1, 2, 4]))
        lights = []
        for place in rng.choice(len(_LIGHTS), number, replace=False):
            ignore = rng.choice(list(_MESHES), int(rng.choice([0, 1, 2]))).tolist()
            light = _LIGHTS[place]
            lights.append(replace(light, ignore=ignore))
        frame = tracer.trace(depth, _CAMERA, lights, Bias(0.01))
        for light in lights:
            _put(oracle, meshes, light.ignore)
            true = oracle.light_bits(_points(depth), [light], 0.01)[0]
            np.testing.assert_array_equal(frame.light_bits(light.name).reshape(-1), true, err_msg=f"{step} {light}")
        if names.startswith("light_grid"):
            assert tracer.verify(depth, _CAMERA, lights, Bias(0.01)) == 0


@pytest.mark.parametrize("variant", ["sah", "median"])
def test_trees_know_what_is_left_out(any_device: str, variant: str) -> None:
    """Other meshes are left out, the same of another scene, of one that has moved, none, and the first ones again."""
    tracer = ShadowTracer("bvh", variant, any_device, Bounds(**_BOUNDS))
    rng, meshes = np.random.default_rng(203), dict(_MESHES)
    panel = RectangleLight("panel", (0.5, 0.25, 3.0), (0.0, 0.5, 0.0), (0.5, 0.0, 0.0), two_sided=True)
    points, ways = rng.uniform(-2.0, 2.0, (200, 3)), ((), ("shade", "ball"), ("shade", "rubble"), ("shade", "ball"))
    _put(tracer, meshes)
    for step in range(3):
        for ignore in ways:
            light = replace(panel, ignore=ignore)
            true = _expected(any_device, points, [light], meshes, 0.01)
            np.testing.assert_array_equal(tracer.light_bits(points, [light], 0.01), true, err_msg=f"{step} {ignore}")
        if step:
            vertices, triangles = meshes["rubble"]
            meshes["rubble"] = vertices + rng.uniform(-0.3, 0.3, vertices.shape), triangles
            tracer.scene.deform("rubble", meshes["rubble"][0])
        else:
            meshes["rubble"] = geometry.soup(rng, 150, 0.4, 1.5)
            _put(tracer, meshes)


def test_nothing_is_made_again_for_lights_that_ignore_nothing(any_device: str) -> None:
    """A frame with a light that ignores a mesh leaves what was made for the others."""
    tracer = ShadowTracer("mesh_bvh", device=any_device, bounds=Bounds(**_BOUNDS))
    _put(tracer, _MESHES)
    for _ in range(2):
        tracer.trace(_depth(191), _CAMERA, _LIGHTS, 0.01)
    frame = tracer.trace(_depth(191), _CAMERA, _LIGHTS, 0.01)
    assert "build" not in frame.stages or frame.stages["build"] == 0.0


@probe.in_forms("names", ["light_grid", "cone_hierarchy", "auto"], ["light_grid"])
def test_recorded_frames_in_which_every_light_ignores_something(any_device: str, names: str) -> None:
    """What is made of the scene while a mesh is left out is not taken for the whole, in replays neither."""
    tracer = ShadowTracer(names, device=any_device, bounds=Bounds(**_BOUNDS), graphs=True)
    rng, lamp = np.random.default_rng(197), (0.5, 0.25, 3.0)
    lights = [PointLight("a", lamp, ignore=["ball", "rubble"]), PointLight("b", lamp, ignore=["shade"])]
    meshes, depth = dict(_MESHES), _depth(198)
    _put(tracer, meshes)
    for step in range(7):
        for name in ("ball", "rubble", "shade", "floor"):
            vertices, triangles = _MESHES[name]
            meshes[name] = vertices + rng.normal(0.0, 0.3, 3), triangles
            tracer.scene.deform(name, meshes[name][0])
        frame = tracer.trace(depth, _CAMERA, lights, 0.01)
        true = _expected(any_device, _points(depth), lights, meshes, 0.01)
        for light, bits in zip(lights, true, strict=True):
            np.testing.assert_array_equal(frame.light_bits(light.name).reshape(-1), bits, err_msg=f"{step}")


def test_a_mesh_without_triangles_at_the_end_of_the_room(any_device: str) -> None:
    """Meshes laid end to end fill it; behind them lies one that is only vertices, and is left out as well."""
    rng, points = np.random.default_rng(201), np.random.default_rng(202).uniform(-2, 2, (300, 3))
    tracer = ShadowTracer("brute_force", device=any_device, bounds=Bounds(**{**_BOUNDS, "max_triangles": 4}))
    meshes = {name: geometry.soup(rng, 1, 3.0, 1.0) for name in "abcd"}
    meshes["e"] = geometry.square(2, 1.5, 0.5)
    for name in "abcd":
        tracer.scene.put(name, *meshes[name])
    lamp = {"position": (0.5, 0.25, 3.0)}
    tracer.occluded(points, PointLight("lamp", **lamp))
    for name in "ac":
        tracer.scene.remove(name)
    tracer.scene.put("e", *meshes["e"])  # there is no gap for two
    tracer.scene.put("vertices", meshes["e"][0][:2], np.zeros((0, 3), np.int32))
    some = tracer.occluded(points, PointLight("lamp", **lamp, ignore=["e", "vertices"]))
    every = tracer.occluded(points, PointLight("lamp", **lamp))
    tracer.scene.remove("e")
    np.testing.assert_array_equal(some, tracer.occluded(points, PointLight("lamp", **lamp)))
    assert some.sum() < every.sum()


def test_sets_of_samples_in_turn(any_device: str) -> None:
    """Two over one scene, of which each leaves out other meshes."""
    tracer = ShadowTracer("light_grid", device=any_device, bounds=Bounds(**{**_BOUNDS, "max_sample_sets": 2}))
    _put(tracer, _MESHES)
    depths = {"one": _depth(195), "two": _depth(196)}
    for _ in range(2):
        for samples, depth in depths.items():
            lights = _LIGHTS[:3] if samples == "one" else _LIGHTS[1:4]
            frame = tracer.trace(depth, _CAMERA, lights, 0.01, samples=samples)
            true = _expected(any_device, _points(depth), lights, _MESHES, 0.01)
            for light, bits in zip(lights, true, strict=True):
                np.testing.assert_array_equal(frame.light_bits(light.name).reshape(-1), bits)


@pytest.mark.usefixtures("small_bands")
@pytest.mark.slow
@pytest.mark.parametrize("names", ["light_grid/packed", "bvh/sah"])
def test_an_interrupt_leaves_nothing_out(names: str) -> None:
    """While meshes are left out as at any other step: the next frames see all of them, or what they leave out."""
    tracer, steps = ShadowTracer(*names.split("/"), device="cpu", bounds=Bounds(**_BOUNDS), threads=2), Steps()
    _put(tracer, _MESHES)
    true = _expected("cpu", _points(_depth(199)), _LIGHTS, _MESHES, 0.01)

    def trace() -> list[np.ndarray]:
        frame = tracer.trace(_depth(199), _CAMERA, _LIGHTS, 0.01)
        return [frame.light_bits(light.name).reshape(-1) for light in _LIGHTS]

    trace()
    total, interrupted = steps.count(trace), 0
    for at in np.random.default_rng(200).integers(1, total, 12):
        tracer.scene.deform("ball", _MESHES["ball"][0])
        try:
            steps.run(trace, int(at))
        except Ring:
            interrupted += 1
        np.testing.assert_array_equal(tracer.occluded(_points(_depth(199)), _LIGHTS[1], 0.01), true[1] == 0)
        np.testing.assert_array_equal(trace(), true)
    assert interrupted > 6
