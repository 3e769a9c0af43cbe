# SPDX-License-Identifier: Apache-2.0
"""Where the samples of a frame are cut into shares. No Warp here."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from shadow_tracer.gpu.device import forms
from shadow_tracer.scene.bounds import Bounds

# Fewer samples for each share are not worth a thread.
LEAST = 16384


def share_count(device: Any, bounds: Bounds, threads: int, graphs: bool) -> int:
    """How many shares of the rays there are to be."""
    if not forms.wide(device) or graphs or bounds.max_rays < LEAST * threads:
        return 1
    return threads


def even_cuts(count: int, shares: int) -> list[tuple[int, int]]:
    """First and end of each share of ``count`` samples."""
    ends = [count * number // shares for number in range(shares + 1)]
    return list(zip(ends[:-1], ends[1:], strict=True))


def image_cuts(depth: np.ndarray, at: Sequence[float], room: int) -> tuple[list[tuple[int, int]], list[float]]:
    """First pixel and end of each share: bands of the image.

    Args:
        at: where to cut, in parts of all measurements from the top, ascending.
        room: the most pixels of a share; all shares together hold the image.

    Returns:
        The bands, and where the cuts really are: at rows, and no share has more pixels than there is room for.
    """
    size, width, shares = depth.size, depth.shape[1], len(at) + 1
    if shares == 1:
        return [(0, size)], []
    step = max(1, min(depth.shape) // 64)
    seen = depth[::step, ::step]
    measured = np.cumsum([0.0, *((seen > 0) & np.isfinite(seen)).sum(axis=1) + 0.1 * seen.shape[1]])
    rows = np.searchsorted(0.5 * (measured[1:] + measured[:-1]), measured[-1] * np.asarray(at))
    rows = np.clip(rows, 1, max(1, len(seen) - 1)) * step  # the first and the last share have some, if there are rows
    ends = [0]
    for number, row in enumerate(rows, start=1):
        # Neither this share nor those that follow may get more than they have room for.
        end = min(max(min(int(row) * width, ends[-1] + room), size - (shares - number) * room, ends[-1]), size)
        ends.append(end)
    ends.append(size)
    above = np.interp([end / width / step for end in ends[1:-1]], np.arange(len(measured)), measured)
    return list(zip(ends[:-1], ends[1:], strict=True)), [float(part) for part in above / measured[-1]]
