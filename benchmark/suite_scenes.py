# SPDX-License-Identifier: Apache-2.0
"""Sections "scenes" (all methods on every view) and "variants" (every variant of every pipeline on a few)."""

from __future__ import annotations

import gc

from case import Case
from contest import contest
from rivals import BruteForce, Contestant, Ours, peers
from scenes import views
from suite_settings import Clock, Rows, Settings, is_slow

_FEW = 300  # samples for the slow variants of brute_force


def scenes(settings: Settings, clock: Clock) -> Rows:
    """Every view: the pipelines, brute force on a few samples, and the peers."""
    rows: Rows = []
    expected = 0.0
    for name in settings.views:
        if not clock.allows(name, 0.7 * expected):
            continue
        begin = clock.spent
        for view in views(settings.size, [name]):
            case = Case(view, len(view.positions))
            entrants: list[Contestant] = [Ours(*pair, case) for pair in settings.pipelines]
            entrants += [BruteForce("filtered", case), *peers(case)]
            rows += contest(case, entrants, settings.effort)
            del entrants
            gc.collect()
        expected = max(expected, clock.spent - begin)
    return rows


def variants(settings: Settings, clock: Clock) -> Rows:
    """A few views, small: every variant of every pipeline, one by one; the slow ones on the first view only."""
    rows: Rows = []
    for number, name in enumerate(settings.views_few):
        if clock.spent > clock.seconds:
            clock.allows(name)
            continue
        for view in views(settings.variants_size, [name]):
            case = Case(view, 2)
            for pipeline, variant in settings.every:
                if number and is_slow((pipeline, variant)):
                    continue
                if clock.allows(f"{name}: {pipeline}/{variant}"):
                    brute = pipeline == "brute_force"
                    entrant = BruteForce(variant, case, _FEW) if brute else Ours(pipeline, variant, case)
                    rows += contest(case, [entrant], settings.effort)
    return rows
