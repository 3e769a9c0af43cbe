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
module's options are: a pragma says so to Clang, and on CUDA the ``_rn`` intrinsics are never contracted.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.device import native


@wp.func_native(
    native.snippet(
        "exact/determinant.h",
        call="double value; int exact_used = 0; return Determinant::sign(q, r, s, o, value, exact_used);",
    )
)
def determinant_sign(q: wp.vec4d, r: wp.vec3d, s: wp.vec3d, o: wp.vec3d) -> int:
    """Sign (-1, 0, 1) of det[q.xyz - q.w*o, r - o, s - o] with q.w either 0 or 1, exact."""
    ...
