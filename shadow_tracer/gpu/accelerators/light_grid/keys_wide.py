# SPDX-License-Identifier: Apache-2.0
"""Frustum, extents and keys of rays, sixteen at a time, for the CPU."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.light_grid.tiles import Tiles
from shadow_tracer.gpu.exact.decision import SIXTEEN

# U, V, W, Z of the 16 rays from `base` on, and which of them are in tiles; lanes behind the last sample repeat it.
_SIXTEEN_RAYS = (
    SIXTEEN
    + r"""
    Sixteen U, V, W, Z;
    SixteenInts in;
    const wp::uint8* group_of = group.data + (size_t)place * tiles.samples;
    const wp::vec4* ray_of = rays.data + (size_t)place * tiles.samples;
    auto larger = [](Sixteen x, Sixteen y) -> Sixteen { return x > y ? x : y; };
    auto smaller = [](Sixteen x, Sixteen y) -> Sixteen { return x < y ? x : y; };
    auto size_of = [&](Sixteen x) -> Sixteen { return larger(x, -x); };
    typedef unsigned char SixteenBytes __attribute__((ext_vector_type(16), aligned(1)));
    auto equal = [&](const wp::uint8* from, int n, unsigned char value) -> SixteenInts {
        unsigned char some[16];
        if (n < 16)
            for (int j = 0; j < 16; ++j)
                some[j] = j < n ? from[j] : 255;
        return __builtin_convertvector(*(const SixteenBytes*)(n < 16 ? some : from) == value, SixteenInts);
    };
    auto look = [&](int base) -> bool {
        const int n = tiles.samples - base < 16 ? tiles.samples - base : 16;
        in = equal(group_of + base, n, 1);
        if (bits(in) == 0)
            return false;
        wp::vec4 some[16];
        if (n < 16)
            for (int j = 0; j < 16; ++j)
                some[j] = ray_of[base + (j < n ? j : n - 1)];
        const Sixteen* four = (const Sixteen*)(n < 16 ? some : ray_of + base);
#define SHADOW_TRACER_LANE(k)                                                                                          \
    __builtin_shufflevector(__builtin_shufflevector(four[0], four[1], k, k + 4, k + 8, k + 12, k + 16, k + 20, k + 24, \
                                                    k + 28),                                                           \
                            __builtin_shufflevector(four[2], four[3], k, k + 4, k + 8, k + 12, k + 16, k + 20, k + 24, \
                                                    k + 28),                                                           \
                            0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)
        U = SHADOW_TRACER_LANE(0);
        V = SHADOW_TRACER_LANE(1);
        W = SHADOW_TRACER_LANE(2);
        Z = SHADOW_TRACER_LANE(3);
#undef SHADOW_TRACER_LANE
        return true;
    };
"""
)

_MEASURE = (
    _SIXTEEN_RAYS
    + r"""
    const Sixteen most = 1.0e30f;
    Sixteen u0 = most, u1 = -most, v0 = most, v1 = -most, farthest = -most, deepest = most;
    bool aligned = true;
    int some = 0;
    for (int base = 0; base < tiles.samples && aligned; base += 16) {
        if (!look(base))
            continue;
        some = 1;
        aligned = bits(in & ~((W > 0.0f) & (size_of(U) <= 2.0f * W) & (size_of(V) <= 2.0f * W))) == 0;
        const Sixteen inverse = 1.0f / W, u = U * inverse, v = V * inverse;
        u0 = in ? smaller(u0, u) : u0;
        u1 = in ? larger(u1, u) : u1;
        v0 = in ? smaller(v0, v) : v0;
        v1 = in ? larger(v1, v) : v1;
        const Sixteen pad = 0x1p-20f * (size_of(U) + size_of(V) + W + size_of(Z));
        farthest = in ? larger(farthest, W + pad) : farthest;
        deepest = in ? smaller(deepest, Z - pad) : deepest;
    }
    wp::vec4* fit = tiles.fit.data + 6 * place;
    auto note = [&](int face, Sixteen a0, Sixteen a1, Sixteen b0, Sixteen b1, Sixteen axis, Sixteen z) {
        float low_u = 2.0f, high_u = -2.0f, low_v = 2.0f, high_v = -2.0f, far = -3.0e38f, deep = 3.0e38f;
        for (int j = 0; j < 16; ++j) {
            low_u = a0[j] < low_u ? a0[j] : low_u;
            high_u = a1[j] > high_u ? a1[j] : high_u;
            low_v = b0[j] < low_v ? b0[j] : low_v;
            high_v = b1[j] > high_v ? b1[j] : high_v;
            far = axis[j] > far ? axis[j] : far;
            deep = z[j] < deep ? z[j] : deep;
        }
        tiles.far.data[6 * place + face] = wp::vec2(far + 0x1p-40f, deep - 0x1p-40f);
        const float wide = high_u - low_u, high = high_v - low_v;
        fit[face] = low_u > high_u ? wp::vec4(0.0f, 0.0f, 0.0f, 0.0f)
                                   : wp::vec4(low_u, low_v, 4096.0f / (wide > 1.0e-12f ? wide : 1.0e-12f),
                                              4096.0f / (high > 1.0e-12f ? high : 1.0e-12f));
    };
    tiles.aligned.data[place] = aligned;
    if (aligned) {
        for (int face = 0; face < 6; ++face)
            fit[face] = wp::vec4(0.0f, 0.0f, 0.0f, 0.0f);
        if (some)
            note(4, u0, u1, v0, v1, farthest, deepest);
        return;
    }
    Sixteen low_u[6], high_u[6], low_v[6], high_v[6], far_of[6], deep_of[6];
    for (int face = 0; face < 6; ++face) {
        low_u[face] = low_v[face] = deep_of[face] = most;
        high_u[face] = high_v[face] = far_of[face] = -most;
    }
    for (int base = 0; base < tiles.samples; base += 16) {
        if (!look(base))
            continue;
        const Sixteen sizes[3] = { size_of(U), size_of(V), size_of(W) };
        const SixteenInts on_u = (sizes[0] >= sizes[1]) & (sizes[0] >= sizes[2]), on_v = ~on_u & (sizes[1] >= sizes[2]);
        const SixteenInts on[3] = { on_u, on_v, ~(on_u | on_v) };
        const Sixteen at[3] = { U, V, W };
        const Sixteen pad = 0x1p-20f * (sizes[0] + sizes[1] + sizes[2] + size_of(Z));
        for (int axis = 0; axis < 3; ++axis) {
            if (bits(on[axis] & in) == 0)
                continue;
            const Sixteen inverse = 1.0f / sizes[axis];
            const Sixteen u = at[(axis + 1) % 3] * inverse, v = at[(axis + 2) % 3] * inverse;
            for (int side = 0; side < 2; ++side) {
                const SixteenInts take = in & on[axis] & (side ? at[axis] < 0.0f : at[axis] >= 0.0f);
                const int face = 2 * axis + side;
                low_u[face] = take ? smaller(low_u[face], u) : low_u[face];
                high_u[face] = take ? larger(high_u[face], u) : high_u[face];
                low_v[face] = take ? smaller(low_v[face], v) : low_v[face];
                high_v[face] = take ? larger(high_v[face], v) : high_v[face];
                far_of[face] = take ? larger(far_of[face], sizes[axis] + pad) : far_of[face];
                deep_of[face] = take ? smaller(deep_of[face], Z - pad) : deep_of[face];
            }
        }
    }
    for (int face = 0; face < 6; ++face)
        note(face, low_u[face], high_u[face], low_v[face], high_v[face], far_of[face], deep_of[face]);
