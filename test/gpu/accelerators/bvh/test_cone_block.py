# SPDX-License-Identifier: Apache-2.0
"""Sixteen triangles beside a cone in float32: none is left out that meets the cone, or is before its axis, or hides all
of it, however close that is; and most others are."""

from __future__ import annotations

from typing import Any

import cones
import numpy as np
import pytest
import warp as wp

from shadow_tracer.gpu.accelerators import cone_kernels  # gives constants to the header
from shadow_tracer.gpu.accelerators.bvh.tree import LANES
from shadow_tracer.gpu.device import native

_CALL = """
ConeBlock block;
const double at[3] = { apices.data[i][0], apices.data[i][1], apices.data[i][2] };
const double axis[3] = { axes.data[i][0], axes.data[i][1], axes.data[i][2] };
block.begin(at, axis, slopes.data[i], lengths.data[i] + padding);
int through, covers;
const int met = block.possible(rows.data + 160 * (size_t)i, through, covers);
found.data[i] = wp::vec3i(met, through, covers);
"""


@wp.func_native(native.snippet("accelerators/bvh/cone_block.h", call=_CALL, cpu=True))
def judge(
    i: int,
    apices: wp.array(dtype=wp.vec3d),
    axes: wp.array(dtype=wp.vec3d),
    slopes: wp.array(dtype=wp.float64),
    lengths: wp.array(dtype=wp.float64),
    padding: float,
    rows: wp.array(dtype=float),
    found: wp.array(dtype=wp.vec3i),
): ...


@wp.kernel(enable_backward=False, module="unique")
def judge_all(
    apices: wp.array(dtype=wp.vec3d),
    axes: wp.array(dtype=wp.vec3d),
    slopes: wp.array(dtype=wp.float64),
    lengths: wp.array(dtype=wp.float64),
    padding: float,
    rows: wp.array(dtype=float),
    found: wp.array(dtype=wp.vec3i),
):
    judge(wp.tid(), apices, axes, slopes, lengths, padding, rows, found)


def _judge(apices: Any, axes: Any, slopes: Any, lengths: Any, corners: np.ndarray) -> np.ndarray:
    """(3, N, 16) whether each of (N, 16, 3, 3) triangles in units of the extent may meet its cone, be before its axis,
    and hide all of it."""
    rows = np.zeros((len(corners), 10, LANES), np.float32)
    one, two = corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]
    for place, vectors in enumerate((corners[:, :, 0], one, two)):
        rows[:, 3 * place : 3 * place + 3] = vectors.transpose(0, 2, 1)
    sizes = np.stack([np.abs(edge).sum(axis=-1) for edge in (one, two, two - one)]).max(axis=0)
    assert cone_kernels.NO_BUDGET and (sizes >= 0.0).all()
    rows[:, 9] = 1.000001 * np.maximum(sizes, 1e-20)
    vectors = [wp.array(np.ascontiguousarray(each), dtype=wp.vec3d, device="cpu") for each in (apices, axes)]
    numbers = [wp.array(each, dtype=wp.float64, device="cpu") for each in (slopes, lengths)]
    found = wp.zeros(len(corners), dtype=wp.vec3i, device="cpu")
    given = wp.array(rows.reshape(-1), dtype=float, device="cpu")
    wp.launch(judge_all, dim=len(corners), inputs=[*vectors, *numbers, 2.0**-19, given, found], device="cpu")
    bits = found.numpy().T[:, :, None] >> np.arange(LANES) & 1
    return bits.astype(bool)


def _cones(rng: np.random.Generator, count: int) -> tuple[np.ndarray, ...]:
    """Apices, axes, slopes and lengths, of cones from slivers to wide ones."""
    apices = rng.uniform(-1.2, 1.2, (count, 3))
    axes = cones.unit(rng.normal(size=(count, 3)))
    axes[::5] = np.eye(3)[rng.integers(0, 3, len(axes[::5]))]
    slopes = 10.0 ** rng.uniform(-5.0, 0.7, count)
    slopes[::9] = 0.0
    return apices, axes, slopes, 10.0 ** rng.uniform(-2.0, 0.8, count)


