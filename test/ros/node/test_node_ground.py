# SPDX-License-Identifier: Apache-2.0
"""Grid maps live: they cast shadow, ``~/shadow_grid`` and ``~/sun_map`` say what reaches them.

grid_map_msgs is not on the package index. Where it is not installed, another type stands for it in these tests, which
carries the same bytes: everything is taken and sent as bytes.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from harness import Rig, wall
from nav_msgs.msg import OccupancyGrid
from node_world import UNKNOWN, camera, library
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import UInt8MultiArray

from shadow_tracer import DirectionalLight, PointLight
from shadow_tracer.ros.diagnostics import ERROR, MESH, OK, PROCESSING, WARN
from shadow_tracer.ros.wire import layouts
from shadow_tracer.ros.wire.grid_map import GridMap, encode_grid_map, grid_part, parse_grid_map
from shadow_tracer.scene.sun import sun_direction

INSTALLED = layouts.grid_map_type()
KIND: Any = INSTALLED or UInt8MultiArray
SECOND = 1_000_000_000
NOON = "2026-06-21T11:10:00Z"
SUN = {
    "fixed_frame": "map", "pose_source": "parameter", "lights.lamp.type": "sun", "lights.lamp.sun.latitude": 48.0,
    "lights.lamp.sun.longitude": 11.5, "lights.lamp.sun.time": NOON, "grid_map.period": 0.25, "sun_map.period": 0.25,
    "sun_map.hours": 12.0, "sun_map.step": 120.0,
}  # fmt: skip


@pytest.fixture(autouse=True)
def stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    if INSTALLED is not None:
        return
    module = type(sys)("grid_map_msgs.msg")
    module.GridMap = KIND  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "grid_map_msgs", type(sys)("grid_map_msgs"))
    monkeypatch.setitem(sys.modules, "grid_map_msgs.msg", module)
    monkeypatch.setattr(layouts, "_grid_map_differs", lambda: "")  # ROS cannot read these bytes as the other type


@pytest.fixture
def rig() -> Iterator[Rig]:
    with Rig({"mask.unknown_value": UNKNOWN, "grid_map.period": 0.25}) as made:
        yield made


def hill(frame: str = "map", height: float = 1.0) -> GridMap:
    """A pyramid in the middle of a plain with a hole."""
    rows, columns = 12, 10
    r, c = np.mgrid[:rows, :columns]
    values = height * np.maximum(0.0, 1.0 - np.maximum(abs(r - 6), abs(c - 5)) / 3)
    values[1, 2] = np.nan
    return GridMap(frame, 0, 0.25, (0.5, -0.25), values.astype(np.float32))


def plaque(height: float = 0.1) -> GridMap:
    """The same, small, between lamp and wall."""
    grid_map = hill("camera", height)
    return replace(grid_map, resolution=0.05, center=(0.25, -0.2), values=grid_map.values + np.float32(1.0))


def send(rig: Rig, grid_map: GridMap, **options: Any) -> None:
    layers = {"variance": grid_map.values * 0.0, "elevation": grid_map.values}
    rig.send_part("grid_map", KIND, encode_grid_map(grid_map, layers, **options))


def points_of(grid_map: GridMap, above: float) -> np.ndarray:
    return grid_map.height_field().positions() + (0.0, 0.0, above)


def grid_of(message: OccupancyGrid) -> np.ndarray:
    """(R, C) as in the map, from the rows along x that the message has."""
    return np.array(message.data, np.int8).reshape(message.info.height, message.info.width).T[::-1, ::-1]


def listen(rig: Rig, kind: Any, topic: str) -> list[Any]:
    """Messages of a topic from now on, as somebody hears them who asks for the last one too."""
    heard: list[Any] = []
    kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    raw = kind is KIND
    rig.friend.create_subscription(kind, f"shadow_tracer/{topic}", heard.append, kept, raw=raw)
    return heard


def test_a_map_casts_shadow_moves_and_goes(rig: Rig) -> None:
    lamp, tracer = PointLight("lamp", (0.5, -0.5, 0.0)), library()
    moved = replace(plaque(), center=(0.0, 0.0))
    for grid_map in (plaque(), plaque(height=0.3), moved, replace(moved, resolution=0.04)):
        send(rig, grid_map, starts=(3, 4))
        tracer.scene.clear()
        tracer.scene.put_surface("grid_map", grid_map.height_field())
        bias = rig.core.settings.bias
        wanted = tracer.trace(wall(), camera(), [lamp], bias=bias).mask(unknown=UNKNOWN)
        assert 0 < (wanted == 0).sum() < wanted.size / 2
        np.testing.assert_array_equal(rig.trace(wall()), wanted)
    assert rig.core.inputs.meshes.store.updates["put"] == 1 and rig.core.inputs.meshes.store.updates["deform"] == 3
    rig.send_part("grid_map", KIND, b"\0\1\0\0 no map")
    rig.wait_status(MESH, ERROR, "grid_map refused")
    np.testing.assert_array_equal(rig.trace(wall()), wanted)  # the last good one stays
    rig.send_part("grid_map", KIND, encode_grid_map(plaque(), {"height": plaque().values}))
    rig.wait_status(MESH, ERROR, "layers: expected one called 'elevation' (grid_map.layer), got 'height'")
    assert rig.set(grid_map__layer="height") == ""
    assert rig.core.inputs.meshes.store.parts["grid_map"].map.resolution == 0.05  # that of the last message, at once
    assert rig.set(grid_map__layer="") != ""
    nothing = replace(plaque(), values=np.empty((0, 0), np.float32))
    rig.send_part("grid_map", KIND, encode_grid_map(nothing, {"height": nothing.values}))
    assert set(np.unique(rig.trace(wall()))) == {UNKNOWN, 255}


def test_shadow_grid_is_what_the_library_says_of_points_over_the_ground() -> None:
    torch = {"light_names": ["lamp", "torch"], "lights.torch.position": [0.5, -0.25, 1.4], "lights.torch.range": 1.5}
    with Rig({**SUN, **torch, "lights.lamp.sun.time": "2026-06-21T04:00:00Z"}) as rig:
        grids = listen(rig, OccupancyGrid, "shadow_grid")
        send(rig, hill(), starts=(5, 1))
        rig.until(lambda: grids, what="a shadow_grid")
        direction, _ = sun_direction(1_782_014_400 * SECOND, 48.0, 11.5)
        lights = [DirectionalLight("sun", direction), PointLight("torch", (0.5, -0.25, 1.4), range=1.5)]
        tracer = library()
        tracer.scene.put_surface("grid_map", hill().height_field())
        points, known = points_of(hill(), 0.05), ~np.isnan(hill().values)
        share = tracer.visibility(points[known], lights)
        wanted = np.full(known.shape, -1, np.int8)
        wanted[known] = 100 - 100 * share.max(axis=0)
        assert {-1, 0, 100} == set(np.unique(wanted)) and not share.min()
        message = grids[0]
        np.testing.assert_array_equal(grid_of(message), wanted)
        assert message.header.frame_id == "map" and message.info.resolution == pytest.approx(0.25)
        origin = message.info.origin.position
        assert (origin.x, origin.y) == (0.5 - 12 * 0.125, -0.25 - 10 * 0.125)
        assert rig.set(grid_map__height_above=1.2, lights__torch__enabled=False) == ""
        rig.until(lambda: (grid_of(grids[-1])[known] == 0).all(), what="everything above the hill is lit")
        rig.wait_status(PROCESSING, OK)
        rig.until(lambda: int(rig.value(PROCESSING, "shadow grids")) >= 2, what="two grids are counted")
        assert rig.set(grid_map__height_above=0.05, grid_map__dark_value=60) == ""
        rig.until(lambda: set(np.unique(grid_of(grids[-1]))) == {-1, 0, 60}, what="shadow costs 60")


def test_what_is_not_known_is_not_lit() -> None:
    with Rig({**SUN, "lights.lamp.frame": "elsewhere"}) as rig:
        grids, maps = listen(rig, OccupancyGrid, "shadow_grid"), listen(rig, KIND, "sun_map")
        send(rig, hill())
        rig.until(lambda: grids and maps, what="both messages")
        assert (grid_of(grids[0]) == -1).all()
        for layer in ("sunlit", "hours"):
            assert np.isnan(parse_grid_map(bytes(maps[0]), layer, 1000).values).all()
        rig.wait_status(PROCESSING, WARN, "the last shadow_grid says unknown")
        assert rig.set(lights__lamp__frame="") == ""
        rig.until(lambda: (grid_of(grids[-1]) >= 0).sum() == 119, what="it is known")
        rig.wait_status(PROCESSING, OK)


def test_sun_map_counts_hours_of_the_ground_alone() -> None:
    with Rig(SUN) as rig:
        maps = listen(rig, KIND, "sun_map")
        send(rig, hill())
        rig.until(lambda: maps, what="a sun_map")
        data, known = bytes(maps[0]), ~np.isnan(hill().values)
        found = {name: parse_grid_map(data, name, 1000) for name in ("elevation", "sunlit", "hours")}
        assert {(each.frame, each.center, each.resolution) for each in found.values()} == {("map", (0.5, -0.25), 0.25)}
        np.testing.assert_array_equal(found["elevation"].values, hill().values)
        surface, _ = grid_part(hill(), None).put[0], None
        tracer = library()
        tracer.scene.put("grid_map", surface.vertices, surface.triangles, nonfinite="skip")
        points, hours, up = points_of(hill(), 0.05)[known], np.zeros(119), 0
        for k in range(6):  # of two hours each, from 12:10 to 22:10
            direction, height = sun_direction(1_782_040_200 * SECOND + (2 * k + 1) * 3600 * SECOND, 48.0, 11.5)
            if height > 0.0:
                up += 1
                hours += 2.0 * ~tracer.occluded(points, DirectionalLight("sun", direction))
        assert 3 <= up <= 5 and 0.0 < hours.min() < hours.max() == 2.0 * up
        np.testing.assert_array_equal(found["hours"].values[known], hours.astype(np.float32))
        assert np.isnan(found["hours"].values[~known]).all() and np.isnan(found["sunlit"].values[~known]).all()
        direction, _ = sun_direction(1_782_040_200 * SECOND, 48.0, 11.5)
        lit = ~tracer.occluded(points, DirectionalLight("sun", direction))
        np.testing.assert_array_equal(found["sunlit"].values[known], lit.astype(np.float32))


@pytest.mark.skipif(INSTALLED is not None, reason="grid_map_msgs is installed here")
def test_a_type_that_is_not_there_is_told_where_somebody_publishes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "grid_map_msgs")
    monkeypatch.delitem(sys.modules, "grid_map_msgs.msg")
    with Rig({"mask.unknown_value": UNKNOWN}) as rig:
        assert rig.core.outputs.sun_map is None
        rig.wait_status(MESH, WARN, "no mesh")
        rig.friend.create_publisher(KIND, "grid_map", 1)
        rig.wait_status(MESH, ERROR, "install ros-jazzy-grid-map-msgs")
