# SPDX-License-Identifier: Apache-2.0
"""Exact signs of 3x3 determinants of coordinate differences: the arithmetic under the shadow test.

Every question the shadow test asks is the sign of ``det[q - w*o, r - o, s - o]`` for points given in float64 (w is 0
for a point at infinity, else 1). It is answered in two tiers:

1. plain float64 with a forward error bound; nearly all calls end here;
2. expansion arithmetic (unevaluated sums of float64): the differences, the products and their sum are kept without any
   rounding, so the sign is that of the real number.

So the answer is a mathematical function of the inputs: it does not depend on the order of the corners, on the winding,
on fused multiply-add, on the device or the compiler. The tiers and the primitives (two-sum, two-product,
grow-expansion, compress) follow Shewchuk, "Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric
Predicates", 1997; ``docs/exactness.md`` has the error bound of tier 1 and the range of validity (no overflow or
underflow: magnitudes of coordinates and of their non-zero differences between 1e-60 and 1e60).

The code is C++ (``arithmetic.h``, ``determinant.h``) because contraction of ``a*b + c`` must be off here, whatever the
module's options are: Clang is told by a pragma, CUDA by the ``_rn`` intrinsics, which are never contracted.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.device import native

# Room for the expansion. Components do not overlap and compress() packs them, so n components cover at least (n - 2) *
# 53 bits; the domain above spans fewer than 1600 bits.
_CAPACITY = 64

ARITHMETIC = r"""
#if defined(__clang__)
#pragma clang fp contract(off)
#endif
#if defined(__CUDA_ARCH__)
    auto add = [](double x, double y) { return __dadd_rn(x, y); };
    auto sub = [](double x, double y) { return __dadd_rn(x, -y); };
    auto mul = [](double x, double y) { return __dmul_rn(x, y); };
#else
    auto add = [](double x, double y) { return x + y; };
    auto sub = [](double x, double y) { return x - y; };
    auto mul = [](double x, double y) { return x * y; };
#endif
    auto absolute = [](double x) { return x < 0.0 ? -x : x; };
    auto norm = [&](double x, double y, double z) { return sqrt(add(add(mul(x, x), mul(y, y)), mul(z, z))); };
