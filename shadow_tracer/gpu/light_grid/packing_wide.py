# SPDX-License-Identifier: Apache-2.0
"""Packs the rays of a pass into tiles, sixteen at a time, for the CPU. ``packing.py`` does the same on CUDA."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.light_frame import LightFrame
from shadow_tracer.gpu.light_grid.tiles import (
    ALL_BLOCKS,
    ALL_COLUMNS,
    ALL_RAYS,
    BLOCK_RAYS,
    COLUMNS_OF,
    FIRST_BLOCK,
    FIRST_COLUMN,
    FIRST_RAY,
    LENGTH,
    RAYS_OF,
    U_CELLS,
    Tiles,
    lay_out,
    make_lookup,
    no_column,
)
from shadow_tracer.gpu.light_space import FACES
from shadow_tracer.gpu.shadow_test import SIXTEEN

# U, V, W of the 16 rays from `base` on, and which of them are in tiles; lanes behind the last sample repeat it.
_SIXTEEN_RAYS = (
    SIXTEEN
    + r"""
    Sixteen U, V, W;
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
#undef SHADOW_TRACER_LANE
        return true;
    };
"""
)

_MEASURE = (
    _SIXTEEN_RAYS
    + r"""
    const Sixteen most = 1.0e30f;
    Sixteen u0 = most, u1 = -most, v0 = most, v1 = -most;
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
    }
    wp::vec4* fit = tiles.fit.data + 6 * place;
    auto note = [&](int face, Sixteen a0, Sixteen a1, Sixteen b0, Sixteen b1) {
        float low_u = 2.0f, high_u = -2.0f, low_v = 2.0f, high_v = -2.0f;
        for (int j = 0; j < 16; ++j) {
            low_u = a0[j] < low_u ? a0[j] : low_u;
            high_u = a1[j] > high_u ? a1[j] : high_u;
            low_v = b0[j] < low_v ? b0[j] : low_v;
            high_v = b1[j] > high_v ? b1[j] : high_v;
        }
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
            note(4, u0, u1, v0, v1);
        return;
    }
    Sixteen low_u[6], high_u[6], low_v[6], high_v[6];
    for (int face = 0; face < 6; ++face)
        low_u[face] = low_v[face] = most, high_u[face] = high_v[face] = -most;
    for (int base = 0; base < tiles.samples; base += 16) {
        if (!look(base))
            continue;
        const Sixteen sizes[3] = { size_of(U), size_of(V), size_of(W) };
        const SixteenInts on_u = (sizes[0] >= sizes[1]) & (sizes[0] >= sizes[2]), on_v = ~on_u & (sizes[1] >= sizes[2]);
        const SixteenInts on[3] = { on_u, on_v, ~(on_u | on_v) };
        const Sixteen at[3] = { U, V, W };
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
            }
        }
    }
    for (int face = 0; face < 6; ++face)
        note(face, low_u[face], high_u[face], low_v[face], high_v[face]);
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


# Rays to their columns: ray number k in the order of (group, cell of u), and of the image within a cell, goes to column
# k / length of its group. ``cells`` holds the number of rays in each cell, ``next`` has a place per column.
@wp.func_native(
    r"""
    // First the cells' counts become the first ray of each, from the start of its group on; then a ray's place among all
    // of its group says the column, and where the column's next free place is says where it goes.
    const int groups = 6 * tiles.lights;
    for (int number = 0; number < groups; ++number) {
        int sum = 0;
        for (int k = 2048 * number; k < 2048 * (number + 1); ++k) {
            const int here = cells.data[k];
            cells.data[k] = sum;
            sum += here;
        }
    }
    const int* of = tiles.groups.data;
    int* free = next.data;
    for (int number = 0; number < groups; ++number)
        for (int k = 0; k < of[6 * number + 4]; ++k)
            free[of[6 * number + 3] + k] = of[6 * number] + k * of[6 * number + 2];
    for (int i = 0; i < count; ++i) {
        const int key = keys.data[i], number = key >> 21;
        const int rank = cells.data[key >> 10]++;
        const int column = of[6 * number + 3] + (rank >> 9) / (of[6 * number + 2] >> 9);
        const int to = free[column]++;
        keys.data[count + to] = key & 1023;
        order.data[count + to] = order.data[i];
    }
    """
)
def to_columns(
    count: int,
    tiles: Tiles,
    cells: wp.array(dtype=int),
    next: wp.array(dtype=int),
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
):
    """Bring the rays of each column together, behind the first ``count`` elements of ``keys`` (then the cell of v) and
    ``order``."""
    ...


