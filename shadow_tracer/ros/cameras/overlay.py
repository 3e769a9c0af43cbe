# SPDX-License-Identifier: Apache-2.0
"""A picture to look at: the depth image as a shaded relief, with the shadows in it. No ROS here."""

from __future__ import annotations

from functools import cache

import numpy as np
import numpy.typing as npt

# Bits of the brightness of the relief, and of the mask, that a colour is made of.
_BITS = 6
_LEVELS = 1 << _BITS
_NO_DEPTH = _LEVELS * _LEVELS
_STRIPED = _NO_DEPTH + 1
INVALID_COLOUR = (52, 18, 44)
_STRIPE_COLOUR = (230, 150, 20)
_STRIPE = 12  # [px]
# The relief is lit from above and left of the camera; unit vector in the optical frame, towards that light.
_TOWARDS_LIGHT = (-0.36, -0.52, -0.775)
_REACH = 2  # slopes are taken over this many pixels to either side: depth is noisy


def overlay(
    depth: npt.NDArray[np.float32] | npt.NDArray[np.uint16],
    mask: npt.NDArray[np.uint8] | None,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
) -> npt.NDArray[np.uint8]:
    """Grey relief where light reaches, the same darkened and bluish in shadow.

    Args:
        depth: (H, W) float32 metres (zero, negative and non-finite are no measurement) or uint16 millimetres.
        mask: (H, W) uint8 as of :meth:`Frame.mask`, 255 lit, 0 not, in between partly; whatever it says where depth is
            invalid does not matter. None: nothing is known, the relief is striped.
        fx, fy: focal lengths [px].
        cx, cy: principal point [px]. Only the grey of the relief depends on these four: for that those of a lens with
            distortion are near enough.

    Returns:
        (H, W, 3) uint8 RGB; pixels without depth have the dark :data:`INVALID_COLOUR`.

    Raises:
        ValueError: the mask has another shape than the depth image.
    """
    if mask is not None and mask.shape != depth.shape:
        raise ValueError(f"mask: expected shape {depth.shape} as the depth image has, got {mask.shape}")
    z = depth.astype(np.float32)  # a millimetre is as good a unit here as a metre
    with np.errstate(all="ignore"):  # a depth at the end of float32 makes a wrong grey, no more
        valid = (z > 0) & (z < np.inf)
        z[~valid] = np.nan
        index = _relief(z, fx, fy, cx, cy).astype(np.uint16)
    if mask is None:
        rows, columns = np.ogrid[: depth.shape[0], : depth.shape[1]]
        stripes = (rows + columns) // _STRIPE % 2 == 1
        index += np.where(stripes, np.uint16(_STRIPED), np.uint16(_NO_DEPTH - _LEVELS))
    else:
        index |= (mask >> np.uint8(8 - _BITS)).astype(np.uint16) << np.uint16(_BITS)
    index[~valid] = _NO_DEPTH
    return _colours().take(index, axis=0, mode="clip")


def _relief(z: npt.NDArray[np.float32], fx: float, fy: float, cx: float, cy: float) -> npt.NDArray[np.float32]:
    """(H, W) brightness, above 0 and below ``_LEVELS``, of the surface that the depth ``z`` shows."""
    # Over x = (u - cx) / fx and y = (v - cy) / fy, the surface (x z, y z, z) has the normal
    # (z_x, z_y, -(z + x z_x + y z_y)) towards the camera.
    z_x, z_y = np.zeros_like(z), np.zeros_like(z)
    k = _REACH
    if z.shape[1] > 2 * k:
        np.subtract(z[:, 2 * k :], z[:, : -2 * k], out=z_x[:, k:-k])
        z_x *= np.float32(fx / (2 * k))
    if z.shape[0] > 2 * k:
        np.subtract(z[2 * k :], z[: -2 * k], out=z_y[k:-k])
        z_y *= np.float32(fy / (2 * k))
    x = ((np.arange(z.shape[1]) - cx) / fx).astype(np.float32)
    y = ((np.arange(z.shape[0]) - cy) / fy).astype(np.float32)
    forward = x * z_x
    forward += y[:, None] * z_y
    forward += z
    shade = np.float32(_TOWARDS_LIGHT[0]) * z_x
    shade += np.float32(_TOWARDS_LIGHT[1]) * z_y
    shade -= np.float32(_TOWARDS_LIGHT[2]) * forward
    z_x *= z_x
    z_y *= z_y
    forward *= forward
    forward += z_x
    forward += z_y
    shade /= np.sqrt(forward, out=forward)
    # A pixel beside one without depth has no slope: as if it faced the camera.
    shade[np.isnan(shade)] = -_TOWARDS_LIGHT[2]
    np.clip(shade, -1.0, 1.0, out=shade)  # what turns away from the light keeps some form
    shade *= np.float32(0.499 * _LEVELS)
    shade += np.float32(0.5 * _LEVELS)
    return shade


@cache
def _colours() -> npt.NDArray[np.uint8]:
    """(N, 3) RGB by brightness + mask * _LEVELS; that of pixels without depth; by brightness within a stripe."""
    bright = (np.arange(_LEVELS) / (_LEVELS - 1))[None, :, None] ** 1.3
    share = (np.arange(_LEVELS) / (_LEVELS - 1))[:, None, None]
    lit = 26.0 + bright * np.array([222.0, 217.0, 208.0])
    dark = np.array([6.0, 10.0, 24.0]) + bright * np.array([46.0, 62.0, 104.0])
    table = share * lit + (1.0 - share) * dark
    striped = 0.5 * (lit[0] + np.array(_STRIPE_COLOUR))
    return np.concatenate([table.reshape(-1, 3), [INVALID_COLOUR], striped]).astype(np.uint8)
