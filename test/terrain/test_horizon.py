# SPDX-License-Identifier: Apache-2.0
"""Codes of small terrains against the horizon by brute force (``horizon.py``)."""

from __future__ import annotations

import math

import data
import horizon
import numpy as np
import pytest
from valleys import hills, sky

from shadow_tracer.terrain.grid import Grid
from shadow_tracer.terrain.plan import make_plan
from shadow_tracer.terrain.tile import solve, tracer_for

NORTH_UP = ((0.0, -2.0), (3.0, 0.0))
TURNED = ((1.2, -1.6), (2.4, 1.8))


@pytest.fixture(scope="module")
def tracer():
    return tracer_for(2500, 1000, device="cpu")


def _answer(tracer, z, steps, suns, **options):
    grid = Grid(*z.shape, *steps)
    plan = make_plan(grid, suns, lambda window: z[window], 1024, **options)
    (tile,) = (plan.tile(number, lambda window: z[window]) for number in range(len(plan.tiles)))
    return solve(tile, tracer).codes


def _holes(z: np.ndarray) -> np.ndarray:
    z = z.copy()
    z[3:5, 7:12], z[9, 2], z[0, 0], z[-1, 4:9] = np.nan, np.nan, np.nan, np.nan
    z[12, 12:15], z[11, 13], z[13, 13] = np.nan, np.nan, np.nan
    z[12, 13] = 3.0  # a cell without neighbours
    return z


@pytest.mark.parametrize("beyond", ["unknown", "nothing"])
@pytest.mark.parametrize("above", [0.0, 1.5])
@pytest.mark.parametrize("steps", [NORTH_UP, TURNED], ids=["north_up", "turned"])
@pytest.mark.parametrize("holes", [False, True], ids=["whole", "holes"])
def test_codes_are_those_of_the_horizon(tracer, steps, holes, above, beyond) -> None:
    z = hills(18, 21, seed=5)
    z = _holes(z) if holes else z
    suns = sky([(11, 3), (97, 12), (203, 25), (290, 40), (333, 70), (90, 8), (180, 2)])
    found = _answer(tracer, z, steps, suns, above=above, beyond=beyond)
    seen = set()
    for k, towards in enumerate(suns.towards):
        expected, close = horizon.codes(z, *steps, tuple(towards), above, beyond == "unknown")
        assert close.sum() < 4
        assert np.array_equal(found[k][~close], expected[~close])
        seen |= set(expected.ravel().tolist())
    assert seen >= {0, 2} and (1 in seen) == (above == 0.0) and (3 in seen) == (holes or beyond == "unknown")


def test_steep_ground_and_ridges(tracer) -> None:
    """Points whose ray goes under a triangle that touches them, near the border too: these are dark."""
    z = np.random.default_rng(3).integers(0, 4, (16, 16)) * 4.0
    suns = sky([(17, 30), (121, 48), (260, 60), (45, 20)])
    found = _answer(tracer, z, NORTH_UP, suns, beyond="nothing")
    for k, towards in enumerate(suns.towards):
        expected, close = horizon.codes(z, *NORTH_UP, tuple(towards), 0.0, False)
        assert close.mean() < 0.05
        assert np.array_equal(found[k][~close], expected[~close])


def test_a_tower_casts_a_shadow_as_long_as_its_height_by_the_slope(tracer) -> None:
    """Azimuth is clockwise from north: a sun in the west throws the shadow to the east."""
    z = np.zeros((9, 30))
    z[4, 3] = 10.0
    codes = _answer(tracer, z, ((0.0, -1.0), (1.0, 0.0)), sky([(270, math.degrees(math.atan2(1.0, 2.0)) + 1e-6)]),
                    beyond="nothing")[0]  # fmt: skip
    # the tower is 10 m high, the sun stands 1 in 2: 20 m of shadow; what touches the tower is its slope
    assert (codes[4, 5:23] == 2).all() and (codes[4, 23:] == 0).all()
    assert (codes[[2, 6]] == 0).all() and (codes[4, :2] == 0).all()


def test_a_plane_that_faces_away_is_turned_away_and_one_below_the_horizon_too(tracer) -> None:
    z = np.arange(12.0)[:, None] * np.ones((1, 12))  # rises towards the south
    codes = _answer(tracer, z, ((0.0, -1.0), (1.0, 0.0)), sky([(180, 44), (0, 30), (180, -3)]), beyond="nothing")
    assert (codes[0] == 1).all() and (codes[1] == 0).all() and (codes[2] == 1).all()


def test_nothing_known_is_unknown_and_one_cell_has_no_slope(tracer) -> None:
    suns = sky([(180, 44)])
    assert (_answer(tracer, np.full((3, 4), np.nan), NORTH_UP, suns) == 3).all()
    assert (_answer(tracer, np.zeros((1, 1)), NORTH_UP, suns) == 3).all()
    assert (_answer(tracer, np.zeros((1, 1)), NORTH_UP, suns, above=1.0) == 0).all()


def test_beyond_an_edge_the_highest_height_could_be() -> None:
    """On flat ground with one tower, what lies beyond could be as high as the tower."""
    z = np.zeros((9, 30))
    z[4, 3] = 10.0
    tracer = tracer_for(2500, 1000, device="cpu")
    suns = sky([(90, 45)])
    unknown = _answer(tracer, z, ((0.0, -1.0), (1.0, 0.0)), suns)[0]
    nothing = _answer(tracer, z, ((0.0, -1.0), (1.0, 0.0)), suns, beyond="nothing")[0]
    # the sun in the east rises 1 in 1: at most 10 m before the first cell beyond, which is column 30
    assert (unknown[:, 20:] == 3).all() and (unknown[:3, :19] == 0).all() and (nothing[:, 6:] == 0).all()


def test_a_part_of_a_real_model(tracer) -> None:
    """24 x 24 heights of an arc second, which float32 gives in steps that are no round numbers."""
    rasterio = pytest.importorskip("rasterio", reason="needs the extra: pip install 'shadow_tracer[terrain]'")
    with rasterio.open(data.file("dem/dem_squared.tif")) as file:
        z = file.read(1)[40:64, 50:74].astype(np.float64)
    suns = sky([(71, 5), (112, 14), (250, 9), (180, 31)])
    found = _answer(tracer, z, ((0.0, -30.8), (24.4, 0.0)), suns)
    for k, towards in enumerate(suns.towards):
        expected, close = horizon.codes(z, (0.0, -30.8), (24.4, 0.0), tuple(towards))
        assert close.sum() < 4 and np.array_equal(found[k][~close], expected[~close])
