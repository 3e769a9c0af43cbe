# SPDX-License-Identifier: Apache-2.0
"""The signs of determinants are those of rational arithmetic."""

from fractions import Fraction

import numpy as np
import pytest

wp = pytest.importorskip("warp")

from shadow_tracer.gpu.exact.determinant import determinant_sign  # noqa: E402


@wp.kernel(enable_backward=False)
def signs(
    q: wp.array(dtype=wp.vec4d),
    r: wp.array(dtype=wp.vec3d),
    s: wp.array(dtype=wp.vec3d),
    o: wp.array(dtype=wp.vec3d),
    out: wp.array(dtype=int),
):
    i = wp.tid()
    out[i] = determinant_sign(q[i], r[i], s[i], o[i])


def device_signs(device, q, r, s, o):
    out = wp.zeros(len(q), dtype=int, device=device)
    arrays = [wp.array(q, dtype=wp.vec4d, device=device)] + [
        wp.array(v, dtype=wp.vec3d, device=device) for v in (r, s, o)
    ]
    wp.launch(signs, dim=len(q), inputs=[*arrays, out], device=device)
    return out.numpy()


def rational_sign(q, r, s, o):
    q, r, s, o = ([Fraction(float(x)) for x in v] for v in (q, r, s, o))
    a = [q[k] - q[3] * o[k] for k in range(3)]
    b = [r[k] - o[k] for k in range(3)]
    c = [s[k] - o[k] for k in range(3)]
    det = sum(a[i] * (b[(i + 1) % 3] * c[(i + 2) % 3] - b[(i + 2) % 3] * c[(i + 1) % 3]) for i in range(3))
    return (det > 0) - (det < 0)


def nearly_coplanar(rng, n):
    """Four points that are coplanar up to the rounding of their coordinates, some of the first at infinity."""
    o = rng.normal(size=(n, 3)) * 10.0 ** rng.integers(-8, 8, (n, 1))
    r = o + rng.normal(size=(n, 3)) * 10.0 ** rng.integers(-8, 8, (n, 1))
    s = o + rng.normal(size=(n, 3))
    u = rng.normal(size=(n, 2))
    offset = u[:, :1] * (r - o) + u[:, 1:] * (s - o)
    w = (rng.random(n) < 0.7).astype(float)
    q = np.column_stack([np.where(w[:, None] == 1.0, o + offset, offset), w])
    return q, r, s, o


def integer_grid(rng, n):
    points = rng.integers(-4, 5, (n, 4, 3)).astype(float)
    return np.column_stack([points[:, 0], np.ones(n)]), points[:, 1], points[:, 2], points[:, 3]


def wild_exponents(rng, n):
    points = rng.normal(size=(n, 4, 3)) * 10.0 ** rng.integers(-55, 55, (n, 4, 3))
    points[: n // 2, 1] = points[: n // 2, 2] * (1 + 2.0**-50)
    return np.column_stack([points[:, 0], np.ones(n)]), points[:, 1], points[:, 2], points[:, 3]


@pytest.mark.parametrize("make", [nearly_coplanar, integer_grid, wild_exponents])
def test_signs_are_those_of_rational_arithmetic(make):
    points = make(np.random.default_rng(1), 3000)
    expected = np.array([rational_sign(*row) for row in zip(*points, strict=True)])
    if make is integer_grid:
        assert (expected == 0).sum() > 100  # ties are really there
    wp.init()
    for device in wp.get_devices():
        np.testing.assert_array_equal(device_signs(device, *points), expected, err_msg=str(device))
