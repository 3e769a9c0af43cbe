# SPDX-License-Identifier: Apache-2.0
"""Pipeline auto: the rule by itself, with costs made up; and with real pipelines, whose bits do not depend on it."""

from __future__ import annotations

import itertools
import time
from dataclasses import replace
from typing import Any

import geometry
import numpy as np
import probe
import pytest
import views
import warp as wp

from shadow_tracer import Bounds, Camera, PointLight, ShadowTracer
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.engine.automatic import CANDIDATES, Chooser
from shadow_tracer.gpu.engine.costs import BRUTE_FORCE, LIGHT_GRID, MESH_BVH, Names, Situation, counted, lawful

_MOVING = Situation(1, 262_144, 70_000, 1, True)
_BOUNDS = Bounds(max_triangles=8192, max_rays=65536, max_lights=8, queue_capacity=65536, grid_entries=65536)

Costs = dict[Names, float]


def play(chooser: Chooser, situation: Situation, costs: Costs, frames: int) -> list[Names]:
    """Frames of one kind with these milliseconds; who traced them."""
    chosen = []
    for _ in range(frames):
        names = chooser.choose(situation)
        chooser.learn(names, situation, costs[names])
        chosen.append(names)
    return chosen


def test_the_law_knows_what_is_good_for_what() -> None:
    def best(situation: Situation) -> Names:
        return min(CANDIDATES, key=lambda names: lawful(names, situation))

    assert best(_MOVING) == LIGHT_GRID
    assert best(Situation(0, 4096, 1_000_000, 1)) == MESH_BVH, "few rays, many triangles that rest"
    for names in CANDIDATES:
        more = replace(_MOVING, rays=2 * _MOVING.rays), replace(_MOVING, triangles=2 * _MOVING.triangles)
        assert all(lawful(names, other) > lawful(names, _MOVING) for other in (*more, replace(_MOVING, lights=3)))
    listed = Situation(0, 100_000, 1_000_000, 1, listed=True)
    assert best(listed) == LIGHT_GRID and best(replace(listed, listed=False)) == MESH_BVH, "points in any order"


@pytest.mark.parametrize("fastest", CANDIDATES, ids="/".join)
def test_the_fastest_wins_whatever_the_law_says(fastest: Names) -> None:
    costs = {names: 10.0 if names == fastest else 40.0 for names in CANDIDATES}
    chooser = Chooser()
    for names in CANDIDATES:
        chooser.calibrated(names, _MOVING, costs[names])
    chosen = play(chooser, _MOVING, costs, 1000)
    assert chosen[5:].count(fastest) >= 990
    total = sum(costs[names] for names in chosen)
    assert total < 1.05 * 1000 * costs[fastest]


@pytest.mark.parametrize("wrong", [0.3, 0.6, 1.6, 3.0])
def test_a_wrong_calibration_is_corrected(wrong: float) -> None:
    """The light grid is measured slower or faster than it will be; the other stays as it was."""
    costs = {LIGHT_GRID: 20.0, MESH_BVH: 26.0, BRUTE_FORCE: 5000.0}
    chooser = Chooser()
    for names in CANDIDATES:
        chooser.calibrated(names, _MOVING, costs[names] * (wrong if names == LIGHT_GRID else 1.0))
    chosen = play(chooser, _MOVING, costs, 2000)
    spent = sum(costs[names] for names in chosen)
    assert spent <= 1.3 * 2000 * min(costs.values()), "never slower than 1.3 times the best"


@pytest.mark.parametrize(("harder", "tried"), [(4.0, False), (30.0, True)])
def test_what_is_hard_for_one_is_expected_to_be_for_others(harder: float, tried: bool) -> None:
    """A scene, or a busy machine, is first met by one of them. Only one that finds it very hard lets others try."""
    kind = Situation(1, 65_536, 128_000, 1, True)
    chooser, base = Chooser(), {LIGHT_GRID: 28.0, MESH_BVH: 46.0, BRUTE_FORCE: 1e4}
    for names, cost in base.items():
        chooser.calibrated(names, kind, cost)
    costs = {LIGHT_GRID: harder * 28.0, MESH_BVH: 5.0 * 46.0, BRUTE_FORCE: 1e4}
    chosen = play(chooser, kind, costs, 15)
    assert chosen == [LIGHT_GRID] + 14 * [MESH_BVH if tried else LIGHT_GRID]


