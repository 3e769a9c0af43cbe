# SPDX-License-Identifier: Apache-2.0
"""Samples of a depth image moved along the normals of their surface, before anything else is made of them: what is
exact for a sample is exact for one that has been moved.

The normal is that of ``scene/normals.py``, which says how it is found, in the same order of operations without
contraction: the same bits. It needs pixels of other shares, so it looks at the whole image.

CUDA takes one pixel per thread (``displace_samples``). On the CPU a thread takes a block of pixels, and the compiler
puts the loop over them, for one neighbour at a time, into vector registers (``displace_block``).
"""

from __future__ import annotations

from typing import Any

import warp as wp

from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.exact.determinant import ARITHMETIC
from shadow_tracer.gpu.samples.pinhole import Pinhole
from shadow_tracer.gpu.samples.sample_set import FrameBuffers
from shadow_tracer.scene.checks import LARGEST
from shadow_tracer.scene.normals import FLATTEST, LARGEST_JUMP, MEASURED

# Pixels per thread of the vectorised loop.
_BLOCK = 256

_LEAST, _MOST = MEASURED
_FLOAT_ARITHMETIC = (
    ARITHMETIC
    + f"""
    const float least = {_LEAST}f, most = {_MOST}f, jump = {LARGEST_JUMP}f;
    const double shortest = {_LEAST}, longest = {_MOST}, flattest = {FLATTEST}, largest = {LARGEST};
"""
    + r"""
#if defined(__CUDA_ARCH__)
    auto plus = [](float x, float y) { return __fadd_rn(x, y); };
    auto minus = [](float x, float y) { return __fadd_rn(x, -y); };
    auto times = [](float x, float y) { return __fmul_rn(x, y); };
    auto invert = [](float x) { return __fdiv_rn(1.0f, x); };
#else
    auto plus = [](float x, float y) { return x + y; };
    auto minus = [](float x, float y) { return x - y; };
    auto times = [](float x, float y) { return x * y; };
    auto invert = [](float x) { return 1.0f / x; };
#endif
    // Inverse depth, 0 where nothing was measured.
    auto inverse = [&](float raw) {
        const bool is = raw >= least && raw <= most;
        return is ? invert(is ? raw : 1.0f) : 0.0f;
    };
"""
)

# The sums w x y xx xy yy d xd yd of a pixel, its inverse depth s and its ray (across, down, 1) say where its sample is
# `moved` to, and whether that is `good`: there is a normal, and room beyond.
_MOVE = r"""
        const double mxx = sub(mul(w, xx), mul(x, x)), myy = sub(mul(w, yy), mul(y, y));
        const double mxy = sub(mul(w, xy), mul(x, y));
        const double mxd = sub(mul(w, xd), mul(x, d)), myd = sub(mul(w, yd), mul(y, d));
        const double det = sub(mul(mxx, myy), mul(mxy, mxy)), share = mul(det, (double)s);
        const double a = sub(mul(myy, mxd), mul(mxy, myd)) / share, b = sub(mul(mxx, myd), mul(mxy, mxd)) / share;
        const double c = sub(sub(1.0, mul(a, across)), mul(b, down));
        const double length = norm(a, b, c), one = 1.0 / length;
        const double nx = mul(-a, one), ny = mul(-b, one), nz = mul(-c, one);
        const double wanted = mul(camera.bias_normal, sample[3]), far = wanted < largest ? wanted : largest;
        double moved[3];
        moved[0] = add(sample[0], mul(far, add(add(mul(r00, nx), mul(r01, ny)), mul(r02, nz))));
        moved[1] = add(sample[1], mul(far, add(add(mul(r10, nx), mul(r11, ny)), mul(r12, nz))));
        moved[2] = add(sample[2], mul(far, add(add(mul(r20, nx), mul(r21, ny)), mul(r22, nz))));
        const bool good = (s > 0.0f) & (det > mul(flattest, mul(mxx, myy))) & (length >= shortest) & (length <= longest)
            & (absolute(moved[0]) <= largest) & (absolute(moved[1]) <= largest) & (absolute(moved[2]) <= largest);
"""

