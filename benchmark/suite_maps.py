# SPDX-License-Identifier: Apache-2.0
"""Section "maps": how many pixels a shadow map gets wrong, measured against the exact masks."""

from __future__ import annotations

import numpy as np
from case import Case
from report import note
from scenes import views
from shadow_map import masks, rasteriser, sides
from suite_settings import Clock, Rows, Settings

_FRAMES = 3


def maps(settings: Settings, clock: Clock) -> Rows:
    """A few views, map sizes ascending. The bias of a row is that of three which gives the map its fewest errors."""
    rows: Rows = []
    for name in settings.views_few:
        for view in views(settings.size, [name]):
            case = Case(view, 1)
            points, right = case.frames[0].points, case.static[0][0]
            drawer, why = rasteriser(view.positions[0], view.triangles)
            if why:
                note(f"shadow maps are drawn by the stand-in, without times: {why}")
            planes = [side for side, _ in sides(view.light, points)]
            expected = 0.0
            for size in settings.maps:
                if not clock.allows(f"{name}: {len(planes)} maps of {size} x {size}, {drawer.name}", 3.0 * expected):
                    continue
                begin = clock.spent
                errors = {
                    factor: float((mask != right).mean())
                    for factor, mask in masks(drawer, view.light, points, view.bias, size).items()
                }
                best = min(errors, key=lambda factor: errors[factor])
                times = [drawer.seconds(planes, size) for _ in range(_FRAMES)] if drawer.real else []
                rows.append(
                    {
                        "view": name,
                        "rays": len(points),
                        "rasteriser": drawer.name,
                        "map": size,
                        "maps": len(planes),
                        "wrong %": 100.0 * errors[best],
                        "bias": best * view.bias,
                        "wrong % by bias": {str(factor * view.bias): 100.0 * e for factor, e in errors.items()},
                        "ms (not exact)": 1e3 * float(np.median(times)) if times else None,
                    }
                )
                expected = clock.spent - begin
    return rows
