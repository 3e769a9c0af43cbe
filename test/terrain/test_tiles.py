# SPDX-License-Identifier: Apache-2.0
"""Tiles with what is around them give the same bits as the whole; what a block cannot hold is unknown, never lit."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from valleys import hills, sky

from shadow_tracer.terrain.dataset import Gathered
from shadow_tracer.terrain.grid import Grid
from shadow_tracer.terrain.plan import BYTES_A_CELL, BYTES_A_SAMPLE, make_plan
from shadow_tracer.terrain.tile import TileResult, solve, tracer_for

STEPS = ((0.0, -5.3), (4.1, 0.0))
SUNS = sky([(75, 4), (110, 21), (181, 44), (181, -2), (245, 30), (290, 6), (300, 0.7)])


def _solved(z, size, tracer=None, memory=2e9, grid=None, **options) -> list[tuple[tuple[slice, slice], TileResult]]:
    grid = grid or Grid(*z.shape, *STEPS)
    plan = make_plan(grid, SUNS, lambda window: z[window], size, memory, **options)
    tracer = tracer or tracer_for(*plan.largest, device="cpu")
    results = [solve(plan.tile(k, lambda window: z[window]), tracer) for k in range(len(plan.tiles))]
    return list(zip([tile.answered for tile in plan.tiles], results, strict=True))


def _together(z, tiles) -> dict[str, np.ndarray]:
    found = {}
    for window, result in tiles:
        for field in dataclasses.fields(TileResult):
            values = getattr(result, field.name)
            whole = found.setdefault(field.name, np.zeros((*values.shape[:-2], *z.shape), values.dtype))
            whole[..., window[0], window[1]] = values
    return found


def _same(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> bool:
    return all(np.array_equal(a[name], b[name], equal_nan=name != "codes") for name in a)


@pytest.fixture(scope="module")
def ground() -> np.ndarray:
    z = hills(53, 61, seed=2, height=20.0)
    z[20:26, 30:34], z[0, 5], z[40, 60] = np.nan, np.nan, np.nan
    return z


@pytest.mark.parametrize("options", [{}, {"beyond": "nothing"}, {"above": 2.0}], ids=["ground", "nothing", "above"])
def test_tiles_are_the_whole_bit_for_bit(ground, options) -> None:
    whole = _together(ground, _solved(ground, 64, **options))
    assert {0, 2, 3} <= set(whole["codes"].ravel().tolist())
    for size in (16, 23):
        assert _same(whole, _together(ground, _solved(ground, size, **options)))


def test_tiles_of_a_turned_and_curved_grid_are_the_whole(ground) -> None:
    grid = Grid(*ground.shape, (120.0, -160.0), (240.0, 180.0), curved=True).checked()
    z = ground * 40.0
    whole = _together(z, _solved(z, 64, grid=grid))
    assert _same(whole, _together(z, _solved(z, 17, grid=grid)))


def test_the_order_of_tiles_and_the_tracer_do_not_matter(ground) -> None:
    plan = make_plan(Grid(*ground.shape, *STEPS), SUNS, lambda window: ground[window], 32)
    shared = tracer_for(*plan.largest, device="cpu")
    for number in reversed(range(len(plan.tiles))):
        tile = plan.tile(number, lambda window: ground[window])
        again, fresh = solve(tile, shared), solve(tile)
        assert np.array_equal(again.codes, fresh.codes)
        assert np.array_equal(again.exposure, fresh.exposure, equal_nan=True)


def test_a_block_that_is_too_small_says_unknown_never_another_answer(ground) -> None:
    z = hills(64, 64, seed=4, height=60.0)
    whole = _together(z, _solved(z, 64))["codes"]
    memory = (BYTES_A_SAMPLE + 14) * 16 * 16 + BYTES_A_CELL * 30 * 30
    plan = make_plan(Grid(*z.shape, *STEPS), SUNS, lambda window: z[window], 16, memory)
    assert 0 < plan.short < len(SUNS.up())
    short = _together(z, _solved(z, 16, memory=memory))["codes"]
    differs = short != whole
    assert differs.any() and (short[differs] == 3).all()


def test_memory_that_is_too_small_for_a_tile_is_refused() -> None:
    with pytest.raises(ValueError, match=r"^memory: expected at least .* GB for tiles of 64 x 64 cells and 7 times"):
        make_plan(Grid(64, 64, *STEPS), SUNS, lambda window: np.zeros((64, 64))[window], 64, 1e6)


def test_blocks_reach_as_far_as_the_highest_can_hide() -> None:
    """20 m of relief under a sun of 1 in 2 from the east: 40 m, 10 columns of 4 m, and two to spare; none elsewhere."""
    z = np.zeros((40, 80))
    z[0, 79] = 20.0
    suns = sky([(90, np.degrees(np.arctan(0.5)))])
    plan = make_plan(Grid(40, 80, (0.0, -4.0), (4.0, 0.0)), suns, lambda window: z[window], 20)
    tile = next(tile for tile in plan.tiles if tile.answered == (slice(20, 40), slice(20, 40)))
    assert tile.block[0] == slice(17, 40) or tile.block[0] == slice(18, 40)
    assert tile.block[1].start == 18 and tile.block[1].stop in (52, 53)
    assert not any(tile.unsure) or tile.block[0].stop == 40


def test_sums_are_those_of_the_codes(ground) -> None:
    grid = Grid(*ground.shape, *STEPS)
    plan = make_plan(grid, SUNS, lambda window: ground[window], 64)
    gathered = Gathered(plan)
    ((window, result),) = _solved(ground, 64)
    gathered.put(window, result)
    known = ~np.isnan(ground)
    lit = (result.codes == 0).sum(axis=0) * 600.0
    assert np.array_equal(gathered.layers["sunshine_duration"][known], lit[known].astype(np.float32))
    assert np.isnan(gathered.layers["direct_exposure"][~known]).all()
    day = 600.0 * (SUNS.elevation > 0).sum()
    assert np.allclose(gathered.layers["sunlit_fraction"][known], lit[known] / day, rtol=1e-6)
    for row, column in np.argwhere(known)[::97]:
        longest = max(len(run) for run in "".join("d" if c else " " for c in result.codes[:, row, column]).split(" "))
        assert result.darkness[row, column] == 600.0 * longest


def test_exposure_is_irradiance_by_the_cosine_of_the_slope() -> None:
    """A plane that rises 1 in 2 to the north under a sun 30 degrees high in the south, 1000 W/m2 for 600 s."""
    z = -np.arange(8.0)[:, None] * 2.0 * np.ones((1, 8))  # rows go south, 4 m each
    grid = Grid(8, 8, (0.0, -4.0), (4.0, 0.0))
    for above, cosine in ((0.0, np.sin(np.radians(30) + np.arctan(0.5))), (1.0, 0.5)):
        plan = make_plan(grid, sky([(180, 30)]), lambda window: z[window], 64, above=above, beyond="nothing")
        found = solve(plan.tile(0, lambda window: z[window])).exposure
        assert np.allclose(found, 1000.0 * 600.0 * cosine, rtol=1e-12)