_ROTATION = r"""
    const double r00 = camera.row0[0], r01 = camera.row0[1], r02 = camera.row0[2];
    const double r10 = camera.row1[0], r11 = camera.row1[1], r12 = camera.row1[2];
    const double r20 = camera.row2[0], r21 = camera.row2[1], r22 = camera.row2[2];
"""

_PIXEL = (
    _FLOAT_ARITHMETIC
    + _ROTATION
    + r"""
    const int pixel = camera.first + i, row = pixel / camera.width, column = pixel - row * camera.width;
    const float s = inverse((float)depth.data[pixel]), limit = times(jump, s);
    float w_ = 0.0f, x_ = 0.0f, y_ = 0.0f, xx_ = 0.0f, xy_ = 0.0f, yy_ = 0.0f, d_ = 0.0f, xd_ = 0.0f, yd_ = 0.0f;
#pragma unroll 1
    for (int k = 0; k < 9; ++k) {
        const int v = k / 3 - 1, u = k % 3 - 1;
        const int at_row = row + v * camera.step_down, at_column = column + u * camera.step_across;
        if (at_row < 0 || at_row >= camera.height || at_column < 0 || at_column >= camera.width)
            continue;
        const float other = inverse((float)depth.data[at_row * camera.width + at_column]), e = minus(other, s);
        if (!(other > 0.0f && fabsf(e) <= limit))
            continue;
        const float px = times((float)u, camera.across), py = times((float)v, camera.down);
        w_ = plus(w_, 1.0f); x_ = plus(x_, px); y_ = plus(y_, py);
        xx_ = plus(xx_, times(px, px)); xy_ = plus(xy_, times(px, py)); yy_ = plus(yy_, times(py, py));
        d_ = plus(d_, e); xd_ = plus(xd_, times(px, e)); yd_ = plus(yd_, times(py, e));
    }
    const double w = w_, x = x_, y = y_, xx = xx_, xy = xy_, yy = yy_, d = d_, xd = xd_, yd = yd_;
    const double across = (column - camera.cx) / camera.fx, down = (row - camera.cy) / camera.fy;
"""
    + _MOVE
    + r"""
    return good ? wp::vec4d(moved[0], moved[1], moved[2], sample[3]) : sample;
"""
)


@wp.func_native(_PIXEL)
def displaced(i: int, camera: Pinhole, depth: wp.array(dtype=wp.float32), sample: wp.vec4d) -> wp.vec4d:
    """``sample`` of pixel ``i`` of a share, moved along its normal if it has one."""
    ...


@wp.func_native(_PIXEL)  # type: ignore[no-redef]
def displaced(  # noqa: F811, an overload
    i: int, camera: Pinhole, depth: wp.array(dtype=wp.uint16), sample: wp.vec4d
) -> wp.vec4d:
    """The same for millimetres."""
    ...


@wp.kernel(enable_backward=False)
def displace_samples(
    cameras: wp.array(dtype=Pinhole),
    depth: wp.array(dtype=Any),
    samples: wp.array(dtype=wp.vec4d),
):
    """Move all samples that have a normal; ``depth`` is the whole image."""
    i = wp.tid()
    samples[i] = displaced(i, cameras[0], depth, samples[i])


wp.overload(displace_samples, {"depth": wp.array(dtype=wp.float32)})
wp.overload(displace_samples, {"depth": wp.array(dtype=wp.uint16)})

