# SPDX-License-Identifier: Apache-2.0
"""How a mask is changed before it is published. Without ROS."""

from __future__ import annotations

import numpy as np
import pytest

from shadow_tracer.ros.cameras.mask_shape import depth_where, inverted, shadow_grown


def _by_hand(mask: np.ndarray, known: np.ndarray, pixels: int) -> np.ndarray:
    grown = mask.copy()
    for row, column in np.argwhere(known):
        around = slice(max(0, row - pixels), row + pixels + 1), slice(max(0, column - pixels), column + pixels + 1)
        grown[row, column] = mask[around][known[around]].min()
    return grown


@pytest.mark.parametrize("pixels", [0, 1, 2, 3, 4, 7, 8, 9, 64])
@pytest.mark.parametrize("shape", [(1, 1), (1, 30), (24, 17), (40, 33)])
def test_shadow_grows_by_a_square(shape: tuple[int, int], pixels: int) -> None:
    rng = np.random.default_rng(pixels)
    mask = rng.choice(np.array([0, 90, 255], np.uint8), shape, p=[0.02, 0.05, 0.93])
    known = rng.random(shape) < 0.9
    mask[~known] = 77
    before = mask.copy()
    grown = shadow_grown(mask, known, pixels)
    assert np.array_equal(grown, _by_hand(mask, known, pixels)) and np.array_equal(mask, before)
    assert (grown[~known] == 77).all() and grown.dtype == np.uint8
    if pixels == 0:
        assert grown is mask


def test_nothing_grows_out_of_what_is_unknown() -> None:
    mask = np.full((9, 9), 255, np.uint8)
    mask[4, 4] = 0
    assert (shadow_grown(mask, mask > 0, 3)[mask > 0] == 255).all()
    assert int((shadow_grown(mask, np.ones((9, 9), np.bool_), 3) == 0).sum()) == 49


def test_inverted_masks_never_say_lit_where_nothing_is_known() -> None:
    """The value of lit is 0 then, and no value that unknown may have, 0 to 254, becomes that."""
    values = np.arange(256, dtype=np.uint8)
    assert inverted(values).tolist() == list(range(255, -1, -1)) and inverted(values).dtype == np.uint8
    assert (inverted(values)[:255] != 0).all()


def test_depth_comes_back_as_the_camera_sent_it() -> None:
    wanted = np.arange(2**16).reshape(256, 256) % 3 > 0
    steps = np.arange(2**16, dtype=np.uint16).reshape(256, 256)
    found = depth_where(steps, wanted, 0.001, True)
    assert found.dtype == np.uint16 and np.array_equal(found, np.where(wanted, steps, 0))
    for unit in (0.0001, 0.00025, 0.00012498, 0.01, 1.0):
        metres = (steps.astype(np.float64) * unit).astype(np.float32)
        assert np.array_equal(depth_where(metres, wanted, unit, True), np.where(wanted, steps, 0)), unit
    metres = steps.astype(np.float32)
    found = depth_where(metres, wanted, 0.001, False)
    assert (
        found.dtype == np.float32 and np.array_equal(found[wanted], metres[wanted]) and np.isnan(found[~wanted]).all()
    )