# Minima are found by halving: a running minimum would have to be taken in order.
_COLUMN = (
    SIXTEEN
    + r"""
    const int face = number % 6, axis = face >> 1, first = (axis + 1) % 3, second = (axis + 2) % 3;
    const bool inverse_mode = (float)frame.w_constant < 1.0f;
    const int n = end - begin, blocks = (n + 511) / 512;
    const int* cell = keys.data + begin;
    const int* ray_of = order.data + begin;
    int next[1024];
    for (int j = 0; j < 1024; ++j)
        next[j] = 0;
    for (int i = 0; i < n; ++i)
        ++next[cell[i]];
    int sum = 0;
    for (int j = 0; j < 1024; ++j) {
        const int here = next[j];
        next[j] = sum;
        sum += here;
    }
    int* sorted = tiles.order.data + 512 * (size_t)first_block;
    for (int i = 0; i < n; ++i)
        sorted[next[cell[i]]++] = ray_of[i];
    // Lanes without a ray repeat the first of their tile, and are not live.
    for (int i = n; i < 512 * blocks; ++i)
        sorted[i] = sorted[i / 32 * 32 < n ? i / 32 * 32 : 0];
    typedef float Bounds[6];
    auto nothing = [](float* bound) {
        for (int q = 0; q < 6; ++q)
            bound[q] = q & 1 ? -3.0e38f : 3.0e38f;
    };
    auto join = [](float* bound, const float* other) {
        for (int q = 0; q < 6; q += 2) {
            bound[q] = other[q] < bound[q] ? other[q] : bound[q];
            bound[q + 1] = other[q + 1] > bound[q + 1] ? other[q + 1] : bound[q + 1];
        }
    };
    auto store = [](float* box, const float* bound) {
        const bool some = bound[0] <= bound[1];
        for (int q = 0; q < 2; ++q) {
            box[16 * q] = some ? 0.5f * (bound[2 * q] + bound[2 * q + 1]) : 0.0f;
            box[16 * (2 + q)] = some ? 0.5f * (bound[2 * q + 1] - bound[2 * q]) + 0x1p-20f : -1.0e30f;
        }
        box[64] = some ? bound[4] - 0x1p-21f * fabsf(bound[4]) : 0.0f;
        box[80] = some ? bound[5] + 0x1p-21f * fabsf(bound[5]) : 0.0f;
    };
    Bounds whole;
    nothing(whole);
    for (int b = 0; b < 16; ++b) {
        Bounds block;
        nothing(block);
        for (int k = 0; b < blocks && k < 16; ++k) {
            const int tile = 16 * (first_block + b) + k, start = 512 * b + 32 * k;
            const int used = n - start < 32 ? n - start : 32;
            Bounds bound;
            nothing(bound);
            tiles.live.data[tile] = used > 0 ? (int)(0xFFFFFFFFu >> (32 - used)) : 0;
            tiles.covered.data[tile] = 0;
            if (used > 0) {
                float* out = tiles.rays.data + 160 * (size_t)tile;
                for (int j = 0; j < 32 && start + 64 + j < n; ++j)
                    __builtin_prefetch(rays.data + sorted[start + 64 + j]);
                float least[3][16], most[3][16];
                for (int half = 0; half < 2; ++half) {
                    float* lane = out + 80 * half;
                    float *U = lane, *V = lane + 16, *W = lane + 32, *Z = lane + 48, *M = lane + 64;
                    for (int j = 0; j < 16; ++j) {
                        const wp::vec4 ray = rays.data[sorted[start + 16 * half + j]];
                        U[j] = ray[0]; V[j] = ray[1]; W[j] = ray[2]; Z[j] = ray[3];
                    }
                    const float *major = lane + 16 * axis, *one = lane + 16 * first, *two = lane + 16 * second;
                    float u[16], v[16], t[16];
                    for (int j = 0; j < 16; ++j) {
                        M[j] = fabsf(U[j]) + fabsf(V[j]) + fabsf(W[j]) + fabsf(Z[j]) + 0x1p-20f;
                        const float inverse = 1.0f / fabsf(major[j]);
                        u[j] = one[j] * inverse;
                        v[j] = two[j] * inverse;
                        t[j] = inverse_mode ? inverse : Z[j] * inverse;
                    }
                    auto fold = [&](const float* x, int q) {
                        for (int j = 0; j < 16; ++j) {
                            least[q][j] = half == 0 || x[j] < least[q][j] ? x[j] : least[q][j];
                            most[q][j] = half == 0 || x[j] > most[q][j] ? x[j] : most[q][j];
                        }
                    };
                    fold(u, 0);
                    fold(v, 1);
                    fold(t, 2);
                }
                for (int q = 0; q < 3; ++q) {
                    for (int half = 8; half > 0; half /= 2)
                        for (int j = 0; j < half; ++j) {
                            least[q][j] = least[q][j] < least[q][j + half] ? least[q][j] : least[q][j + half];
                            most[q][j] = most[q][j] > most[q][j + half] ? most[q][j] : most[q][j + half];
                        }
                    bound[2 * q] = least[q][0];
                    bound[2 * q + 1] = most[q][0];
                }
            }
            store(tiles.boxes.data + 96 * (size_t)(first_block + b) + k, bound);
            join(block, bound);
        }
        store(tiles.blocks.data + 96 * (size_t)column + b, block);
        join(whole, block);
    }
    store(tiles.columns.data + 96 * (size_t)(column / 16) + column % 16, whole);
    """
)