def test_costs_that_change_are_followed() -> None:
    """The rays leave the light grid's favourite view: within a few frames the other takes over, and gives back."""
    chooser = Chooser()
    near = {LIGHT_GRID: 20.0, MESH_BVH: 40.0, BRUTE_FORCE: 5000.0}
    far = near | {LIGHT_GRID: 90.0}
    assert play(chooser, _MOVING, near, 50)[-1] == LIGHT_GRID
    play(chooser, _MOVING, {**near, MESH_BVH: 40.0}, 400)
    chooser.learn(MESH_BVH, _MOVING, 40.0)
    assert play(chooser, _MOVING, far, 40)[-10:] == [MESH_BVH] * 10
    assert play(chooser, _MOVING, near, 2000)[-100:].count(LIGHT_GRID) > 90


def test_one_slow_frame_changes_nothing() -> None:
    chooser = Chooser()
    costs = {LIGHT_GRID: 20.0, MESH_BVH: 28.0, BRUTE_FORCE: 5000.0}
    for names in CANDIDATES:
        chooser.calibrated(names, _MOVING, costs[names])
    play(chooser, _MOVING, costs, 10)
    chooser.learn(LIGHT_GRID, _MOVING, 2000.0)
    chosen = play(chooser, _MOVING, costs, 40)
    # Frames 20 and 21 of this kind are a trial of the other.
    assert chosen[9:11] == [MESH_BVH] * 2 and chosen[11:].count(LIGHT_GRID) == 29


def test_what_is_far_slower_is_never_tried() -> None:
    chooser = Chooser()
    costs = {LIGHT_GRID: 20.0, MESH_BVH: 35.0, BRUTE_FORCE: 5000.0}
    for names in CANDIDATES:
        chooser.calibrated(names, _MOVING, costs[names])
    assert BRUTE_FORCE not in play(chooser, _MOVING, costs, 3000)


def test_a_trial_takes_two_frames() -> None:
    """In its first frame who is tried has to catch up, and nothing is learned; the second shows what it can do."""
    chooser = Chooser()
    for names in CANDIDATES:
        chooser.calibrated(names, _MOVING, {LIGHT_GRID: 20.0, MESH_BVH: 26.0, BRUTE_FORCE: 5000.0}[names])
    chosen: list[Names] = []
    for _ in range(60):
        chosen.append(chooser.choose(_MOVING))
        if chosen[-2:-1] == chosen[-1:]:  # else it has not seen the frame before
            chooser.learn(chosen[-1], _MOVING, 10.0 if chosen[-1] == MESH_BVH else 20.0)
    assert chosen[:19] == [LIGHT_GRID] * 19 and chosen[19:] == [MESH_BVH] * 41


def test_a_trial_that_shows_nothing_new_ends_after_two_frames() -> None:
    chooser = Chooser()
    costs = {LIGHT_GRID: 20.0, MESH_BVH: 26.0, BRUTE_FORCE: 5000.0}
    for names in CANDIDATES:
        chooser.calibrated(names, _MOVING, costs[names])
    chosen = play(chooser, _MOVING, costs, 1000)
    assert [k for k, names in enumerate(chosen, start=1) if names != LIGHT_GRID] == [20, 21, 420, 421, 820, 821]


def test_a_scene_that_rests_is_tried_at_once() -> None:
    """By the law they take the same, and the measured first is the slower one."""
    chooser, kind = Chooser(), Situation(0, 1_024, 2_000, 1)
    costs = {LIGHT_GRID: 0.6, MESH_BVH: 0.5, BRUTE_FORCE: 5000.0}
    assert play(chooser, kind, costs, 30) == [LIGHT_GRID] + [MESH_BVH] * 29
    chooser = Chooser()
    chosen = play(chooser, kind, {**costs, MESH_BVH: 0.9}, 30)
    assert chosen == [LIGHT_GRID] + [MESH_BVH] * 2 + [LIGHT_GRID] * 27


@pytest.mark.parametrize(("rays", "triangles"), [(16_384, 70_000), (131_072, 1_000_000)])
def test_a_large_mesh_is_tried_when_its_tree_has_been_earned(rays: int, triangles: int) -> None:
    """A million triangles take 0.35 s to build a tree of: not in the second frame of 34 ms."""
    chooser, kind = Chooser(), Situation(0, rays, triangles, 1)
    costs = {names: lawful(names, kind) * (1.3 if names == MESH_BVH else 1.0) for names in CANDIDATES}
    earned = int(0.35e-3 * triangles / costs[LIGHT_GRID]) - 1
    assert earned > 5
    assert play(chooser, kind, costs, 40) == [LIGHT_GRID] * earned + [MESH_BVH] * 2 + [LIGHT_GRID] * (38 - earned)


