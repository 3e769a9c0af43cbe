# SPDX-License-Identifier: Apache-2.0
"""The built-in self-test: right on this machine, and able to say so when something is not."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import oracle
import pytest

from shadow_tracer import DirectionalLight, SpotLight, State, available_pipelines, self_test
from shadow_tracer.gpu.accelerators.brute_force.brute_force import BruteForce
from shadow_tracer.gpu.accelerators.bvh.mesh_bvh import Judge
from shadow_tracer.gpu.accelerators.light_grid.packed import PackedGrid
from shadow_tracer.gpu.accelerators.walker import Walker
from shadow_tracer.gpu.engine.band import Band

_NAMES = ["brute_force", *(name for name in available_pipelines() if name != "brute_force")]


def test_all_pipelines_are_right(any_device: str) -> None:
    self_test.run(any_device)  # kernels are loaded
    begin = time.perf_counter()
    results = self_test.run(any_device)
    seconds = time.perf_counter() - begin
    assert [result.pipeline for result in results] == _NAMES
    for result in results:
        assert result.ok and result.differing == 0 and result.text == "", result
        assert result.variant == available_pipelines()[result.pipeline][0] and 0.0 < result.seconds < seconds


def _expected() -> list[list[np.ndarray]]:
    """States by the oracle, per frame and light; no sample may be near the edge of a light."""
    depth, camera, frames = self_test.depth(), self_test.camera(), []
    valid = np.isfinite(depth) & (depth > 0)
    points = camera.unproject(np.where(valid, depth, 1.0))
    for number in range(2):
        states = []
        for light in self_test.LIGHTS:
            answer = oracle.occluded(points, light, *self_test.sheet(number), self_test.BIAS)
            assert not answer.tie.any()
            state = np.where(answer.hidden.reshape(depth.shape), State.SHADOWED, State.LIT).astype(np.uint8)
            if not isinstance(light, DirectionalLight):
                way = points - light.position
                distance = np.linalg.norm(way, axis=-1)
                assert abs(distance - light.range).min() > 1e-6
                state[distance > light.range] = State.OUTSIDE
                if isinstance(light, SpotLight):
                    cosine = way @ light.direction / np.linalg.norm(light.direction) / distance
                    assert abs(cosine - np.cos(light.outer_angle)).min() > 1e-6
                    state[cosine < np.cos(light.outer_angle)] = State.OUTSIDE
            state[~valid] = State.INVALID
            states.append(state)
        frames.append(states)
    return frames


def test_the_checksum_is_that_of_the_oracle() -> None:
    """So the self-test cannot be content with pipelines that are wrong alike. Every state occurs in its scene."""
    expected = _expected()

    class Known:
        def __init__(self, states: list[np.ndarray]) -> None:
            self._states = dict(zip((light.name for light in self_test.LIGHTS), states, strict=True))

        def state(self, name: str) -> np.ndarray:
            return self._states[name]

    frames: Any = [Known(states) for states in expected]
    assert self_test.checksum(frames) == self_test._CHECKSUM
    counts = np.bincount(np.concatenate([state.reshape(-1) for states in expected for state in states]), minlength=4)
    assert (counts > 100).all()
    assert sum(int((a != b).sum()) for a, b in zip(*expected, strict=True)) > 100, "the deformed sheet casts others"


def test_a_wrong_pipeline_is_named(any_device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that leaves out the last light, so that its shadows are lit: exactly these pairs are counted."""
    shadows = sum(int((states[2] == State.SHADOWED).sum()) for states in _expected())
    trace = Band.trace

    def all_but_the_last(this: Any, work: Any) -> None:
        trace(this, work)
        if isinstance(this.pipeline, PackedGrid):
            states = this.samples.states_of(2)
            host = states.numpy()
            states.assign(np.where(host == State.SHADOWED, np.uint8(State.LIT), host))

    monkeypatch.setattr(Band, "trace", all_but_the_last)
    results = {result.pipeline: result for result in self_test.run(any_device, threads=1)}
    wrong = results.pop("light_grid")
    results.pop("auto")  # which may have handed the scene to it
    if any_device == "cpu":
        assert (wrong.ok, wrong.differing) == (False, shadows)
        assert str(shadows) in wrong.text and "brute_force" in wrong.text
    else:  # a recording cannot read back
        assert not wrong.ok
    assert all(result.ok for result in results.values())


def test_a_pipeline_that_fails_is_named(any_device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(this: Any, *_: Any) -> None:
        raise RuntimeError("out of luck")

    monkeypatch.setattr(Judge, "show", fail)
    results = {result.pipeline: result for result in self_test.run(any_device, threads=1)}
    assert not results["mesh_bvh"].ok and "out of luck" in results["mesh_bvh"].text
    assert results["mesh_bvh"].differing == 2 * 64 * 48 * 3
    results.pop("auto")  # which may have handed the scene to it
    for name in ("height_field", "geometry_image"):
        assert not results.pop(name).ok, "its meshes go through that"
    assert all(result.ok for name, result in results.items() if name != "mesh_bvh")


def test_a_wrong_reference_is_found_out(any_device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    class Blind(Walker):
        def show(self, *_: Any) -> None:
            """Nothing."""

    monkeypatch.setattr(BruteForce, "walker", lambda this, context: Blind(this, context))
    results = self_test.run(any_device)
    assert not any(result.ok for result in results)
    assert "checksum" in results[0].text


@pytest.mark.wide
@pytest.mark.parametrize("threads", [2, 3, 8])
@pytest.mark.parametrize("wrong", ["light_grid", "brute_force"])
def test_what_only_the_last_of_several_shares_does_wrong_is_found(
    threads: int, wrong: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bands work side by side in a finer image; a wrong reference is found out as well."""
    trace = Band.trace

    def all_but_the_last(this: Any, work: Any) -> None:
        if this.names[0] != wrong or this.samples.number != threads - 1:
            trace(this, work)

    monkeypatch.setattr(Band, "trace", all_but_the_last)
    results = {result.pipeline: result for result in self_test.run("cpu", ["light_grid", "mesh_bvh"], threads=threads)}
    assert not results[wrong].ok and results[wrong].differing > 100
    assert results["mesh_bvh"].ok == (wrong == "light_grid")


def test_a_finer_image_has_the_pixels_of_the_small_one() -> None:
    points = [self_test.camera(fine).unproject(np.nan_to_num(self_test.depth(fine))) for fine in (1, 4)]
    assert np.array_equal(points[1][::4, ::4], points[0])


def test_chosen_pipelines_and_progress(any_device: str) -> None:
    told: list[Any] = []
    results = self_test.run(any_device, ["mesh_bvh", "brute_force"], lambda *args: told.append(args))
    assert [result.pipeline for result in results] == ["brute_force", "mesh_bvh"]
    assert told == [("brute_force", 0, 2), ("mesh_bvh", 1, 2)]


def test_errors_name_the_argument() -> None:
    with pytest.raises(ValueError, match="^pipeline: expected one of.*mesh_bvh.*cone"):
        self_test.run("cpu", ["cone"])
    with pytest.raises(ValueError, match="^device:"):
        self_test.run("cuda:77")
