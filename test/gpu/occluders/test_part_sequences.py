# SPDX-License-Identifier: Apache-2.0
"""Random sequences of unlike parts that are put, removed, deformed and moved on one tracer, with the same lights for
many frames: what is kept of the parts that rest, and gaps, are right in every pipeline."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import geometry
import numpy as np
import probe
import probe_occluders
import pytest

from shadow_tracer import Bounds, Camera, DirectionalLight, PointLight, Scene, ShadowTracer, available_pipelines
from shadow_tracer.gpu.engine import bands
from shadow_tracer.gpu.engine import frame as frame_tracer

_MOST = 1400
_BOUNDS = Bounds(_MOST, 3000, 3, queue_capacity=2048, grid_entries=8192)
_CAMERA = Camera(60, 50, 50.0, 50.0, 29.5, 24.5)
_SHARED = [("light_grid", "packed"), ("cone_hierarchy", "linear"), ("brute_force", "filtered"), ("auto", "measured")]
_VARIANTS = [(name, variant) for name, variants in available_pipelines().items() for variant in variants]
_DEFAULTS = [(name, variants[0]) for name, variants in available_pipelines().items()]
_MARKED = [
    *(pytest.param(names, probe.USUAL, id="/".join(names)) for names in _DEFAULTS),
    *(
        pytest.param(names, form, id=f"{'/'.join(names)}-{form}", marks=pytest.mark.slow)
        for form in probe.FORMS
        for names in _VARIANTS
        if form == probe.CUDA or names not in _DEFAULTS
    ),
]
_SEEDS = [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))]
# Those that follow the papers closely, or decide everything exactly, are slow: one sequence is enough for them.
_SLOWEST = "cone_hierarchy/spheres", "cone_hierarchy/precise", "brute_force/float64", "bsp", "ray_classification"
_QUICK = [case for case in _MARKED if not "/".join(case.values[0]).startswith(_SLOWEST)]  # type: ignore[arg-type]

Change = Callable[[Scene], object]
Rng = np.random.Generator


@pytest.fixture(autouse=True)
def _small_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (bands, frame_tracer):
        monkeypatch.setattr(module, "LEAST", 64)


@dataclass(frozen=True)
class _Step:
    changes: tuple[Change, ...]
    depth: np.ndarray | None
    points: np.ndarray
    lights: tuple[Any, ...]
    culling: bool
    states: np.ndarray
    silent: tuple[int, int, int]  # triangles, and those that are degenerate and culled

    def ask(self, tracer: ShadowTracer) -> tuple[np.ndarray, dict[str, int]]:
        """States, and counters."""
        tracer.front_face_culling = self.culling
        if self.depth is None:
            traced = probe.trace_points(tracer, self.points, self.lights)
            return traced.states, traced.counters
        frame = tracer.trace(self.depth, _CAMERA, self.lights)
        return np.stack([frame.state(light.name).reshape(-1) for light in self.lights]), dict(frame.counters)


def _lights(rng: Rng) -> tuple[Any, ...]:
    lights = [
        PointLight("lamp", rng.uniform((-1, -1, -1), (1, 1, 0.5))),
        DirectionalLight("sun", rng.normal((0, 0, 1.5), 0.5)),
        PointLight("low", rng.uniform((-3, 1, 3), (3, 2, 5))),
    ]
    return tuple(lights[: rng.integers(1, 4)])


def _change(rng: Rng, scene: Scene) -> Change:
    """One that is possible, of one of six names."""
    name = str(rng.choice(list("abcdef")))
    kind = rng.choice(["put", "put", "deform", "move", "move", "remove"])
    if name not in scene or kind == "put":
        old = scene[name] if name in scene else None
        room = _MOST - scene.triangle_count + (len(old.triangles) if old else 0)
        room = min(room, (3 * _MOST - scene.vertex_count + (len(old.vertices) if old else 0)) // 3)
        count = min(room, int(rng.choice([0, 1, 2, 30, 127, 128, 129, 300, 700])))
        if rng.random() < 0.1:
            count = room
        vertices, triangles = geometry.soup(rng, max(count, 1), float(rng.choice([0.2, 1.5])), 2.0)
        vertices += (0.0, 0.0, 3.0)
        vertices[rng.random(len(vertices)) < 0.02] = np.nan
        vertices, triangles = vertices[: 3 * room], triangles[:count]
        triangles[rng.random(len(triangles)) < 0.05, 1] = 0
        triangles[rng.random(len(triangles)) < 0.02] = 0
        return lambda scene: scene.put(name, vertices, triangles, nonfinite="skip")
    if kind == "remove":
        return lambda scene: scene.remove(name)
    if kind == "move":
        pose = geometry.pose_of(geometry.rotation(rng), rng.normal(0.0, 0.3, 3))
        return lambda scene: scene.move(name, pose)
    moved = scene[name].vertices + rng.normal(0.0, 0.1, scene[name].vertices.shape)
    return lambda scene: scene.deform(name, moved, nonfinite="skip")


@cache
def _sequence(seed: int, length: int = 40) -> tuple[_Step, ...]:
    rng, scene, steps = np.random.default_rng([94, seed]), Scene(_BOUNDS), []
    lights, culling, points, depth = _lights(rng), False, np.zeros((0, 3)), None
    for number in range(length):
        changes = []
        for _ in range(int(rng.choice([0, 1, 1, 1, 2, 3]))):
            changes.append(_change(rng, scene))
            changes[-1](scene)
        if rng.random() < 0.04:
            changes.append(Scene.clear)
            scene.clear()
        lights = _lights(rng) if rng.random() < 0.15 else lights
        culling ^= bool(rng.random() < 0.1)
        if number == 0 or rng.random() < 0.3:
            points = rng.uniform((-2.5, -2.5, 0.0), (2.5, 2.5, 7.0), (int(rng.choice([1, 300, 3000])), 3))
            depth = rng.uniform(0.5, 7.0, (50, 60)).astype(np.float32) if rng.random() < 0.5 else None
        step = _Step(tuple(changes), depth, points, lights, culling, np.zeros(0), (0, 0, 0))
        reference = ShadowTracer("brute_force", device="cpu", bounds=_BOUNDS, threads=1)
        for mesh in scene:
            reference.scene.put(mesh.name, mesh.vertices, mesh.triangles, mesh.pose, nonfinite="skip")
        states, counters = step.ask(reference)
        silent = counters["triangles"], counters["degenerate"], counters["culled"]
        steps.append(_Step(**{**vars(step), "states": states, "silent": silent}))
    return tuple(steps)


def _walk(tracer: ShadowTracer, seed: int, exact_counts: bool) -> list[probe_occluders.Layout]:
    """Every frame is right; how the scene lay in each."""
    layouts = []
    for number, step in enumerate(_sequence(seed)):
        for change in step.changes:
            change(tracer.scene)
        states, counters = step.ask(tracer)
        assert np.array_equal(states, step.states), number
        assert counters["triangles"] == step.silent[0], number
        counted = (counters["degenerate"], counters["culled"])
        if exact_counts:
            assert counted == step.silent[1:], number
        assert all(some <= every for some, every in zip(counted, step.silent[1:], strict=True)), number
        layouts.append(probe_occluders.layout(tracer))
    return layouts


def _tracer(names: tuple[str, str], **more: Any) -> ShadowTracer:
    return ShadowTracer(*names, **{"device": "cpu", "bounds": _BOUNDS, "threads": 1, **more})


def _counts_all(names: tuple[str, str]) -> bool:
    """Whether there are records of all triangles; else only of those that may concern a ray."""
    return names not in (("light_grid", "packed"), ("auto", "measured")) or not probe.wide("cpu")


@pytest.mark.parametrize(("names", "kernel_form"), _MARKED, indirect=["kernel_form"])
def test_parts_come_and_go(names: tuple[str, str]) -> None:
    _parts_come_and_go(names, 1)


@pytest.mark.parametrize("seed", [2, 3])
@pytest.mark.parametrize(("names", "kernel_form"), _QUICK, indirect=["kernel_form"])
@pytest.mark.slow
def test_more_parts_come_and_go(names: tuple[str, str], seed: int) -> None:
    _parts_come_and_go(names, seed)


def _parts_come_and_go(names: tuple[str, str], seed: int) -> None:
    layouts = _walk(_tracer(names), seed, _counts_all(names))
    gaps = sum(each.looked_at > each.live for each in layouts)
    assert gaps >= 8, "frames with gaps"
    moved = [
        any(after.first[name] != place for name, place in before.first.items() if name in after.first)
        for before, after in zip(layouts, layouts[1:], strict=False)
    ]
    assert 0 < sum(moved) < len(moved) / 2, "parts mostly stay where they are"


@pytest.mark.parametrize("seed", _SEEDS)
@pytest.mark.parametrize("names", _SHARED, ids="/".join)
def test_parts_come_and_go_by_two_threads(names: tuple[str, str], seed: int) -> None:
    _walk(_tracer(names, threads=2), seed, _counts_all(names))


@pytest.mark.parametrize("seed", _SEEDS)
@probe.in_forms("names", [("light_grid", "packed")], [("light_grid", "packed"), ("cone_hierarchy", "linear")])
def test_parts_come_and_go_while_frames_are_recorded(names: tuple[str, str], seed: int) -> None:
    """Some frames of the sequence are asked for again, and so recorded and replayed."""
    tracer = _tracer(names, graphs=True)
    for number, step in enumerate(_sequence(seed)):
        for change in step.changes:
            change(tracer.scene)
        for _ in range(1 + 2 * (number % 3 == 0)):
            assert np.array_equal(step.ask(tracer)[0], step.states), number


@pytest.mark.parametrize("seed", _SEEDS)
def test_pipelines_take_turns_while_parts_come_and_go(seed: int) -> None:
    """What one has made of the parts, and what it has missed."""
    rng, tracer = np.random.default_rng(seed), _tracer(("light_grid", "packed"), threads=2)
    tracer.prepare_verify("cone_hierarchy")
    for number, step in enumerate(_sequence(seed)):
        for change in step.changes:
            change(tracer.scene)
        if rng.random() < 0.3:
            tracer.select(*_VARIANTS[rng.integers(len(_VARIANTS))])
        assert np.array_equal(step.ask(tracer)[0], step.states), (number, tracer.pipeline, tracer.variant)
        if step.depth is not None and rng.random() < 0.3:
            assert tracer.verify(step.depth, _CAMERA, step.lights) == 0, number