@wp.func_native("#if !defined(__CUDA_ARCH__)\n" + _COLUMN + "\n#endif\n")
def pack_column(
    frame: LightFrame,
    number: int,
    column: int,
    first_block: int,
    begin: int,
    end: int,
    rays: wp.array(dtype=wp.vec4),
    tiles: Tiles,
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
):
    """Tiles, blocks and the box of one column of group ``number``: its rays are ``order[begin:end]``, with the cells of
    v in ``keys``."""
    ...


@wp.kernel(enable_backward=False)
def pack_wide(
    lights: wp.array(dtype=LightFrame),
    rays: wp.array(dtype=wp.vec4),
    states: wp.array(dtype=wp.uint8),
    group: wp.array(dtype=wp.uint8),
    tiles: Tiles,
    cells: wp.array(dtype=int),
    scratch: wp.array(dtype=int),
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
):
    """One thread."""
    for k in range(FACES * tiles.lights * U_CELLS):
        cells[k] = 0
    count = int(0)
    for place in range(tiles.lights):
        measure(place, rays, group, tiles)
        count = write_keys(place, count, rays, states, group, tiles, cells, keys, order)
    ray = int(0)
    column = int(0)
    block = int(0)
    for number in range(FACES * tiles.lights):
        rays_of = int(0)
        for k in range(U_CELLS):
            rays_of += cells[number * U_CELLS + k]
        last = column + lay_out(number, ray, rays_of, column, block, tiles)
        for k in range(column + tiles.groups[number, COLUMNS_OF], last):
            no_column(k, tiles)
        column = last
        ray += rays_of
        block += (rays_of + BLOCK_RAYS - 1) // BLOCK_RAYS
    to_columns(count, tiles, cells, scratch, keys, order)
    for number in range(FACES * tiles.lights):
        first = tiles.groups[number, FIRST_RAY]
        length = tiles.groups[number, LENGTH]
        for k in range(tiles.groups[number, COLUMNS_OF]):
            pack_column(
                lights[number // FACES],
                number,
                tiles.groups[number, FIRST_COLUMN] + k,
                tiles.groups[number, FIRST_BLOCK] + k * (length // BLOCK_RAYS),
                count + first + k * length,
                count + first + wp.min(tiles.groups[number, RAYS_OF], (k + 1) * length),
                rays,
                tiles,
                keys,
                order,
            )
        make_lookup(number, tiles)
    tiles.counts[ALL_RAYS] = count
    tiles.counts[ALL_COLUMNS] = column
    tiles.counts[ALL_BLOCKS] = block
