# SPDX-License-Identifier: Apache-2.0
"""A teapot in a stadium: thousands of triangles of 5 mm in one place of a bowl of 300 m, seen and lit from near and
far. Two of its views are in ``test_views.py`` as well, at full size."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import probe
import pytest
import views
from trees import Tree, hidden, tracer_of

from benchmark import procedural
from shadow_tracer import PointLight, SpotLight, State

_ADAPTIVE = (("kd_tree", "sah"), ("octree", "parametric"), ("bsp", "exact"), ("light_buffer", "cube"))
_EYES = ("pot", "touchline", "stand")


@cache
def _seen(eye: str) -> tuple[views.View, np.ndarray]:
    view = views.procedural_view("stadium", eye, 48, views.SMALL)
    return view, views.expected_states(view)


def _small_triangles(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(T,) bool: those of the pot."""
    edges = vertices[triangles] - np.roll(vertices[triangles], 1, axis=1)
    small: np.ndarray = np.linalg.norm(edges, axis=2).max(axis=1) < 0.1
    return small


@pytest.mark.parametrize("count", [3_000, 70_000, 300_000])
def test_nearly_all_of_it_is_the_pot(count: int) -> None:
    made = procedural.stadium(count)
    vertices, triangles = made.positions[0], made.triangles
    assert 0.85 * count < len(triangles) < 1.05 * count
    small = _small_triangles(vertices, triangles)
    corners = vertices[triangles[small]]
    pot = np.ptp(corners.reshape(-1, 3), axis=0)
    edges = np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)
    assert small.mean() > 0.8 and 0.004 < np.median(edges) < 0.006
    assert pot.max() < 1.5 and np.ptp(vertices, axis=0)[:2].min() > 300.0
    middle = 0.5 * (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1)))
    distances = {name: np.linalg.norm(made.lights[name].position - middle) for name in ("inside", "outside", "far")}
    assert distances["inside"] == pytest.approx(1.0, abs=0.3) and distances["outside"] == pytest.approx(200.0, abs=1.0)
    assert distances["far"] == pytest.approx(5e4, rel=1e-3)


@pytest.mark.parametrize("part", [0, 1, 2, 3], ids=["body", "knob", "handle", "spout"])
def test_the_pot_is_closed(part: int) -> None:
    """Every edge of each of its parts belongs to two triangles, in opposite directions."""
    made = procedural.stadium(3_000)
    triangles = made.triangles[_small_triangles(made.positions[0], made.triangles)]
    # parts share no vertices, so the lowest vertex that can be reached tells them apart
    reached = np.arange(triangles.max() + 1)
    for _ in range(200):
        lowest = reached[triangles].min(axis=1)
        np.minimum.at(reached, triangles.reshape(-1), np.repeat(lowest, 3))
    roots = np.unique(reached[triangles[:, 0]])
    assert len(roots) == 4
    mine = triangles[reached[triangles[:, 0]] == roots[part]]
    edges = np.concatenate([mine[:, [0, 1]], mine[:, [1, 2]], mine[:, [2, 0]]])
    assert len(np.unique(edges, axis=0)) == len(edges)
    assert set(map(tuple, edges.tolist())) == set(map(tuple, edges[:, ::-1].tolist()))


@pytest.mark.parametrize("eye", ["touchline"])  # the others: test_views.py
def test_small_equals_the_oracle(tracer: Any, eye: str) -> None:
    view, expected = _seen(eye)
    view.check(tracer, expected)


def test_every_light_hides_and_reaches() -> None:
    everywhere = np.concatenate([_seen(eye)[1].reshape(6, -1) for eye in _EYES], axis=1)
    for light, states in zip(_seen("pot")[0].lights, everywhere, strict=True):
        counts = np.bincount(states, minlength=4)
        assert counts[State.LIT] > 500 and counts[State.SHADOWED] > 100, (light.name, counts)
    assert (everywhere == State.OUTSIDE).sum() > 500 and (everywhere == State.INVALID).sum() > 500


@pytest.mark.parametrize("eye", _EYES)
def test_far_lights_converge_to_the_sun(tracer: Any, eye: str) -> None:
    """50 km and 1e8 m away in the sun's direction: a few pixels at edges of shadows, and next to none."""
    view, expected = _seen(eye)
    names = [light.name for light in view.lights]
    three = replace(view, lights=tuple(view.lights[names.index(name)] for name in ("far", "star", "sun")))
    tracer.scene.put("mesh", view.vertices, view.triangles)
    step = three.step_for(tracer)
    far, star, sun = three.trace(tracer, step)
    assert (star != sun).sum() <= 1 and (far != sun).sum() < 0.01 * sun.size
    np.testing.assert_array_equal(sun, expected[names.index("sun"), ::step, ::step])
    assert (sun == State.SHADOWED).mean() > 0.05


def test_the_pot_turns(tracer: Any) -> None:
    """Forth, and back."""
    view, before = _seen("pot")
    turned = views.next_positions("stadium", views.SMALL)
    after = _turned()
    assert (before != after).any()
    tracer.scene.put("mesh", view.vertices, view.triangles)
    for positions, expected in ((view.vertices, before), (turned, after), (view.vertices, before)):
        tracer.scene.deform("mesh", positions)
        view.check_again(tracer, expected)


