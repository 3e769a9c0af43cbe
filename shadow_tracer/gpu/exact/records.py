# SPDX-License-Identifier: Apache-2.0
"""Triangles as seen from a light: the four planes of each triangle in the light's frame, and their error bounds.

Set-up is float64, rounded once to the 64-byte record that the filter of ``decision.py`` reads; ``docs/exactness.md``
derives the bounds. A triangle that casts nothing gets a record that says no to every ray: it has a corner that is not
finite, no area, or is seen exactly edge-on (``degenerate``), or its front faces the light and front faces are culled.

CUDA takes one triangle per thread (``prepare_triangles``). On the CPU Warp's loops are scalar, so there a thread takes
a block of triangles, sixteen at a time in vector registers (``prepare_block``).

Those that cast nothing are counted for each block of 128 triangles, so that the records of some blocks can be made
again; triangles of gaps (``occluders/world.py``) are neither degenerate nor culled.
"""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.device import native
from shadow_tracer.gpu.exact.light_frame import LightFrame

# Unit roundoff of float32, and the factors in front of it (docs/exactness.md, section 3): an edge is off by 5 u of the
# ray's magnitude at most, the own plane by 4 u of its magnitude and 2 u of its offset; what is more pays for the
# roundings of the bounds.
U32 = 2.0**-24
FILTER_FACTOR = 8.0
SLOPE_FACTOR = 5.0
OFFSET_FACTOR = 3.0
# Bound of the float64 errors of frame coordinates and of products of them, relative to the magnitudes involved.
SETUP_ERROR = 2.0**-46
# A plane's offset beyond this may not fit in float32: its bound is infinite, so that it decides nothing there.
LARGEST_OFFSET = 1.0e38
# The vertex that is no mesh's, and not a number: the corners of a triangle in a gap (``occluders/world.py``).
GAP_VERTEX = 0
native.constants(
    GAP_VERTEX=GAP_VERTEX,
    FILTER_FACTOR=FILTER_FACTOR,
    SLOPE_FACTOR=SLOPE_FACTOR,
    OFFSET_FACTOR=OFFSET_FACTOR,
    U32=U32,
    SETUP_ERROR=SETUP_ERROR,
    LARGEST_OFFSET=LARGEST_OFFSET,
)


@native.func_native("exact/one_record.h", calls="OneRecord::make")
def make_record(
    i: int,
    frame: LightFrame,
    factor: wp.float64,
    slope_factor: wp.float64,
    offset_factor: wp.float64,
    u32: wp.float64,
    setup: wp.float64,
    largest_offset: wp.float64,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    records: wp.array2d(dtype=wp.vec4),
    cull: int,
) -> int:
    """Four planes and their error bounds of triangle ``i``: (n_ab, s_e) (n_bc, s_N) (n_ca, s_D) (N, D). Returns 1 if it
    casts nothing because it is degenerate, 2 because it is culled, 0 if it is in a gap or may cast a shadow."""
    ...


# Triangles per thread of the CPU.
BLOCK = 128
native.constants(RECORDS_BLOCK=BLOCK)


@wp.kernel(enable_backward=False)
def prepare_triangles(
    first: int,
    light: wp.array(dtype=LightFrame),
    factor: wp.float64,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    records: wp.array2d(dtype=wp.vec4),
    cull: int,
    silent: wp.array(dtype=wp.vec2i),
):
    """One triangle per thread, those from ``first`` on. With ``cull``, triangles whose front faces the light cast
    nothing. ``silent``, of each block of triangles how many are degenerate and culled, is added to."""
    i = first + wp.tid()
    nothing = make_record(
        i,
        light[0],
        factor,
        wp.float64(SLOPE_FACTOR),
        wp.float64(OFFSET_FACTOR),
        wp.float64(U32),
        wp.float64(SETUP_ERROR),
        wp.float64(LARGEST_OFFSET),
        vertices,
        triangles,
        records,
        cull,
    )
    if nothing == 1:
        wp.atomic_add(silent, i // BLOCK, wp.vec2i(1, 0))
    if nothing == 2:
        wp.atomic_add(silent, i // BLOCK, wp.vec2i(0, 1))


# Sums of what casts nothing for a light: the CUDA form makes them of the counts per block, for the host to fetch.
SUMS = 128


@wp.kernel(enable_backward=False)
def add_up(blocks: int, silent: wp.array(dtype=wp.vec2i), sums: wp.array(dtype=wp.vec2i)):
    """Every so many blocks one thread."""
    i = wp.tid()
    total = wp.vec2i(0, 0)
    for block in range(i, blocks, SUMS):
        total += silent[block]
    sums[i] = total


@native.func_native("exact/records.h", calls="Records::block")
def prepare_block(
    first: int,
    count: int,
    frame: LightFrame,
    factor: wp.float64,
    slope_factor: wp.float64,
    offset_factor: wp.float64,
    u32: wp.float64,
    setup: wp.float64,
    largest_offset: wp.float64,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    first_record: int,
    records: wp.array2d(dtype=wp.vec4),
    cull: int,
    row: int,
    silent: wp.array(dtype=wp.vec2i),
):
    """``prepare_triangles`` for up to 128 triangles from ``first`` on, sixteen at a time, with records from
    ``first_record`` on. ``silent[row]`` becomes how many of them are degenerate and culled."""
    ...


@wp.kernel(enable_backward=False)
def prepare_blocks(
    first_block: int,
    count: int,
    light: wp.array(dtype=LightFrame),
    factor: wp.float64,
    vertices: wp.array(dtype=wp.vec3d),
    triangles: wp.array(dtype=wp.vec3i),
    records: wp.array2d(dtype=wp.vec4),
    cull: int,
    silent: wp.array(dtype=wp.vec2i),
):
    """A block of triangles per thread, those from ``first_block`` on, of ``count`` triangles in all."""
    block = first_block + wp.tid()
    first = block * BLOCK
    prepare_block(
        first,
        count,
        light[0],
        factor,
        wp.float64(SLOPE_FACTOR),
        wp.float64(OFFSET_FACTOR),
        wp.float64(U32),
        wp.float64(SETUP_ERROR),
        wp.float64(LARGEST_OFFSET),
        vertices,
        triangles,
        first,
        records,
        cull,
        block,
        silent,
    )
