# SPDX-License-Identifier: Apache-2.0
"""The Dataset that Dask computes tile by tile is the one that is computed at once."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from valleys import hills

pytest.importorskip("ephem")
xarray = pytest.importorskip("xarray")
dask = pytest.importorskip("dask")

from shadow_tracer import HeightField, Place, sunlight  # noqa: E402
from shadow_tracer.terrain import blocks  # noqa: E402

DAY = [f"2026-03-20T{hour:02d}:00Z" for hour in (0, 6, 7, 12, 17)]


@pytest.mark.parametrize("axes", [((0, -1), (1, 0)), ((0.6, -0.8), (0.8, 0.6))], ids=["straight", "turned"])
def test_a_lazy_dataset_is_that_of_now(axes: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    z = hills(40, 46, seed=9, height=90.0)
    z[12:15, 20:22] = np.nan
    field, asked = HeightField(z, 10.0, axes=axes), {"interval": 3600.0, "device": "cpu", "tile": 20}
    now = sunlight(field, DAY, Place(46.0, 8.0), **asked)
    solved: list[Any] = []
    solve = blocks.solve
    monkeypatch.setattr(blocks, "solve", lambda tile, tracer: solved.append(tile.answered) or solve(tile, tracer))
    found = sunlight(field, DAY, Place(46.0, 8.0), **asked, lazy=True)
    assert found.sun_code.chunks == ((5,), (20, 20), (20, 20, 6)) and not solved
    assert float(found.sunshine_duration[30, 5]) == float(now.sunshine_duration[30, 5])
    assert solved == [(slice(20, 40), slice(0, 20))]  # no more than was asked for
    with dask.config.set(scheduler="threads"):
        xarray.testing.assert_identical(found.compute(), now)