def test_who_was_tried_first_does_not_stay_unless_it_is_better() -> None:
    """The first frame of all loads kernels and teaches nothing, so the second is known before the present one is."""
    chooser, kind = Chooser(), Situation(0, 1_024, 2_000, 1)
    assert chooser.choose(kind) == LIGHT_GRID
    chosen = play(chooser, kind, {LIGHT_GRID: 0.47, MESH_BVH: 0.62, BRUTE_FORCE: 5000.0}, 30)
    assert chosen == [MESH_BVH] * 2 + [LIGHT_GRID] * 28


def test_a_trial_that_is_won_at_once_does_not_try_the_loser() -> None:
    chooser = Chooser()
    costs = {LIGHT_GRID: 20.0, MESH_BVH: 26.0, BRUTE_FORCE: 5000.0}
    for names in CANDIDATES:
        chooser.calibrated(names, _MOVING, costs[names])
    chosen = play(chooser, _MOVING, {**costs, MESH_BVH: 15.0}, 60)
    assert chosen == [LIGHT_GRID] * 19 + [MESH_BVH] * 41


def test_the_reason_names_all_of_them() -> None:
    chooser = Chooser()
    chooser.choose(_MOVING)
    assert chooser.reason.startswith("light_grid/packed: expected ") and " ms (" in chooser.reason
    assert all("/".join(names) in chooser.reason for names in CANDIDATES)
    chooser.forced = MESH_BVH
    assert chooser.choose(_MOVING) == MESH_BVH and chooser.reason == "asked for"


def test_little_is_remembered() -> None:
    chooser = Chooser()
    for rays in range(40):
        for triangles in range(40):
            chooser.learn(LIGHT_GRID, Situation(0, 1 << rays, 1 << triangles, 1), 1.0)
    assert probe.lessons(chooser, LIGHT_GRID) <= 512


# --- with real pipelines ---


def _states(tracer: ShadowTracer, seen: views.View) -> np.ndarray:
    frame = tracer.trace(seen.depth, seen.camera, list(seen.lights), bias=seen.bias)
    return np.stack([frame.state(light.name) for light in seen.lights])


@pytest.mark.parametrize("threads", [1, 2])
def test_bits_do_not_depend_on_the_choice(threads: int) -> None:
    """Each candidate in turn, over frames whose mesh rests, moves and is replaced."""
    seen = views.procedural_view("robots", "corridor", 192, 1500)
    made = ShadowTracer("auto", device="cpu", bounds=_BOUNDS, threads=threads)
    reference = ShadowTracer("mesh_bvh", device="cpu", bounds=_BOUNDS)
    chooser: Any = probe.chooser(made)
    rng = np.random.default_rng(8)
    few = seen.triangles[::12]
    for step in range(12):
        vertices = seen.vertices + rng.normal(0.0, 0.01, seen.vertices.shape) * (step % 3 > 0)
        triangles = few if step % 4 < 3 else few[::-1]
        for tracer in (made, reference):
            tracer.scene.put("mesh", vertices, triangles)
        chooser.forced = CANDIDATES[rng.integers(3)]
        assert np.array_equal(_states(made, seen), _states(reference, seen)), chooser.chosen
        assert probe.bands(made)[0].names == chooser.chosen == chooser.forced


@probe.in_both_forms
def test_it_is_warmed_up_and_says_what_it_does(kernel_form: str) -> None:
    """By the clock it is calibrated, too."""
    made = ShadowTracer("auto", device="cpu", bounds=replace(_BOUNDS, max_triangles=16384))
    assert (made.pipeline, made.variant) == ("auto", "measured") and made.choice
    assert made.warm_up() > 0.0
    chooser: Any = probe.chooser(made)
    assert probe.calibrated(made) == (set() if forms.wide(wp.get_device("cpu")) else set(CANDIDATES))
    assert chooser.forced is None
    seen = views.procedural_view("robots", "corridor", 64, 300)
    made.scene.put("mesh", seen.vertices, seen.triangles)
    for _ in range(3):
        _states(made, seen)
    assert any(made.choice.startswith("/".join(names)) for names in CANDIDATES)
    made.select("light_grid")
    assert made.choice == "" and probe.chooser(made) is None
    before = made.device_bytes
    made.select("auto")
    assert made.device_bytes > before, "the buffers of all candidates count"
    assert made.verify(seen.depth, seen.camera, list(seen.lights), bias=seen.bias) == 0


