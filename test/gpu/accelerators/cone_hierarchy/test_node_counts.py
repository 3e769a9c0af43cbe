# SPDX-License-Identifier: Apache-2.0
"""What the paper says of its variants, as counts of nodes: counts do not depend on how busy the machine is.

That the bits are right is tested everywhere else; here only how much was looked at.
"""

from __future__ import annotations

import math
from typing import Any

import geometry
import numpy as np
import probe
import pytest
import views

from shadow_tracer import Camera, PointLight, ShadowTracer, State, available_pipelines

# Nodes go with the number of triangles, so a third of the full scenes tells as much in a third of the time.
_TRIANGLES = 24_000
_SEVEN = ("precise", "precise_sorted", "spheres", "spheres_sorted", "precise_sea", "precise_eatp", "precise_seatp")


class Counts:
    """Counters by (device, variant, scene, eye, light), each traced once."""

    def __init__(self, tracers: Any) -> None:
        self._tracers = tracers
        self._made: dict[tuple[Any, ...], dict[str, int]] = {}

    def __call__(self, device: str, variant: str, scene: str, eye: str, light: str, size: int) -> dict[str, int]:
        key = (device, variant, scene, eye, light, size)
        if key not in self._made:
            view = views.procedural_view(scene, eye, size, _TRIANGLES)
            (lamp,) = (made for made in view.lights if made.name == light)
            tracer = self._tracers(device, "cone_hierarchy", variant)
            tracer.scene.put("mesh", view.vertices, view.triangles)
            frame = tracer.trace(view.depth, view.camera, [lamp], view.bias)
            state = frame.state(light)
            traced = np.isin(state, (State.LIT, State.SHADOWED))
            hidden = round(1000 * (state[traced] == State.SHADOWED).mean())
            self._made[key] = {**frame.counters, "hidden per mille": hidden}
            tracer.scene.clear()
        return self._made[key]

    def nodes(self, *key: Any) -> int:
        count = self(*key)["nodes_visited"]
        assert count > 0, "nothing is counted"
        return count


@pytest.fixture(scope="module")
def counts(tracers: Any) -> Counts:
    return Counts(tracers)


def test_the_seven_variants_have_their_names() -> None:
    assert set(_SEVEN) <= set(available_pipelines()["cone_hierarchy"])


@pytest.mark.slow
@pytest.mark.parametrize("test", ["precise", "spheres"])
def test_sorting_pays_where_neighbours_see_things_far_apart(counts: Counts, any_device: str, test: str) -> None:
    """Ten times fewer nodes in the museum (the paper's Table 2 has 40 to 85 at a larger image)."""
    case = ("museum", "room", "inside", 128)
    unsorted = counts.nodes(any_device, test, *case)
    assert 10 * counts.nodes(any_device, f"{test}_sorted", *case) <= unsorted


@pytest.mark.parametrize("case", [("robots", "wall", "inside", 128), ("museum", "wallview", "inside", 128)], ids=str)
@pytest.mark.parametrize("test", ["precise", "spheres"])
def test_sorting_costs_nothing_where_the_view_is_in_order(
    counts: Counts, any_device: str, test: str, case: tuple[Any, ...]
) -> None:
    """At most a tenth more nodes than 2 x 2 blocks of pixels in front of a wall."""
    assert counts.nodes(any_device, f"{test}_sorted", *case) <= 1.1 * counts.nodes(any_device, test, *case)


@pytest.mark.parametrize("light", ["inside", "outside"])
@pytest.mark.parametrize("eye", ["corridor", "grazing", "wall", "disc"])
def test_the_precise_test_looks_at_no_more_than_spheres(counts: Counts, any_device: str, eye: str, light: str) -> None:
    """Among robots, large triangles and small: no bounding sphere rejects what the precise test does not."""
    for suffix in ("", "_sorted"):
        case = ("robots", eye, light, 64)
        precise = counts.nodes(any_device, f"precise{suffix}", *case)
        assert precise <= counts.nodes(any_device, f"spheres{suffix}", *case)


@pytest.mark.parametrize("case", [("robots", "wall", "outside", 128), ("museum", "room", "far", 64)], ids=str)
@pytest.mark.parametrize("both,neither", [("precise_seatp", "precise_sorted"), ("precise_eatp", "precise")])
def test_two_passes_pay_in_the_shadow(
    counts: Counts, any_device: str, both: str, neither: str, case: tuple[Any, ...]
) -> None:
    """Half the nodes or less where large occluders put nearly everything in shadow."""
    assert counts(any_device, neither, *case)["hidden per mille"] > 600, "not a view mostly in shadow"
    assert 2 * counts.nodes(any_device, both, *case) <= counts.nodes(any_device, neither, *case)


