# SPDX-License-Identifier: Apache-2.0
"""Polygons become triangles that cover what they cover, edge by edge, or are refused."""

from __future__ import annotations

import sys
from collections import Counter
from typing import Any

import numpy as np
import pytest

from shadow_tracer.ros.wire.mesh_files import polygons
from shadow_tracer.ros.wire.mesh_files.content import ReadError
from shadow_tracer.ros.wire.mesh_files.polygons import triangulate, triangulate_rings

pytest.importorskip("mapbox_earcut", reason="needs mapbox_earcut: pip install 'shadow_tracer[mesh]'")


def lifted(points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Points of a plane somewhere in space: along an axis, or turned."""
    space = np.insert(points, rng.integers(3), 0.25, axis=1)
    if rng.random() < 0.5:
        space = space @ np.linalg.qr(rng.normal(size=(3, 3)))[0].T + rng.normal(size=3)
    return space


def star(rng: np.random.Generator) -> np.ndarray:
    """A simple polygon around the origin, concave nearly everywhere."""
    count = rng.integers(5, 30)
    angles = (np.arange(count) + rng.uniform(0, 0.9, count)) * 2 * np.pi / count
    return rng.uniform(0.2, 1, count)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def skyline(rng: np.random.Generator) -> np.ndarray:
    """Right angles, and many corners on one line."""
    heights = rng.integers(1, 4, rng.integers(3, 12))
    top = [(k + side, height) for k, height in enumerate(heights) for side in (0, 1)]
    points = [*top, *((k, 0) for k in range(len(heights), -1, -1))]
    return np.array([point for k, point in enumerate(points) if point != points[k - 1]], float)


def shoelace(points: np.ndarray) -> float:
    x, y = points.T
    return abs(float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())) / 2


def normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a) / 2


def edges(triangles: np.ndarray) -> list[tuple[int, int]]:
    """Directed edges that no other triangle has the other way round."""
    found = Counter((int(t[k]), int(t[(k + 1) % 3])) for t in triangles for k in range(3))
    return sorted((a, b) for (a, b), count in found.items() if count != found.get((b, a), 0))


@pytest.mark.parametrize("shape", [star, skyline])
def test_concave_polygons(shape: object) -> None:
    """Areas add up, every triangle is wound as the polygon, and only its own edges are open."""
    rng = np.random.default_rng(20261128)
    for _ in range(150):
        flat = shape(rng)  # type: ignore[operator]
        flat = np.roll(flat[:: rng.choice([-1, 1])], rng.integers(len(flat)), axis=0)
        count, space = len(flat), lifted(flat, rng)
        triangles = triangulate(space, np.arange(count), np.array([count]))
        assert triangles.shape == (count - 2, 3)
        areas = normals(space, triangles)
        around = np.cross(space[1:-1] - space[0], space[2:] - space[0]).sum(axis=0)
        assert np.linalg.norm(areas, axis=1).sum() == pytest.approx(shoelace(flat), rel=1e-9)
        assert (areas @ around >= -1e-12).all()
        assert edges(triangles) == sorted((k, (k + 1) % count) for k in range(count))


def test_polygons_of_all_sizes_keep_their_order() -> None:
    rng = np.random.default_rng(7)
    shapes = [star(rng) for _ in range(20)] + [np.array([(0, 0), (1, 0), (0, 1)]), np.eye(4)[:, :2] * 2]
    rng.shuffle(shapes)  # type: ignore[arg-type]
    vertices = np.concatenate([lifted(shape, rng) for shape in shapes])
    counts = np.array([len(shape) for shape in shapes])
    triangles = triangulate(vertices, np.arange(len(vertices)), counts)
    owner = np.repeat(np.arange(len(counts)), counts)
    assert (owner[triangles] == np.repeat(np.arange(len(counts)), counts - 2)[:, None]).all()


@pytest.mark.parametrize("reflex", range(4))
def test_a_concave_quad_is_cut_at_its_reflex_corner(reflex: int) -> None:
    flat = np.roll(np.array([(0.5, 1.0), (2.0, 2.0), (0.0, 1.0), (2.0, 0.0)]), reflex, axis=0)
    space = np.insert(flat, 1, 0.0, axis=1)
    triangles = triangulate(space, np.arange(4), np.array([4]))
    assert all(reflex in triangle for triangle in triangles.tolist())
    assert np.linalg.norm(normals(space, triangles), axis=1).sum() == pytest.approx(shoelace(flat))


@pytest.mark.parametrize(
    "flat",
    [
        [(0, 0), (1, 1), (1, 0), (0, 1)],
        [(0, 0), (2, 2), (2, 0), (0, 1)],
        [(0, 0), (2, 2), (2, 0), (0, 2), (-1, 1)],
        [(np.cos(4 * np.pi * k / 5), np.sin(4 * np.pi * k / 5)) for k in range(5)],
    ],
    ids=["bow tie", "uneven bow tie", "crossing", "pentagram"],
)
def test_polygons_that_cross_themselves_are_refused(flat: list[tuple[float, float]]) -> None:
    space = np.insert(np.array(flat, float), 2, 0.0, axis=1)
    with pytest.raises(ReadError, match="polygon 1 .*crosses itself.*triangulate the mesh"):
        triangulate(
            np.concatenate([space, np.eye(3)]),
            np.array([*range(len(flat), len(flat) + 3), *range(len(flat))]),
            np.array([3, len(flat)]),
        )


@pytest.mark.parametrize("corners", [4, 6])
def test_slivers_that_cross_themselves_by_rounding_are_no_reason_to_refuse(corners: int) -> None:
    """Corners on a line, folded too, written with six digits: none of them may be taken for a bow tie."""
    rng = np.random.default_rng(corners)
    for _ in range(100):
        start, way = rng.uniform(-9, 9, 3), rng.normal(size=3)
        line = start + np.append(rng.random(corners - 2), (0.0, 3.0))[:, None] * way
        sliver = np.array([[float(f"{x:.6g}") for x in row] for row in line])
        triangles = triangulate(sliver, np.arange(corners), np.array([corners]))
        assert len(triangles) == corners - 2 and np.linalg.norm(normals(sliver, triangles), axis=1).sum() < 1e-2


def test_putting_corners_back_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """In this folded sliver, with a corner that stands twice, every split leaves another edge to be split."""
    sliver = np.array(
        [
            (0.750108, -7.33419, 0.60448),
            (0.762049, -7.34736, 0.607621),
            (0.78515, -7.37283, 0.613696),
            (0.74777, -7.33161, 0.603865),
            (0.744062, -7.32752, 0.60289),
            (0.744062, -7.32752, 0.60289),
            (0.760064, -7.34517, 0.607098),
            (0.778368, -7.36535, 0.611912),
            (0.767254, -7.35309, 0.608989),
        ]
    )
    asked: list[Any] = []
    between = polygons._between

    def count(*given: Any) -> list[int]:
        asked.append(given)
        assert len(asked) < 1000, "no end"
        return between(*given)

    monkeypatch.setattr(polygons, "_between", count)
    assert len(triangulate(sliver, np.arange(9), np.array([9]))) == 7 and asked


@pytest.mark.parametrize("away", [0.0, 1e6])
def test_small_loops_are_found(away: float) -> None:
    """A loop at a corner of a twentieth of the size is no rounding, wherever the polygon is."""
    for tie in (
        [(0, 0), (1, 1), (1, 0), (0, 0.02)],
        [(0, 0), (2, 0), (2, 2.1), (2.1, 2), (0, 2)],
    ):
        space = np.insert(np.array(tie) + away, 2, 0.0, axis=1)
        with pytest.raises(ReadError, match="crosses itself"):
            triangulate(space, np.arange(len(tie)), np.array([len(tie)]))


def test_corners_that_stand_twice_and_polygons_without_area() -> None:
    flat = [(0, 0), (1, 0), (1, 0), (1, 1), (0, 1), (0, 1)]
    space = np.insert(np.array(flat, float), 2, 0.0, axis=1)
    triangles = triangulate(space, np.arange(6), np.array([6]))
    assert len(triangles) == 4 and np.linalg.norm(normals(space, triangles), axis=1).sum() == pytest.approx(1.0)
    line = np.outer(np.arange(6.0), (1.0, 2.0, 3.0))
    assert not normals(line, triangulate(line, np.arange(6), np.array([6]))).any()


def test_a_polygon_that_is_not_plane_is_covered_between_its_corners() -> None:
    flat = np.array([(0, 0), (4, 0), (4, 3), (3, 3), (3, 1), (1, 1), (1, 3), (0, 3)], float)
    space = np.column_stack([flat, 0.3 * np.sin(flat.sum(axis=1))])
    triangles = triangulate(space, np.arange(8), np.array([8]))
    assert np.abs(normals(space, triangles)[:, 2]).sum() == pytest.approx(shoelace(flat))
    assert edges(triangles) == sorted((k, (k + 1) % 8) for k in range(8))


def test_holes() -> None:
    outline = np.array([(0, 0), (6, 0), (6, 4), (0, 4)], float)
    holes = [np.array([(1, 1), (1, 2), (2, 2), (2, 1)], float), np.array([(4, 1), (5, 1), (5, 3)], float)]
    flat = np.concatenate([outline, *holes])
    for turned in (False, True):
        space = np.insert(flat, 1, 2.0, axis=1)
        rings = [np.arange(4)[::-1] if turned else np.arange(4), np.arange(4, 8), np.arange(8, 11)]
        triangles = triangulate_rings(space, rings, "the wall")
        assert len(triangles) == 13
        assert np.linalg.norm(normals(space, triangles), axis=1).sum() == pytest.approx(24 - 1 - 1)
        around = np.cross(*(space[rings[0][k]] - space[rings[0][0]] for k in (1, 2)))
        assert (normals(space, triangles) @ around >= 0.0).all()
    with pytest.raises(ReadError, match="the wall .*crosses itself"):
        beyond = np.concatenate([space, space[6:7] + (9.0, 0.0, 0.0)])
        triangulate_rings(beyond, [np.arange(4), np.array([4, 11, 6])], "the wall")
    with pytest.raises(ReadError, match="the wall has a hole or an outline with fewer than 3"):
        triangulate_rings(space, [np.arange(4), np.array([4, 5])], "the wall")


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.1])
def test_corners_on_a_line_keep_their_edges_beside_holes(angle: float) -> None:
    """A neighbour may have a corner in the middle of a straight side: no gap of rounding may open there."""
    outline = [(3, 4), (4, 4), (4, 3), (5, 3), (6, 3), (6, 4), (7, 4), (7, 5), (7, 6), (7, 7), (6, 7), (5, 7), (4, 7)]
    outline += [(3, 7), (3, 6), (3, 5)]
    hole = [(5, 5), (5, 6), (6, 6), (6, 5)]
    turn = np.array([(np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))])
    space = np.insert(np.array(outline + hole, float) @ turn, 1, 0.0, axis=1)
    triangles = triangulate_rings(space, [np.arange(16), np.arange(16, 20)], "the wall")
    assert len(triangles) == 16 + 4 - 2 + 2
    around = [(k, (k + 1) % 16) for k in range(16)] + [(16 + k, 16 + (k + 1) % 4) for k in range(4)]
    assert edges(triangles) == sorted(around) or edges(triangles) == sorted((b, a) for a, b in around)
    assert np.linalg.norm(normals(space, triangles), axis=1).sum() == pytest.approx(13.0)


def test_far_away_and_of_any_size() -> None:
    flat = np.array([(0, 0), (4, 0), (4, 3), (3, 3), (3, 1), (1, 1), (1, 3), (0, 3)], float)
    for scale in (1e-9, 1e12, 1e40):
        space = np.insert(flat * scale, 0, 0.0, axis=1)
        triangles = triangulate(space, np.arange(8), np.array([8]))
        assert np.linalg.norm(normals(space, triangles), axis=1).sum() == pytest.approx(shoelace(flat) * scale**2)


def test_without_earcut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mapbox_earcut", None)
    convex = np.insert(np.array([(0, 0), (2, 0), (3, 1), (2, 2), (0, 2)], float), 2, 0.0, axis=1)
    assert len(triangulate(convex, np.arange(5), np.array([5]))) == 3
    convex[2] = 1, 1, 0
    with pytest.raises(ReadError, match=r"needs mapbox_earcut: pip install 'shadow_tracer\[mesh\]'"):
        triangulate(convex, np.arange(5), np.array([5]))
