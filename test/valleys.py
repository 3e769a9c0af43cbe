# SPDX-License-Identifier: Apache-2.0
"""Made terrains and suns for the tests of ``terrain``."""

from __future__ import annotations

import numpy as np

from shadow_tracer.terrain.suns import Suns


def hills(rows: int, columns: int, seed: int = 0, height: float = 12.0) -> np.ndarray:
    """(R, C) smooth and rough ground, multiples of 1/64 m, whatever the last bits of the random numbers."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 256, (rows // 4 + 2, columns // 4 + 2))
    r, c = np.arange(rows) / 4.0, np.arange(columns) / 4.0
    i, j = r.astype(int), c.astype(int)
    u, v = (r - i)[:, None], (c - j)[None, :]
    near, far = coarse[i][:, j] * (1 - v) + coarse[i][:, j + 1] * v, None
    far = coarse[i + 1][:, j] * (1 - v) + coarse[i + 1][:, j + 1] * v
    smooth = (near * (1 - u) + far * u) / 256.0
    return np.round((smooth * height + rng.integers(0, 64, (rows, columns)) / 64.0) * 64.0) / 64.0


def sky(places: list[tuple[float, float]], seconds: float = 600.0, irradiance: float = 1000.0) -> Suns:
    """Suns at azimuths, clockwise from north, and elevations [degrees], ten minutes from each to the next."""
    azimuth, elevation = (np.array([place[k] for place in places], np.float64) for k in (0, 1))
    a, h = np.radians(azimuth), np.radians(elevation)
    towards = np.stack([np.cos(h) * np.sin(a), np.cos(h) * np.cos(a), np.sin(h)], axis=-1)
    stamps = tuple(1_782_000_000_000_000_000 + k * round(seconds * 1e9) for k in range(len(places)))
    count = len(places)
    return Suns(stamps, np.full(count, seconds), azimuth, elevation, towards, np.full(count, irradiance))