@cache
def _turned() -> np.ndarray:
    return views.expected_states(_seen("pot")[0], views.next_positions("stadium", views.SMALL))


@cache
def _at_the_pot(eye: str) -> tuple[views.View, np.ndarray]:
    """The lights in it, on it, a millimetre above it, and so far to the side that it is on the light's horizon."""
    view = _seen(eye)[0]
    vertices, triangles = view.vertices, view.triangles
    small = triangles[_small_triangles(vertices, triangles)]
    corners = vertices[small]
    middle = 0.5 * (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1)))
    top = vertices[small[np.argmax(corners[:, 0, 2]), 0]]
    outwards = corners.mean(axis=1) - middle
    side = corners[np.argmax(outwards @ [0.6, -0.8, 0.2])]
    normal = np.cross(side[1] - side[0], side[2] - side[0])
    lights = (
        PointLight("in it", middle),
        PointLight("on its top vertex", top),
        PointLight("on an edge of it", 0.5 * (side[0] + side[1])),
        PointLight("a millimetre above", side.mean(axis=0) + 1e-3 * normal / np.linalg.norm(normal)),
        PointLight("low", middle + [50.0, 10.0, 0.0]),
        SpotLight("a spot a tenth of a degree wide", middle + [60.0, -80.0, 100.0], [-60.0, 80.0, -100.0], 0.0017),
    )
    view = replace(view, lights=lights)
    return view, views.expected_states(view)


@pytest.mark.parametrize("eye", ["pot", "stand"])
def test_lights_at_the_pot(tracer: Any, eye: str) -> None:
    """All rays of a light in it begin among triangles that fill every direction; seen from the stand, the rays are
    long."""
    view, expected = _at_the_pot(eye)
    view, expected = view.part_for(tracer, expected, len(tracer.variant))
    view.check(tracer, expected)


def test_lights_at_the_pot_see_what_they_must() -> None:
    states = np.concatenate([_at_the_pot(eye)[1].reshape(6, -1) for eye in ("pot", "stand")], axis=1)
    seen = states[:, states[0] != State.INVALID]
    hidden = (seen == State.SHADOWED).mean(axis=1)
    stand = _at_the_pot("stand")[1][0]
    assert (stand[stand != State.INVALID] == State.SHADOWED).all(), "the pot is closed"
    assert all(0.02 < part < 1.0 for part in hidden[1:5]), hidden
    outside = (seen[5] == State.OUTSIDE).mean()
    assert 0.5 < outside < 1.0


@pytest.mark.parametrize("eye", ["pot", "stand"])
@probe.in_both_forms
def test_packed_tiles_do_not_blow_up(tracers: Any, any_device: str, eye: str) -> None:
    """In a grid of equal cells all rays and all of the pot meet in one. Here one tile of 32 rays may still meet all of
    it, where it is smaller than a pixel; on average a ray looks at less than one in a hundred triangles."""
    view = views.procedural_view("stadium", eye, 96)
    tracer = tracers(any_device, "light_grid", "packed")
    tracer.scene.put("mesh", view.vertices, view.triangles)
    for light in view.lights:
        frame = tracer.trace(view.depth, view.camera, [light], view.bias)
        counters, triangles = frame.counters, len(view.triangles)
        if counters["rays"] < 500:
            continue  # a spot that hardly reaches this view
        assert 0 < counters["leaf_tests"] < 0.01 * counters["rays"] * triangles, (light.name, counters)
        assert 0 < counters["entries"] < 3 * triangles, (light.name, counters)
        if eye == "pot":
            assert 0 < counters["largest_tile"] < 0.25 * triangles, (light.name, counters)
    tracer.scene.clear()


@pytest.mark.parametrize("eye", ["pot", "stand"])
@probe.in_both_forms
def test_structures_that_adapt_show_a_small_part_of_the_pot(tracers: Any, any_device: str, eye: str) -> None:
    """Equal cells show all of it to every ray that comes near."""
    view = views.procedural_view("stadium", eye, 32, 10_000)
    tests = []
    for names in (("uniform_grid", "dda"), ("hierarchical_grid", "nested"), *_ADAPTIVE):
        tracer = tracers(any_device, *names)
        tracer.scene.put("mesh", view.vertices, view.triangles)
        frame = tracer.trace(view.depth, view.camera, view.lights[:1], view.bias)
        assert frame.counters["rays"] > 300
        tests.append(frame.counters["leaf_tests"])
        tracer.scene.clear()
    assert all(0 < 20 * few < tests[0] for few in tests[1:]), tests


@pytest.mark.parametrize("pipeline", ["kd_tree", "octree", "bsp"])
@probe.in_both_forms
def test_little_room_leaves_the_pot_in_many_leaves(any_device: str, pipeline: str) -> None:
    """Trees are split level by level: what the stadium takes of the room for references must not leave the pot, which
    comes last, in one leaf."""
    made = procedural.stadium(3_000)
    count = len(made.triangles)
    tracer = tracer_of(any_device, pipeline, max_triangles=count, grid_entries=4 * count)
    hidden(tracer, (made.positions[0], made.triangles), np.array([[0.0, 0.0, 1.0]]), made.lights["inside"])
    tree = Tree(tracer)
    sizes = [len(tree.triangles(leaf)) for leaf in tree.leaves]
    assert max(sizes) < 0.15 * count and sum(sizes) <= 4 * count
