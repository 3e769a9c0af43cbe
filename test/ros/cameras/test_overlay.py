# SPDX-License-Identifier: Apache-2.0
"""The overlay picture: relief, shadows, pixels without depth, frames of which nothing is known."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from shadow_tracer.ros.cameras.overlay import INVALID_COLOUR, overlay

_H, _W = 48, 64
_OPTICS: tuple[float, float, float, float] = (60.0, 60.0, 31.5, 23.5)


def _wall(slope_x: float = 0.0, slope_y: float = 0.0) -> np.ndarray:
    """Depth of the plane z = 2 + slope_x x + slope_y y."""
    fx, fy, cx, cy = _OPTICS
    v, u = np.mgrid[0:_H, 0:_W]
    return (2.0 / (1.0 - slope_x * (u - cx) / fx - slope_y * (v - cy) / fy)).astype(np.float32)


def _mask(value: int = 255) -> np.ndarray:
    return np.full((_H, _W), value, np.uint8)


def _grey(picture: np.ndarray) -> float:
    """Mean brightness of the middle."""
    return float(picture[8:-8, 8:-8].mean())


def test_shape_and_type() -> None:
    picture = overlay(_wall(), _mask(), *_OPTICS)
    assert picture.shape == (_H, _W, 3) and picture.dtype == np.uint8 and picture.flags.c_contiguous


def test_shadow_is_darker_and_bluish() -> None:
    mask = _mask()
    mask[:, _W // 2 :] = 0
    picture = overlay(_wall(), mask, *_OPTICS).astype(int)
    lit, dark = picture[:, : _W // 2], picture[:, _W // 2 :]
    assert lit.mean() > 2.0 * dark.mean()
    assert (abs(lit.max(axis=-1) - lit.min(axis=-1)) < 25).all(), "lit is grey"
    assert (dark[..., 2] > 1.4 * dark[..., 0]).all() and (dark[..., 2] > dark[..., 1]).all()


def test_part_of_a_light_is_in_between_and_in_order() -> None:
    brightness = [_grey(overlay(_wall(), _mask(value), *_OPTICS)) for value in range(0, 256, 15)]
    assert all(a < b for a, b in zip(brightness, brightness[1:], strict=False))


@pytest.mark.parametrize("millimetres", [False, True])
def test_slopes_show(millimetres: bool) -> None:
    """Brighter where the surface looks up and to the left of the camera, by the true slope and not by that in pixels:
    a plane has one brightness all over, seen obliquely too."""

    def brightness(x: float, y: float) -> float:
        depth = _wall(x, y)
        given = (1000.0 * depth + 0.5).astype(np.uint16) if millimetres else depth
        middle = overlay(given, _mask(), *_OPTICS)[8:-8, 8:-8, 0]
        assert int(np.ptp(middle)) <= (60 if millimetres else 5), "one plane, one brightness"
        return float(middle.mean())

    # a wall that comes nearer to the right looks to the left; a floor comes nearer downwards
    assert brightness(-0.3, 0.0) > brightness(0.0, 0.0) + 2 and brightness(0.0, 0.0) > brightness(0.6, 0.0) + 20
    assert brightness(0.0, -0.6) > brightness(0.0, 0.0) + 2 and brightness(0.0, 0.0) > brightness(0.0, 0.6) + 20


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("known", [True, False])
def test_pixels_without_depth(value: float, known: bool) -> None:
    """They have their colour, whatever the mask says, and spoil their neighbours' relief, not their light."""
    depth = _wall()
    holes = np.zeros(depth.shape, bool)
    holes[10:20, 5:30] = holes[0, 0] = holes[-1, -1] = True
    depth[holes] = value
    mask = _mask() if known else None
    if mask is not None:
        mask[12:14] = 0
        mask[15:17] = 128
    picture = overlay(depth, mask, *_OPTICS)
    assert (picture[holes] == INVALID_COLOUR).all()
    assert not (picture[~holes] == INVALID_COLOUR).all(axis=-1).any()
    clean = overlay(_wall(), mask, *_OPTICS)
    far = ~holes
    far[8:22, 3:32] = far[:3, :3] = far[-3:, -3:] = False
    np.testing.assert_array_equal(picture[far], clean[far])
    np.testing.assert_allclose(picture[~holes], clean[~holes], atol=6)


def test_zero_millimetres_are_no_depth() -> None:
    depth = np.full((_H, _W), 2000, np.uint16)
    depth[3, 4] = 0
    picture = overlay(depth, _mask(), *_OPTICS)
    assert tuple(picture[3, 4]) == INVALID_COLOUR and tuple(picture[30, 30]) != INVALID_COLOUR


def test_nothing_known_is_striped() -> None:
    """Two tones, each about half, that a mask cannot produce together."""
    picture = overlay(_wall(), None, *_OPTICS).reshape(-1, 3)
    lit = overlay(_wall(), _mask(), *_OPTICS)[30, 30]
    plain = (picture == lit).all(axis=1)
    assert 0.3 < plain.mean() < 0.7
    striped = picture[~plain].astype(int)
    assert (striped[:, 0] > striped[:, 2] + 60).all(), "amber"


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (4, 4), (5, 5), (2, 700)])
def test_tiny_images(shape: tuple[int, int]) -> None:
    depth = np.full(shape, 2.0, np.float32)
    picture = overlay(depth, np.zeros(shape, np.uint8), *_OPTICS)
    assert picture.shape == (*shape, 3) and not (picture == INVALID_COLOUR).all(axis=-1).any()


def test_extreme_depths_raise_no_warning(recwarn: Any) -> None:
    depth = _wall()
    depth[5, ::3], depth[7, ::4], depth[9, ::5] = 3e38, 1e-45, 1e-38
    assert overlay(depth, _mask(), *_OPTICS).shape == (_H, _W, 3)
    assert not list(recwarn)


def test_inputs_are_not_written_to_and_may_be_read_only() -> None:
    depth, mask = _wall(), _mask()
    depth[2, 2] = np.nan
    before = depth.copy()
    depth.setflags(write=False)
    mask.setflags(write=False)
    overlay(depth, mask, *_OPTICS)
    np.testing.assert_array_equal(depth, before)


def test_a_mask_of_another_shape_is_refused() -> None:
    with pytest.raises(ValueError, match="^mask: expected shape"):
        overlay(_wall(), _mask()[1:], *_OPTICS)
