# SPDX-License-Identifier: Apache-2.0
"""Triangles into the tiles of `packed`: items, chunks, parts, flushes, and what is kept from frame to frame."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import geometry
import numpy as np
import probe
import probe_accelerators
import pytest
import views

from shadow_tracer import Bounds, Camera, DirectionalLight, PointLight, ShadowTracer, SpotLight, State
from shadow_tracer.gpu.accelerators.light_grid import binning, threads
from shadow_tracer.gpu.occluders import seen as records


def _tracer(device: str, graphs: bool = False, **capacities: int) -> ShadowTracer:
    bounds = {"max_triangles": 4_000, "max_rays": 10_000, "max_lights": 5, "queue_capacity": 4_000}
    return ShadowTracer(
        "light_grid",
        "packed",
        device,
        Bounds(**{**bounds, "grid_entries": 100_000, **capacities}),
        graphs=graphs,
        threads=1,  # its lists are looked at, and shares have lists of their own
    )


def _states(tracer: ShadowTracer, view: views.View) -> tuple[np.ndarray, dict[str, int]]:
    """(lights, H, W) states and the counters."""
    if "mesh" not in tracer.scene:
        tracer.scene.put("mesh", view.vertices, view.triangles)
    frame = tracer.trace(view.depth, view.camera, view.lights, view.bias)
    return np.stack([frame.state(light.name) for light in view.lights]), frame.counters


_LIGHTS = (
    PointLight("inside", (0.1, 0.2, 3.3)),
    PointLight("outside", (3.0, -4.0, -1.0)),
    DirectionalLight("sun", (-0.3, 0.4, 0.8)),
    SpotLight("spot", (0.3, -0.5, 0.5), (0.0, 0.1, 1.0), 0.4),
    PointLight("far", (3e4, -2e4, -4e4)),
)


def _view(width: int, height: int, lights: tuple[Any, ...], *meshes: geometry.Geometry) -> views.View:
    rng = np.random.default_rng(470)
    camera = Camera(width, height, 0.9 * width, 0.9 * width, 0.5 * width - 0.5, 0.5 * height - 0.5)
    depth = rng.uniform(2.0, 5.0, (height, width)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = 0.0
    vertices, triangles = geometry.join(meshes)
    return views.View(vertices + [0.0, 0.0, 3.0], triangles, depth, camera, lights, 0.01)


@cache
def _crowd() -> tuple[views.View, np.ndarray]:
    """40 triangles before 192 pixels, five lights."""
    rng = np.random.default_rng(471)
    view = _view(16, 12, _LIGHTS, geometry.soup(rng, 32, 0.3, 1.0), geometry.soup(rng, 8, 2.0, 2.0))
    return view, views.expected_states(view)


# --- triangles over many columns ---


@cache
def _huge(width: int = 160, height: int = 130) -> tuple[views.View, np.ndarray]:
    """Triangles as large as the view, some small ones, and 18,700 rays: on CUDA 19 columns and more in one frustum."""
    rng = np.random.default_rng(472)
    meshes = (geometry.soup(rng, 12, 4.0, 3.0), geometry.slivers(rng, 20, 8.0, 300.0), geometry.soup(rng, 60, 0.1, 2.0))
    view = _view(width, height, (_LIGHTS[0], _LIGHTS[2]), *meshes)
    tracer = ShadowTracer("brute_force", "filtered", "cpu", Bounds(100, 41_600, 2))
    return view, _states(tracer, view)[0]


@probe.in_both_forms
@pytest.mark.parametrize("width, height", [(160, 130), (16, 1280)])
def test_large_triangles(any_device: str, kernel_form: str, width: int, height: int) -> None:
    view, expected = _huge(width, height)
    tracer = _tracer(any_device, max_rays=41_600)
    for _ in range(2):
        np.testing.assert_array_equal(_states(tracer, view)[0], expected)
    tiles = probe_accelerators.tiles(probe.pipeline(tracer))
    # Sixteen columns are looked at together. Those of pieces are four times as wide.
    assert (tiles.groups.numpy()[6 + 4, 4] > 16) == (kernel_form == "cuda_form" or width < height)


@probe.in_cuda_form
@pytest.mark.parametrize("places", [0, 1, 3, 5, 70_000])
def test_large_triangles_become_items(monkeypatch: Any, any_device: str, places: int) -> None:
    view, expected = _huge()
    monkeypatch.setattr(threads, "room_for_items", lambda _: places)
    tracer = _tracer(any_device, max_rays=41_600)
    bins = probe_accelerators.bins(probe.pipeline(tracer))
    assert bins.items.shape[0] == places
    for _ in range(2):
        states, counters = _states(tracer, view)
        np.testing.assert_array_equal(states, expected)
    used = int(bins.item_count.numpy()[0])
    items = bins.items.numpy()[:used]
    assert used > 50 if places == 70_000 else used <= places
    if places >= 5:
        assert used > 0 and (items[:, 3] - items[:, 2] < 8).all() and set(items[:, 1]) <= {0, 1, 2, 3, 4, 5}
    monkeypatch.undo()
    plain = _tracer(any_device, max_rays=41_600)
    assert _states(plain, view)[1]["entries"] == counters["entries"]
    few = _tracer(any_device, max_rays=41_600, grid_entries=counters["entries"] // 5)
    states, counters = _states(few, view)
    np.testing.assert_array_equal(states, expected)
    assert counters["overflow_passes"] in (5, 6)


@cache
def _wires() -> tuple[views.View, np.ndarray]:
    """Twelve wires before 36,100 pixels, which are 36 columns; each is a few pixels wide, across the whole view, and
    most tiles that it shades have no other entry."""
    rng = np.random.default_rng(474)
    camera = Camera(190, 190, 171.0, 171.0, 94.5, 94.5)
    depth = rng.uniform(2.9, 3.0, (190, 190)).astype(np.float32)
    angles = np.pi * np.arange(12) / 12.0
    along = np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    middle = rng.uniform(-0.5, 0.5, (12, 3)) * [1.0, 1.0, 0.2] + [0.0, 0.0, 2.0]
    corners = np.stack([middle - 3.0 * along, middle + 3.0 * along, middle + 3.0 * along + [0.02, 0.03, 0.0]], axis=1)
    light = DirectionalLight("sun", (0.02, -0.01, 1.0))
    view = views.View(corners.reshape(-1, 3), np.arange(36).reshape(-1, 3), depth, camera, (light,), 0.01)
    return view, _states(ShadowTracer("brute_force", "filtered", "cpu", Bounds(100, 40_000, 1)), view)[0]


@probe.in_cuda_form
@pytest.mark.parametrize(("places", "entries"), [(0, 100_000), (4, 100_000), (1_000, 100_000), (4, 100), (1_000, 100)])
def test_triangles_that_warps_take(monkeypatch: Any, any_device: str, places: int, entries: int) -> None:
    """As items or whole, in one list or part by part."""
    view, expected = _wires()
    assert 0.02 < (expected == State.SHADOWED).mean() < 0.2
    monkeypatch.setattr(threads, "room_for_items", lambda _: places)
    tracer = _tracer(any_device, max_rays=40_000, grid_entries=entries)
    for _ in range(2):
        np.testing.assert_array_equal(_states(tracer, view)[0], expected)
    bins = probe_accelerators.bins(probe.pipeline(tracer))
    lengths = bins.length_of.numpy()[: len(view.triangles)]
    whole = (lengths == binning.LONG).sum()
    in_items = (lengths == binning.IN_ITEMS).sum()
    assert whole + in_items > 8
    assert (whole > 0) == (places < 1_000) and (in_items > 0) == (places > 0)


# --- long lists ---


@cache
def _pile(count: int) -> views.View:
    """``count`` triangles before 25 pixels, which are one tile: every triangle has a corner among its rays, so that it
    misses none of their box and covers none of it."""
    rng = np.random.default_rng(473)
    camera = Camera(5, 5, 50.0, 50.0, 2.0, 2.0)
    heights = rng.uniform(0.5, 0.9, count)
    corners = np.array([(0.0, 0.0, 1.0), (9.0, 2.0, 1.0), (9.0, -2.0, 1.0)]) * heights[:, None, None]
    corners[:, :, :2] += rng.uniform(-1e-3, 1e-3, (count, 1, 2))
    triangles = np.arange(3 * count).reshape(-1, 3)
    light = DirectionalLight("sun", (0.0, 0.0, 1.0))
    return views.View(corners.reshape(-1, 3), triangles, np.full((5, 5), 1.0, np.float32), camera, (light,), 0.0)


@probe.in_both_forms
@pytest.mark.parametrize("count", [1, 63, 64, 65, 256, 1200])
def test_long_lists_are_cut(any_device: str, count: int) -> None:
    view = _pile(count)
    states, counters = _states(_tracer(any_device), view)
    np.testing.assert_array_equal(states, views.expected_states(view))
    assert counters["entries"] == counters["largest_tile"] == count
    if not probe.wide(any_device):
        assert counters["splits"] == -(-count // 64) - 1


@probe.in_cuda_form
@pytest.mark.parametrize("entries", [1, 63, 64, 100, 600])
def test_lists_cut_by_parts_and_chunks(any_device: str, entries: int) -> None:
    """600 entries of one tile: the first part is done twice, once before it is known that it is a part."""
    view = _pile(600)
    states, counters = _states(_tracer(any_device, grid_entries=entries), view)
    np.testing.assert_array_equal(states, views.expected_states(view))
    parts = [min(entries, 600 - first) for first in range(0, 600, entries)]
    again = parts[:1] if len(parts) > 1 else []
    assert counters["splits"] == sum(-(-part // 64) - 1 for part in again + parts)
    assert counters["entries"] == counters["largest_tile"] == 600
    assert counters["overflow_passes"] == (len(parts) if len(parts) > 1 else 0)


# --- fewer entries than there are ---


def _entries_of(device: str, view: views.View) -> list[int]:
    """Entries of each light."""
    tracer = _tracer(device)
    return [_states(tracer, replace(view, lights=(light,)))[1]["entries"] for light in view.lights]


@probe.in_cuda_form
@pytest.mark.parametrize("graphs", [False, True])
@pytest.mark.parametrize("together", [1, 2, 5])
def test_parts(any_device: str, together: int, graphs: bool) -> None:
    """Any capacity: the same bytes; each pass that needs several parts does all of them after the first look, and
    entries are counted once."""
    view, expected = _crowd()
    alone = _entries_of(any_device, view)
    total = sum(alone)
    passes = [sum(alone[first : first + together]) for first in range(0, 5, together)]
    assert min(alone) > 10
    some = (passes[0] - 1, passes[0], passes[0] + 1, total - 1, total, total + 1)
    for entries in (29, passes[0], total - 1, total) if graphs else (1, 7, *some):
        tracer = _tracer(any_device, graphs, grid_entries=entries, max_rays=192 * together)
        parts = [-(-needed // entries) for needed in passes]
        for _ in range(3 if graphs else 1 if entries == 1 else 2):
            states, counters = _states(tracer, view)
            np.testing.assert_array_equal(states, expected)
            assert counters["entries"] == total
            assert counters["overflow_passes"] == sum(count for count in parts if count > 1)
        assert probe.recordings(tracer) == (1 if graphs else 0)


@probe.in_both_forms
@pytest.mark.parametrize("together", [1, 2, 5])
@pytest.mark.parametrize("queue", [1, 40])
@pytest.mark.slow
def test_parts_with_a_full_queue(any_device: str, queue: int, together: int) -> None:
    """Pixels on the triangles themselves, seen from lights in their planes and at their corners."""
    view = _touching()
    expected = views.expected_states(view)
    for entries in (1, 7, 60):
        for graphs in (False, True):
            capacities = {"grid_entries": entries, "queue_capacity": queue, "max_rays": view.depth.size * together}
            tracer = _tracer(any_device, graphs, **capacities)
            for _ in range(3 if graphs else 1):
                states, counters = _states(tracer, view)
                np.testing.assert_array_equal(states, expected)
            assert queue > 1 or probe.wide(any_device) or counters["overflow_passes"] > 0


@cache
def _touching() -> views.View:
    vertices, triangles = geometry.join(
        [geometry.square(axis, float(at), 2.0) for axis in range(3) for at in (-1, 0, 1, 2)]
    )
    pose = geometry.pose_of(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 2.0))
    depth = np.tile(np.array([1.0, 2.0, 4.0, 3.0], np.float32)[:, None], (1, 5))
    lights = (
        PointLight("lamp", (0.25, 0.5, 3.0)),
        PointLight("corner", (2.0, 2.0, 2.0)),
        DirectionalLight("sun", (1.0, 2.0, -4.0)),
        PointLight("middle", (0.0, 0.0, 0.25)),
        DirectionalLight("level", (1.0, 1.0, 0.0)),
    )
    return views.View(vertices, triangles, depth, Camera(5, 4, 4.0, 4.0, 2.0, 1.5, pose), lights, 0.0)


@pytest.mark.wide
@pytest.mark.parametrize("graphs", [False, True])
@pytest.mark.parametrize("together", [1, 2, 5])
def test_flushes(together: int, graphs: bool) -> None:
    """The same for lists of the wide form: at most as many flushes as lists full of all entries, of which some do not
    wait; fewer entries the earlier tiles are done."""
    view, expected = _crowd()
    alone = _entries_of("cpu", view)
    total = sum(alone)
    passes = [sum(alone[first : first + together]) for first in range(0, 5, together)]
    before = 0
    for entries in (1, 7, passes[0] - 1, passes[0], passes[0] + 1, total - 1, total, total + 1):
        tracer = _tracer("cpu", graphs, grid_entries=entries, max_rays=192 * together)
        for _ in range(4 if graphs else 2):
            states, counters = _states(tracer, view)
            np.testing.assert_array_equal(states, expected)
        assert before <= counters["entries"] <= total or entries < passes[0]
        before = counters["entries"]
        full = counters["entries"] / entries
        assert 0.2 * full - len(passes) <= counters["overflow_passes"] <= full
        if entries >= max(passes):
            assert counters["overflow_passes"] == 0 and counters["entries"] == total


@pytest.mark.wide
@pytest.mark.parametrize("entries", [1, 2, 3, 64, 65, 1000])
def test_finished_tiles_take_no_more_entries(entries: int) -> None:
    """50 squares behind each other: the two triangles of the first hide all rays, but neither covers their box."""
    camera = Camera(5, 5, 50.0, 50.0, 2.0, 2.0)
    vertices, triangles = geometry.join([geometry.square(2, 0.3 + 0.01 * k, 1.0, (0.01, 0.0)) for k in range(50)])
    depth = np.full((5, 5), 1.0, np.float32)
    view = views.View(vertices, triangles, depth, camera, (DirectionalLight("sun", (0.0, 0.0, 1.0)),), 0.0)
    states, counters = _states(_tracer("cpu", grid_entries=entries), view)
    assert (states == 1).all()
    # a full list is traced when there is one more entry, and that one is for a tile that is done by then
    assert counters["entries"] == min(max(entries, 2), 100)
    assert counters["overflow_passes"] == (1 if entries == 1 else 0)


# --- what is kept from frame to frame ---


@probe.in_both_forms
@pytest.mark.parametrize("room, made", [(3, [3, 0]), (2, [3, 2]), (1, [3, 3])])
def test_lights_that_stay_keep_their_triangles(monkeypatch: Any, any_device: str, room: int, made: list[int]) -> None:
    """As many as there is room for: with two places for three lights, the first and the last take turns."""
    rng = np.random.default_rng(474)
    view = _view(24, 18, _LIGHTS[:3], geometry.soup(rng, 80, 0.25, 1.0))
    calls: list[Any] = []
    begin = records.TriangleRecords.begin

    def counted(self: Any, frame: Any) -> Any:
        made = begin(self, frame)
        calls.extend([1] * bool(made))
        return made

    monkeypatch.setattr(records.TriangleRecords, "begin", counted)
    tracer = _tracer(any_device, max_triangles=80 * room)
    anchors = []
    for step in range(2):
        pose = geometry.pose_of(np.eye(3), (0.05 * step, -0.03 * step, 0.02 * step))
        depth = np.where(view.depth > 0, view.depth * np.float32(1.0 - 0.01 * step), 0.0).astype(np.float32)
        now = replace(view, depth=depth, camera=replace(view.camera, camera_to_world=pose))
        calls.clear()
        states, _ = _states(tracer, now)
        assert len(calls) == made[step]
        anchors.append(probe.anchor(tracer))
        np.testing.assert_array_equal(states, _states(_tracer(any_device), now)[0])
        np.testing.assert_array_equal(states, views.expected_states(now))
    assert anchors[0] == anchors[1]
    calls.clear()
    tracer.scene.deform("mesh", view.vertices * 1.001)
    states, _ = _states(tracer, now)
    assert len(calls) == 3
    np.testing.assert_array_equal(states, views.expected_states(now, view.vertices * 1.001))
