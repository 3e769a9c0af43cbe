# SPDX-License-Identifier: Apache-2.0
"""Packs the rays of a pass into tiles, sixteen at a time, for the CPU. ``packing.py`` does the same on CUDA."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.light_grid.keys_wide import measure, write_keys
from shadow_tracer.gpu.accelerators.light_grid.tiles import (
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
from shadow_tracer.gpu.exact.decision import SIXTEEN
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.exact.light_space import FACES


# Rays in the order of (group, cell of u), within a cell in that of the image: so a column is a range of them. ``cells``
# holds the number of rays in each cell.
@wp.func_native(
    r"""
    int sum = 0;
    for (int k = 0; k < 6 * tiles.lights * 2048; ++k) {
        const int here = cells.data[k];
        cells.data[k] = sum;
        sum += here;
    }
    for (int i = 0; i < count; ++i) {
        const int key = keys.data[i], to = count + cells.data[key >> 10]++;
        keys.data[to] = key & 1023;
        order.data[to] = order.data[i];
    }
    """
)
def to_columns(
    count: int, tiles: Tiles, cells: wp.array(dtype=int), keys: wp.array(dtype=int), order: wp.array(dtype=int)
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
                        M[j] = fabsf(U[j]) + fabsf(V[j]) + fabsf(Z[j]) + 0x1p-20f;
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
    to_columns(count, tiles, cells, keys, order)
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
