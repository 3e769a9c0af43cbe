# SPDX-License-Identifier: Apache-2.0
"""ShadowTracer.cone_hits: no triangle missed, late or twice, lists in order, and lists in pieces equal one list."""

from __future__ import annotations

from typing import Any

import cones
import geometry
import numpy as np
import probe
import pytest

from shadow_tracer import Bounds, Camera, DirectionalLight, ShadowTracer, render_depth

_SMALL = {"max_triangles": 4000, "max_rays": 1 << 15, "max_lights": 2, "queue_capacity": 4000, "grid_entries": 20_000}


def _tracer(device: str, *meshes: geometry.Geometry) -> ShadowTracer:
    tracer = ShadowTracer("light_grid", device=device, bounds=Bounds(**_SMALL), threads=1)
    for number, mesh in enumerate(meshes):
        tracer.scene.put(f"mesh {number}", *mesh)
    return tracer


def _asked(rng: Any, count: int, most: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    axes = cones.unit(rng.uniform(-1, 1, (count, 3)))
    axes[::5] = np.eye(3)[np.arange(len(axes[::5])) % 3]  # along the axes of boxes
    return rng.uniform(-1, 1, (count, 3)), axes, 10.0 ** rng.uniform(-2.0, np.log10(most), count)


@probe.in_both_forms
def test_none_missed_and_none_late(any_device: str, kernel_form: str) -> None:
    rng = np.random.default_rng(520)
    vertices, triangles = geometry.soup(rng, 15, 0.6, 1.0)
    tracer = _tracer(any_device, (vertices, triangles))
    apices, axes, angles = _asked(rng, 25, 1.4)
    numbers, distances = tracer.cone_hits(apices, axes, angles, 15)
    pairs = [np.repeat(each, 15, axis=0) for each in (apices, axes, np.tan(angles))]
    expected = cones.entry(np.tile(vertices[triangles], (25, 1, 1)), *pairs).reshape(25, 15)
    found = np.full((25, 16), np.inf)
    np.put_along_axis(found, np.where(numbers < 0, 15, numbers), distances, axis=1)
    np.testing.assert_array_equal(np.isfinite(found[:, :15]), np.isfinite(expected))
    met = np.isfinite(expected)
    assert 30 < met.sum() < 400
    np.testing.assert_allclose(found[:, :15][met], expected[met], rtol=0, atol=1e-5)


@probe.in_both_forms
def test_order_pieces_and_no_duplicates(any_device: str, kernel_form: str) -> None:
    rng = np.random.default_rng(521)
    tracer = _tracer(any_device, geometry.icosphere(2), geometry.integer_soup(rng, 100))
    apices, axes, angles = _asked(rng, 50, 0.9)
    apices[::4] = np.rint(apices[::4])  # many distances are equal
    numbers, distances = tracer.cone_hits(apices, axes, angles, 500)
    assert (numbers[:, -1] == -1).all()
    for row, t in zip(numbers, distances, strict=True):
        some = row >= 0
        assert len(set(row[some])) == some.sum() and not some[some.sum() :].any()
        assert sorted(zip(t[some], row[some], strict=True)) == list(zip(t[some], row[some], strict=True))
    ties = (distances[:, 1:] == distances[:, :-1]).sum() - np.isinf(distances[:, 1:]).sum()
    assert ties > 100
    for n in (1, 3, 7):
        after, pieces = None, []
        while True:
            some, t = tracer.cone_hits(apices, axes, angles, n, after=after)
            if (some < 0).all():
                break
            pieces.append((some, t))
            after = (t[:, -1], some[:, -1])
            if len(pieces) * n > 40:
                break
        count = len(pieces) * n
        np.testing.assert_array_equal(np.concatenate([some for some, _ in pieces], axis=1), numbers[:, :count])
        np.testing.assert_array_equal(np.concatenate([t for _, t in pieces], axis=1), distances[:, :count])


def test_lists_go_on_behind_any_number(any_device: str) -> None:
    """Also behind one that is no triangle's, however large: it is compared, and not cut to its last bits."""
    tracer = _tracer(any_device, geometry.integer_soup(np.random.default_rng(523), 100))
    cone = (0.0, 0.0, 9.0), (0.0, 0.0, -1.0), 0.5, 100
    numbers, distances = tracer.cone_hits(*cone)
    at = int(np.flatnonzero(distances[1:] == distances[:-1])[0])  # the first of several at one distance
    assert 0 < numbers[at] and distances[at] < distances[-1]
    for dtype in (np.uint64, np.int64):
        further, _ = tracer.cone_hits(*cone, after=(distances[at], dtype(2**32)))
        np.testing.assert_array_equal(further[further >= 0], numbers[(distances > distances[at]) & (numbers >= 0)])
    further, _ = tracer.cone_hits(*cone, after=(distances[at], -(2**32)))
    np.testing.assert_array_equal(further[further >= 0], numbers[(distances >= distances[at]) & (numbers >= 0)])


def test_half_angle_zero_is_the_ray(any_device: str) -> None:
    rng = np.random.default_rng(522)
    mesh = geometry.integer_soup(rng, 80)
    tracer = _tracer(any_device, mesh)
    points = rng.integers(-4, 5, (300, 3)).astype(np.float64)
    axis = np.array([1.0, 2.0, -3.0])
    numbers, distances = tracer.cone_hits(points, axis, 0.0, 80)
    hidden = tracer.occluded(points, DirectionalLight("sun", -axis))
    np.testing.assert_array_equal(numbers[:, 0] >= 0, hidden)
    assert 20 < hidden.sum() < 290
    for number in range(80):
        alone = _tracer(any_device, (mesh[0], mesh[1][number : number + 1])) if number < 5 else None
        if alone is not None:
            expected = alone.occluded(points, DirectionalLight("sun", -axis))
            np.testing.assert_array_equal((numbers == number).any(axis=1), expected)
    assert (distances[numbers >= 0] >= 0).all()


def test_numbers_are_those_of_the_scene(any_device: str) -> None:
    """Also where meshes lie elsewhere on the device than in the scene: counted as ``render_depth`` does."""
    tracer = _tracer(any_device, geometry.icosphere(1), geometry.icosphere(2, 0.5, (0, 0, 3)), geometry.icosphere(0))
    tracer.cone_hits((0, 0, 0), (0, 0, 1), 0.1)
    tracer.scene.remove("mesh 0")
    tracer.scene.put("late", *geometry.icosphere(0, 0.3, (2, 0, 3)))
    camera = Camera(16, 12, 20.0, 20.0, 7.5, 5.5)
    depth, seen = render_depth(tracer.scene, camera)
    row, column = np.nonzero(seen >= 0)
    way = np.stack([(column - 7.5) / 20.0, (row - 5.5) / 20.0, np.ones(len(row))], axis=1)
    numbers, distances = tracer.cone_hits((0, 0, 0), way, 0.0, 1)
    np.testing.assert_array_equal(numbers[:, 0], seen[row, column])
    np.testing.assert_allclose(distances[:, 0], depth[row, column] * np.sqrt((way * way).sum(axis=1)), rtol=1e-5)
    assert len(row) > 50


@pytest.mark.parametrize("far", [1e3, 1e7, 1e12])
def test_far_from_the_origin_and_from_the_scene(any_device: str, far: float) -> None:
    vertices, triangles = geometry.icosphere(1)
    shift = np.array([far, 0.25 * far, -far])
    tracer = _tracer(any_device, (vertices + shift, triangles))
    placed = np.array([mesh.vertices for mesh in tracer.scene])[0]
    numbers, distances = tracer.cone_hits(shift + [0, 0, 3], (0, 0, -1), 0.2, 80)
    expected = cones.entry(placed[triangles], shift + [0, 0, 3], np.array([0.0, 0.0, -1.0]), np.tan(0.2))
    assert set(numbers[numbers >= 0]) == set(np.flatnonzero(np.isfinite(expected)))
    numbers, distances = tracer.cone_hits((0, 0, 0), shift, 1e-3, 80)  # from as far as that
    assert (numbers >= 0).sum() == 80 and np.isfinite(distances).all()
    assert tracer.cones((0, 0, 0), shift * 2, half_angle=1e-3) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"apex": 1.0}, "apex: expected real numbers of shape"),
        ({"axis": (0, 0, 0)}, "axis: expected directions"),
        ({"half_angle": -0.1}, "half_angle: expected"),
        ({"n": 0}, "n: expected an integer from 1"),
        ({"n": 5000}, "n: expected an integer from 1"),
        ({"n": True}, "n: expected an integer from 1"),
        ({"after": 1.0}, "after: expected"),
        ({"after": (np.nan, 1)}, "after: expected distances that are not NaN"),
        ({"after": (1.0, 1.5)}, "after: expected distances that are not NaN"),
        ({"after": (np.zeros(3), np.zeros(3, int))}, "after: expected shape"),
    ],
)
def test_what_is_refused(any_device: str, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        _tracer(any_device).cone_hits(**{"apex": (0, 0, 0), "axis": (0, 0, 1), "half_angle": 0.1, **arguments})