"""

_DETERMINANT = (
    r"""
    // two_sum: s + e == x + y exactly
    auto two_sum = [&](double x, double y, double& s, double& e) {
        s = add(x, y);
        double t = sub(s, x);
        e = add(sub(x, sub(s, t)), sub(y, t));
    };
    // two_product: p + e == x * y exactly
    auto two_product = [&](double x, double y, double& p, double& e) {
        p = mul(x, y);
#if defined(__CUDA_ARCH__)
        e = __fma_rn(x, y, -p);
#else
        double c = mul(134217729.0, x);
        double xh = sub(c, sub(c, x));
        double xl = sub(x, xh);
        c = mul(134217729.0, y);
        double yh = sub(c, sub(c, y));
        double yl = sub(y, yh);
        e = sub(mul(xl, yl), sub(sub(sub(p, mul(xh, yh)), mul(xl, yh)), mul(xh, yl)));
#endif
    };
    // Sign of det[q - w*o, r - o, s - o]; value is its float64 approximation, exact_used counts calls of tier 2.
    int exact_used = 0;
    using wp::vec3d;
    auto determinant = [&](const wp::vec4d& q, const vec3d& r, const vec3d& s, const vec3d& o, double& value) -> int {
        double m[3][3];
        for (int k = 0; k < 3; ++k) {
            m[0][k] = q[3] != 0.0 ? sub(q[k], o[k]) : q[k];
            m[1][k] = sub(r[k], o[k]);
            m[2][k] = sub(s[k], o[k]);
        }
        double permanent = 0.0;
        value = 0.0;
        for (int k = 0; k < 3; ++k) {
            int i = (k + 1) % 3, j = (k + 2) % 3;
            double ij = mul(m[1][i], m[2][j]), ji = mul(m[1][j], m[2][i]);
            value = add(value, mul(m[0][k], sub(ij, ji)));
            permanent = add(permanent, mul(absolute(m[0][k]), add(absolute(ij), absolute(ji))));
        }
        // 8 roundings per term (3 differences, 2 products, 1 subtraction, 2 additions) are 8.9e-16 of the permanent.
        if (absolute(value) > 1.0e-15 * permanent)
            return value > 0.0 ? 1 : -1;
        if (permanent == 0.0)
            return 0;

        exact_used += 1;
        double tail[3][3];
        for (int k = 0; k < 3; ++k) {
            const double origin = o[k];
            double from[3] = { q[k], r[k], s[k] };
            for (int row = 0; row < 3; ++row) {
                double unused;
                if (row == 0 && q[3] == 0.0)
                    tail[row][k] = 0.0;
                else
                    two_sum(from[row], -origin, unused, tail[row][k]);
            }
        }
        double h[CAPACITY];
        int n = 0;
        auto compress = [&]() {
            double top = h[n - 1];
            int bottom = n - 1;
            for (int i = n - 2; i >= 0; --i) {
                double sum, error;
                two_sum(top, h[i], sum, error);
                if (error != 0.0) {
                    h[bottom--] = sum;
                    top = error;
                } else {
                    top = sum;
                }
            }
            h[bottom] = top;
            int count = 0;
            double carry = h[bottom];
            for (int i = bottom + 1; i < n; ++i) {
                double sum, error;
                two_sum(h[i], carry, sum, error);
                if (error != 0.0)
                    h[count++] = error;
                carry = sum;
            }
            h[count++] = carry;
            n = count;
        };
        auto grow = [&](double x) {
            if (n == CAPACITY)
                compress();
            int kept = 0;
            for (int i = 0; i < n; ++i) {
                double sum, error;
                two_sum(x, h[i], sum, error);
                if (error != 0.0)
                    h[kept++] = error;
                x = sum;
            }
            if (x != 0.0 && kept < CAPACITY)
                h[kept++] = x;
            n = kept;
        };
#pragma unroll 1
        for (int term = 0; term < 6; ++term) {
            const int first = term / 2;
            const int i = (first + 1 + term % 2) % 3, j = (first + 2 - term % 2) % 3;
#pragma unroll 1
            for (int part = 0; part < 8; ++part) {
                double x = part & 1 ? tail[0][first] : m[0][first];
                const double y = part & 2 ? tail[1][i] : m[1][i];
                const double z = part & 4 ? tail[2][j] : m[2][j];
                if (x == 0.0 || y == 0.0 || z == 0.0)
                    continue;
                if (term % 2)
                    x = -x;
                double high, low, p, e;
                two_product(x, y, high, low);
#pragma unroll 1
                for (int half = 0; half < 4; ++half) {
                    two_product(half < 2 ? high : low, z, p, e);
                    grow(half % 2 ? p : e);
                }
            }
        }
        if (n == 0)
            return 0;
        return h[n - 1] > 0.0 ? 1 : -1;
    };
"""
).replace("CAPACITY", str(_CAPACITY))

DETERMINANT = ARITHMETIC + _DETERMINANT


@wp.func_native(
    native.snippet(
        "exact/determinant.h",
        call="double value; int exact_used = 0; return Determinant::sign(q, r, s, o, value, exact_used);",
    )
)
def determinant_sign(q: wp.vec4d, r: wp.vec3d, s: wp.vec3d, o: wp.vec3d) -> int:
    """Sign (-1, 0, 1) of det[q.xyz - q.w*o, r - o, s - o] with q.w either 0 or 1, exact."""
    ...


@native.func_native("exact/arithmetic.h", calls="Arithmetic::norm")
def norm3(x: wp.float64, y: wp.float64, z: wp.float64) -> wp.float64:
    """Euclidean norm without contraction: the same bits on every device."""
    ...


@wp.func_native(
    native.snippet(
        "exact/arithmetic.h",
        call="return wp::vec3d(Arithmetic::row(row0, v), Arithmetic::row(row1, v), Arithmetic::row(row2, v));",
    )
)
def transform_point(row0: wp.vec4d, row1: wp.vec4d, row2: wp.vec4d, v: wp.vec3d) -> wp.vec3d:
    """((r0 x + r1 y) + r2 z) + t per row, without contraction: the bits of ``Mesh.world_vertices`` and
    ``Camera.unproject``."""
    ...
