# SPDX-License-Identifier: Apache-2.0
"""Where the samples of a frame are cut into shares. No Warp here."""

from __future__ import annotations

from typing import Any

import numpy as np

from shadow_tracer.scene.bounds import Bounds

# Fewer samples for each share are not worth a thread.
LEAST = 16384


def share_count(device: Any, bounds: Bounds, threads: int, graphs: bool) -> int:
    """How many shares of the rays there are to be."""
    if not device.is_cpu or graphs or bounds.max_rays < LEAST * threads or bounds.queue_capacity < threads:
        return 1
    return threads


def even_cuts(count: int, shares: int) -> list[tuple[int, int]]:
    """First and end of each share of ``count`` samples."""
    ends = [count * number // shares for number in range(shares + 1)]
    return list(zip(ends[:-1], ends[1:], strict=True))


def image_cuts(depth: np.ndarray, shares: int, room: int) -> list[tuple[int, int]]:
    """First pixel and end of each share: bands of the image with about as many measurements each, as far as there is
    ``room`` in a share."""
    size = depth.size
    if shares == 1:
        return [(0, size)]
    step = max(1, min(depth.shape) // 64)
    seen = depth[::step, ::step]
    measured = np.cumsum(((seen > 0) & np.isfinite(seen)).sum(axis=1) + 0.1 * seen.shape[1])
    rows = np.searchsorted(measured, measured[-1] * np.arange(1, shares) / shares) * step
    ends = [0]
    for number, row in enumerate(rows, start=1):
        end = int(row) * depth.shape[1]
        # Neither this share nor those that follow may get more than they have room for.
        end = max(min(end, ends[-1] + room), size - (shares - number) * room, ends[-1])
        ends.append(end)
    ends.append(size)
    return list(zip(ends[:-1], ends[1:], strict=True))
