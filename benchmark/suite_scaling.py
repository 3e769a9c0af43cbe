# SPDX-License-Identifier: Apache-2.0
"""Sections "rays", "triangles" and "lights": what more of them cost. ``growth`` is by how much the time has grown since
the row before, in parts of how much their number has: 1 is linear, less is better."""

from __future__ import annotations

import gc
from dataclasses import replace

import numpy as np
from case import Case
from contest import Effort, contest
from procedural import Light
from rivals import BruteForce, Contestant, Ours, peers
from scenes import View, procedural_view, views
from suite_settings import Clock, Rows, Settings

from shadow_tracer import Bounds, DirectionalLight, PointLight

_PAIRS = 3e8  # sample/triangle pairs up to which brute force takes part with all samples
_FRAMES = 2


def rays(settings: Settings, clock: Clock) -> Rows:
    """The first of the few views in ascending image sizes."""
    rows: Rows = []
    expected, area = 0.0, 0
    for size in settings.sizes:
        if clock.allows(f"{size} x {size}", expected * (size * size / max(area, 1)) ** 0.5):
            begin = clock.spent
            for view in views(size, list(settings.views_few[:1])):
                rows += _measured(Case(view, _FRAMES), settings)
            expected, area = clock.spent - begin, size * size
    return _with_growth(rows, "rays")


def triangles(settings: Settings, clock: Clock) -> Rows:
    """The museum, which can have any number of triangles and always shows about as much."""
    rows: Rows = []
    expected, last = 0.0, 0
    for count in settings.triangles:
        if clock.allows(f"{count:,} triangles", expected * (count / max(last, 1)) ** 0.5):
            begin = clock.spent
            view = procedural_view("museum", "room", "inside", settings.size, count, _FRAMES)
            rows += _measured(Case(view, _FRAMES), settings)
            expected, last = clock.spent - begin, count
    return _with_growth(rows, "triangles")


def lights(settings: Settings, clock: Clock) -> Rows:
    """The first of the few views with ascending numbers of lights; ours have the default bounds, at least."""
    rows: Rows = []
    expected, last = 0.0, 1
    for view in views(settings.size, list(settings.views_few[:1])):
        for count in settings.lights:
            if clock.allows(f"lights: {count}", expected * (count / last) ** 0.5):
                begin = clock.spent
                rows += _measured(Case(view, _FRAMES, around(view, count)), settings, _roomy(view, count))
                expected, last = clock.spent - begin, count
    return _with_growth(rows, "lights")


def around(view: View, count: int) -> list[Light]:
    """The view's light and others on a circle around it, half as far from it as what the camera looks at is."""
    if isinstance(view.light, DirectionalLight):
        raise ValueError(f"views: expected views with a point light, got {view.name!r}")
    pose = view.camera.camera_to_world
    first = np.asarray(view.light.position)
    middle = pose[:3, 3] + pose[:3, 2] * np.linalg.norm(first - pose[:3, 3])
    forward = middle - first
    distance = float(np.linalg.norm(forward))
    side = np.cross(forward, np.eye(3)[int(np.argmin(np.abs(forward)))])
    side /= np.linalg.norm(side)
    up = np.cross(side, forward / distance)
    angles = 2.0 * np.pi * np.arange(count - 1) / max(count - 1, 1)
    others = [first + 0.5 * distance * (np.cos(a) * side + np.sin(a) * up) for a in angles]
    return [PointLight(f"lamp {k}", tuple(position)) for k, position in enumerate([first, *others])]


def _roomy(view: View, lights: int) -> Bounds:
    default, pixels = Bounds(), view.camera.width * view.camera.height
    needed = {
        "max_triangles": max(default.max_triangles, len(view.triangles)),
        "max_rays": max(default.max_rays, pixels),
        "max_lights": max(default.max_lights, lights),
    }
    return replace(default, **needed)


def _measured(case: Case, settings: Settings, bounds: Bounds | None = None) -> Rows:
    entrants: list[Contestant] = [Ours(*pair, case, bounds) for pair in settings.pipelines]
    if case.rays * len(case.view.triangles) <= _PAIRS:
        entrants.append(BruteForce("filtered", case, case.rays))
    entrants += peers(case)
    rows = contest(case, entrants, Effort(settings.effort.frames, 0.5 * settings.effort.seconds), static=False)
    del entrants
    gc.collect()
    return rows


def _with_growth(rows: Rows, what: str) -> Rows:
    last: dict[tuple[str, str], dict[str, float]] = {}
    for row in rows:
        key = row["view"] if what != "triangles" else "", row["method"]
        row["growth"] = None
        if row["dynamic ms"]:
            if key in last:
                before = last[key]
                row["growth"] = row["dynamic ms"] / before["dynamic ms"] / (row[what] / before[what])
            last[key] = row
    return rows
