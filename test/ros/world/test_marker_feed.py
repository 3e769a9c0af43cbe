# SPDX-License-Identifier: Apache-2.0
"""What casts and what shines, as markers: what is in a message, and when there is one. No ROS is needed here."""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from shadow_tracer import Bounds, Scene
from shadow_tracer.ros.parameters.parameters import settings_from
from shadow_tracer.ros.wire.cdr_markers import (
    ADD,
    ARROW,
    DELETEALL,
    LINE_LIST,
    SPHERE,
    TEXT,
    TRIANGLE_LIST,
    MarkerMessage,
    encode_markers,
    parse_markers,
)
from shadow_tracer.ros.wire.messages import quaternion_of, rigid
from shadow_tracer.ros.wire.parts import Changes, Part, soup_triangles
from shadow_tracer.ros.world.light_markers import light_markers
from shadow_tracer.ros.world.lighting import Lighting, LightPose
from shadow_tracer.ros.world.marker_feed import NAMELESS, PERIOD, MarkerFeed, Markers
from shadow_tracer.ros.world.mesh_store import MeshStore
from shadow_tracer.ros.world.scene_markers import TURN, ShownPart, draw_parts, shown_parts, world_name

MANY = 1_000_000
MAP = settings_from({"fixed_frame": "map"})


def frozen(array: Any, dtype: Any = np.float64) -> np.ndarray:
    owned = np.array(array, dtype)
    owned.setflags(write=False)
    return owned


def soup(key: str, count: int = 1, seed: int = 0, **values: Any) -> Part:
    points = np.random.default_rng(seed).uniform(-1, 1, (3 * count, 3))
    return Part(key, frozen(points), soup_triangles(count), **values)


def store_of(*parts: Part) -> MeshStore:
    store = MeshStore(MANY)
    store.commit(Changes(parts), 1)
    return store


def run(work: Generator[None, None, bytes]) -> tuple[bytes, int]:
    """What a drawing makes, and in how many turns."""
    turns = 1
    while True:
        try:
            next(work)
        except StopIteration as done:
            return done.value, turns
        turns += 1


def drawn(store: MeshStore, world: str = "map", **values: Any) -> list[MarkerMessage]:
    """The markers of a scene, as whoever gets them reads them."""
    settings = settings_from({"fixed_frame": world, **values})
    markers = parse_markers(run(draw_parts(shown_parts(store, settings, world)[0]))[0], MANY)
    assert markers[0].action == DELETEALL and markers[0].ns == ""  # nothing stays of those before
    assert len({(marker.ns, marker.id) for marker in markers[1:]}) == len(markers) - 1
    assert all(marker.frame_locked and marker.stamp == 0 and marker.action == ADD for marker in markers[1:])
    return markers[1:]


# Parts


def test_parts_are_shown_in_the_frame_with_which_they_move() -> None:
    pose = rigid((1.0, 2.0, 3.0), (0.5, 0.5, 0.5, 0.5), "pose")
    parts = (
        soup("mesh", 2, seed=1),
        soup("markers/arm/7", 3, seed=2, frame="/arm_link", pose=pose),
        soup("markers/a/b/-1", seed=3, frame="tool"),
        soup("files/0", seed=4),
    )
    found = drawn(store_of(*parts), **{"mesh.frame": "base"})
    assert [(marker.ns, marker.id, marker.frame) for marker in found] == [
        ("mesh", 0, "base"),
        ("markers/arm", 7, "arm_link"),
        ("markers/a/b", -1, "tool"),
        ("files", 0, "base"),
    ]
    for marker, part in zip(found, parts, strict=True):
        assert marker.type == TRIANGLE_LIST and marker.scale == (1.0, 1.0, 1.0)
        np.testing.assert_array_equal(marker.points, part.vertices[part.triangles].reshape(-1, 3))
    assert found[1].position == (1.0, 2.0, 3.0)
    np.testing.assert_allclose(found[1].orientation, (0.5, 0.5, 0.5, 0.5))
    assert {marker.frame for marker in drawn(store_of(*parts[::3]))} == {"map"}