@probe.in_cuda_form
def test_what_it_was_calibrated_by_is_forgotten(kernel_form: str) -> None:
    """Frames after it are those of a tracer that has seen nothing: where its samples lie, and how much is looked at."""
    bounds = replace(_BOUNDS, max_triangles=16384)
    made, alone = (ShadowTracer(name, device="cpu", bounds=bounds) for name in ("auto", "light_grid"))
    made.warm_up()
    assert probe.calibrated(made) == set(CANDIDATES)
    chooser: Any = probe.chooser(made)
    chooser.forced = LIGHT_GRID
    camera, lamp = Camera(192, 192, 192.0, 192.0, 95.5, 95.5), PointLight("lamp", (0.9, -0.4, -0.2))
    for tracer in (made, alone):
        tracer.scene.put("ball", *geometry.icosphere(3, 0.4, (0.2, 0.1, 1.3)))
    for step in range(2):
        depth = np.random.default_rng(step).uniform(1.9, 2.3, (192, 192)).astype(np.float32)  # in that sheet's box
        found = [tracer.trace(depth, camera, [lamp], bias=0.01) for tracer in (made, alone)]
        assert probe.kept(made, "") == probe.kept(alone, "")
        assert np.array_equal(found[0].state("lamp"), found[1].state("lamp"))
        assert found[0].counters == found[1].counters


def test_small_bounds_leave_the_law() -> None:
    made = ShadowTracer("auto", device="cpu", bounds=Bounds(max_triangles=10, max_rays=100))
    made.warm_up()
    chooser: Any = probe.chooser(made)
    assert probe.calibrated(made) == set() and chooser.forced is None


class _Lesson:
    """A tracer with a mesh, and who learns from each of its frames, by the clock or by counts."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **more: Any) -> None:
        self.seen = views.procedural_view("robots", "corridor", 64, 300)
        self.tracer = ShadowTracer("auto", device="cpu", bounds=_BOUNDS, **more)
        self.tracer.scene.put("mesh", self.seen.vertices, self.seen.triangles)
        self._learned: list[Names] = []
        learn = Chooser.learn

        def note(this: Chooser, names: Names, situation: Situation, milliseconds: float) -> None:
            self._learned.append(names)
            learn(this, names, situation, milliseconds)

        monkeypatch.setattr(Chooser, "learn", note)

    def frame(self, names: Names, depth: np.ndarray | None = None) -> list[Names]:
        """Trace a frame by this candidate; who was told to have learned from it."""
        self._learned.clear()
        chooser: Any = probe.chooser(self.tracer)
        chooser.forced = names
        image = self.seen.depth if depth is None else depth
        self.tracer.trace(image, self.seen.camera, list(self.seen.lights), bias=self.seen.bias)
        return list(self._learned)


@probe.in_cuda_form
def test_a_frame_that_catches_up_teaches_nothing(kernel_form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who has not seen the scene for a while builds first: that is not what a frame costs."""
    lesson = _Lesson(monkeypatch)
    lesson.frame(LIGHT_GRID)
    lesson.tracer.scene.put("mesh", lesson.seen.vertices, lesson.seen.triangles[::-1])
    assert lesson.frame(LIGHT_GRID) == [LIGHT_GRID]
    assert lesson.frame(MESH_BVH) == [], "it had two new topologies to catch up with"
    assert lesson.frame(MESH_BVH) == [MESH_BVH]


