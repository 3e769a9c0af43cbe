# SPDX-License-Identifier: Apache-2.0
"""Hours of sun in a made valley, and the shortest day over real hills, by ``shadow_tracer terrain``.

    python benchmark/pictures_terrain.py

writes the valley as a GeoTIFF into a folder for temporary files and draws ``docs/images/terrain_hours.png``. Where
``SHADOW_TRACER_DATA`` or ``../shared/data`` has ``dem/dem_squared.tif`` (of gazebosim/gz-common, Apache-2.0), it draws
``docs/images/terrain_day.gif`` of that.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import numpy as np
import rasterio
from report import ROOT

from shadow_tracer.apps.terrain import terrain

_OUT = ROOT / "docs" / "images"
_HILLS = Path(os.environ.get("SHADOW_TRACER_DATA") or ROOT.parent / "shared" / "data") / "dem" / "dem_squared.tif"
_CELLS, _METRES = 300, 30.0


def valley() -> np.ndarray:
    """(300, 300) float32 heights: a valley from west to east between ridges, with side valleys and rough slopes [m]."""
    r, c = np.mgrid[:_CELLS, :_CELLS] / _CELLS
    bottom = 0.55 + 0.12 * np.sin(5.0 * c + 0.6)
    away = np.abs(r - bottom)
    height = 450.0 + 1900.0 * away / (0.35 + away)
    rng = np.random.default_rng(12)
    for octave in range(5):
        turn, phase = rng.uniform(0.0, np.pi, 3), rng.uniform(0.0, 2.0 * np.pi, 3)
        waves = sum(
            np.sin(2.0 * np.pi * 1.5 * 1.9**octave * (r * np.cos(t) + c * np.sin(t)) + p)
            for t, p in zip(turn, phase, strict=True)
        )
        height += np.minimum(away * 6.0, 1.0) * 260.0 / 2.1**octave * (1.0 - np.abs(waves))
    return height.astype(np.float32)


def main() -> int:
    """Draw both pictures; returns the exit code of the program."""
    with tempfile.TemporaryDirectory() as folder:
        path, out = Path(folder) / "valley.tif", ["-o", str(Path(folder) / "sun.tif"), "--overwrite"]
        place = rasterio.Affine(_METRES, 0.0, 400_000.0, 0.0, -_METRES, 5_110_000.0)
        with rasterio.open(
            path, "w", driver="GTiff", height=_CELLS, width=_CELLS, count=1, dtype="float32", crs="EPSG:32632",
            transform=place,
        ) as file:  # fmt: skip
            file.write(valley(), 1)
        day = ["--every", "15min", "--beyond", "nothing", *out]
        spring = ["--date", "2026-03-01", "--tz", "Europe/Zurich", "--png", str(_OUT / "terrain_hours.png")]
        code = terrain.main([str(path), *spring, *day])
        if code or not _HILLS.exists():
            return code
        winter = ["--date", "2026-12-21", "--tz", "America/Los_Angeles", "--gif", str(_OUT / "terrain_day.gif")]
        return terrain.main([str(_HILLS), *winter, *day])


if __name__ == "__main__":
    raise SystemExit(main())
