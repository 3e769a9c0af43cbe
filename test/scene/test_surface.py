# SPDX-License-Identifier: Apache-2.0
"""Organised surfaces in the scene: triangles of quads, masks, height fields, charts, and errors that change nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from shadow_tracer import Bounds, BoundsError, HeightField, Scene
from shadow_tracer.scene.chart import STEPS, find_chart


def _grid(rows: int, columns: int) -> np.ndarray:
    down, across = np.mgrid[:rows, :columns]
    return np.stack([across, -down, np.sin(down + 0.3 * across)], axis=-1).astype(float)


def _casting(scene: Scene, name: str) -> set[frozenset[int]]:
    """Corners of the triangles that have only valid ones."""
    mesh = scene[name]
    there = ~np.isnan(mesh.vertices[:, 0])
    return {frozenset(triangle.tolist()) for triangle in mesh.triangles if there[triangle].all()}


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (2, 1), (2, 2), (3, 5), (513, 2), (2, 513)])
def test_two_triangles_to_a_quad_along_the_stated_diagonal(shape: tuple[int, int]) -> None:
    scene = Scene()
    mesh = scene.put_surface("ground", _grid(*shape))
    rows, columns = shape
    wanted = []
    for row in range(rows - 1):
        for column in range(columns - 1):
            a = row * columns + column
            wanted += [(a, a + columns, a + columns + 1), (a, a + columns + 1, a + 1)]
    assert mesh.grid == shape and mesh.triangles.tolist() == [list(each) for each in wanted]
    assert np.array_equal(mesh.vertices, _grid(*shape).reshape(-1, 3)) and mesh.valid.all()
    assert scene.triangle_count == len(wanted) == 2 * (rows - 1) * (columns - 1)


@pytest.mark.parametrize("pattern", range(16))
def test_a_quad_casts_the_triangle_of_its_three_valid_corners(pattern: int) -> None:
    valid = np.array([bool(pattern >> k & 1) for k in range(4)]).reshape(2, 2)
    scene = Scene()
    scene.put_surface("quad", np.where(valid[..., None], _grid(2, 2), np.nan), valid)
    there = frozenset(np.flatnonzero(valid.reshape(-1)).tolist())
    expected = {3: {there}, 4: {frozenset((0, 2, 3)), frozenset((0, 3, 1))}}.get(len(there), set())
    assert _casting(scene, "quad") == expected
    assert scene["quad"].degenerate_count == 2 - len(expected)


def test_fronts_of_a_map_look_up() -> None:
    scene = Scene()
    mesh = scene.put_surface("ground", HeightField(np.zeros((3, 4)), 2.0))
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_height_fields_lie_where_they_say() -> None:
    z = np.arange(6, dtype=np.float32).reshape(2, 3)
    field = HeightField(z, (3.0, 2.0), origin=(10.0, 20.0, 5.0))
    assert field.positions()[1, 2].tolist() == [14.0, 17.0, 10.0]
    turned = HeightField(z, 0.5, axes=((1.0, 0.0), (0.0, 1.0)))
    assert turned.positions()[1, 2].tolist() == [0.5, 1.0, 5.0]
    assert field.shape == (2, 3) and field.valid.all() and not field.z.flags.writeable


@pytest.mark.parametrize("invalid", [float("nan"), -9999.0, -9999, np.float32(-9999), 0])
def test_what_a_height_field_leaves_out(invalid: Any) -> None:
    z = np.full((3, 3), 7.0)
    z[0, 1], z[2, 2] = invalid, np.nan
    field = HeightField(np.ma.MaskedArray(z, mask=np.eye(3) * [0, 1, 0]), 1.0, invalid=invalid)
    assert np.argwhere(~field.valid).tolist() == [[0, 1], [1, 1], [2, 2]]
    mesh = Scene().put_surface("ground", field, valid=np.arange(9).reshape(3, 3) > 0)
    assert np.argwhere(~mesh.valid).tolist() == [[0, 0], [0, 1], [1, 1], [2, 2]]


def test_deformed_surfaces_keep_their_triangles_and_their_mask() -> None:
    scene, valid = Scene(), np.ones((4, 5), bool)
    valid[1, 2] = False
    mesh = scene.put_surface("ground", _grid(4, 5), valid)
    topology, before = mesh.topology_revision, mesh.vertices_revision
    scene.deform_surface("ground", _grid(4, 5) + 1.0)
    assert scene["ground"].topology_revision == topology and scene["ground"].vertices_revision > before
    assert np.array_equal(scene["ground"].valid, valid) and np.isnan(scene["ground"].vertices[7]).all()
    valid[1, 2], valid[0, 0] = True, False
    scene.deform_surface("ground", _grid(4, 5), valid)
    fresh = Scene().put_surface("ground", _grid(4, 5), valid)
    assert np.array_equal(scene["ground"].triangles, fresh.triangles)
    assert np.array_equal(scene["ground"].vertices, fresh.vertices, equal_nan=True)
    pose = np.eye(4)
    pose[0, 3] = 2.0
    scene.move("ground", pose)
    scene.deform_surface("ground", HeightField(np.zeros((4, 5)), 1.0))
    assert scene["ground"].valid.all() and np.array_equal(scene["ground"].pose, pose), "a height field brings its mask"


@pytest.mark.parametrize("shape", [(9, 13), (10, 12), (2, 3), (1, 1)])
@pytest.mark.parametrize("level", [0, 1, 2, 15])
def test_a_level_of_detail_is_the_surface_of_some_positions(shape: tuple[int, int], level: int) -> None:
    """Every so many rows and columns, and the last ones; deformed likewise, with and without another mask."""
    scene, (rows, columns) = Scene(), shape
    kept = np.ix_(*(sorted({*range(0, count, 2**level), count - 1}) for count in shape))
    valid = np.arange(rows * columns).reshape(shape) != 3

    def around(mask: np.ndarray) -> np.ndarray:
        """Kept positions whose neighbourhood, up to the next ones that are kept, is valid; of level 0 the mask."""
        some, down, across = mask[kept], kept[0].ravel(), kept[1].ravel()
        for i, j in np.ndindex(some.shape if level else (0, 0)):
            top, bottom = down[max(i - 1, 0)], down[min(i + 1, len(down) - 1)]
            left, right = across[max(j - 1, 0)], across[min(j + 1, len(across) - 1)]
            some[i, j] = mask[top : bottom + 1, left : right + 1].all()
        return some

    mesh, fresh = scene.put_surface("cloth", _grid(*shape), valid, level=level), Scene()
    coarse = fresh.put_surface("cloth", _grid(*shape)[kept], around(valid))
    assert mesh.grid == coarse.grid == (len(kept[0]), kept[1].shape[1])
    other = np.arange(rows * columns).reshape(shape) % 31 != 17
    for given, mask in ((None, None), (_grid(*shape) + 2.0, None), (_grid(*shape), other), (_grid(*shape), None)):
        if given is not None:
            scene.deform_surface("cloth", given, mask)
            fresh.deform_surface("cloth", given[kept], None if mask is None else around(mask))
        assert np.array_equal(scene["cloth"].vertices, fresh["cloth"].vertices, equal_nan=True)
        assert np.array_equal(scene["cloth"].triangles, fresh["cloth"].triangles)
        assert np.array_equal(scene["cloth"].valid, fresh["cloth"].valid)
    message = rf"^positions: expected shape \({rows}, {columns}, 3\) as surface 'cloth' has"
    with pytest.raises(ValueError, match=message):
        scene.deform_surface("cloth", _grid(rows + 1, columns))


def test_the_same_positions_at_another_level_are_another_surface() -> None:
    """Two by two positions have the same four at any level, but what they are given next differs."""
    scene = Scene()
    scene.put_surface("cloth", _grid(2, 2))
    scene.put_surface("cloth", _grid(3, 3), level=1)
    scene.deform_surface("cloth", _grid(3, 3) + 1.0)
    assert scene["cloth"].vertices[-1].tolist() == (_grid(3, 3)[2, 2] + 1.0).tolist()


def test_a_level_of_a_field_of_heights() -> None:
    z = np.arange(63.0).reshape(7, 9)
    z[1, 1] = np.nan
    mesh = Scene().put_surface("ground", HeightField(z, 1.0), level=1)
    assert mesh.grid == (4, 5) and np.argwhere(~mesh.valid).tolist() == [[0, 0], [0, 1], [1, 0], [1, 1]]


def test_a_level_of_an_atlas_has_nothing_between_its_charts() -> None:
    """A gutter of one column, between those that are kept."""
    valid = np.ones((9, 17), bool)
    valid[:, 7] = False
    mesh = Scene().put_surface("atlas", _grid(9, 17), valid, level=1)
    corners = mesh.vertices[mesh.triangles]
    there = np.isfinite(corners).all(axis=(1, 2))
    columns = np.sort(_columns_of(mesh, there), axis=1)
    assert there.sum() == 2 * 4 * 5 and not ((columns[:, 0] < 7) & (columns[:, -1] > 7)).any()


def _columns_of(mesh: Any, some: np.ndarray) -> np.ndarray:
    """(T, 3) columns of the positions that were given, of the corners of some triangles."""
    kept = mesh.sampling.kept()[1]
    return np.array(kept[mesh.triangles[some] % len(kept)])


def test_a_mesh_in_place_of_a_surface_and_back() -> None:
    scene = Scene()
    surface = scene.put_surface("thing", _grid(3, 3))
    mesh = scene.put("thing", surface.vertices, surface.triangles)
    assert mesh.grid is None
    with pytest.raises(ValueError, match="^name: 'thing' is no surface; use deform"):
        scene.deform_surface("thing", _grid(3, 3))
    assert scene.put_surface("thing", _grid(3, 3)).grid == (3, 3)
    with pytest.raises(ValueError, match="^name: 'thing' is a surface; use deform_surface"):
        scene.deform("thing", mesh.vertices)


_NAN = _grid(3, 3)
_NAN[1, 2, 0] = np.nan


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"positions": np.zeros((3, 3))}, r"^positions: expected shape \(R, C, 3\)"),
        ({"positions": np.zeros((0, 3, 3))}, "^positions: expected shape"),
        ({"positions": np.zeros((3, 3, 3), complex)}, "^positions: expected real numbers"),
        ({"positions": [[1.0], [1.0, 2.0]]}, "^positions: expected an array"),
        ({"positions": _NAN}, "^positions: expected finite.*at row 1, column 2"),
        ({"positions": 1e51 * np.ones((2, 2, 3))}, "^positions: expected finite.*at row 0, column 0"),
        ({"positions": np.ma.MaskedArray(np.zeros((2, 2, 3)), mask=True)}, "^positions: .*masked"),
        (
            {"positions": _grid(3, 3), "valid": np.ones((3, 2), bool)},
            r"^valid: expected truth values of shape \(3, 3\)",
        ),
        ({"positions": _grid(3, 3), "valid": np.ones((3, 3))}, "^valid: expected truth values"),
        ({"positions": _grid(3, 3), "valid": [[True], [True, False]]}, "^valid: expected truth values.*got list"),
        ({"positions": _grid(3, 3), "pose": np.zeros((4, 4))}, "^pose: "),
        ({"positions": _grid(3, 3), "level": -1}, "^level: expected an integer from 0 to 15, got -1"),
        ({"positions": _grid(3, 3), "level": 1.0}, "^level: expected an integer"),
        ({"positions": _grid(3, 3), "level": True}, "^level: expected an integer"),
        ({"positions": _grid(9, 9)}, "^bounds.max_triangles: "),
        ({"positions": _grid(3, 3), "name": ""}, "^name: "),
    ],
)
def test_what_is_refused_changes_nothing(arguments: dict[str, Any], message: str) -> None:
    scene = Scene(Bounds(max_triangles=20))
    scene.put_surface("ground", _grid(3, 3))
    before = scene.revision, scene["ground"].vertices.tobytes(), scene.names
    with pytest.raises(ValueError, match=message) as caught:
        scene.put_surface(**{"name": "ground", **arguments})
    assert ("bounds" in message) == isinstance(caught.value, BoundsError)
    assert (scene.revision, scene["ground"].vertices.tobytes(), scene.names) == before


def test_deformations_that_are_refused() -> None:
    scene = Scene()
    scene.put_surface("ground", _grid(3, 3))
    revision = scene.revision
    with pytest.raises(ValueError, match=r"^positions: expected shape \(3, 3, 3\).*got \(3, 4, 3\); use put_surface"):
        scene.deform_surface("ground", _grid(3, 4))
    with pytest.raises(ValueError, match="^positions: .*row 1, column 2"):
        scene.deform_surface("ground", _NAN)
    with pytest.raises(ValueError, match="^name: expected one of"):
        scene.deform_surface("sea", _grid(3, 3))
    assert scene.revision == revision


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"z": np.zeros(3)}, "z"),
        ({"z": np.zeros((0, 3))}, "z"),
        ({"z": np.array([["a"]])}, "z"),
        ({"z": np.array([[np.inf]])}, "z"),
        ({"z": np.array([[1e51]])}, "z"),
        ({"resolution": 0.0}, "resolution"),
        ({"resolution": (1.0, -1.0)}, "resolution"),
        ({"resolution": (1.0, 1.0, 1.0)}, "resolution"),
        ({"resolution": "wide"}, "resolution"),
        ({"origin": (0.0, 0.0)}, "origin"),
        ({"axes": ((1.0, 0.0), (1.0, 0.0))}, "axes"),
        ({"axes": ((2.0, 0.0), (0.0, 1.0))}, "axes"),
        ({"axes": "map"}, "axes"),
        ({"invalid": "none"}, "invalid"),
    ],
)
def test_height_fields_that_are_refused(arguments: dict[str, Any], field: str) -> None:
    with pytest.raises(ValueError, match=f"^{field}: "):
        HeightField(**{"z": np.zeros((2, 2)), "resolution": 1.0, **arguments})


def _places(positions: np.ndarray) -> np.ndarray:
    chart = find_chart(positions.reshape(-1, 3), positions.shape[:2])
    assert chart is not None
    there = np.column_stack([positions.reshape(-1, 3) - chart.center, np.ones(positions.size // 3)]) @ chart.rows.T
    assert not (there[:, 3] < chart.nearest).any()
    return (there[:, :3] / there[:, 3:]).reshape(positions.shape)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("offset", [0.0, 5e5])
def test_charts_of_terrain(axis: int, offset: float) -> None:
    positions = np.roll(_grid(9, 20) * (2.0, 3.0, 5.0), axis + 1, axis=-1) + offset
    places = _places(positions)
    down, across = np.mgrid[:9, :20]
    assert np.abs(places[..., 0] - across).max() < 1e-9 and np.abs(places[..., 1] - down).max() < 1e-9
    assert places[..., 2].min() >= 0.0 and places[..., 2].max() <= STEPS and np.ptp(places[..., 2]) > 0.9 * STEPS


def test_charts_of_depth_images() -> None:
    down, across = np.mgrid[:48, :64]
    depth = 2.0 + np.sin(0.3 * across) + 0.01 * down
    positions = np.stack([(across - 30.0) / 50.0 * depth, (down - 20.0) / 55.0 * depth, depth], axis=-1)
    positions[3, 4] = np.nan
    places = _places(positions)
    there = ~np.isnan(places[..., 0])
    assert np.abs(places[there][:, 0] - across[there]).max() < 1e-9
    assert np.allclose(
        1.0 / depth[there], np.interp(places[there][:, 2], *_line(places[there][:, 2], 1.0 / depth[there]))
    )


def _line(x: np.ndarray, y: np.ndarray) -> tuple[list[float], list[float]]:
    return [float(x.min()), float(x.max())], [float(y.min()), float(y.max())]


@pytest.mark.parametrize("scale", [1e-50, 1e-9, 1e9, 1e50])
def test_charts_of_absurd_sizes_are_charts_or_none(scale: float) -> None:
    chart = find_chart((scale * _grid(9, 20)).reshape(-1, 3), (9, 20))
    assert chart is None or np.isfinite(chart.rows).all()


@pytest.mark.parametrize("kind", ["folded", "random", "one row", "flat to a line", "none", "behind the camera"])
def test_surfaces_without_a_chart(kind: str) -> None:
    rng = np.random.default_rng(1)
    positions = _grid(9, 20)
    if kind == "folded":
        positions[..., 0] = np.abs(positions[..., 0] - 9.0)
    elif kind in ("random", "behind the camera"):
        positions = rng.normal(size=(9, 20, 3))
    elif kind == "one row":
        positions = _grid(1, 20)
    elif kind == "flat to a line":
        positions *= (1.0, 0.0, 0.0)
    else:
        positions[:] = np.nan
    assert find_chart(positions.reshape(-1, 3), positions.shape[:2]) is None