@probe.in_cuda_form
def test_who_missed_a_change_is_not_told_what_the_next_one_took(
    kernel_form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The mesh moves in every frame, so that it looks the same to who has seen the last one and to who has not: the
    latter builds its tree instead of refitting it."""
    lesson = _Lesson(monkeypatch)
    order = [MESH_BVH, MESH_BVH, LIGHT_GRID, LIGHT_GRID, MESH_BVH, MESH_BVH]
    told = []
    for step, names in enumerate(order):
        lesson.tracer.scene.deform("mesh", lesson.seen.vertices + 0.001 * step)
        told.append(lesson.frame(names))
    assert told == [[], [MESH_BVH], [], [LIGHT_GRID], [], [MESH_BVH]]


@probe.in_cuda_form
def test_points_that_another_candidate_was_asked_about_are_a_frame_missed(
    kernel_form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    lesson = _Lesson(monkeypatch)
    for names in (MESH_BVH, LIGHT_GRID, MESH_BVH):
        lesson.frame(names)
    chooser: Any = probe.chooser(lesson.tracer)
    lesson.tracer.scene.deform("mesh", lesson.seen.vertices + 0.001)
    chooser.forced = LIGHT_GRID
    lesson.tracer.occluded([[0.0, 0.0, 1.0]], lesson.seen.lights[0])
    lesson.tracer.scene.deform("mesh", lesson.seen.vertices + 0.002)
    assert lesson.frame(MESH_BVH) == []
    assert lesson.frame(MESH_BVH) == [MESH_BVH]


@probe.in_cuda_form
@pytest.mark.parametrize("names", CANDIDATES, ids="/".join)
def test_the_first_frame_teaches_nothing(names: Names, kernel_form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a warm-up kernels are loaded, or even compiled, in the first frame of each format."""
    lesson = _Lesson(monkeypatch)
    assert lesson.frame(names) == []
    assert lesson.frame(names) == [names]
    millimetres = (1000.0 * np.nan_to_num(lesson.seen.depth)).astype(np.uint16)
    assert lesson.frame(names, millimetres) == [], "a kernel that takes millimetres is loaded"
    assert lesson.frame(names, millimetres) == [names]
    lesson.tracer.select("brute_force", "float64")
    lesson.tracer.select("auto")
    assert lesson.frame(names) == [], "its buffers are new"
    assert lesson.frame(names) == [names]


@probe.in_cuda_form
def test_a_frame_that_is_recorded_teaches_nothing(kernel_form: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """To record the launches takes longer than to launch them, once."""
    lesson = _Lesson(monkeypatch, graphs=True)
    told = [lesson.frame(LIGHT_GRID) for _ in range(5)]
    assert probe.recordings(lesson.tracer) == 1
    # Kernels are loaded; the launches are recorded; and replayed.
    assert told == [[], [], [LIGHT_GRID], [LIGHT_GRID], [LIGHT_GRID]]


def _told(monkeypatch: pytest.MonkeyPatch, second: float) -> list[tuple[Names, float]]:
    """Who traced the frames of a scene that moves and rests and what was learned, where a clock moves so much."""
    monkeypatch.setattr(time, "perf_counter", itertools.count(0.0, second).__next__)
    seen = views.procedural_view("robots", "corridor", 64, 300)
    tracer = ShadowTracer("auto", device="cpu", bounds=_BOUNDS, threads=1)
    tracer.warm_up()
    found: list[tuple[Names, float]] = []
    with monkeypatch.context() as patch:
        patch.setattr(
            Chooser,
            "learn",
            lambda this, names, frame, cost: (found.append((names, cost)), _LEARN(this, names, frame, cost)),
        )
        for step in range(40):
            if step % 20 < 10:
                tracer.scene.put("mesh", seen.vertices + 0.001 * step, seen.triangles)
            _states(tracer, seen)
            tracer.states_at(seen.vertices[: 50 * (step + 1)], list(seen.lights))
    return found


_LEARN = Chooser.learn


@pytest.mark.wide
def test_no_clock_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    """Counts do, of images and of points, from the first frame on."""
    slow, fast = _told(monkeypatch, 10.0), _told(monkeypatch, 1e-6)
    assert slow == fast and len(slow) == 80 and len({names for names, _ in slow}) > 1


@pytest.mark.wide
@pytest.mark.parametrize("names", CANDIDATES, ids="/".join)
def test_what_is_counted_costs(names: Names, monkeypatch: pytest.MonkeyPatch) -> None:
    """What hides the samples is found sooner by who looks at all triangles, and is less far away for the others."""
    lesson = _Lesson(monkeypatch)
    costs: list[float] = []
    monkeypatch.setattr(Chooser, "learn", lambda this, names, frame, cost: costs.append(cost))
    for far in (0.0, 0.001, 1e3):
        lesson.tracer.scene.deform("mesh", lesson.seen.vertices + far)
        lesson.frame(names)
    assert (costs[1] > costs[2] > 0.0) == (names != BRUTE_FORCE)


@pytest.mark.parametrize("names", CANDIDATES, ids="/".join)
def test_more_of_what_is_counted_costs_more(names: Names) -> None:
    frame, counters = Situation(0, 1000, 20_000, 1), dict.fromkeys(("nodes_visited", "leaf_tests", "entries"), 1000)
    cost = counted(names, frame, counters)
    more = [name for name in counters if counted(names, frame, counters | {name: 2000}) > cost]
    assert (
        more
        == {
            LIGHT_GRID: ["nodes_visited", "entries"],
            MESH_BVH: ["nodes_visited", "leaf_tests"],
            BRUTE_FORCE: ["leaf_tests"],
        }[names]
    )
    others = [replace(frame, change=1), replace(frame, rays=2000), replace(frame, lights=2)]
    others += [replace(frame, listed=True)] if names != BRUTE_FORCE else []
    for other in others:
        assert counted(names, other, counters) > cost
