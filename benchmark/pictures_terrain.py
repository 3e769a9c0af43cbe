# SPDX-License-Identifier: Apache-2.0
"""A made valley through a day of spring, by ``shadow_tracer terrain``.

    python benchmark/pictures_terrain.py

writes the valley as a GeoTIFF into a folder for temporary files and draws ``docs/images/terrain_hours.png`` and
``docs/images/terrain_day.gif``.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import rasterio

from shadow_tracer.apps.terrain import terrain

_OUT = Path(__file__).resolve().parents[1] / "docs" / "images"
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
        path = Path(folder) / "valley.tif"
        place = rasterio.Affine(_METRES, 0.0, 400_000.0, 0.0, -_METRES, 5_110_000.0)
        with rasterio.open(
            path, "w", driver="GTiff", height=_CELLS, width=_CELLS, count=1, dtype="float32", crs="EPSG:32632",
            transform=place,
        ) as file:  # fmt: skip
            file.write(valley(), 1)
        options = ["--date", "2026-03-01", "--every", "15min", "--tz", "Europe/Zurich", "--beyond", "nothing"]
        pictures = ["--png", str(_OUT / "terrain_hours.png"), "--gif", str(_OUT / "terrain_day.gif"), "--overwrite"]
        return terrain.main([str(path), "-o", str(Path(folder) / "sun.tif"), *options, *pictures])


if __name__ == "__main__":
    raise SystemExit(main())
