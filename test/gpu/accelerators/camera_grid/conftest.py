# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests of depth images."""

from __future__ import annotations

from typing import Any

import pytest
from depth_views import BOUNDS

from shadow_tracer import DepthCamera


@pytest.fixture(scope="module")
def depth_camera(any_device: str) -> DepthCamera:
    return DepthCamera(any_device, BOUNDS)


@pytest.fixture(scope="module")
def plain_forms(any_device: str) -> list[Any]:
    """The plain Warp form with sorting tiles of 8 pixels, 4 and 16."""
    from shadow_tracer.gpu.accelerators.camera_grid.primary import PrimaryRays
    from shadow_tracer.gpu.device.devices import pick_device

    return [PrimaryRays(pick_device(any_device), BOUNDS, wide=False, tile=tile) for tile in (8, 4, 16)]