def test_a_part_that_stays_where_its_frame_was_is_shown_there_once_a_frame_was_traced_with_it() -> None:
    class Places:
        world = "map"

        def frame_to_world(self, frame: str, field: str, stamp: int | None = None) -> np.ndarray:
            assert (frame, stamp) == ("wagon", 5)
            return rigid((4.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), "pose")

    store = store_of(soup("cloud", frame="wagon", stamp=5, locked=False))
    assert drawn(store) == []
    store.update(Scene(Bounds(max_triangles=10)), Places(), "")
    (found,) = drawn(store)
    assert (found.frame, found.position, found.orientation) == ("map", (4.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))
    store.commit(Changes((soup("cloud", frame="wagon", stamp=5, locked=False, seed=1),)), 0)
    assert drawn(store) == []  # another one, which no frame has placed


def test_parts_that_cast_nothing_are_not_shown() -> None:
    assert drawn(store_of(soup("mesh")), occluders="depth") == []
    assert drawn(store_of(soup("cloud", 0))) == []


def test_quaternions_are_those_of_the_rotations() -> None:
    rng = np.random.default_rng(0)
    turns = [np.eye(4)[k] for k in range(4)] + [q / np.linalg.norm(q) for q in rng.normal(size=(50, 4))]
    for q in turns:
        found = quaternion_of(rigid((0.0, 0.0, 0.0), q, "pose"))
        np.testing.assert_allclose(np.outer(found, found), np.outer(q, q), atol=1e-12)  # q and -q turn alike


@pytest.mark.parametrize(
    ("values", "camera_frame", "world"),
    [
        ({}, "", ""),
        ({}, "/camera", "camera"),
        ({"fixed_frame": "map"}, "camera", "map"),
        ({"pose_source": "parameter"}, "camera", ""),
    ],
)
def test_the_world_has_the_name_that_frames_are_traced_in(
    values: dict[str, Any], camera_frame: str, world: str
) -> None:
    assert world_name(settings_from(values), camera_frame) == world


def test_small_parts_come_first_and_those_beyond_the_limit_are_boxes_that_say_so() -> None:
    rng = np.random.default_rng(1)
    points = np.concatenate([rng.uniform((1, 2, 3), (3, 6, 9), (30, 3)), [(1, 2, 3), (3, 6, 9), (9e9, 9e9, 9e9)]])
    points = np.concatenate([points, [(np.nan, 0, 0)]])  # no triangle uses the last two
    corners = frozen(np.concatenate([np.arange(30).reshape(-1, 3), [(0, 30, 31)]]), np.int32)
    pose = rigid((10.0, 0.0, 0.0), (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)), "pose")
    store = store_of(Part("mesh", frozen(points), corners, pose=pose), soup("files/0", 6), soup("files/1", 4))
    found = drawn(store, **{"markers.max_triangles": 10})
    assert [(marker.ns, marker.id, marker.type) for marker in found] == [
        ("mesh", 0, LINE_LIST),
        ("mesh (text)", 0, TEXT),
        ("files", 0, TRIANGLE_LIST),
        ("files", 1, TRIANGLE_LIST),
    ]
    box, text = found[:2]
    edges = box.points.reshape(-1, 2, 3)
    assert len(np.unique(edges, axis=0)) == 12 and (np.count_nonzero(edges[:, 0] != edges[:, 1], axis=1) == 1).all()
    assert sorted(map(tuple, np.unique(box.points, axis=0))) == sorted(
        (x, y, z) for x in (1, 3) for y in (2, 6) for z in (3, 9)
    )
    assert box.position == (10.0, 0.0, 0.0)
    np.testing.assert_allclose(text.position, (10.0 - 4.0, 2.0, 6.0))  # the middle (2, 4, 6), turned by 90 degrees
    settings = settings_from({"fixed_frame": "map", "markers.max_triangles": 10})
    data, _ = run(draw_parts(shown_parts(store, settings, "map")[0]))
    assert b"mesh: 11 triangles, shown as a box\nmarkers.max_triangles is 10 for all parts\0" in data
    whole = drawn(store, **{"markers.max_triangles": 21})
    assert [marker.type for marker in whole] == [TRIANGLE_LIST] * 3
    assert [marker.type for marker in drawn(store, **{"markers.max_triangles": 0})] == [LINE_LIST, TEXT] * 3


