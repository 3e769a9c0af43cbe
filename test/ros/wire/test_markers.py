# SPDX-License-Identifier: Apache-2.0
"""What markers ask for: names, actions, lifetimes, scale, poses; and what is refused."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from shadow_tracer import Scene
from shadow_tracer.ros.wire.cdr_markers import ADD, DELETE, DELETEALL, TRIANGLE_LIST, MarkerMessage
from shadow_tracer.ros.wire.markers import count_ignored, marker_changes, marker_key
from shadow_tracer.ros.wire.parts import Changes, Part, PartError
from shadow_tracer.ros.world.mesh_store import MeshStore

RNG = np.random.default_rng(20261122)
POINTS = RNG.normal(size=(6, 3))
HALF = float(np.sqrt(0.5))


def marker(ns: str = "arm", number: int = 3, **values: Any) -> MarkerMessage:
    return replace(MarkerMessage(ns=ns, id=number, frame="base", points=POINTS), **values)


def delete(ns: str = "arm", number: int = 3) -> MarkerMessage:
    return MarkerMessage(ns=ns, id=number, action=DELETE)


def delete_all(ns: str = "") -> MarkerMessage:
    return MarkerMessage(ns=ns, action=DELETEALL)


class Rig:
    """A store that takes messages."""

    def __init__(self) -> None:
        self.store = MeshStore(1000)

    def send(self, *messages: MarkerMessage, now_ns: int = 0) -> None:
        changes = marker_changes(messages, self.store.parts, now_ns, "mesh_markers")
        self.store.commit(changes, now_ns)

    def part(self, ns: str = "arm", number: int = 3) -> Part:
        return self.store.parts[marker_key(ns, number)]

    @property
    def keys(self) -> set[str]:
        return set(self.store.parts)


def test_a_marker_becomes_a_part() -> None:
    rig = Rig()
    rig.send(marker(stamp=5_000_000_007, frame_locked=True))
    part = rig.part()
    np.testing.assert_array_equal(part.vertices, POINTS)
    np.testing.assert_array_equal(part.triangles, [(0, 1, 2), (3, 4, 5)])
    np.testing.assert_array_equal(part.pose, np.eye(4))
    assert (part.key, part.frame, part.stamp, part.locked, part.expires) == (
        "markers/arm/3",
        "base",
        5_000_000_007,
        True,
        None,
    )
    assert part.field == "header.frame_id of mesh_markers 'arm' 3"
    rig.send(marker(stamp=0, frame=""))
    assert (rig.part().frame, rig.part().stamp, rig.part().locked) == ("", 0, False)


def test_arrays_are_kept_by_the_scene_as_they_are() -> None:
    rig = Rig()
    rig.send(marker(points=POINTS.astype(">f8")))
    part = rig.part()
    assert part.vertices.dtype == np.float64 and part.vertices.dtype.isnative
    mesh = Scene().put("a", part.vertices, part.triangles, part.pose)
    assert mesh.vertices is part.vertices and mesh.triangles is part.triangles


def test_the_message_is_not_kept_alive() -> None:
    rig = Rig()
    data = bytearray(POINTS.tobytes())
    rig.send(marker(points=np.frombuffer(data, np.float64).reshape(-1, 3)))
    data[:] = bytes(len(data))
    np.testing.assert_array_equal(rig.part().vertices, POINTS)


@pytest.mark.parametrize("scale", [(1.0, 1.0, 1.0), (2.0, 2.0, 2.0), (2.0, -0.5, 3.0)])
def test_unchanged_points_keep_their_arrays(scale: tuple[float, ...]) -> None:
    rig = Rig()
    rig.send(marker(scale=scale))
    first = rig.part()
    rig.send(marker(scale=scale, position=(1.0, 2.0, 3.0), points=POINTS.copy()))
    second = rig.part()
    assert second.vertices is first.vertices and second.triangles is first.triangles
    np.testing.assert_array_equal(second.pose[:3, 3], (1.0, 2.0, 3.0))
    rig.send(delete_all(), marker(scale=scale))
    assert rig.part().vertices is first.vertices and rig.part().triangles is first.triangles


@pytest.mark.parametrize("row", [0, -1])
def test_changed_points_keep_the_topology_only(row: int) -> None:
    rig = Rig()
    points = np.concatenate([POINTS] * 50)
    rig.send(marker(points=points))
    first = rig.part()
    changed = points.copy()
    changed[row, 2] += 1e-12
    rig.send(marker(points=changed))
    second = rig.part()
    assert second.vertices is not first.vertices and second.triangles is first.triangles
    np.testing.assert_array_equal(second.vertices, changed)
    rig.send(marker(points=changed[:-3]))
    third = rig.part()
    assert len(third.triangles) == 99 and len(third.vertices) == 297


def test_topology_is_kept_however_many_sizes_there_are() -> None:
    """More sizes than soup_triangles() remembers."""
    rig = Rig()
    messages = [marker(number=count, points=RNG.normal(size=(3 * count, 3))) for count in range(1, 31)]
    rig.send(*messages)
    first = {key: part.triangles for key, part in rig.store.parts.items()}
    rig.send(*(replace(message, points=message.points + 1.0) for message in messages))
    assert all(rig.store.parts[key].triangles is triangles for key, triangles in first.items())


def test_scale_is_applied_before_the_pose() -> None:
    rig = Rig()
    rig.send(marker(scale=(2.0, -0.5, 3.0), position=(1.0, 2.0, 3.0), orientation=(0.0, 0.0, HALF, HALF)))
    part = rig.part()
    np.testing.assert_array_equal(part.vertices, POINTS * (2.0, -0.5, 3.0))
    turned = part.pose @ np.array([1.0, 0.0, 0.0, 1.0])
    np.testing.assert_allclose(turned, (1.0, 3.0, 3.0, 1.0), atol=1e-15)


def test_a_quaternion_of_zeros_is_no_rotation() -> None:
    rig = Rig()
    rig.send(marker(orientation=(0.0, -0.0, 0.0, 0.0), position=(1.0, 2.0, 3.0)))
    expected = np.eye(4)
    expected[:3, 3] = (1.0, 2.0, 3.0)
    np.testing.assert_array_equal(rig.part().pose, expected)


def test_lifetime() -> None:
    rig = Rig()
    rig.send(marker(lifetime=2_000_000_000), marker(number=4), marker(number=5, lifetime=-1), now_ns=10)
    assert rig.part().expires == 2_000_000_010
    assert rig.part(number=4).expires is None and rig.part(number=5).expires is None
    rig.store.expire(2_000_000_009)
    assert len(rig.keys) == 3
    rig.send(marker(lifetime=2_000_000_000), now_ns=1_000_000_000)  # lives on
    rig.store.expire(2_000_000_010)
    assert len(rig.keys) == 3
    rig.store.expire(3_000_000_000)
    assert rig.keys == {"markers/arm/4", "markers/arm/5"}


def test_delete() -> None:
    rig = Rig()
    rig.send(marker(), marker(number=-4), marker(ns="leg"))
    rig.send(delete(), delete(number=99), delete(ns="nobody"))
    assert rig.keys == {"markers/arm/-4", "markers/leg/3"}


def test_delete_all_spares_what_is_no_marker() -> None:
    rig = Rig()
    cloud = Part("cloud", POINTS, np.array([(0, 1, 2)], np.int32))
    rig.store.commit(Changes((cloud,)), 0)
    rig.send(marker())
    rig.send(delete_all())
    assert rig.keys == {"cloud"}


def test_delete_all_of_a_namespace() -> None:
    """Marker.msg: "deletes all objects (or those with the given ns if any)"."""
    rig = Rig()
    rig.send(marker(), marker(number=4), marker(ns="arm/3"), marker(ns="ar"), marker(ns=""))
    rig.send(marker(number=9), delete_all("arm"), marker(number=4))
    assert rig.keys == {"markers/arm/4", "markers/arm/3/3", "markers/ar/3", "markers//3"}
    rig.send(delete_all(""))
    assert rig.keys == set()


def test_names_do_not_collide() -> None:
    names = [("a", 1), ("a/1", 1), ("a/1/1", 1), ("", 1), ("/1", 1), ("a", 11), ("a", -1), ("a/-", 1)]
    assert len({marker_key(*name) for name in names}) == len(names)


def test_actions_of_an_array_follow_each_other() -> None:
    rig = Rig()
    rig.send(marker(number=1), marker(number=2), marker(number=3))
    other = POINTS + 1.0
    rig.send(
        marker(number=4),
        delete(number=1),
        marker(number=2, points=other),
        delete(number=2),
        delete(number=3),
        marker(number=3, points=POINTS),
        marker(number=3, points=other),
    )
    assert rig.keys == {"markers/arm/3", "markers/arm/4"}
    np.testing.assert_array_equal(rig.part(number=3).vertices, other)
    rig.send(marker(number=1), delete_all(), marker(number=2))
    assert rig.keys == {"markers/arm/2"}


@pytest.mark.parametrize("kind", [0, 1, 4, 5, 9, 10, 12, -5])
def test_other_types_cast_nothing(kind: int) -> None:
    rig = Rig()
    other = marker(number=4, type=kind, points=POINTS[:1] * np.nan, scale=(0.0, 0.0, 0.0), stamp=-1)
    rig.send(marker(), other)
    assert rig.keys == {"markers/arm/3"}
    assert count_ignored([marker(), other, delete(), replace(other, action=DELETEALL)]) == 1
    rig.send(replace(other, id=3))  # the marker is now something else
    assert rig.keys == set()


def test_a_marker_without_points_goes() -> None:
    rig = Rig()
    rig.send(marker(), marker(number=4, points=np.empty((0, 3))))
    assert rig.keys == {"markers/arm/3"}
    rig.send(marker(points=np.empty((0, 3))))
    assert rig.keys == set()


NAN, INF = float("nan"), float("inf")
BAD: list[tuple[dict[str, Any], str]] = [
    ({"points": POINTS[:4]}, "points of mesh_markers 'arm' 3: expected three per triangle, got 4"),
    ({"points": np.where(np.arange(18).reshape(6, 3) == 10, NAN, POINTS)}, "coordinate y of point 3 is nan, not finit"),
    ({"points": np.where(np.arange(18).reshape(6, 3) == 17, -INF, POINTS)}, "coordinate z of point 5 is -inf"),
    ({"points": np.full((3, 3), 2e50)}, "points of mesh_markers 'arm' 3: coordinate x of point 0 is 2e+50, larger"),
    ({"scale": (1e40, 1.0, 1.0), "points": np.full((3, 3), 1e20)}, "coordinate x of point 0 is 1e+60"),
    ({"scale": (1e300, 1e300, 1e300), "points": np.full((3, 3), 1e20)}, "coordinate x of point 0 is inf"),
    ({"scale": (1.0, 0.0, 1.0)}, "scale of mesh_markers 'arm' 3: expected three finite numbers other than 0, got"),
    ({"scale": (1.0, NAN, 1.0)}, "scale of mesh_markers 'arm' 3: expected"),
    ({"scale": (1.0, 1.0, INF)}, "scale of mesh_markers 'arm' 3: expected"),
    ({"orientation": (0.0, 0.0, 0.0, 2.0)}, "pose of mesh_markers 'arm' 3: expected a unit quaternion"),
    ({"orientation": (0.0, 1e300, 0.0, 1.0)}, "pose of mesh_markers 'arm' 3: expected a unit quaternion, got [0.0"),
    ({"orientation": (NAN, 0.0, 0.0, 1.0)}, "pose of mesh_markers 'arm' 3: expected a unit quaternion"),
    ({"position": (NAN, 0.0, 0.0)}, "pose of mesh_markers 'arm' 3: expected a finite position"),
    ({"position": (0.0, 1e51, 0.0)}, "pose of mesh_markers 'arm' 3: expected a finite position of at most 1e+50 m"),
    ({"action": 1}, "action of mesh_markers 'arm' 3: expected 0 (add or modify), 2 (delete) or 3 (delete all), got 1"),
    ({"action": -1}, "action of mesh_markers 'arm' 3"),
    ({"stamp": -1}, "header.stamp of mesh_markers 'arm' 3: expected 0 or later, got -1 ns"),
]


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize(("change", "text"), BAD, ids=lambda value: str(value)[:30].replace("\n", " "))
def test_a_bad_marker_refuses_the_whole_message(change: dict[str, Any], text: str) -> None:
    rig = Rig()
    rig.send(marker(), marker(number=4))
    before = dict(rig.store.parts)
    for _ in range(2):
        with pytest.raises(PartError) as caught:
            rig.send(delete(number=4), marker(number=5), marker(**change), delete_all("leg"))
        assert text in str(caught.value)
        assert dict(rig.store.parts) == before


def test_what_is_deleted_again_is_not_looked_at() -> None:
    rig = Rig()
    rig.send(marker(points=POINTS * np.nan), delete(), marker(number=4))
    assert rig.keys == {"markers/arm/4"}


def test_long_names_are_cut_in_errors_only() -> None:
    rig = Rig()
    rig.send(marker(ns="n" * 300))
    assert rig.part(ns="n" * 300).field == f"header.frame_id of mesh_markers '{'n' * 40}...' 3"


def apply_one_by_one(state: dict[tuple[str, int], np.ndarray], messages: Sequence[MarkerMessage]) -> None:
    """What RViz does, message by message."""
    for message in messages:
        name = (message.ns, message.id)
        if message.action == DELETEALL:
            for key in [key for key in state if not message.ns or key[0] == message.ns]:
                del state[key]
        elif message.action == DELETE or message.type != TRIANGLE_LIST or not len(message.points):
            state.pop(name, None)
        else:
            state[name] = message.points * message.scale


def test_any_sequence_of_actions_ends_as_one_by_one() -> None:
    rng = np.random.default_rng(5)
    rig = Rig()
    state: dict[tuple[str, int], np.ndarray] = {}
    seen = set()
    for _ in range(600):
        messages = [
            marker(
                ns=str(rng.choice(["", "a", "a/1", "b"])),
                number=int(rng.integers(-1, 3)),
                action=int(rng.choice([ADD, DELETE, DELETEALL], p=[0.75, 0.17, 0.08])),
                type=int(rng.choice([TRIANGLE_LIST, 5], p=[0.9, 0.1])),
                points=POINTS[: int(rng.choice([0, 3, 6]))] + float(rng.integers(0, 2)),
                scale=tuple(float(v) for v in rng.choice([1.0, 2.0], 3)),
            )
            for _ in range(int(rng.integers(0, 6)))
        ]
        apply_one_by_one(state, messages)
        rig.send(*messages)
        assert rig.keys == {marker_key(*name) for name in state}
        for name, vertices in state.items():
            np.testing.assert_array_equal(rig.part(*name).vertices, vertices)
        seen.add(len(state))
    assert len(seen) > 8
