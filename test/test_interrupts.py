# SPDX-License-Identifier: Apache-2.0
"""An exception that reaches the calling thread in the middle of a frame arrives, and the next frame has the right bits:
nothing that was half done is believed, and no thread works on in buffers that are used again."""

from __future__ import annotations

import time
import weakref
from collections.abc import Callable
from functools import cache
from typing import Any

import geometry
import numpy as np
import probe
import pytest
from interrupts import Ring, Steps, ring_after

from shadow_tracer import Bounds, Camera, DirectionalLight, PointLight, ShadowTracer, render_depth
from shadow_tracer.gpu.engine import bands, frame
from shadow_tracer.gpu.engine import frame as frame_tracer
from shadow_tracer.scene.mesh import Scene

_SIZE = 128
_BOUNDS = Bounds(max_triangles=4000, max_rays=_SIZE * _SIZE, max_lights=2, queue_capacity=4096, grid_entries=32768)
_CAMERA = Camera(_SIZE, _SIZE, 100.0, 100.0, 63.5, 63.5)
_DEPTH = np.full((_SIZE, _SIZE), 5.0, np.float32)
_DEPTH[::7] = 3.0
_POINTS = np.random.default_rng(1).uniform((-2, -2, 3), (2, 2, 6), (4096, 3))
_LIGHTS = [PointLight("lamp", (0.0, 0.2, 0.5)), DirectionalLight("sun", (0.3, 0.2, 1.0))]
_OTHERS = [PointLight("lamp", (-0.7, 0.5, 0.2)), DirectionalLight("sun", (-0.2, 0.4, 1.0))]
_FEW = _POINTS[:100]  # of so many and 2,000 triangles every pair is asked about
_QUESTIONS = ["trace", "occluded", "few", "states_at", "verify", "render_depth"]
_THREADS = [1, 2, 4, 8]
_SIGNALS = 50  # of each question and number of threads: over a thousand in all

Answer = Callable[[], Any]


