# SPDX-License-Identifier: Apache-2.0
"""What the tests of recordings share."""

from __future__ import annotations

import numpy as np
import pytest


@pytest.fixture(scope="session")
def expected(tmp_path_factory: pytest.TempPathFactory) -> list[np.ndarray]:
    """Masks of the journey from a plain mcap file: every frame and light counts in them."""
    from bag_journey import FRAMES, journey, run

    folder = tmp_path_factory.mktemp("plain")
    masks = run(journey().write(folder / "in"), folder / "out.mcap")
    assert len(masks) == 2 * FRAMES and all(20 < (mask == 0).sum() < mask.size - 20 for mask in masks)
    assert not any(np.array_equal(one, other) for one, other in zip(masks, masks[1:], strict=False))
    return masks
