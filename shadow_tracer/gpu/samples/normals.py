# SPDX-License-Identifier: Apache-2.0
"""Samples of a depth image moved along the normals of their surface, before anything else is made of them: what is
exact for a sample is exact for one that has been moved.

The normal is that of ``scene/normals.py``, which says how it is found, in the same order of operations without
contraction: the same bits. It needs pixels of other bands, so it looks at the whole image.

CUDA takes one pixel per thread (``displace_samples``). On the CPU a thread takes a block of pixels, and the compiler
puts the loop over them, for one neighbour at a time, into vector registers (``displace_block``).
"""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.device import forms, native
from shadow_tracer.gpu.samples.pinhole import Pinhole
from shadow_tracer.gpu.samples.sample_set import SampleSet
from shadow_tracer.scene.checks import LARGEST
from shadow_tracer.scene.normals import FLATTEST, LARGEST_JUMP, MEASURED

# Pixels per thread of the vectorised loop.
_BLOCK = 256

native.constants(
    NORMALS_BLOCK=_BLOCK,
    NEAREST_MEASURED=MEASURED[0],
    FARTHEST_MEASURED=MEASURED[1],
    LARGEST_JUMP=LARGEST_JUMP,
    FLATTEST=FLATTEST,
    LARGEST_COORDINATE=LARGEST,
)
_PIXEL = native.snippet("samples/normals_pixel.h", call="return Displace::sample(i, camera, table, depth, sample);")
_STRETCHES = native.snippet(
    "samples/normals_block.h", call="DisplaceBlock::block(first, count, camera, table, depth, samples);"
)


@wp.func_native(_PIXEL)
def displaced(
    i: int, camera: Pinhole, table: wp.array(dtype=wp.vec2), depth: wp.array(dtype=wp.float32), sample: wp.vec4d
) -> wp.vec4d:
    """``sample`` of pixel ``i`` of a band, moved along its normal if it has one."""
    ...


@wp.func_native(_PIXEL)  # type: ignore[no-redef]
def displaced(  # noqa: F811, an overload
    i: int, camera: Pinhole, table: wp.array(dtype=wp.vec2), depth: wp.array(dtype=wp.uint16), sample: wp.vec4d
) -> wp.vec4d:
    """The same for millimetres."""
    ...


@wp.kernel(enable_backward=False)
def displace_samples(
    cameras: wp.array(dtype=Pinhole),
    table: wp.array(dtype=wp.vec2),
    depth: wp.array(dtype=Any),
    samples: wp.array(dtype=wp.vec4d),
):
    """Move all samples that have a normal; ``depth`` is the whole image."""
    i = wp.tid()
    samples[i] = displaced(i, cameras[0], table, depth, samples[i])


wp.overload(displace_samples, {"depth": wp.array(dtype=wp.float32)})
wp.overload(displace_samples, {"depth": wp.array(dtype=wp.uint16)})


@wp.func_native(_STRETCHES)
def displace_block(
    first: int,
    count: int,
    camera: Pinhole,
    table: wp.array(dtype=wp.vec2),
    depth: wp.array(dtype=wp.float32),
    samples: wp.array(dtype=wp.vec4d),
):
    """``displace_samples`` for up to 256 pixels from ``first`` on, vectorised."""
    ...


@wp.func_native(_STRETCHES)  # type: ignore[no-redef]
def displace_block(  # noqa: F811, an overload
    first: int,
    count: int,
    camera: Pinhole,
    table: wp.array(dtype=wp.vec2),
    depth: wp.array(dtype=wp.uint16),
    samples: wp.array(dtype=wp.vec4d),
):
    """The same for millimetres."""
    ...


@wp.kernel(enable_backward=False)
def displace_blocks(
    count: int,
    cameras: wp.array(dtype=Pinhole),
    table: wp.array(dtype=wp.vec2),
    depth: wp.array(dtype=Any),
    samples: wp.array(dtype=wp.vec4d),
):
    displace_block(wp.tid() * _BLOCK, count, cameras[0], table, depth, samples)


wp.overload(displace_blocks, {"depth": wp.array(dtype=wp.float32)})
wp.overload(displace_blocks, {"depth": wp.array(dtype=wp.uint16)})


def displace(depth: wp.array, buffers: SampleSet) -> None:
    """Move the samples that have just been made of ``depth``, the whole image, as ``buffers.pinhole`` says."""
    wide = forms.wide(buffers.device)

    def prepare() -> tuple[int, list[Any]]:
        inputs = [buffers.pinhole, buffers.ray_table, depth, buffers.positions]
        return (-(-buffers.count // _BLOCK), [buffers.count, *inputs]) if wide else (buffers.count, inputs)

    buffers.launch(displace_blocks if wide else displace_samples, (depth.ptr, buffers.count), prepare)