def _triangles(rng: np.random.Generator, apices: np.ndarray, axes: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Around the mantles of cones, of all sizes, some flat along an axis, in a plane near the apex, or far away."""
    count = len(apices)
    along = rng.uniform(-0.1, 1.0, (count, LANES))
    beside = cones.unit(rng.normal(size=(count, LANES, 3)))
    middle = apices[:, None] + along[..., None] * axes[:, None]
    middle += (along * slopes[:, None] * rng.uniform(0.0, 1.5, (count, LANES)))[..., None] * beside
    size = 10.0 ** rng.uniform(-6.0, 0.0, (count, LANES, 1, 1))
    corners = middle[:, :, None] + size * rng.normal(size=(count, LANES, 3, 3))
    corners[:, 3, :, 0] = corners[:, 3, :1, 0]
    corners[:, 4, :, 1] = apices[:, None, 1] + 10.0 ** rng.uniform(-9, -4, (count, 1))
    corners[:, 5] = rng.uniform(-1.0, 1.0, (count, 3, 3))
    corners[:, 6, 2] = 0.5 * (corners[:, 6, 0] + corners[:, 6, 1])
    return np.clip(corners, -1.0, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_none_that_matters_is_left_out(seed: int) -> None:
    rng = np.random.default_rng(700 + seed)
    apices, axes, slopes, lengths = _cones(rng, 100)
    corners = _triangles(rng, apices, axes, slopes)
    met, through, covers = (bits.reshape(-1) for bits in _judge(apices, axes, slopes, lengths, corners))
    given = [np.repeat(each, LANES, axis=0) for each in (apices, apices + axes * lengths[:, None], slopes)]
    flat = corners.reshape(-1, 3, 3)
    outside = cones.excess(flat, *given)
    touching = outside < -1e-12
    assert met[touching].all() and touching.sum() > 150
    apart = outside > 1e-3
    assert (~met[apart]).mean() > 0.9 and apart.sum() > 50
    # The axis, and rays at the rim of the end, of which a triangle that hides all hides each.
    hides = np.ones(len(flat), bool)
    for number, ends in enumerate(cones.ends_of_rays(*given[:2], np.repeat(slopes * lengths, LANES), 9).swapaxes(0, 1)):
        hit = _hit(flat, given[0], given[1] if number == 0 else ends)
        if number == 0:
            assert through[hit].all() and hit.sum() > 15
            assert (~through[met & ~hit]).mean() > 0.5
        hides &= hit
    assert hides.sum() > 5
    assert covers[hides & _covered(flat, *given)].all()
    assert (covers <= through).all() and (through <= met).all()


def _volumes(corners: np.ndarray, apices: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """(3, N) on which side of the planes through an apex and the edges of triangles ends are."""
    from_apex, ways = corners - apices[:, None], ends - apices
    return np.stack([(np.cross(from_apex[:, k], from_apex[:, (k + 1) % 3]) * ways).sum(axis=1) for k in range(3)])


def _hit(corners: np.ndarray, apices: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Whether triangles are between apices and ends, but for roundings certainly."""
    sides = _volumes(corners, apices, ends)
    inside = (sides > 1e-15).all(axis=0) | (sides < -1e-15).all(axis=0)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    near = (normals * (corners[:, 0] - apices)).sum(axis=1)
    far = (normals * (corners[:, 0] - ends)).sum(axis=1)
    return inside & (near * far < 0.0) & (np.minimum(np.abs(near), np.abs(far)) > 1e-15)


def _covered(corners: np.ndarray, apices: np.ndarray, ends: np.ndarray, slopes: np.ndarray) -> np.ndarray:
    """Whether all of a cone is certainly inside of the planes through apex and edges."""
    from_apex, axes = corners - apices[:, None], cones.unit(ends - apices)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sign = np.sign((normal * from_apex[:, 0]).sum(axis=1))
    inside = np.ones(len(corners), bool)
    for k in range(3):
        plane = sign[:, None] * np.cross(from_apex[:, k], from_apex[:, (k + 1) % 3])
        along = (plane * axes).sum(axis=1)
        across = np.linalg.norm(plane - along[:, None] * axes, axis=1)
        inside &= along - slopes * across > 1e-13
    return inside


def test_what_is_nothing_is_left_out() -> None:
    """Lanes without a triangle, whatever else they have."""
    corners = np.tile(np.array([(-1.0, -1.0, 0.5), (1.0, -1.0, 0.5), (0.0, 1.0, 0.5)]), (1, LANES, 1, 1))
    given = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), np.array([0.1]), np.array([1.0])
    assert _judge(*given, corners).all()
    rows = np.zeros((10, LANES), np.float32)
    rows[9] = -1.0
    arrays = [wp.array(each, dtype=wp.vec3d, device="cpu") for each in given[:2]]
    arrays += [wp.array(each, dtype=wp.float64, device="cpu") for each in given[2:]]
    found = wp.zeros(1, dtype=wp.vec3i, device="cpu")
    given_rows = wp.array(rows.reshape(-1), dtype=float, device="cpu")
    wp.launch(judge_all, dim=1, inputs=[*arrays, 0.0, given_rows, found], device="cpu")
    assert found.numpy().tolist() == [[0, 0, 0]]
