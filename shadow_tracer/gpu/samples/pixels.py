# SPDX-License-Identifier: Apache-2.0
"""Depth image to samples: one sample per pixel, in the world, float64, in image order.

A pixel is valid iff its depth is finite and positive (REP 117, REP 118), it has a ray, and its sample is no farther
from the origin than coordinates may be: NaN, infinity, zero and negative values, and 0 in millimetre images, never
become samples. The operations are those of ``Camera.unproject`` in the same order without contraction, so a point
computed there is the sample traced here, bit for bit.

CUDA takes one pixel per thread (``unproject``). On the CPU Warp's loops are scalar, so there a thread takes a block of
pixels and the compiler puts the loop over them into vector registers (``unproject_block``).
"""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.samples.pinhole import Pinhole
from shadow_tracer.gpu.samples.sample_set import SampleSet
from shadow_tracer.scene.checks import LARGEST

# Pixels per thread of the vectorised loop.
_BLOCK = 1024
native.constants(UNPROJECT_BLOCK=_BLOCK)
_UNPROJECT = native.snippet(
    "samples/pixels_block.h",
    call="UnprojectBlock::block(first, count, camera, table, units_per_metre, largest, depth, samples, valid);",
)


@wp.func_native(_UNPROJECT)
def unproject_block(
    first: int,
    count: int,
    camera: Pinhole,
    table: wp.array(dtype=wp.vec2),
    units_per_metre: wp.float64,
    largest: wp.float64,
    depth: wp.array(dtype=wp.float32),
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
):
    """Samples and validity of up to 1024 pixels from ``first`` on, and before ``count``; ``units_per_metre`` is 1 for
    metres, 1000 for millimetres. Samples of invalid pixels are written, too."""
    ...


@wp.func_native(_UNPROJECT)  # type: ignore[no-redef]
def unproject_block(  # noqa: F811, an overload
    first: int,
    count: int,
    camera: Pinhole,
    table: wp.array(dtype=wp.vec2),
    units_per_metre: wp.float64,
    largest: wp.float64,
    depth: wp.array(dtype=wp.uint16),
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
):
    """The same for millimetres."""
    ...


_ONE = native.snippet(
    "samples/pixels_one.h",
    call="Unproject::one(i, camera, table, units_per_metre, largest, depth, samples, valid);",
)


@wp.func_native(_ONE)
def unproject_pixel(
    i: int,
    camera: Pinhole,
    table: wp.array(dtype=wp.vec2),
    units_per_metre: wp.float64,
    largest: wp.float64,
    depth: wp.array(dtype=wp.float32),
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
):
    """Sample and validity of pixel ``i`` of the buffers; ``units_per_metre`` is 1 for metres, 1000 for millimetres."""
    ...


@wp.func_native(_ONE)  # type: ignore[no-redef]
def unproject_pixel(  # noqa: F811, an overload
    i: int,
    camera: Pinhole,
    table: wp.array(dtype=wp.vec2),
    units_per_metre: wp.float64,
    largest: wp.float64,
    depth: wp.array(dtype=wp.uint16),
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
):
    """The same for millimetres."""
    ...


@wp.kernel(enable_backward=False)
def unproject(
    cameras: wp.array(dtype=Pinhole),
    table: wp.array(dtype=wp.vec2),
    units_per_metre: wp.float64,
    depth: wp.array(dtype=Any),
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
):
    """One pixel per thread; ``units_per_metre`` is 1 for metres, 1000 for millimetres."""
    i = wp.tid()
    unproject_pixel(i, cameras[0], table, units_per_metre, wp.float64(LARGEST), depth, samples, valid)


wp.overload(unproject, {"depth": wp.array(dtype=wp.float32)})
wp.overload(unproject, {"depth": wp.array(dtype=wp.uint16)})


@wp.kernel(enable_backward=False)
def unproject_blocks(
    count: int,
    cameras: wp.array(dtype=Pinhole),
    table: wp.array(dtype=wp.vec2),
    units_per_metre: wp.float64,
    depth: wp.array(dtype=Any),
    samples: wp.array(dtype=wp.vec4d),
    valid: wp.array(dtype=wp.uint8),
):
    first = wp.tid() * _BLOCK
    unproject_block(first, count, cameras[0], table, units_per_metre, wp.float64(LARGEST), depth, samples, valid)


wp.overload(unproject_blocks, {"depth": wp.array(dtype=wp.float32)})
wp.overload(unproject_blocks, {"depth": wp.array(dtype=wp.uint16)})


def unproject_image(depth: wp.array, buffers: SampleSet) -> None:
    """Samples and validity of the ``buffers.count`` pixels of ``depth``, float32 metres or uint16 millimetres, seen by
    ``buffers.pinhole``."""
    wide = forms.wide(buffers.device)

    def prepare() -> tuple[int, list[Any]]:
        units = wp.float64(1.0 if depth.dtype == wp.float32 else 1000.0)
        inputs = [buffers.pinhole, buffers.ray_table, units, depth, buffers.positions, buffers.valid]
        return (-(-buffers.count // _BLOCK), [buffers.count, *inputs]) if wide else (buffers.count, inputs)

    buffers.launch(unproject_blocks if wide else unproject, (depth.ptr, buffers.count), prepare)
