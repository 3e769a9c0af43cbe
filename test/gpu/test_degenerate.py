# SPDX-License-Identifier: Apache-2.0
"""Triangles without area, corners that are no numbers, meshes with nothing in them: nothing cast, nothing disturbed."""

from __future__ import annotations

from typing import Any

import geometry
import numpy as np
import pytest

from shadow_tracer import DirectionalLight, PointLight

_LIGHTS = [
    PointLight("lamp", (0.2, 0.1, 3.0)),
    PointLight("inside", (0.0, 0.0, 0.5)),
    DirectionalLight("sun", (0.3, 0.1, -1.0)),
]
_POINTS = np.concatenate(
    [np.random.default_rng(40).uniform(-3, 3, (200, 3)), np.random.default_rng(41).integers(-3, 4, (100, 3))]
)

_NOTHING: dict[str, tuple[Any, Any]] = {
    "two_equal_corners": ([(0, 0, 0), (2, 0, 1), (2, 0, 1)], [[0, 1, 2]]),
    "an_index_twice": ([(0, 0, 0), (2, 0, 1)], [[0, 1, 1], [0, 0, 1], [1, 0, 1]]),
    "collinear": ([(-1, -1, 0), (1, 1, 0), (3, 3, 0)], [[0, 1, 2]]),
    "all_equal": ([(0.5, 0.5, 0.5)] * 3, [[0, 1, 2]]),
    "all_zero": (np.zeros((3, 3)), [[0, 0, 0], [0, 1, 2]]),
    "no_triangle": ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], np.zeros((0, 3), int)),
    "nothing_at_all": (np.zeros((0, 3)), np.zeros((0, 3), int)),
    "not_a_number": ([(0, 0, 0), (9, 0, 0), (np.nan, 9, 0)], [[0, 1, 2]]),
    "infinite": (
        [(-9, -9, 0), (9, -9, 0), (0, np.inf, 0), (-np.inf, np.inf, np.nan)],
        [[0, 1, 2], [1, 2, 3], [2, 3, 3]],
    ),
}


def _ask(tracer: Any) -> np.ndarray:
    return np.stack([tracer.occluded(_POINTS, light) for light in _LIGHTS])


@pytest.mark.parametrize("kind", _NOTHING)
def test_casts_nothing(tracer: Any, kind: str) -> None:
    tracer.scene.put("nothing", *_NOTHING[kind], nonfinite="skip")
    assert not _ask(tracer).any()


@pytest.mark.parametrize("kind", _NOTHING)
@pytest.mark.parametrize("first", [True, False])
def test_disturbs_nobody(tracer: Any, kind: str, first: bool) -> None:
    """Beside a sphere, in another mesh and within the same mesh."""
    sphere = geometry.icosphere(2, 1.0)
    tracer.scene.put("sphere", *sphere)
    expected = _ask(tracer)
    assert expected.any() and not expected.all()
    nothing = (np.asarray(_NOTHING[kind][0], float).reshape(-1, 3), np.asarray(_NOTHING[kind][1]).reshape(-1, 3))
    if first:
        tracer.scene.clear()
    tracer.scene.put("nothing", *nothing, nonfinite="skip")
    tracer.scene.put("sphere", *sphere)
    np.testing.assert_array_equal(_ask(tracer), expected)
    tracer.scene.clear()
    tracer.scene.put("both", *geometry.join([nothing, sphere] if first else [sphere, nothing]), nonfinite="skip")
    np.testing.assert_array_equal(_ask(tracer), expected)


def test_no_mesh_at_all(tracer: Any) -> None:
    assert not _ask(tracer).any()
    tracer.scene.put("sphere", *geometry.icosphere(1, 1.0))
    assert _ask(tracer).any()
    tracer.scene.remove("sphere")
    assert not _ask(tracer).any(), "what was removed still casts"


def test_one_triangle(tracer: Any) -> None:
    tracer.scene.put("one", [(-1, -1, 0), (3, -1, 0), (-1, 3, 0)], [[0, 1, 2]])
    hidden = tracer.occluded([(0, 0, -1), (0, 0, 1), (5, 5, -1)], DirectionalLight("sun", (0, 0, -1)))
    np.testing.assert_array_equal(hidden, [True, False, False])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("column", [0, 1, 2])
def test_one_bad_vertex_takes_only_its_own_triangles(tracer: Any, bad: float, column: int) -> None:
    vertices, triangles = geometry.icosphere(2, 1.0)
    broken = vertices.copy()
    broken[7, column] = bad
    tracer.scene.put("mesh", vertices, triangles[~(triangles == 7).any(axis=1)])
    expected = _ask(tracer)
    tracer.scene.put("mesh", broken, triangles, nonfinite="skip")
    np.testing.assert_array_equal(_ask(tracer), expected)
    tracer.scene.deform("mesh", vertices)
    healed = _ask(tracer)
    tracer.scene.clear()
    tracer.scene.put("mesh", vertices, triangles)
    np.testing.assert_array_equal(healed, _ask(tracer))


def test_bad_vertices_that_no_triangle_uses(tracer: Any) -> None:
    """No pipeline looks at them, wherever they stand in the list, and none has to be asked to skip them."""
    vertices, triangles = geometry.icosphere(2, 1.0)
    tracer.scene.put("mesh", vertices, triangles)
    expected = _ask(tracer)
    bad = np.array([(np.nan, 0, 0), (0, np.inf, 0), (0, 0, -1e60)])
    tracer.scene.put("mesh", np.concatenate([bad, vertices, bad]), triangles + 3)
    np.testing.assert_array_equal(_ask(tracer), expected)
    tracer.scene.deform("mesh", np.concatenate([bad[::-1], vertices, bad]))
    np.testing.assert_array_equal(_ask(tracer), expected)


def test_bad_vertices_under_a_pose(tracer: Any) -> None:
    """NaN and infinity stay without effect when the pose mixes the coordinates."""
    rng = np.random.default_rng(42)
    vertices, triangles = geometry.icosphere(2, 1.0)
    broken = vertices.copy()
    broken[[3, 50]] = [np.inf, -np.inf, 0.0]
    pose = geometry.pose_of(geometry.rotation(rng), (0.1, 0.2, -0.3))
    tracer.scene.put("mesh", vertices, triangles[~np.isin(triangles, [3, 50]).any(axis=1)], pose=pose)
    expected = _ask(tracer)
    tracer.scene.put("mesh", broken, triangles, pose=pose, nonfinite="skip")
    np.testing.assert_array_equal(_ask(tracer), expected)


def test_nearly_degenerate_triangles_are_decided_exactly(tracer: Any) -> None:
    """A needle one ulp wide still is a triangle: closed, and in front of exactly the samples the oracle says."""
    import oracle

    ulp = np.nextafter(1.0, 2.0)
    vertices = np.array([(-1, 1.0, 0), (1, 1.0, 0), (0, ulp, 0), (-1, -1, 0.0), (1, -1, 0), (0, -1, 5e-16)], float)
    triangles = np.array([[0, 1, 2], [3, 4, 5]])
    light = PointLight("lamp", (0.0, 0.0, 2.0))
    points = np.array(
        [
            (x, y, -2.0)
            for x in (-1.0, 0.0, 0.5, 2.0, 3.0)
            for y in (2.0, 2 * ulp, np.nextafter(2.0, 0), -2.0, np.nextafter(-2.0, -3))
        ]
    )
    tracer.scene.put("mesh", vertices, triangles)
    expected = oracle.occluded_exact(points, light, vertices, triangles)
    np.testing.assert_array_equal(tracer.occluded(points, light), expected)
    assert 3 <= expected.sum() < len(points)
