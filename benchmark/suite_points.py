# SPDX-License-Identifier: Apache-2.0
"""Section "points": ``occluded(points)`` beside the peers' queries on the same points, in random order."""

from __future__ import annotations

import gc

from case import Case
from contest import Effort, contest
from rivals import Asked, Contestant, peers
from scenes import View, procedural_view, views
from suite_settings import Clock, Rows, Settings

_FRAMES = 2
_SIDE = 512  # pixels a side of the image whose samples are drawn from


def points(settings: Settings, clock: Clock) -> Rows:
    """The samples of every view, all of them; then the museum, of few and of many triangles, asked about few and many
    points."""
    rows: Rows = []
    expected = 0.0
    for name in settings.views:
        if clock.allows(name, 0.7 * expected):
            begin = clock.spent
            for view in views(settings.size, [name]):
                rows += _asked(view, settings.size**2, settings)
            expected = max(expected, clock.spent - begin)
    for triangles, count in settings.asked:
        if clock.allows(f"{triangles:,} triangles, {count:,} points"):
            view = procedural_view("museum", "room", "inside", _SIDE, triangles, _FRAMES)
            rows += _asked(view, count, settings)
    return rows


def _asked(view: View, count: int, settings: Settings) -> Rows:
    case = Case(view, _FRAMES).drawn(count)
    entrants: list[Contestant] = [Asked(*pair, case) for pair in settings.pipelines]
    rows = contest(case, [*entrants, *peers(case)], Effort(settings.effort.frames, 0.5 * settings.effort.seconds))
    del entrants
    gc.collect()
    return rows