"""
)

# Cells of u (11 bits, behind the group) are counted for the columns' sake, cells of v are kept in ten.
_KEYS = (
    _SIXTEEN_RAYS
    + r"""
    int found = first;
    const bool aligned = tiles.aligned.data[place] != 0;
    const wp::vec4* fit = tiles.fit.data + 6 * place;
    const wp::uint8* state = states.data + (size_t)place * tiles.samples;
    int* count_of = cells.data;
    Sixteen low_u = fit[4][0], low_v = fit[4][1], scale_u = fit[4][2], scale_v = fit[4][3];
    SixteenInts face = 4;
    for (int base = 0; base < tiles.samples; base += 16) {
        if (!look(base))
            continue;
        Sixteen u, v;
        if (aligned) {
            const Sixteen inverse = 1.0f / W;
            u = U * inverse;
            v = V * inverse;
        } else {
            const Sixteen x = size_of(U), y = size_of(V), z = size_of(W);
            const SixteenInts on_u = (x >= y) & (x >= z), on_v = ~on_u & (y >= z);
            const Sixteen major = on_u ? U : on_v ? V : W, inverse = 1.0f / size_of(major);
            const SixteenInts below = major < 0.0f, zero = 0;
            u = (on_u ? V : on_v ? W : U) * inverse;
            v = (on_u ? W : on_v ? U : V) * inverse;
            face = (on_u ? zero : on_v ? zero + 2 : zero + 4) - below;
            auto pick = [&](int k) -> Sixteen {
                Sixteen above, under;
                above = on_u ? Sixteen(fit[0][k]) : on_v ? Sixteen(fit[2][k]) : Sixteen(fit[4][k]);
                under = on_u ? Sixteen(fit[1][k]) : on_v ? Sixteen(fit[3][k]) : Sixteen(fit[5][k]);
                return below ? under : above;
            };
            low_u = pick(0), low_v = pick(1), scale_u = pick(2), scale_v = pick(3);
        }
        const Sixteen none = 0.0f, last = 4095.0f;
        const SixteenInts x = __builtin_convertvector(smaller(larger((u - low_u) * scale_u, none), last), SixteenInts);
        const SixteenInts y = __builtin_convertvector(smaller(larger((v - low_v) * scale_v, none), last), SixteenInts);
        const SixteenInts key = ((6 * place + face) << 21) | ((x >> 1) << 10) | (y >> 2);
        const int n = tiles.samples - base < 16 ? tiles.samples - base : 16;
        const int from = place * tiles.samples + base;
        int code[16];
        memcpy(code, &key, 64);
        for (int take = bits(in & ~equal(state + base, n, 1)); take; take &= take - 1) {
            const int j = __builtin_ctz(take);
            keys.data[found] = code[j];
            order.data[found++] = from + j;
            ++count_of[code[j] >> 10];
        }
    }
    return found;
"""
)


@wp.func_native("#if !defined(__CUDA_ARCH__)\n" + _MEASURE + "\n#endif\n")
def measure(place: int, rays: wp.array(dtype=wp.vec4), group: wp.array(dtype=wp.uint8), tiles: Tiles):
    """Frustum and extents of the rays of the light at ``place``."""
    ...


@wp.func_native("#if !defined(__CUDA_ARCH__)\n" + _KEYS + "\n#else\nreturn 0;\n#endif\n")
def write_keys(
    place: int,
    first: int,
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    group: wp.array(dtype=wp.uint8),
    tiles: Tiles,
    cells: wp.array(dtype=int),
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
) -> int:
    """Keys and numbers of the light's rays that are in tiles and not known to be in shadow, to be stored from ``first``
    on; returns the end."""
    ...
