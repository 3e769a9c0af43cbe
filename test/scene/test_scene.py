# SPDX-License-Identifier: Apache-2.0
"""The scene in plain numpy: put, move, deform, remove, their revisions, and errors that leave everything as it was."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import pytest

from shadow_tracer import Bounds, BoundsError, Mesh, Scene

_VERTICES = [(0.0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
_TRIANGLES = [[0, 1, 2], [0, 2, 3]]
_SHEAR = np.eye(4)
_SHEAR[0, 1] = 0.5
_LAST_ROW = np.eye(4)
_LAST_ROW[3, 0] = 1e-3


def _scene() -> Scene:
    scene = Scene(Bounds(max_triangles=10))
    scene.put("room", _VERTICES, _TRIANGLES)
    return scene


def _fingerprint(scene: Scene) -> list[Any]:
    meshes = [scene[name] for name in scene.names]
    state: list[Any] = [scene.revision, scene.names, scene.triangle_count, scene.vertex_count]
    for mesh in meshes:
        state.append(
            (
                mesh.vertices.tobytes(),
                mesh.triangles.tobytes(),
                mesh.pose.tobytes(),
                mesh.topology_revision,
                mesh.vertices_revision,
                mesh.pose_revision,
            )
        )
    return state


def test_put_stores_exact_copies() -> None:
    scene = Scene()
    vertices = np.array(_VERTICES, np.float32) / np.float32(3.0)
    triangles = np.array(_TRIANGLES, np.uint16)
    scene.put("room", vertices, triangles)
    wanted = vertices.astype(np.float64)
    vertices[:] = 7.0
    triangles[:] = 0
    mesh = scene["room"]
    assert isinstance(mesh, Mesh) and mesh.name == "room" and "room" in scene and "cellar" not in scene
    np.testing.assert_array_equal(mesh.vertices, wanted)
    np.testing.assert_array_equal(mesh.triangles, _TRIANGLES)
    np.testing.assert_array_equal(mesh.pose, np.eye(4))
    assert mesh.vertices.dtype == np.float64 and mesh.triangles.dtype == np.int32 and mesh.pose.dtype == np.float64
    assert (scene.names, scene.triangle_count, scene.vertex_count) == (("room",), 2, 4)
    for array in (mesh.vertices, mesh.triangles):
        with pytest.raises(ValueError):
            array[0] = 0


@pytest.mark.parametrize("dtype", [np.int8, np.uint8, np.int16, np.uint16, np.int32, np.uint32, np.int64, np.uint64])
def test_any_integer_type(dtype: Any) -> None:
    scene = Scene()
    scene.put("room", _VERTICES, np.array(_TRIANGLES, dtype))
    np.testing.assert_array_equal(scene["room"].triangles, _TRIANGLES)


_PUT_ERRORS: list[tuple[str, str, dict[str, Any], str]] = [
    ("empty name", "name", {"name": ""}, ""),
    ("name is no string", "name", {"name": 7}, ""),
    ("two columns", "vertices", {"vertices": np.zeros((4, 2))}, "(4, 2)"),
    ("flat vertices", "vertices", {"vertices": np.zeros(12)}, "(12,)"),
    ("vertices are text", "vertices", {"vertices": [["a", "b", "c"]]}, ""),
    ("complex vertices", "vertices", {"vertices": np.zeros((4, 3), complex)}, "complex"),
    ("ragged vertices", "vertices", {"vertices": [[0, 0, 0], [1, 1]]}, ""),
    ("no vertices", "vertices", {"vertices": None}, ""),
    ("NaN", "vertices", {"vertices": np.array([(0, 0, 0), (1, 0, 0), (0, np.nan, 0), (0, 0, 1)])}, "vertex 2"),
    ("infinity", "vertices", {"vertices": np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, -np.inf)])}, "vertex 3"),
    ("index too large", "triangles", {"triangles": [[0, 1, 2], [1, 2, 4]]}, "triangle 1, corner 2"),
    ("index negative", "triangles", {"triangles": [[0, 1, 2], [-1, 2, 3]]}, "triangle 1, corner 0"),
    ("index too large for int32", "triangles", {"triangles": np.array([[0, 1, 2**33]])}, "triangle 0, corner 2"),
    (
        "index too large for int64",
        "triangles",
        {"triangles": np.array([[0, 1, 2**63 + 5]], np.uint64)},
        "triangle 0, corner 2",
    ),
    ("float indices", "triangles", {"triangles": np.array(_TRIANGLES, float)}, "float64"),
    ("bool indices", "triangles", {"triangles": np.zeros((1, 3), bool)}, "bool"),
    ("quads", "triangles", {"triangles": [[0, 1, 2, 3]]}, "(1, 4)"),
    ("flat triangles", "triangles", {"triangles": [0, 1, 2]}, "(3,)"),
    ("ragged triangles", "triangles", {"triangles": [[0, 1, 2], [0, 1]]}, ""),
    ("no triangles", "triangles", {"triangles": None}, ""),
    ("triangles without vertices", "triangles", {"vertices": np.zeros((0, 3))}, "triangle 0"),
    ("pose 3x4", "pose", {"pose": np.eye(4)[:3]}, "(3, 4)"),
    ("pose scales", "pose", {"pose": np.diag([2.0, 2, 2, 1])}, ""),
    ("pose mirrors", "pose", {"pose": np.diag([1.0, 1, -1, 1])}, ""),
    ("pose shears", "pose", {"pose": _SHEAR}, ""),
    ("pose projects", "pose", {"pose": _LAST_ROW}, "last row"),
    ("pose is NaN", "pose", {"pose": np.full((4, 4), np.nan)}, ""),
    ("pose is text", "pose", {"pose": "home"}, ""),
    ("nonfinite misspelt", "nonfinite", {"nonfinite": "ignore"}, "ignore"),
]


@pytest.mark.parametrize("field,change,part", [row[1:] for row in _PUT_ERRORS], ids=[row[0] for row in _PUT_ERRORS])
@pytest.mark.parametrize("name", ["room", "new"])
def test_put_refuses_and_changes_nothing(field: str, change: dict[str, Any], part: str, name: str) -> None:
    scene = _scene()
    before = _fingerprint(scene)
    with pytest.raises(ValueError) as caught:
        scene.put(**{"name": name, "vertices": _VERTICES, "triangles": _TRIANGLES, **change})
    assert str(caught.value).startswith(field + ":"), caught.value
    assert part in str(caught.value), caught.value
    assert not isinstance(caught.value, BoundsError)
    assert _fingerprint(scene) == before


_OTHER_ERRORS: list[tuple[str, str, Any]] = [
    ("move unknown", "name", lambda s: s.move("cellar", np.eye(4))),
    ("move not rigid", "pose", lambda s: s.move("room", 2.0 * np.eye(4))),
    ("move mirrored", "pose", lambda s: s.move("room", np.diag([-1.0, 1, 1, 1]))),
    ("move to NaN", "pose", lambda s: s.move("room", np.full((4, 4), np.nan))),
    ("move without pose", "pose", lambda s: s.move("room", None)),
    ("deform unknown", "name", lambda s: s.deform("cellar", _VERTICES)),
    ("deform with fewer", "vertices", lambda s: s.deform("room", _VERTICES[:3])),
    ("deform with more", "vertices", lambda s: s.deform("room", [*_VERTICES, (1, 1, 1)])),
    ("deform to NaN", "vertices", lambda s: s.deform("room", np.full((4, 3), np.nan))),
    ("deform to 2-D", "vertices", lambda s: s.deform("room", np.zeros((4, 2)))),
    ("remove unknown", "name", lambda s: s.remove("cellar")),
    ("get unknown", "name", lambda s: s["cellar"]),
]


@pytest.mark.parametrize("field,act", [row[1:] for row in _OTHER_ERRORS], ids=[row[0] for row in _OTHER_ERRORS])
def test_other_errors_change_nothing(field: str, act: Any) -> None:
    scene = _scene()
    before = _fingerprint(scene)
    with pytest.raises(ValueError) as caught:
        act(scene)
    assert str(caught.value).startswith(field + ":"), caught.value
    if field == "name":
        assert "cellar" in str(caught.value) and "room" in str(caught.value), "what was asked for, and what there is"
    assert _fingerprint(scene) == before


def test_capacity_names_the_bound_and_changes_nothing() -> None:
    scene = _scene()
    before = _fingerprint(scene)
    nine = np.tile([[0, 1, 2]], (9, 1))
    with pytest.raises(BoundsError, match=r"^bounds\.max_triangles:"):
        scene.put("more", _VERTICES, nine)
    assert _fingerprint(scene) == before
    scene.put("more", _VERTICES, nine[:8])
    assert scene.triangle_count == 10
    scene.put("room", _VERTICES, nine[:2])  # replacing counts the old one no more
    full = _fingerprint(scene)
    with pytest.raises(BoundsError, match=r"^bounds\.max_triangles:.*\b10\b"):
        scene.put("room", _VERTICES, nine[:3])
    assert _fingerprint(scene) == full
    scene.remove("more")
    scene.put("room", _VERTICES, nine)


def _revisions(mesh: Mesh) -> tuple[int, int, int]:
    return mesh.topology_revision, mesh.vertices_revision, mesh.pose_revision


def test_revisions_change_with_what_they_count() -> None:
    scene = _scene()
    topology, vertices, pose = _revisions(scene["room"])
    revision = scene.revision
    scene.move("room", geometry.pose_of(np.eye(3), (1, 0, 0)))
    moved = _revisions(scene["room"])
    assert moved[:2] == (topology, vertices) and moved[2] != pose and scene.revision != revision
    revision = scene.revision
    scene.deform("room", np.asarray(_VERTICES) * 2.0)
    deformed = _revisions(scene["room"])
    assert (
        deformed[0] == topology and deformed[1] != vertices and deformed[2] == moved[2] and scene.revision != revision
    )
    revision = scene.revision
    scene.put("room", np.asarray(_VERTICES) * 3.0, np.array(_TRIANGLES, np.int64), pose=scene["room"].pose)
    again = _revisions(scene["room"])
    assert again[0] == topology and again[1] != deformed[1] and scene.revision != revision, (
        "the same triangles are a deformation"
    )
    np.testing.assert_array_equal(scene["room"].vertices, np.asarray(_VERTICES) * 3.0)
    revision = scene.revision
    scene.put("room", _VERTICES, [[0, 1, 2], [0, 3, 2]])
    assert scene["room"].topology_revision != topology and scene.revision != revision
    np.testing.assert_array_equal(scene["room"].pose, np.eye(4), err_msg="put without a pose means identity")


def test_a_mesh_removed_and_put_again_is_new() -> None:
    scene = _scene()
    before, revision = _revisions(scene["room"]), scene.revision
    scene.remove("room")
    assert "room" not in scene and scene.triangle_count == 0 and scene.revision != revision
    assert not scene.names
    scene.put("room", _VERTICES, _TRIANGLES)
    assert all(a != b for a, b in zip(_revisions(scene["room"]), before, strict=True))
    scene.put("hall", _VERTICES, _TRIANGLES)
    assert scene.names == ("room", "hall")
    scene.clear()
    assert scene.vertex_count == 0 and not scene.names


def test_reading_changes_no_revision() -> None:
    scene = _scene()
    before = _fingerprint(scene)
    _ = (
        scene["room"].degenerate_count,
        scene["room"].world_vertices(),
        scene.names,
        scene.triangle_count,
        "room" in scene,
    )
    assert _fingerprint(scene) == before


def test_world_vertices_in_this_order_of_operations() -> None:
    rng = np.random.default_rng(61)
    vertices = rng.normal(size=(100, 3)) * 10.0 ** rng.uniform(-3, 5, (100, 1))
    pose = geometry.pose_of(geometry.rotation(rng), (5e5, -2e6, 100.0))
    scene = Scene()
    scene.put("room", vertices, [[0, 1, 2]], pose=pose)
    expected = [
        [((row[0] * x + row[1] * y) + row[2] * z) + row[3] for row in pose[:3].tolist()]
        for x, y, z in vertices.tolist()
    ]
    np.testing.assert_array_equal(scene["room"].world_vertices(), expected)


@pytest.mark.parametrize("value", [np.nan, np.inf, -1e60])
def test_a_vertex_that_no_triangle_uses_may_be_anything(value: float) -> None:
    """It is stored as NaN and cannot matter; as soon as a triangle uses it, it is refused as before."""
    scene = Scene()
    vertices = np.array([*_VERTICES, (value, 0, 0)])
    scene.put("room", vertices, _TRIANGLES)
    assert np.isnan(scene["room"].vertices[4]).all() and scene["room"].degenerate_count == 0
    np.testing.assert_array_equal(scene["room"].vertices[:4], _VERTICES)
    scene.deform("room", vertices + (0.0, 0.0, 1.0))
    before = _fingerprint(scene)
    with pytest.raises(ValueError, match=r"^vertices: .* at vertex 4 \(nonfinite='skip'"):
        scene.put("room", vertices, [*_TRIANGLES, [0, 1, 4]])
    with pytest.raises(ValueError, match="^vertices: .* at vertex 0 "):
        scene.deform("room", vertices[::-1])
    assert _fingerprint(scene) == before
    scene.put("points", np.full((2, 3), value), np.zeros((0, 3), int))


def test_degenerate_count() -> None:
    vertices = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0), (np.nan, 0, 0), (0, 0, 0)]
    scene = Scene()
    scene.put(
        "room",
        vertices,
        [[0, 1, 3], [0, 1, 2], [0, 0, 3], [0, 5, 3], [3, 3, 3], [0, 1, 4], [1, 2, 3]],
        nonfinite="skip",
    )
    assert scene["room"].degenerate_count == 5
    scene.deform("room", [(0, 0, 0), (1, 0, 0), (2, 0, 1), (0, 1, 0), (0, 0, 1), (3, 3, 3)])
    assert scene["room"].degenerate_count == 2, "counted again after a deformation"


def test_world_of_a_slightly_unclean_rotation() -> None:
    """Rotations as they come from quaternions in float32 are rigid enough; visibly wrong ones are not."""
    turn = geometry.rotation(np.random.default_rng(62)).astype(np.float32).astype(np.float64)
    scene = _scene()
    scene.move("room", geometry.pose_of(turn, (1, 2, 3)))
    np.testing.assert_array_equal(scene["room"].pose[:3, :3], turn)
    with pytest.raises(ValueError, match="^pose:"):
        scene.move("room", geometry.pose_of(turn * 1.001, (1, 2, 3)))