@pytest.mark.parametrize("light", ["inside", "far"])
@pytest.mark.parametrize("scene,eye", [("robots", "corridor"), ("museum", "room")])
def test_early_accept_never_adds_nodes(counts: Counts, any_device: str, scene: str, eye: str, light: str) -> None:
    case = (scene, eye, light, 64)
    assert counts.nodes(any_device, "precise_sea", *case) <= counts.nodes(any_device, "precise_sorted", *case)


def test_accepted_and_passes_are_counted(counts: Counts, any_device: str) -> None:
    case = ("robots", "corridor", "outside", 64)
    for variant in _SEVEN:
        counters = counts(any_device, variant, *case)
        accepts, two = variant in ("precise_sea", "precise_eatp", "precise_seatp"), variant.endswith("tp")
        assert (counters["accepted"] > 0) == accepts, variant
        assert counters["passes"] == (2 if two else 1), variant
        assert counters["peak_queue"] > 0 and counters["leaf_tests"] > 0, variant


@pytest.mark.parametrize("scene,eye", [("robots", "corridor"), ("robots", "disc"), ("museum", "room")])
def test_linear_looks_at_far_fewer_nodes(counts: Counts, any_device: str, scene: str, eye: str) -> None:
    """Triangles start at their own cells instead of at the root."""
    case = (scene, eye, "inside", 128)
    assert 5 * counts.nodes(any_device, "linear", *case) <= counts.nodes(any_device, "precise_sorted", *case)


# --- a wall of two triangles between the light and everything ---


def _behind_a_wall(tracers: Any, device: str, variant: str, size: int, centre: tuple[float, float]) -> dict[str, int]:
    """Counters of ``size`` x ``size`` samples on a floor; ``centre`` is where the wall's middle is."""
    # Each share of the rays has a tree of its own; here the nodes of one tree are counted.
    bounds = tracers(device, "cone_hierarchy", variant).bounds
    tracer = ShadowTracer("cone_hierarchy", variant, device, bounds, threads=1)
    tracer.scene.put("wall", *geometry.square(2, 5.0, 100.0, centre))
    down = geometry.pose_of(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 4.0))
    middle = 0.5 * size - 0.5
    camera = Camera(size, size, 0.9 * size, 0.9 * size, middle, middle, down)
    frame = tracer.trace(np.full((size, size), 4.0, np.float32), camera, [PointLight("lamp", (0.0, 0.0, 10.0))])
    assert (frame.state("lamp") == State.SHADOWED).all()
    counters: dict[str, int] = frame.counters
    return counters


# Leaves that one thread walks in the CUDA form of linear, times the rays of a leaf.
_CHUNK = 64 * 32


def _in_chunks(device: str, variant: str) -> bool:
    """Whether large triangles are dealt to many threads, a chunk of the leaves each: then no thread sees the whole
    tree."""
    return variant == "linear" and not probe.wide(device)


_accepting = probe.in_forms("variant", ["precise_sea", "precise_eatp", "precise_seatp", "linear"], ["linear"])


@_accepting
@pytest.mark.parametrize("size", [16, 64, 256])
def test_a_wall_costs_log_n_nodes(tracers: Any, any_device: str, variant: str, size: int) -> None:
    """One of the wall's two triangles covers the view: it is accepted near the root, and no ray is tested."""
    counters = _behind_a_wall(tracers, any_device, variant, size, (40.0, -40.0))
    levels = math.log(size * size, 4)
    assert 0 < counters["nodes_visited"] <= 2 * 4 * levels
    most = 16 + (size * size // _CHUNK if _in_chunks(any_device, variant) else 0)
    assert 0 < counters["accepted"] <= most and counters["leaf_tests"] == 0
    without = _behind_a_wall(tracers, any_device, "precise_sorted", size, (40.0, -40.0))
    assert without["nodes_visited"] > size * size / 4 and without["leaf_tests"] >= size * size


@_accepting
def test_a_diagonal_through_the_view_costs_its_length(tracers: Any, any_device: str, variant: str) -> None:
    """Nodes on the diagonal belong to both triangles and are accepted by neither: their number grows with the image's
    side, not with its area. Leaves of the CUDA form hold twice the rays."""
    most = 16 if _in_chunks(any_device, variant) else 8
    for size in (16, 64, 256):
        counters = _behind_a_wall(tracers, any_device, variant, size, (0.01, -0.02))
        assert counters["accepted"] > 0
        assert counters["nodes_visited"] <= 8 * size and counters["leaf_tests"] <= most * size
