# SPDX-License-Identifier: Apache-2.0
"""The light grid's own promises: any capacity of its entry list gives the same bits, its counters tell what it did,
several lights in one pass do not know each other, and nothing that is kept from one frame to the next is out of date.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import geometry
import numpy as np
import probe
import pytest
import views

from shadow_tracer import (
    Bounds,
    Camera,
    DirectionalLight,
    PointLight,
    ShadowTracer,
    SpotLight,
    State,
    available_pipelines,
)

_PIPELINE = "light_grid"
_EVERY = probe.in_forms("variant", available_pipelines()[_PIPELINE], ["packed"])

Make = Callable[..., ShadowTracer]


@pytest.fixture(scope="module")
def make() -> Make:
    """Tracers with the given capacities, made once; in the state of fresh ones when they are handed out."""
    made: dict[tuple[Any, ...], ShadowTracer] = {}

    def get(device: str, variant: str, **capacities: int) -> ShadowTracer:
        key = (device, probe.wide(device), variant, *sorted(capacities.items()))
        if key not in made:
            made[key] = _fresh(device, variant, **capacities)
        return probe.reset(made[key])

    return get


def _fresh(device: str, variant: str, **capacities: int) -> ShadowTracer:
    bounds = {"max_triangles": 2_000, "max_rays": 2_500, "max_lights": 16, "grid_entries": 200_000, **capacities}
    return ShadowTracer(_PIPELINE, variant, device, Bounds(**bounds))


# --- capacities ---

_LIGHTS: dict[str, Any] = {
    "inside": PointLight("inside", (0.1, 0.2, 3.3)),
    "outside": PointLight("outside", (3.0, -4.0, -1.0)),
    "far": PointLight("far", (3e4, -2e4, -4e4)),
    "sun": DirectionalLight("sun", (-0.3, 0.4, 0.8)),
    "spot": SpotLight("spot", (0.3, -0.5, 0.5), (0.0, 0.1, 1.0), 0.4),
}


@cache
def _image(*lights: str) -> tuple[views.View, np.ndarray]:
    """40 triangles, some of them large, in front of and behind 16 x 12 pixels."""
    rng = np.random.default_rng(440)
    camera = Camera(16, 12, 14.0, 14.0, 7.5, 5.5)
    depth = rng.uniform(2.0, 5.0, (12, 16)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = 0.0
    vertices, triangles = geometry.join([geometry.soup(rng, 32, 0.3, 1.0), geometry.soup(rng, 8, 2.0, 2.0)])
    chosen = tuple(_LIGHTS[name] for name in lights)
    view = views.View(vertices + [0.0, 0.0, 3.0], triangles, depth, camera, chosen, 0.01)
    return view, views.expected_states(view)


def _traced(tracer: ShadowTracer, view: views.View) -> tuple[np.ndarray, dict[str, int]]:
    """(lights, H, W) states and the counters."""
    if "mesh" not in tracer.scene:
        tracer.scene.put("mesh", view.vertices, view.triangles)
    frame = tracer.trace(view.depth, view.camera, view.lights, view.bias)
    return np.stack([frame.state(light.name) for light in view.lights]), frame.counters


@_EVERY
@pytest.mark.parametrize("light", _LIGHTS)
@pytest.mark.parametrize("capacity", ["one", "half", "one too few", "all", "one more"])
def test_any_number_of_entries(make: Make, any_device: str, variant: str, light: str, capacity: str) -> None:
    view, expected = _image(light)
    states, counters = _traced(make(any_device, variant), view)
    np.testing.assert_array_equal(states, expected)
    total = counters["entries"]
    assert total > 10 and counters["overflow_passes"] == 0, "a bad test scene"
    entries = {"one": 1, "half": total // 2, "one too few": total - 1, "all": total, "one more": total + 1}[capacity]
    cramped = _fresh(any_device, variant, grid_entries=entries)
    at_once = probe.wide(any_device) and variant == "packed"
    for _ in range(2):
        states, counters = _traced(cramped, view)
        np.testing.assert_array_equal(states, expected)
        if capacity == "one too few":
            # a tile that is dark after the first pass takes no more entries: the rest may fit by now
            assert counters["overflow_passes"] > 0 or counters["entries"] <= entries or at_once, counters
        elif at_once:  # what waits on the list is a part of all entries
            assert counters["overflow_passes"] < max(total / entries, 1), counters
            assert capacity != "one" or counters["overflow_passes"] > 0
        else:
            assert (counters["overflow_passes"] > 0) == (entries < total), counters


@_EVERY
@pytest.mark.parametrize("entries", [1, 7, 64, 1000])
def test_few_entries_for_all_lights(make: Make, any_device: str, variant: str, entries: int) -> None:
    view, expected = _image(*_LIGHTS)
    needed = _traced(make(any_device, variant), view)[1]["entries"]
    cramped = make(any_device, variant, grid_entries=entries)
    for _ in range(2):
        states, counters = _traced(cramped, view)
        np.testing.assert_array_equal(states, expected)
    if entries * len(_LIGHTS) < needed:
        assert counters["overflow_passes"] > 0
    points = view.camera.unproject(np.where(view.depth > 0, view.depth, 1.0))[view.depth > 0]
    for k, light in enumerate(view.lights):
        hidden = cramped.occluded(points, light, view.bias)
        np.testing.assert_array_equal(hidden, expected[k][view.depth > 0] == State.SHADOWED)


@cache
def _lattice() -> tuple[views.View, np.ndarray]:
    """Every sample lies on a lattice of touching triangles: many pairs that float32 cannot decide."""
    vertices, triangles = geometry.join(
        [geometry.square(axis, float(at), 2.0) for axis in range(3) for at in (-2, -1, 0, 1, 2)]
    )
    pose = geometry.pose_of(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 2.0))
    depth = np.tile(np.array([1.0, 2.0, 4.0, 1.0, 2.0, 4.0, 3.0], np.float32)[:, None], (1, 9))
    lights = (
        PointLight("lamp", (0.25, 0.5, 3.0)),
        PointLight("corner", (2.0, 2.0, 2.0)),
        DirectionalLight("sun", (1.0, 2.0, -4.0)),
    )
    view = views.View(vertices, triangles, depth, Camera(9, 7, 4.0, 4.0, 4.0, 3.0, pose), lights, 0.0)
    return view, views.expected_states(view)


@_EVERY
@pytest.mark.parametrize("entries", [1, 2, 30])
@pytest.mark.parametrize("queue", [1, 3, 64])
@pytest.mark.slow
def test_few_entries_and_a_small_queue(make: Make, any_device: str, variant: str, queue: int, entries: int) -> None:
    view, expected = _lattice()
    cramped = make(any_device, variant, grid_entries=entries, queue_capacity=queue)
    for _ in range(2):
        states, counters = _traced(cramped, view)
        np.testing.assert_array_equal(states, expected)
        assert queue > 3 or probe.wide(any_device) or counters["overflow_passes"] > 0
    assert 0.2 < (expected == State.SHADOWED).mean() < 0.98


# --- counters ---


@_EVERY
@pytest.mark.parametrize("light", _LIGHTS)
def test_counters(make: Make, any_device: str, variant: str, light: str) -> None:
    view, expected = _image(light)
    _, counters = _traced(make(any_device, variant), view)
    rays, triangles = counters["rays"], counters["triangles"]
    assert rays == (expected < State.OUTSIDE).sum() > 20 and triangles == 40
    assert 0 < counters["entries"]
    assert 0 < counters["leaf_tests"] <= rays * triangles
    assert 0 < counters["largest_tile"] <= triangles
    assert 0 <= counters["retested"] <= counters["leaf_tests"]
    assert counters["splits"] >= 0 and counters["passes"] >= 1 and counters["overflow_passes"] == 0
    assert "overflows" not in counters


@_EVERY
def test_counters_of_frames_with_nothing_to_do(make: Make, any_device: str, variant: str) -> None:
    view, _ = _image("inside")
    tracer = make(any_device, variant)
    _, counters = _traced(tracer, replace(view, depth=np.full_like(view.depth, np.nan)))
    assert counters["rays"] == counters["leaf_tests"] == counters["overflow_passes"] == 0
    tracer.scene.put("mesh", view.vertices, view.triangles[:0])
    states, counters = _traced(tracer, view)
    assert counters["entries"] == counters["leaf_tests"] == counters["overflow_passes"] == 0
    assert (states[0][view.depth > 0] == State.LIT).all()


@_EVERY
@pytest.mark.parametrize("light", ["outside", "far", "sun", "spot"])
def test_a_wall_before_everything(make: Make, any_device: str, variant: str, light: str) -> None:
    """Tiles that one triangle covers are accepted whole: no ray of them is tested."""
    view, _ = _image(light)
    chosen = view.lights[0]
    toward = chosen.homogeneous[:3] - chosen.homogeneous[3] * np.array([0.0, 0.0, 3.0])
    toward = toward / np.linalg.norm(toward)
    right = np.cross(toward, (0.0, 1.0, 0.0))
    down = np.cross(toward, right)
    # just before the light, or 10 m away: among far and directional lights' rays, beside all samples
    at = chosen.position - 0.05 * toward if light in ("spot", "outside") else np.array([0.0, 0.0, 3.0]) + 10.0 * toward
    wall = np.stack([at + 1e3 * (x * right + y * down) for x, y in ((-1.0, -1.0), (1.0, -1.0), (0.0, 1.5))])
    tracer = make(any_device, variant)
    tracer.scene.put("wall", wall, [[0, 1, 2]])
    frame = tracer.trace(view.depth, view.camera, view.lights, view.bias)
    states, counters = frame.state(light), frame.counters
    assert np.isin(states[view.depth > 0], [State.SHADOWED, State.OUTSIDE]).all() and counters["rays"] > 20
    if variant == "packed":
        assert counters["accepted"] > 0 and counters["leaf_tests"] == counters["retested"] == 0, counters
    tracer.scene.put("mesh", view.vertices, view.triangles)
    np.testing.assert_array_equal(tracer.trace(view.depth, view.camera, view.lights, view.bias).state(light), states)


@_EVERY
def test_narrower_spots_have_fewer_entries(make: Make, any_device: str, variant: str) -> None:
    rng = np.random.default_rng(441)
    camera = Camera(48, 48, 30.0, 30.0, 23.5, 23.5)
    depth = rng.uniform(3.0, 5.0, (48, 48)).astype(np.float32)
    vertices, triangles = geometry.soup(rng, 600, 0.08, 2.0)
    tracer = make(any_device, variant)
    tracer.scene.put("soup", vertices + [0.0, 0.0, 3.0], triangles)
    entries, rays = [], []
    for angle in (1.0, 0.4, 0.15, 0.05):
        spot = SpotLight("spot", (0.2, -0.1, 0.1), (0.0, 0.0, 1.0), angle)
        counters = tracer.trace(depth, camera, [spot], 0.01).counters
        entries.append(counters["entries"])
        rays.append(counters["rays"])
    assert rays[-1] > 5 and all(b < a for a, b in zip(rays, rays[1:], strict=False)), rays
    assert all(b < a for a, b in zip(entries, entries[1:], strict=False)), entries


# --- several lights in one pass ---


def _many_lights(count: int) -> tuple[Any, ...]:
    """All kinds, near and far, some with a range, one of them twice under two names."""
    rng = np.random.default_rng(442)
    lights: list[Any] = []
    for k in range(count - 1):
        way, place = geometry.directions(rng, 1)[0], rng.uniform((-2, -2, 0), (2, 2, 5))
        if k % 4 == 0:
            lights.append(PointLight(f"lamp {k}", place, range=4.0 if k % 8 else np.inf))
        elif k % 4 == 1:
            lights.append(DirectionalLight(f"sun {k}", way))
        elif k % 4 == 2:
            lights.append(SpotLight(f"spot {k}", place, [0.1, 0.0, 3.0] - place, rng.uniform(0.2, 2.5)))
        else:
            lights.append(PointLight(f"star {k}", way * 10.0 ** rng.uniform(2, 8)))
    return (*lights, replace(lights[0], name="the first again"))


@cache
def _crowd(count: int) -> tuple[views.View, np.ndarray]:
    rng = np.random.default_rng(443)
    camera = Camera(32, 24, 28.0, 28.0, 15.5, 11.5)
    depth = rng.uniform(2.0, 5.0, (24, 32)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.05] = np.inf
    vertices, triangles = geometry.join([geometry.soup(rng, 150, 0.15, 1.6), geometry.square(1, 2.0, 8.0)])
    view = views.View(vertices + [0.0, 0.0, 3.0], triangles, depth, camera, _many_lights(count), 0.01)
    return view, views.expected_states(view)


@_EVERY
@pytest.mark.parametrize("count", [2, 3, 7, 16])
def test_lights_do_not_know_each_other(make: Make, any_device: str, variant: str, count: int) -> None:
    """Together, each alone, in another order, a part of them: the same states."""
    view, expected = _crowd(count)
    tracer = make(any_device, variant)
    states, _ = _traced(tracer, view)
    np.testing.assert_array_equal(states, expected)
    np.testing.assert_array_equal(states[0], states[-1])
    for order in (np.random.default_rng(444).permutation(count), np.arange(count)[::-1], np.arange(0, count, 2)):
        some, _ = _traced(tracer, replace(view, lights=tuple(view.lights[k] for k in order)))
        np.testing.assert_array_equal(some, expected[order])
    for k, light in enumerate(view.lights):
        alone, _ = _traced(tracer, replace(view, lights=(light,)))
        np.testing.assert_array_equal(alone[0], expected[k], err_msg=light.name)


@_EVERY
@pytest.mark.parametrize("entries", [50, 2000])
def test_many_lights_and_few_entries(make: Make, any_device: str, variant: str, entries: int) -> None:
    view, expected = _crowd(16)
    states, counters = _traced(make(any_device, variant, grid_entries=entries), view)
    np.testing.assert_array_equal(states, expected)
    assert entries > 50 or counters["overflow_passes"] > 0


def test_the_lights_differ() -> None:
    expected = _crowd(16)[1]
    hidden, lit = ((expected == state).mean(axis=(1, 2)) for state in (State.SHADOWED, State.LIT))
    assert (hidden > 0.05).sum() >= 12 and (lit > 0.05).sum() >= 12
    assert len({states.tobytes() for states in expected}) >= 13


# --- what is kept from frame to frame ---


class Stage:
    """A mesh, a ground, a camera and three lights, one step after the other."""

    def __init__(self, seed: int) -> None:
        self.rng = rng = np.random.default_rng([445, seed])
        self.mesh = geometry.soup(rng, 80, 0.25, 1.0)
        self.ground = geometry.square(1, 1.8, 6.0)
        self.pose = geometry.pose_of(np.eye(3), (0.0, 0.0, 3.0))
        self.camera = Camera(24, 18, 20.0, 20.0, 11.5, 8.5)
        self.depth = rng.uniform(2.0, 5.0, (18, 24)).astype(np.float32)
        self.lights: list[Any] = [
            PointLight("lamp", (0.5, -1.0, 2.0)),
            SpotLight("spot", (-1.0, -1.5, 0.0), (0.3, 0.4, 1.0), 0.7),
            DirectionalLight("sun", (0.2, 0.9, 0.4)),
        ]

    def light_moves(self) -> None:
        k, rng = int(self.rng.integers(0, 3)), self.rng
        if k == 2:
            self.lights[2] = replace(self.lights[2], direction=rng.normal(size=3))
        else:
            reach = 10.0 ** rng.uniform(0, 5)  # sometimes from inside to far away
            self.lights[k] = replace(self.lights[k], position=rng.normal(size=3) * reach)

    def mesh_moves(self) -> None:
        self.pose = geometry.pose_of(geometry.rotation(self.rng), self.rng.normal(size=3) * 0.3 + [0.0, 0.0, 3.0])

    def mesh_deforms(self) -> None:
        vertices, triangles = self.mesh
        self.mesh = vertices + self.rng.normal(size=vertices.shape) * 0.1, triangles

    def mesh_changes(self) -> None:
        self.mesh = geometry.soup(self.rng, int(self.rng.integers(1, 120)), 0.25, 1.0)

    def camera_moves(self) -> None:
        pose = geometry.pose_of(np.eye(3), self.rng.normal(size=3) * 0.2)
        self.camera = replace(self.camera, camera_to_world=pose)

    def depth_changes(self) -> None:
        self.depth = self.rng.uniform(2.0, 5.0, self.depth.shape).astype(np.float32)
        self.depth[self.rng.random(self.depth.shape) < self.rng.choice([0.0, 0.2, 0.95])] = 0.0

    def lights_change_places(self) -> None:
        self.lights = self.lights[1:] + self.lights[:1]

    def nothing_changes(self) -> None:
        pass

    def show(self, tracer: ShadowTracer) -> None:
        """Bring a tracer's scene up to date, whatever it held."""
        vertices, triangles = self.mesh
        if "mesh" in tracer.scene and np.array_equal(tracer.scene["mesh"].triangles, triangles):
            if not np.array_equal(tracer.scene["mesh"].vertices, vertices):
                tracer.scene.deform("mesh", vertices)
            if not np.array_equal(tracer.scene["mesh"].pose, self.pose):
                tracer.scene.move("mesh", self.pose)
        else:
            tracer.scene.put("mesh", vertices, triangles, pose=self.pose)
        if "ground" not in tracer.scene:
            tracer.scene.put("ground", *self.ground)

    def trace(self, tracer: ShadowTracer) -> np.ndarray:
        """(3, H, W) states, in the order of the names."""
        frame = tracer.trace(self.depth, self.camera, self.lights, 0.01)
        return np.stack([frame.state(name) for name in ("lamp", "spot", "sun")])


