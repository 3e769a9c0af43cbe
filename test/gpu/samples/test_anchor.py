# SPDX-License-Identifier: Apache-2.0
"""The anchor of a depth image is near its samples, whatever else is in the image, and says nothing on stderr."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from shadow_tracer import Camera
from shadow_tracer.gpu.exact.light_frame import make_anchor
from shadow_tracer.gpu.samples.anchor import depth_anchor
from shadow_tracer.scene.bias import Bias

_CAMERA, _BIAS = Camera(64, 48, 60.0, 60.0, 32.0, 24.0), Bias(0.01)


@pytest.mark.parametrize("bad", [np.inf, -np.inf, np.nan, 0.0, -1.0, 3e38])
def test_what_is_no_sample_does_not_matter(bad: float) -> None:
    """Nor few samples at the end of the world; in the column and the row of the optical centre infinity meets 0."""
    depth = np.full((48, 64), 2.0, np.float32)
    expected = depth_anchor(depth, _CAMERA, _BIAS, None)
    depth[24, ::5] = depth[3::7, 32] = bad
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert depth_anchor(depth, _CAMERA, _BIAS, None) == expected


def test_it_is_around_the_few_that_are_seen() -> None:
    depth = np.zeros((48, 64), np.uint16)
    depth[4:12, 50:60] = 3000
    anchor = depth_anchor(depth, _CAMERA, _BIAS, None)
    pixels = np.array([[50.0, 4.0], [59.0, 11.0]])
    corners = np.column_stack([3.0 * (pixels - (32.0, 24.0)) / 60.0, [3.0, 3.0]])
    assert np.linalg.norm(anchor.center - corners.mean(axis=0)) < 0.1
    assert anchor.scale < 2.0 * np.linalg.norm(corners[1] - corners[0])


@pytest.mark.parametrize("bad", [np.nan, 0.0])
def test_without_samples_it_stays(bad: float) -> None:
    before = make_anchor(np.array([1.0, 2.0, 3.0]), 4.0, None)
    depth = np.full((48, 64), bad, np.float32)
    assert depth_anchor(depth, _CAMERA, _BIAS, before) is before
    assert depth_anchor(depth, _CAMERA, _BIAS, None) == make_anchor(_CAMERA.position, 1.0, None)
