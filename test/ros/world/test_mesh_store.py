# SPDX-License-Identifier: Apache-2.0
"""Parts as they were received, and the scene that follows them: only what differs is copied. No ROS is needed here."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from shadow_tracer import Bounds, Scene
from shadow_tracer.ros.diagnostics import TRANSFORMS, Missing
from shadow_tracer.ros.wire.parts import Changes, Part, PartError, soup_triangles
from shadow_tracer.ros.world.mesh_store import MeshStore

SECOND = 1_000_000_000


def frozen(array: Any, dtype: Any) -> np.ndarray:
    owned = np.array(array, dtype)
    owned.setflags(write=False)
    return owned


def shift(x: float) -> np.ndarray:
    pose = np.eye(4)
    pose[0, 3] = x
    return pose


def soup(key: str, count: int = 1, seed: int = 0, **values: Any) -> Part:
    points = np.random.default_rng(seed).uniform(-1, 1, (3 * count, 3))
    return Part(key, frozen(points, np.float64), soup_triangles(count), **values)


class Places:
    """Frames by name, and what was asked for."""

    def __init__(self, world: str = "map", **frames: np.ndarray) -> None:
        self.world = world
        self.frames = frames
        self.asked: list[tuple[str, str, int | None]] = []

    def frame_to_world(self, frame: str, field: str, stamp: int | None = None) -> np.ndarray:
        self.asked.append((frame, field, stamp))
        if frame in ("", self.world):
            return np.eye(4)
        if frame not in self.frames:
            raise Missing(TRANSFORMS, f"no transform from {frame!r} for {field}")
        return self.frames[frame]


@pytest.fixture
def store() -> MeshStore:
    return MeshStore(max_triangles=100)


@pytest.fixture
def scene() -> Scene:
    return Scene(Bounds(max_triangles=100))


def test_soups_of_one_size_share_their_triangles() -> None:
    triangles = soup_triangles(5)
    assert triangles is soup_triangles(5) and triangles.base is None and not triangles.flags.writeable
    assert triangles.dtype == np.int32 and triangles.tolist() == np.arange(15).reshape(5, 3).tolist()
    for count in range(100, 116):  # only the last sizes are kept, or memory would grow with every size seen
        soup_triangles(count)
    assert soup_triangles(5) is not triangles
    assert soup_triangles(115) is soup_triangles(115)
    assert soup_triangles(0).shape == (0, 3)


def test_changes_clear_then_remove_then_put(store: MeshStore) -> None:
    store.commit(Changes((soup("markers/a/1"), soup("markers/b/1"), soup("mesh"), soup("cloud"))), 0)
    again = soup("markers/a/1", 2)
    store.commit(Changes((again,), ("cloud", "unknown", "markers/a/1"), "markers/"), 1)
    assert dict(store.parts) == {"mesh": store.parts["mesh"], "markers/a/1": again}
    assert (store.triangle_count, store.vertex_count) == (3, 9)
    with pytest.raises(TypeError):
        store.parts["mesh"] = again  # type: ignore[index]


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (soup("big", 100), "bounds.max_triangles: all meshes together would have 102 triangles and 306 vertices; at"),
        (Part("loose", frozen(np.zeros((298, 3)), np.float64), soup_triangles(0)), "would have 2 triangles and 304"),
        (
            Part("far", frozen([[0, 0, 0], [0, 0, 1], [0, 2e50, 0]], np.float64), soup_triangles(1)),
            "vertices: expected",
        ),
        (
            Part("nan", frozen([[0, 0, 0], [0, 0, 1], [0, np.nan, 0]], np.float64), soup_triangles(1)),
            "got [0.0, nan, 0.0] at vertex 2 of nan",
        ),
    ],
    ids=["triangles", "vertices", "coordinates", "nan"],
)
def test_what_does_not_fit_is_refused_whole(store: MeshStore, part: Part, message: str) -> None:
    kept = soup("mesh")
    store.commit(Changes((kept,)), SECOND)
    with pytest.raises(PartError) as caught:
        store.commit(Changes((soup("other"), part), ("other",), "other"), 6 * SECOND)
    assert message in str(caught.value)
    assert dict(store.parts) == {"mesh": kept} and store.oldest(6 * SECOND) == ("mesh", 5.0)
    replacing = soup("mesh", 100)
    store.commit(Changes((replacing,)), 7 * SECOND)  # what it replaces does not count
    assert store.parts["mesh"] is replacing


def test_a_vertex_that_no_triangle_uses_may_be_anything(store: MeshStore, scene: Scene) -> None:
    """Also when it is deformed, and no longer when other triangles use it."""
    triangles = soup_triangles(1)
    for k, value in enumerate((np.nan, np.inf, 1e60)):
        corners = frozen([[0, 0, k], [0, 0, 1 + k], [0, 1, 0], [value, 0, 0]], np.float64)
        store.commit(Changes((Part("mesh", corners, triangles),)), 0)
        store.update(scene, Places(), "")
        assert np.isnan(scene["mesh"].vertices[3]).all() and scene["mesh"].vertices[1, 2] == 1 + k
    assert store.updates == {"put": 1, "deform": 2, "move": 0}
    with pytest.raises(PartError, match="at vertex 3 of mesh"):
        store.commit(Changes((Part("mesh", corners, frozen([[0, 1, 3]], np.int32)),)), 0)


def test_only_what_differs_reaches_the_scene(store: MeshStore, scene: Scene) -> None:
    places = Places(arm=shift(1.0))
    a, b = soup("a", 2), soup("b", 3, frame="arm")
    store.commit(Changes((a, b)), 0)
    store.update(scene, places, "")
    assert store.updates == {"put": 2, "deform": 0, "move": 0}
    np.testing.assert_array_equal(scene["b"].pose, shift(1.0))
    assert scene["a"].vertices is a.vertices and scene["a"].triangles is a.triangles  # nothing was copied
    revision = scene.revision

    def changed() -> dict[str, int]:
        before = dict(store.updates)
        store.update(scene, places, "")
        return {name: count - before[name] for name, count in store.updates.items()}

    assert changed() == {"put": 0, "deform": 0, "move": 0} and scene.revision == revision
    places.frames["arm"] = shift(2.0)
    revisions = (scene["b"].topology_revision, scene["b"].vertices_revision, scene["a"].pose_revision)
    assert changed() == {"put": 0, "deform": 0, "move": 1}
    assert revisions == (scene["b"].topology_revision, scene["b"].vertices_revision, scene["a"].pose_revision)
    np.testing.assert_array_equal(scene["b"].pose, shift(2.0))
    store.commit(Changes((replace(b, vertices=soup("b", 3, 1).vertices),)), 1)
    topology = scene["b"].topology_revision
    assert changed() == {"put": 0, "deform": 1, "move": 0} and scene["b"].topology_revision == topology
    store.commit(Changes((replace(b, pose=shift(0.5)),)), 2)
    assert changed() == {"put": 0, "deform": 1, "move": 1}
    np.testing.assert_array_equal(scene["b"].pose, shift(2.5))
    store.commit(Changes((soup("b", 4, 2, frame="arm"),)), 3)
    assert changed() == {"put": 1, "deform": 0, "move": 0}  # a new mesh brings its pose
    np.testing.assert_array_equal(scene["b"].pose, shift(2.0))
    store.commit(Changes(remove=("b",)), 4)
    assert changed() == {"put": 0, "deform": 0, "move": 0} and scene.names == ("a",)


def test_a_frame_that_cannot_be_found_leaves_the_scene_as_it_was(store: MeshStore, scene: Scene) -> None:
    store.commit(Changes((soup("a"),)), 0)
    store.update(scene, Places(), "")
    revision = scene.revision
    store.commit(Changes((soup("a", 2), soup("b", frame="arm", field="header.frame_id of x"))), 0)
    with pytest.raises(Missing, match="header.frame_id of x"):
        store.update(scene, Places(), "")
    assert scene.revision == revision and scene.triangle_count == 1
    store.update(scene, Places(arm=shift(1.0)), "")
    assert scene.triangle_count == 3


def test_parts_without_a_frame_are_in_the_frame_of_the_parameter(store: MeshStore, scene: Scene) -> None:
    store.commit(Changes((soup("mesh"), soup("cloud", frame="lidar", locked=False))), 0)
    places = Places(odom=shift(3.0), lidar=shift(4.0))
    store.update(scene, places, "odom")
    assert scene["mesh"].pose[0, 3] == 3.0 and scene["cloud"].pose[0, 3] == 4.0
    store.update(scene, places, "")
    assert scene["mesh"].pose[0, 3] == 0.0 and scene["cloud"].pose[0, 3] == 4.0


def test_an_unlocked_part_stays_where_its_frame_was(store: MeshStore, scene: Scene) -> None:
    places = Places(arm=shift(1.0))
    part = soup("m", frame="arm", stamp=7, locked=False, pose=shift(0.25), field="its frame")
    store.commit(Changes((part, soup("now", frame="arm", locked=False))), 0)
    store.update(scene, places, "")
    assert places.asked == [("arm", "its frame", 7), ("arm", "mesh.frame", None)]  # stamp 0: that of the image
    places.frames["arm"] = shift(2.0)
    store.update(scene, places, "")
    assert len(places.asked) == 2 and scene["m"].pose[0, 3] == 1.25 and scene["now"].pose[0, 3] == 1.0
    store.commit(Changes((replace(part, pose=shift(0.5)),)), 1)  # sent anew: looked up anew
    store.update(scene, places, "")
    assert scene["m"].pose[0, 3] == 2.5 and scene["now"].pose[0, 3] == 1.0
    places.world = "odom"  # another world: all places are others
    store.update(scene, places, "")
    assert scene["now"].pose[0, 3] == 2.0


def test_what_came_before_there_was_a_time_came_with_it(store: MeshStore) -> None:
    """A simulation whose /clock comes late: ages and lifetimes begin with it, whoever asks first."""
    store.commit(Changes((soup("stays"), soup("short", expires=3 * SECOND))), 0)
    assert store.oldest(0) == ("stays", 0.0)
    store.expire(0)
    store.expire(100 * SECOND)
    assert set(store.parts) == {"stays", "short"}
    assert store.oldest(101 * SECOND)[1] == 1.0
    store.expire(103 * SECOND)
    assert set(store.parts) == {"stays"}
    other = MeshStore(100)
    other.commit(Changes((soup("a"),)), 0)
    assert other.oldest(50 * SECOND) == ("a", 0.0) and other.oldest(52 * SECOND) == ("a", 2.0)


def test_lifetimes_end_and_ages_are_counted_by_part(store: MeshStore) -> None:
    store.commit(Changes((soup("files/0"),)), 0)
    assert store.oldest(10 * SECOND) == ("", 0.0)  # files do not age
    store.commit(Changes((soup("short", expires=3 * SECOND), soup("long", expires=8 * SECOND))), SECOND)
    store.commit(Changes((soup("mesh"),)), 2 * SECOND)
    assert store.oldest(2 * SECOND) in (("short", 1.0), ("long", 1.0))
    store.expire(3 * SECOND - 1)
    assert set(store.parts) == {"files/0", "short", "long", "mesh"}
    store.expire(3 * SECOND)
    assert set(store.parts) == {"files/0", "long", "mesh"}
    assert store.oldest(4 * SECOND) == ("long", 3.0)
    store.commit(Changes((soup("long"),)), 4 * SECOND)
    assert store.oldest(4 * SECOND) == ("mesh", 2.0)


def test_after_a_time_jump_parts_count_as_received_now(store: MeshStore, scene: Scene) -> None:
    places = Places(arm=shift(1.0))
    part = soup("m", frame="arm", stamp=99 * SECOND, locked=False, expires=103 * SECOND)
    store.commit(Changes((part, soup("mesh"))), 100 * SECOND)
    store.update(scene, places, "")
    before = dict(store.updates)
    store.restart_age(5 * SECOND)
    assert store.oldest(5 * SECOND)[1] == 0.0
    del places.frames["arm"]  # of the time of its stamp nothing is known any more
    store.update(scene, places, "")
    assert store.updates == before
    store.expire(8 * SECOND - 1)
    assert "m" in store.parts
    store.expire(8 * SECOND)
    assert "m" not in store.parts and "mesh" in store.parts


def test_parts_can_be_hidden_and_other_meshes_are_left_alone(store: MeshStore, scene: Scene) -> None:
    scene.put("depth", *(soup("x").vertices, soup_triangles(1)))
    store.commit(Changes((soup("mesh"),)), 0)
    store.update(scene, Places(), "")
    store.update(scene, Places(), "", shown=False)
    assert scene.names == ("depth",) and set(store.parts) == {"mesh"}
    store.update(scene, Places(), "")
    assert set(scene.names) == {"depth", "mesh"} and store.updates["put"] == 2


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ({"a": (90, 0), "b": (10, 0)}, {"a": (10, 0), "b": (90, 0)}),
        ({"a": (10, 0), "b": (90, 0)}, {"a": (90, 0), "b": (10, 0)}),
        ({"a": (50, 0), "b": (50, 0)}, {"a": (49, 53), "b": (50, -50)}),  # fewer triangles, but more vertices
    ],
    ids=["first shrinks", "last shrinks", "vertices"],
)
def test_a_full_scene_can_change_its_shares(store: MeshStore, scene: Scene, before: Any, after: Any) -> None:
    """Parts that fit together must fit on the way, too; (triangles, vertices beyond three a triangle) each."""

    def parts(sizes: dict[str, tuple[int, int]]) -> tuple[Part, ...]:
        made = []
        for key, (count, more) in sizes.items():
            vertices = np.random.default_rng(count).uniform(-1, 1, (3 * count + more, 3))
            triangles = np.minimum(np.arange(3 * count).reshape(count, 3), len(vertices) - 1)
            made.append(Part(key, frozen(vertices, np.float64), frozen(triangles, np.int32)))
        return tuple(made)

    for sizes in (before, after, before):
        store.commit(Changes(parts(sizes)), 0)
        store.update(scene, Places(), "")
        assert {name: len(scene[name].triangles) for name in scene.names} == {k: n for k, (n, _) in sizes.items()}
        assert all(scene[part.key].vertices is part.vertices for part in store.parts.values())


def test_whatever_comes_the_scene_is_what_the_store_says(scene: Scene) -> None:
    rng = np.random.default_rng(8)
    store, now = MeshStore(100), 0
    places = Places(arm=shift(1.0))
    refused = 0
    for step in range(400):
        now += int(rng.integers(0, SECOND))
        put = []
        for _ in range(rng.integers(0, 4)):
            key, count = f"{rng.choice(['m/', 'n/'])}{rng.integers(0, 5)}", int(rng.integers(0, 30))
            known = store.parts.get(key)
            part = soup(
                key, count, step, frame=str(rng.choice(["", "arm"])), locked=bool(rng.integers(0, 2)),
                pose=shift(float(rng.integers(0, 3))), expires=rng.choice([None, now + 2 * SECOND]),
            )  # fmt: skip
            put.append(
                replace(part, vertices=known.vertices, triangles=known.triangles) if known and step % 3 else part
            )
        remove = (f"m/{rng.integers(0, 5)}",) if rng.random() < 0.3 else ()
        before = dict(store.parts)
        try:
            store.commit(Changes(tuple(put), remove, "n/" if rng.random() < 0.05 else None), now)
        except PartError:
            refused += 1
            assert dict(store.parts) == before
        store.expire(now)
        places.frames["arm"] = shift(float(rng.integers(0, 4)))
        store.update(scene, places, "")
        assert set(scene.names) == set(store.parts)
        for part in store.parts.values():
            mesh = scene[part.key]
            assert mesh.vertices is part.vertices and np.array_equal(mesh.triangles, part.triangles)
            if part.locked:
                frame = places.frames[part.frame] if part.frame else np.eye(4)
                np.testing.assert_array_equal(mesh.pose, frame @ part.pose)
    assert refused > 5 and store.updates["deform"] + store.updates["put"] > 100