@pytest.mark.parametrize("limit", [100_000, 10])
def test_much_is_drawn_in_turns(limit: int) -> None:
    """No turn has more than TURN triangles; the last one only sends."""
    parts = [soup("mesh", 2 * TURN + 5), *(soup(f"files/{k}", TURN // 4) for k in range(8))]
    settings = settings_from({"fixed_frame": "map", "markers.max_triangles": limit})
    work = draw_parts(shown_parts(store_of(*parts), settings, "map")[0])
    _, turns = run(work)
    assert turns >= 2 + 4 * TURN // TURN
    assert run(draw_parts([]))[1] == 2
    many = [soup(f"files/{k}") for k in range(640)]
    assert run(draw_parts(shown_parts(store_of(*many), settings, "map")[0]))[1] > 640 // 64


def test_what_looks_the_same_and_what_does_not() -> None:
    part = soup("mesh", 100)
    last = part.vertices.copy()
    last[-1, -1] += 1e-9
    shown = ShownPart(part.key, "map", part.pose, part.vertices, part.triangles, 10)
    copies = {"vertices": part.vertices.copy(), "triangles": part.triangles.copy(), "pose": part.pose.copy()}
    assert shown.same(replace(shown, **copies)) and shown.same(replace(shown, most=11))
    assert not replace(shown, whole=False).same(replace(shown, whole=False, most=11))
    for change in (
        {"key": "files/0"},
        {"frame": "odom"},
        {"whole": False},
        {"pose": 2.0 * part.pose},
        {"vertices": part.vertices + 1e-9},
        {"vertices": last},
        {"triangles": part.triangles[:1]},
        {"triangles": part.triangles[::-1].copy()},
    ):
        assert not shown.same(replace(shown, **change)), change


# Lights


def lit(lighting: Lighting | None = None, world: str = "map", stamp: int = 0, **lights: dict[str, Any]) -> Any:
    """Markers by name of the light and id."""
    values: dict[str, Any] = {"light_names": list(lights)}
    for name, group in lights.items():
        values |= {f"lights.{name}.{key}": value for key, value in group.items()}
    markers, nameless = light_markers(settings_from(values), lighting or Lighting(), world, stamp)
    assert markers[0].action == DELETEALL
    assert parse_markers(encode_markers(markers), MANY)[1:] or len(markers) == 1
    assert all(marker.frame_locked for marker in markers[1:])
    return {(marker.ns, marker.id): marker for marker in markers[1:]}, nameless


@pytest.mark.parametrize("angle", [0.3, math.pi / 2, 2.5, math.pi])
@pytest.mark.parametrize(("reach", "length"), [(0.0, 1.0), (3.0, 3.0), (1e9, 5.0)])
@pytest.mark.parametrize("way", [(0.0, 0.0, 2.0), (-1.0, 0.5, 0.2)])
def test_a_spot_is_its_cone(angle: float, reach: float, length: float, way: Any) -> None:
    group = {"type": "spot", "position": (1.0, 2.0, 3.0), "direction": way, "outer_angle": angle, "range": reach}
    found, _ = lit(beam=group)
    bulb, cone, text = found["beam", 0], found["beam", 1], found["beam", 2]
    assert (bulb.type, bulb.position, cone.type, cone.position) == (SPHERE, (1.0, 2.0, 3.0), LINE_LIST, (0, 0, 0))
    ends = cone.points - (1.0, 2.0, 3.0)
    size = np.linalg.norm(ends, axis=1)
    rim = ends[size > 1e-9]
    assert len(ends) - len(rim) == 8  # ribs begin at the apex
    np.testing.assert_allclose(np.linalg.norm(rim, axis=1), length)
    np.testing.assert_allclose(rim @ way / np.linalg.norm(way) / length, math.cos(angle), atol=1e-9)
    if 0.1 < angle < 3.0:  # all around
        np.testing.assert_allclose(cone.points[:64:2].mean(axis=0), np.add((1, 2, 3), np.multiply(
            way, length * math.cos(angle) / np.linalg.norm(way))), atol=1e-9)  # fmt: skip
    assert (text.type, text.text) == (TEXT, "beam")


def test_points_are_small_spheres_and_spheres_have_their_size() -> None:
    found, _ = lit(p={"position": (1.0, 0.0, 0.0), "frame": "arm"}, s={"type": "sphere", "radius": 0.4})
    assert (found["p", 0].type, found["p", 0].frame, found["p", 0].position) == (SPHERE, "arm", (1.0, 0.0, 0.0))
    assert found["s", 0].scale == (0.8, 0.8, 0.8) and found["s", 0].frame == "map"
    assert set(found) == {("p", 0), ("p", 2), ("s", 0), ("s", 2)}


def test_flat_lights_and_tubes_have_their_outline() -> None:
    """All lines lie on the light, but one to where its middle shines, or two."""
    shapes: dict[str, dict[str, Any]] = {
        "disc": {"type": "disc", "radius": 0.4, "two_sided": True},
        "panel": {"type": "rectangle", "size": (1.0, 0.5)},
        "tube": {"type": "tube", "length": 2.0, "radius": 0.1, "axis": (0.0, 1.0, 0.0)},
        "line": {"type": "tube", "length": 2.0, "radius": 0.0, "axis": (0.0, 1.0, 0.0)},
        "post": {"type": "tube", "length": 2.0, "axis": (0.0, 0.0, 1.0)},
    }
    found, _ = lit(**{name: {**group, "position": (1.0, 2.0, 3.0)} for name, group in shapes.items()})
    lines = {name: found[name, 1].points - (1.0, 2.0, 3.0) for name in shapes}
    assert all(found[name, 1].type == LINE_LIST and found[name, 0].type == SPHERE for name in shapes)
    np.testing.assert_allclose(np.linalg.norm(lines["disc"][:-4], axis=1), 0.4)
    np.testing.assert_allclose(lines["disc"][-4:, 2], (0.0, 0.2, 0.0, -0.2))
    np.testing.assert_allclose(abs(lines["panel"][:-2]), np.tile((0.5, 0.25, 0.0), (8, 1)))
    np.testing.assert_allclose(lines["panel"][-2:], [(0, 0, 0), (0, 0, 0.2)], atol=1e-12)
    np.testing.assert_allclose(abs(lines["line"]), np.tile((0.0, 1.0, 0.0), (2, 1)), atol=1e-12)
    np.testing.assert_allclose(abs(lines["tube"][:, 1]), 1.0)
    np.testing.assert_allclose(np.linalg.norm(lines["tube"][2:, ::2], axis=1), 0.1)
    assert all(0.0 < found[name, 2].position[2] - found[name, 1].points[:, 2].max() < 0.2 for name in shapes)


def test_parallel_light_is_an_arrow_to_the_origin_of_its_frame() -> None:
    found, _ = lit(sky={"type": "directional", "direction": (0.0, 3.0, -4.0)})
    arrow = found["sky", 0]
    assert arrow.type == ARROW
    np.testing.assert_allclose(arrow.points, [(0.0, -0.6, 0.8), (0.0, 0.0, 0.0)])


def test_a_light_that_is_off_is_grey_and_says_so() -> None:
    found, _ = lit(a={}, b={"enabled": False})
    assert found["b", 2].text == "b (off)"
    assert len(set(found["b", 0].color[:3])) == 1 and len(set(found["a", 0].color[:3])) == 3


def test_a_light_is_where_a_topic_has_put_it() -> None:
    lighting = Lighting()
    turned = rigid((0.0, 1.0, 2.0), (0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5)), "pose")  # x is down
    lighting.move("beam", LightPose("hand", turned))
    found, _ = lit(lighting, beam={"type": "spot", "outer_angle": 0.001})
    assert (found["beam", 0].frame, found["beam", 0].position) == ("hand", (0.0, 1.0, 2.0))
    np.testing.assert_allclose(found["beam", 1].points[0], (0.0, 1.0, 1.0), atol=2e-3)


def test_the_sun_is_shown_while_it_shines() -> None:
    pytest.importorskip("ephem", reason="needs ephem: pip install 'shadow_tracer[sun]'")
    group = {"type": "sun", "sun.latitude": 48.0, "sun.longitude": 11.0}
    noon, night = 1_782_039_600_000_000_000, 1_781_996_400_000_000_000  # 2026-06-21, 11:00 and 0:00 UTC less 1 h
    tail = lit(stamp=noon, sun=group)[0]["sun", 0].points[0]
    assert tail[2] > 0.85 and tail[1] < 0.0  # high in the south
    assert lit(stamp=night, sun=group)[0] == {} and lit(stamp=0, sun=group)[0] == {}
    assert lit(stamp=0, sun={**group, "sun.time": "2026-06-21T11:00:00Z"})[0]


def test_lights_of_a_world_without_a_name_are_counted() -> None:
    found, nameless = lit(world="", a={}, b={"frame": "arm"})
    assert set(found) == {("b", 0), ("b", 2)} and nameless == 1


# When


class Sink:
    """A publisher that somebody may listen to."""

    def __init__(self, listeners: int = 1) -> None:
        self.listeners = listeners
        self.sent: list[Any] = []

    def get_subscription_count(self) -> int:
        return self.listeners

    def publish(self, data: Any) -> None:
        self.sent.append(data)


class Watched:
    """A feed of numbers, drawn in some turns."""

    def __init__(self, listeners: int = 1, turns: int = 3) -> None:
        self.sink = Sink(listeners)
        self.looks = 0
        self.value = 0
        self.turns = turns
        self.feed = MarkerFeed(self.sink, self._draw, lambda one, other: one == other)

    def step(self, now: float) -> bool:
        return self.feed.step(now, self._look)

    def _look(self) -> int:
        self.looks += 1
        return self.value

    def _draw(self, seen: int) -> Generator[None, None, Any]:
        for _ in range(self.turns - 1):
            yield
        return seen


def test_nothing_is_looked_at_without_a_listener() -> None:
    watched = Watched(listeners=0)
    assert not any(watched.step(0.25 * k) for k in range(100))
    assert watched.looks == 0 and watched.sink.sent == []


def test_what_does_not_change_is_sent_once() -> None:
    watched = Watched()
    assert [watched.step(0.0) for _ in range(3)] == [True, True, False]
    assert not any(watched.step(0.25 * k) for k in range(1, 100))
    assert watched.sink.sent == [0] and 20 <= watched.looks <= 25


def test_what_changes_all_the_time_is_sent_once_a_second() -> None:
    watched, times = Watched(), []
    for k in range(1000):
        watched.value = k
        before = len(watched.sink.sent)
        watched.step(0.01 * k)
        times += [0.01 * k] * (len(watched.sink.sent) - before)
    assert (np.diff(times) >= PERIOD - 1e-9).all() and len(times) >= 9
    assert watched.sink.sent == sorted(set(watched.sink.sent))


def test_whoever_begins_to_listen_gets_everything() -> None:
    watched = Watched(turns=1)
    watched.step(0.0)
    watched.step(10.0)
    assert watched.sink.sent == [0]
    watched.sink.listeners = 2
    watched.step(11.0)
    assert watched.sink.sent == [0, 0]
    watched.sink.listeners = 0
    watched.step(12.0)
    watched.sink.listeners = 1
    watched.step(12.25)
    assert watched.sink.sent == [0, 0, 0]


def test_a_drawing_that_fails_is_begun_again() -> None:
    watched = Watched(turns=2)
    watched.step(0.0)
    watched.feed._work = iter([])  # type: ignore[assignment]

    def fail() -> Generator[None, None, bytes]:
        raise ValueError("no memory")
        yield

    watched.feed._work = fail()
    with pytest.raises(ValueError, match="no memory"):
        watched.step(0.1)
    watched.value = 5
    while watched.step(2.0):
        pass
    assert watched.sink.sent == [5]


def test_both_topics_have_what_there_is_and_the_unnamed_is_said() -> None:
    said: list[str] = []
    scene, lights = Sink(), Sink()
    store = store_of(soup("mesh", expires=7), soup("files/0"))
    markers = Markers(scene, lights, store, Lighting(), said.append)
    now = 0.0
    for settings, camera, number in (
        (settings_from({}), "", 0),  # the first image brings the name
        (settings_from({"pose_source": "parameter"}), "camera", 0),
        (settings_from({}), "camera", 2),
        (MAP, "camera", 2),
    ):
        now += 2.0
        assert said == [NAMELESS] * (2 if now > 4.0 else 0)
        while markers.step(settings, camera, 0, now, 6):
            pass
        assert len(parse_markers(scene.sent[-1], MANY)) == 1 + number
        assert len(parse_markers(lights.sent[-1], MANY)) == 1 + number
    markers.step(MAP, "camera", 0, 10.0, 7)
    while markers.step(MAP, "camera", 0, 10.0, 7):
        pass
    assert [marker.ns for marker in parse_markers(scene.sent[-1], MANY)] == [
        "",
        "files",
    ]  # the other one's time is over