@pytest.fixture(autouse=True)
def _small_bands(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (bands, frame_tracer):
        monkeypatch.setattr(module, "LEAST", 256)


@cache
def _mesh(seed: int) -> geometry.Geometry:
    vertices, triangles = geometry.soup(np.random.default_rng(seed), 2000, 0.1, 1.5)
    return vertices + (0.0, 0.0, 2.0), triangles


def _tracer(names: str = "light_grid", threads: int = 1, **more: Any) -> ShadowTracer:
    tracer = ShadowTracer(*names.split("/"), device="cpu", bounds=_BOUNDS, threads=threads, **more)
    tracer.scene.put("mesh", *_mesh(1))
    return tracer


def _ask(tracer: ShadowTracer, question: str, lights: list[Any] = _LIGHTS) -> Any:
    """An answer that can be compared."""
    if question == "trace":
        frame = tracer.trace(_DEPTH, _CAMERA, lights)
        return np.stack([frame.state(name) for name in frame.names]).tobytes()
    if question == "occluded":
        return tracer.occluded(_POINTS, lights[0]).tobytes()
    if question == "few":
        return tracer.states_at(_FEW, lights).tobytes()
    if question == "states_at":
        return tracer.states_at(_POINTS, lights).tobytes()
    if question == "verify":
        return tracer.verify(_DEPTH, _CAMERA, lights)
    return [image.tobytes() for image in render_depth(tracer.scene, _CAMERA, "cpu")]


@cache
def _right(question: str, seed: int = 1) -> Any:
    tracer = _tracer("brute_force")
    tracer.scene.put("mesh", *_mesh(seed))
    return _ask(tracer, question)


def _changed(tracer: ShadowTracer, number: int) -> None:
    """Everything is to be made again: other triangles for the frame that is interrupted."""
    tracer.scene.put("mesh", *_mesh(2 + number % 3))


@pytest.mark.slow
# What a handler raises while an object is being deleted is printed by Python, and lost.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("threads", _THREADS)
@pytest.mark.parametrize("question", _QUESTIONS)
def test_signals_at_random_moments(question: str, threads: int) -> None:
    tracer, rng = _tracer(threads=threads), np.random.default_rng(threads)
    for _ in range(2):
        _ask(tracer, question, _OTHERS)
    begin = time.perf_counter()
    _ask(tracer, question)
    seconds, interrupted = time.perf_counter() - begin, 0
    for number in range(_SIGNALS):
        _changed(tracer, number)
        interrupted += ring_after(rng.uniform(0.0, seconds), lambda: _ask(tracer, question, _OTHERS))
        tracer.scene.put("mesh", *_mesh(1))
        # Whatever has been interrupted, all questions are answered rightly.
        for next_question in (question, _QUESTIONS[number % len(_QUESTIONS)]):
            assert _ask(tracer, next_question) == _right(next_question), (number, next_question)
    assert interrupted > 0


_KINDS: list[tuple[str, int, dict[str, Any], str]] = [
    ("light_grid/packed", 1, {}, probe.USUAL),
    ("light_grid/packed", 2, {}, probe.USUAL),
    ("light_grid/packed", 1, {"graphs": True}, probe.CUDA),
    ("light_grid/spherical", 1, {}, probe.USUAL),
    ("cone_hierarchy/linear", 2, {}, probe.USUAL),
    ("cone_hierarchy/precise", 1, {}, probe.USUAL),
    ("mesh_bvh/refit", 1, {}, probe.USUAL),
    ("uniform_grid/dda", 1, {}, probe.USUAL),
    ("hierarchical_grid/nested", 1, {}, probe.CUDA),
    ("kd_tree/sah", 1, {}, probe.USUAL),
    ("octree/parametric", 1, {}, probe.CUDA),
    ("light_buffer/cube", 1, {}, probe.USUAL),
    ("ray_classification/lazy", 1, {}, probe.USUAL),
    ("height_field/pyramid", 2, {}, probe.USUAL),
    ("geometry_image/threaded", 2, {}, probe.CUDA),
    ("brute_force/filtered", 2, {}, probe.USUAL),
    ("auto/measured", 2, {}, probe.USUAL),
]

_SLOW = "ray_classification/lazy", "cone_hierarchy/precise", "geometry_image/threaded"


# Points in no order are slow to trace for the variants that follow the paper.
@pytest.mark.parametrize(
    ("question", "names", "threads", "more", "kernel_form"),
    [
        (question, *kind)
        for question in ("trace", "states_at", "verify")
        for kind in _KINDS
        if (question, kind[0]) != ("states_at", "cone_hierarchy/precise")
    ]
    + [("few", "light_grid/packed", 1, {}, probe.USUAL)],
    indirect=["kernel_form"],
)
@pytest.mark.slow
def test_an_exception_at_any_step(question: str, names: str, threads: int, more: dict[str, Any]) -> None:
    """At steps of all functions that a frame runs, Warp's among them; the same ones in every run."""
    tracer, steps = _tracer(names, threads, **more), Steps()
    for _ in range(3):
        _ask(tracer, question, _OTHERS)
    _changed(tracer, 0)
    total = steps.count(lambda: _ask(tracer, question, _OTHERS))
    assert total > (100 if question == "few" else 300)
    for number, at in enumerate(np.random.default_rng(7).integers(1, total, 8 if names in _SLOW else 25)):
        _changed(tracer, number)
        _interrupt(steps, lambda: _ask(tracer, question, _OTHERS), int(at))
        tracer.scene.put("mesh", *_mesh(1))
        assert _ask(tracer, question) == _right(question), at
        if number % 5 == 0:
            assert tracer.verify(_DEPTH, _CAMERA, _LIGHTS) == 0


def _interrupt(steps: Steps, function: Callable[[], Any], at: int) -> None:
    try:
        steps.run(function, at)
    except Ring:
        return
    assert steps.taken < steps.at, "an exception arrives"


def test_no_exception_is_lost_in_what_swallows_it() -> None:
    """One that arrives in a ``__del__`` or in a weak reference's callback is only printed: another follows."""

    class Deleted:
        def __del__(self) -> None:
            len("")

    def function() -> None:
        nonlocal kept
        kept = None
        Deleted()
        len("")

    steps, weak, moved = Steps(), weakref.WeakSet[Any](), 0
    kept = Deleted()
    weak.add(kept)
    for at in range(1, steps.count(function) + 1):
        kept = Deleted()
        weak.add(kept)
        with pytest.raises(Ring):
            steps.run(function, at)
        moved += steps.taken > at
    assert moved > 3


def test_an_exception_at_any_step_of_an_image() -> None:
    tracer, steps = _tracer(), Steps()
    total = steps.count(lambda: _ask(tracer, "render_depth"))
    for number, at in enumerate(np.random.default_rng(8).integers(1, total, 40)):
        _changed(tracer, number)
        _interrupt(steps, lambda: _ask(tracer, "render_depth"), int(at))
        tracer.scene.put("mesh", *_mesh(1))
        assert _ask(tracer, "render_depth") == _right("render_depth"), at


_CHANGES: dict[str, Callable[[Scene], Any]] = {
    "put": lambda scene: scene.put("mesh", *_mesh(3), pose=geometry.pose_of(np.eye(3), (0.1, 0.0, 0.3))),
    "put other triangles": lambda scene: scene.put("mesh", _mesh(3)[0], _mesh(3)[1][::-1]),
    "put another": lambda scene: scene.put("other", *_mesh(3)),
    "deform": lambda scene: scene.deform("mesh", _mesh(3)[0]),
    "move": lambda scene: scene.move("mesh", geometry.pose_of(np.eye(3), (0.1, 0.0, 0.3))),
    "remove": lambda scene: scene.remove("mesh"),
    "clear": lambda scene: scene.clear(),
}


@pytest.mark.parametrize("change", _CHANGES)
@pytest.mark.slow
def test_a_change_of_the_scene_has_happened_or_not(change: str) -> None:
    """Interrupted at every step: the scene is the one before or the one after, and the tracer traces what it holds."""
    steps = Steps()

    def holding() -> tuple[ShadowTracer, list[Any]]:
        tracer = _tracer()
        _ask(tracer, "trace")
        return tracer, _content(tracer.scene)

    _CHANGES[change](holding()[0].scene)  # what happens only once in a process
    tracer, before = holding()
    total = steps.count(lambda: _CHANGES[change](tracer.scene))
    after = _content(tracer.scene)
    assert before != after
    every = 1 + total // 40
    for at in range(1, total + 1, every):
        tracer, _ = holding()
        with pytest.raises(Ring):
            steps.run(lambda tracer=tracer: _CHANGES[change](tracer.scene), at)
        content = _content(tracer.scene)
        assert content in (before, after), at
        fresh = ShadowTracer("mesh_bvh", device="cpu", bounds=_BOUNDS)
        for mesh in tracer.scene:
            fresh.scene.put(mesh.name, mesh.vertices, mesh.triangles, mesh.pose)
        assert _ask(tracer, "trace") == _ask(fresh, "trace"), at
        assert tracer.scene.triangle_count == fresh.scene.triangle_count


def _content(scene: Scene) -> list[Any]:
    return [(mesh.name, mesh.vertices.tobytes(), mesh.triangles.tobytes(), mesh.pose.tobytes()) for mesh in scene]


def test_a_frame_cannot_begin_within_a_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    """As when a handler of a signal asks the tracer that is at work: an error, not a wait without end."""
    tracer = _tracer()
    _ask(tracer, "trace")
    begin = frame.FrameTracer.trace_depth

    def asks_again(this: Any, *arguments: Any) -> Any:
        monkeypatch.setattr(frame.FrameTracer, "trace_depth", begin)
        _ask(tracer, "trace")
        return begin(this, *arguments)

    monkeypatch.setattr(frame.FrameTracer, "trace_depth", asks_again)
    with pytest.raises(RuntimeError, match="a frame is under way in this thread"):
        _ask(tracer, "trace")
    assert _ask(tracer, "trace") == _right("trace")
