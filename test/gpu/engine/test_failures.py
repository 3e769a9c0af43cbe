# SPDX-License-Identifier: Apache-2.0
"""What failed once leaves nothing behind: the next frame is right, and the pipeline that worked before still does."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import geometry
import numpy as np
import probe
import pytest
import warp as wp

from shadow_tracer import Bounds, Camera, PointLight, ShadowTracer, State
from shadow_tracer.gpu.accelerators.bvh import mesh_bvh
from shadow_tracer.gpu.engine import frame as frame_tracer
from shadow_tracer.gpu.engine.automatic import CANDIDATES
from shadow_tracer.gpu.engine.band import Band
from shadow_tracer.gpu.occluders import world
from shadow_tracer.gpu.occluders.corners import Corners
from shadow_tracer.gpu.samples import sample_set

_BOUNDS = Bounds(max_triangles=2000, max_rays=4096, max_lights=2, queue_capacity=4096, grid_entries=8192)
_CAMERA = Camera(48, 40, 48.0, 48.0, 23.5, 19.5)
_DEPTH = np.full((40, 48), 5.0, np.float32)
_LIGHTS = [PointLight("left", (-0.5, 0.0, 0.0)), PointLight("right", (0.5, 0.1, 0.0))]
_MOVED = [PointLight("left", (0.3, 0.9, 0.2)), PointLight("right", (-0.4, -0.8, 0.1))]
_PIPELINES = ["light_grid/packed", "cone_hierarchy/linear", "mesh_bvh/refit"]


class _Out(RuntimeError):
    """Raised once."""


def _tracer(names: str, **more: Any) -> ShadowTracer:
    tracer = ShadowTracer(*names.split("/"), device="cpu", bounds=_BOUNDS, threads=1, **more)
    tracer.scene.put("ball", *geometry.icosphere(2, 0.7, (0.0, 0.0, 2.5)))
    return tracer


def _states(tracer: ShadowTracer, lights: list[PointLight] = _LIGHTS) -> np.ndarray:
    frame = tracer.trace(_DEPTH, _CAMERA, lights)
    return np.stack([frame.state(light.name) for light in lights])


def _fail_once(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str, after: int = 0) -> None:
    """Call number ``after`` of this function raises; those before and after do what they should."""
    original, calls = getattr(owner, name), [0]

    def failing(*arguments: Any, **named: Any) -> Any:
        calls[0] += 1
        if calls[0] == after + 1:
            raise _Out(name)
        return original(*arguments, **named)

    monkeypatch.setattr(owner, name, failing)


@probe.in_both_forms
@pytest.mark.parametrize("names", _PIPELINES)
@pytest.mark.parametrize("where", ["project", "aim", "trace"])
def test_a_frame_after_one_that_failed_is_right(names: str, where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Records were announced for new lights and not made: none may be taken for those of the old lights."""
    tracer, other = _tracer(names), _tracer(names)
    _states(tracer)
    with monkeypatch.context() as patch:
        _fail_once(patch, Band, where)
        with pytest.raises(_Out):
            _states(tracer, _MOVED)
    expected = _states(other, _MOVED)
    assert (expected == State.SHADOWED).any()
    assert np.array_equal(_states(tracer, _MOVED), expected)


def test_a_tree_that_could_not_be_made_is_made_in_the_next_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    tracer, other = _tracer("mesh_bvh/refit"), _tracer("mesh_bvh/refit")
    _states(tracer)
    for each in (tracer, other):
        each.scene.put("ball", *geometry.icosphere(2, 0.4, (0.5, 0.5, 2.0)))
    with monkeypatch.context() as patch:
        _fail_once(patch, mesh_bvh, "scene_box")
        with pytest.raises(_Out):
            _states(tracer)
    assert np.array_equal(_states(tracer), _states(other))