def _steps(stage: Stage, kind: str) -> list[Callable[[], None]]:
    light, mesh = [stage.light_moves], [stage.mesh_moves, stage.mesh_deforms, stage.mesh_changes]
    rest = [stage.camera_moves, stage.depth_changes, stage.lights_change_places, stage.nothing_changes]
    chosen = {
        "lights": [light],
        "meshes": [mesh],
        "alternately": [light, mesh],
        "everything": [light, mesh, rest],
    }[kind]
    return [stage.rng.choice(chosen[k % len(chosen)]) for k in range(20)]  # type: ignore[arg-type]


@_EVERY
@pytest.mark.parametrize("kind", ["lights", "meshes", "alternately", "everything"])
@pytest.mark.slow
def test_nothing_is_out_of_date(make: Make, any_device: str, variant: str, kind: str) -> None:
    """Twenty steps; a tracer that has seen them all says what a new one says, and so does the brute force."""
    stage = Stage(len(kind))
    tracer = make(any_device, variant)
    brute = ShadowTracer("brute_force", None, any_device, Bounds(max_triangles=2_000, max_rays=2_500, max_lights=3))
    seen = []
    for step in [stage.nothing_changes, *_steps(stage, kind)]:
        step()
        new = _fresh(any_device, variant)
        for each in (tracer, brute, new):
            stage.show(each)
        states = stage.trace(tracer)
        name = step.__name__
        np.testing.assert_array_equal(states, stage.trace(new), err_msg=f"{name}: not what a new tracer says")
        np.testing.assert_array_equal(states, stage.trace(brute), err_msg=f"{name}: not what brute force says")
        if kind == "everything":
            # a question in between about other samples, another light, and the other side of triangles
            tracer.front_face_culling = not tracer.front_face_culling
            tracer.occluded(stage.rng.normal(size=(50, 3)), PointLight("other", stage.rng.normal(size=3)))
            tracer.front_face_culling = not tracer.front_face_culling
        seen.append(states.tobytes())
    assert len(set(seen)) > 8, "nothing moved"
