# SPDX-License-Identifier: Apache-2.0
"""Frames are left out only where time runs short, and evenly."""

from __future__ import annotations

import pytest

from shadow_tracer.apps.demo.pace import Pace


def played(frames: int, budget: float, seconds: float, compiling: float = 0.0) -> tuple[list[int], float]:
    """Indices played on a machine that needs so many seconds per frame, and the time from the first answer on."""
    pace = Pace(frames, budget)
    index, now, indices = 0, compiling, []
    while index < frames:
        now += seconds
        indices.append(index)
        pace.answered(now)
        index = pace.after(index)
    return indices, now - compiling - seconds


@pytest.mark.parametrize(("budget", "seconds"), [(30, 0.7), (0, 100), (30, 0.0)])
def test_nothing_is_left_out_without_need(budget: float, seconds: float) -> None:
    indices, _ = played(40, budget, seconds, compiling=60)
    assert indices == list(range(40))


@pytest.mark.parametrize("seconds", [0.9, 1.3, 2.0, 2.5])
def test_a_slow_machine_keeps_the_budget(seconds: float) -> None:
    indices, spent = played(40, 30, seconds)
    assert spent <= 30 + seconds
    assert len(indices) >= 0.7 * 30 / seconds
    steps = [b - a for a, b in zip(indices, indices[1:], strict=False)][2:]
    assert max(steps) - min(steps) <= 1


def test_a_very_slow_machine_still_shows_every_fourth() -> None:
    indices, _ = played(40, 30, 30.0)
    assert len(indices) >= 10