# Sums of a stretch of a row, one neighbour after the other; a neighbour outside of the image adds nothing.
_STRETCHES = (
    _FLOAT_ARITHMETIC
    + _ROTATION
    + r"""
#if !defined(__CUDA_ARCH__)
    const int end = count - first < 256 ? count - first : 256;
    float s_[256], w_[256], x_[256], y_[256], xx_[256], xy_[256], yy_[256], d_[256], xd_[256], yd_[256];
    typedef double Four[4];
    for (int i = 0; i < end;) {
        const int pixel = camera.first + first + i, row = pixel / camera.width, column = pixel - row * camera.width;
        const int n = camera.width - column < end - i ? camera.width - column : end - i;
        const auto* __restrict__ own = depth.data + pixel;
        for (int j = 0; j < n; ++j) {
            s_[j] = inverse((float)own[j]);
            w_[j] = x_[j] = y_[j] = xx_[j] = xy_[j] = yy_[j] = d_[j] = xd_[j] = yd_[j] = 0.0f;
        }
        for (int k = 0; k < 9; ++k) {
            const int v = k / 3 - 1, u = k % 3 - 1;
            const int at_row = row + v * camera.step_down, shift = column + u * camera.step_across;
            if (at_row < 0 || at_row >= camera.height)
                continue;
            const int begin = shift < 0 ? -shift : 0, stop = camera.width - shift < n ? camera.width - shift : n;
            const auto* __restrict__ line = depth.data + at_row * camera.width;
            const float px = times((float)u, camera.across), py = times((float)v, camera.down);
            const float pxx = times(px, px), pxy = times(px, py), pyy = times(py, py);
            for (int j = begin; j < stop; ++j) {
                const float s = s_[j], other = inverse((float)line[shift + j]), e = minus(other, s);
                const bool is = (other > 0.0f) & (fabsf(e) <= times(jump, s));
                w_[j] = plus(w_[j], is ? 1.0f : 0.0f);
                x_[j] = plus(x_[j], is ? px : 0.0f);
                y_[j] = plus(y_[j], is ? py : 0.0f);
                xx_[j] = plus(xx_[j], is ? pxx : 0.0f);
                xy_[j] = plus(xy_[j], is ? pxy : 0.0f);
                yy_[j] = plus(yy_[j], is ? pyy : 0.0f);
                d_[j] = plus(d_[j], is ? e : 0.0f);
                xd_[j] = plus(xd_[j], is ? times(px, e) : 0.0f);
                yd_[j] = plus(yd_[j], is ? times(py, e) : 0.0f);
            }
        }
        const double fx = camera.fx, cx = camera.cx, down = (row - camera.cy) / camera.fy;
        Four* __restrict__ place = (Four*)(samples.data + first + i);
        for (int j = 0; j < n; ++j) {
            const float s = s_[j];
            const double* sample = place[j];
            const double w = w_[j], x = x_[j], y = y_[j], xx = xx_[j], xy = xy_[j], yy = yy_[j];
            const double d = d_[j], xd = xd_[j], yd = yd_[j], across = ((double)(column + j) - cx) / fx;
"""
    + _MOVE
    + r"""
            for (int k = 0; k < 3; ++k)
                place[j][k] = good ? moved[k] : place[j][k];
        }
        i += n;
    }
#endif
"""
)


@wp.func_native(_STRETCHES)
def displace_block(
    first: int,
    count: int,
    camera: Pinhole,
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
    depth: wp.array(dtype=wp.uint16),
    samples: wp.array(dtype=wp.vec4d),
):
    """The same for millimetres."""
    ...


@wp.kernel(enable_backward=False)
def displace_blocks(
    count: int,
    cameras: wp.array(dtype=Pinhole),
    depth: wp.array(dtype=Any),
    samples: wp.array(dtype=wp.vec4d),
):
    displace_block(wp.tid() * _BLOCK, count, cameras[0], depth, samples)


wp.overload(displace_blocks, {"depth": wp.array(dtype=wp.float32)})
wp.overload(displace_blocks, {"depth": wp.array(dtype=wp.uint16)})


def displace(depth: wp.array, buffers: FrameBuffers) -> None:
    """Move the samples that have just been made of ``depth``, the whole image, as ``buffers.pinhole`` says."""
    wide = forms.wide(buffers.device)

    def prepare() -> tuple[int, list[Any]]:
        inputs = [buffers.pinhole, depth, buffers.samples]
        return (-(-buffers.count // _BLOCK), [buffers.count, *inputs]) if wide else (buffers.count, inputs)

    buffers.launch(displace_blocks if wide else displace_samples, (depth.ptr, buffers.count), prepare)