def test_a_scene_that_was_copied_in_part_is_copied_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mesh grows over the place of the next one, the copy fails, and the mesh is what it was: the next one is not."""
    tracer, other = _tracer("light_grid/packed"), _tracer("light_grid/packed")
    small, large = geometry.icosphere(1, 0.3, (-0.6, 0.0, 2.0)), geometry.icosphere(3, 0.3, (-0.6, 0.0, 2.0))
    for each in (tracer, other):
        each.scene.clear()
        each.scene.put("a", *small)
        each.scene.put("b", *geometry.icosphere(1, 0.4, (0.6, 0.0, 2.0)))
    _states(tracer)
    tracer.scene.put("a", *large)
    with monkeypatch.context() as patch:
        _fail_once(patch, world.SceneBuffers, "_sync_part", 1)  # "a" is there, "b" is not
        with pytest.raises(_Out):
            _states(tracer)
    tracer.scene.put("a", *small)
    assert np.array_equal(_states(tracer), _states(other))


@pytest.mark.parametrize("wanted", ["brute_force", "mesh_bvh", "auto"])
@pytest.mark.parametrize("names", ["light_grid", "auto"])
def test_a_selection_that_fails_changes_nothing(names: str, wanted: str, monkeypatch: pytest.MonkeyPatch) -> None:
    tracer = _tracer(names)
    expected = _states(tracer)
    if wanted == names:
        return
    before = tracer.device_bytes
    chooser = probe.chooser(tracer)
    with monkeypatch.context() as patch:
        _fail_once(patch, frame_tracer, "Band", 2 if wanted == "auto" else 0)  # in the middle of the candidates
        with pytest.raises(_Out):
            tracer.select(wanted)
    assert tracer.pipeline == names and probe.chooser(tracer) is chooser and tracer.device_bytes == before
    assert np.array_equal(_states(tracer), expected)
    tracer.select(wanted)
    assert tracer.pipeline == wanted and np.array_equal(_states(tracer), expected)


def test_a_selection_that_fails_keeps_the_second_pipeline(monkeypatch: pytest.MonkeyPatch) -> None:
    tracer = _tracer("light_grid")
    tracer.prepare_verify("mesh_bvh")
    with monkeypatch.context() as patch:
        _fail_once(patch, frame_tracer, "Band")
        with pytest.raises(_Out):
            tracer.select("mesh_bvh")
    assert probe.verifier(tracer) == "mesh_bvh" and tracer.verify(_DEPTH, _CAMERA, _LIGHTS) == 0


@pytest.mark.parametrize("candidate", range(len(CANDIDATES)))
def test_a_warm_up_that_fails_forces_no_choice(candidate: int, monkeypatch: pytest.MonkeyPatch) -> None:
    tracer = _tracer("auto")
    with monkeypatch.context() as patch:
        turn = SimpleNamespace(begins=lambda: None)
        _fail_once(patch, turn, "begins", candidate)
        probe.before_small_scenes(tracer, patch, lambda: turn.begins())
        with pytest.raises(_Out):
            tracer.warm_up()
    chooser = probe.chooser(tracer)
    assert chooser is not None and chooser.forced is None
    _states(tracer)
    assert tracer.choice.startswith("/".join(chooser.chosen))


@probe.in_cuda_form  # in the other the first pipeline has something else instead
def test_what_a_pipeline_shares_is_freed_with_its_last_user() -> None:
    """Vertices seen from a light belong to all bands that need them; whoever verifies has separate ones."""
    tracer = _tracer("mesh_bvh")
    shared = probe.context(tracer).shared
    plain = tracer.device_bytes
    tracer.prepare_verify("cone_hierarchy")
    assert shared.find(Corners) is None and tracer.device_bytes > plain
    tracer.release_verify()
    assert tracer.device_bytes == plain
    tracer.select("light_grid")
    assert shared.find(Corners) is not None and shared.nbytes() > 0
    tracer.prepare_verify("cone_hierarchy")
    tracer.select("brute_force")
    assert shared.find(Corners) is None and shared.nbytes() == 0
    assert tracer.verify(_DEPTH, _CAMERA, _LIGHTS) == 0


def test_slices_of_two_threads() -> None:
    """One clears what the other has just kept: both have their part all the same."""
    kept = sample_set.Slices()

    class Cleared(dict[Any, Any]):
        def __setitem__(self, key: Any, value: Any) -> None:
            """Somebody else clears right after."""

    array: Any = wp.zeros(8, dtype=int, device="cpu")
    kept._made = Cleared()
    assert kept(array, 2, 3).shape == (3,)
