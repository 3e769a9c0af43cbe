# SPDX-License-Identifier: Apache-2.0
"""Without any one of its safeguards the sun on terrain is wrong, and the comparisons of the other tests show it."""

from __future__ import annotations

import sys
import types
from functools import lru_cache
from pathlib import Path

import horizon
import numpy as np
import pytest
from valleys import hills, sky

from shadow_tracer.terrain import plan, tile
from shadow_tracer.terrain.grid import Grid

STEPS = ((0.0, -2.0), (3.0, 0.0))
SUNS = sky([(11, 3), (97, 12), (203, 25), (290, 40), (90, 8), (180, 2)])


def _without(module: types.ModuleType, there: str, instead: str) -> types.ModuleType:
    """A copy of a module with one text replaced; dataclasses look themselves up by the name of their module."""
    source = Path(module.__file__).read_text(encoding="utf-8")
    assert source.count(there) == 1, f"the safeguard has moved from {module.__name__}: update this test"
    changed = types.ModuleType(f"{module.__name__}_without")
    sys.modules[changed.__name__] = changed
    exec(compile(source.replace(there, instead), module.__file__, "exec"), changed.__dict__)
    return changed


@pytest.fixture(scope="module")
def tracer():
    return tile.tracer_for(4500, 4000, device="cpu")


def _ground() -> np.ndarray:
    z = hills(18, 21, seed=5)
    z[3:5, 7:12], z[9, 2], z[12, 12:15], z[11, 13], z[13, 13] = np.nan, np.nan, np.nan, np.nan, np.nan
    z[12, 13] = 3.0
    return z


@lru_cache
def _expected(beyond: str) -> list[tuple[np.ndarray, np.ndarray]]:
    return [horizon.codes(_ground(), *STEPS, tuple(towards), 0.0, beyond == "unknown") for towards in SUNS.towards]


def _differs_from_the_horizon(solve, tracer, beyond: str) -> bool:
    z = _ground()
    made = plan.make_plan(Grid(*z.shape, *STEPS), SUNS, lambda window: z[window], 64, beyond=beyond)
    found = solve(made.tile(0, lambda window: z[window]), tracer).codes
    for k, (expected, close) in enumerate(_expected(beyond)):
        if not np.array_equal(found[k][~close], expected[~close]):
            return True
    return False


ANSWERS = {
    "beyond": ("(tile.floor if side else unknown for side", "(tile.floor for side", "unknown"),
    "open_sides": ("(tile.floor if side else unknown for side", "(unknown for side", "nothing"),
    "closed_below": ("np.full([count + 2 * RINGS for count in z.shape], tile.floor)",
                     "np.full([count + 2 * RINGS for count in z.shape], unknown)", "unknown"),
    "holes": ("np.where(np.isnan(z), unknown, z)", "np.where(np.isnan(z), tile.floor, z)", "nothing"),
    "second_surface": ("tile.unsure[k] or np.isnan(z).any()", "tile.unsure[k]", "nothing"),
    "no_slope": ("codes[k][np.isnan(cosine)] = Code.UNKNOWN", "pass", "nothing"),
    "turned_away": ("codes[k][known & (cosine <= 0.0)] = Code.TURNED_AWAY", "pass", "nothing"),
}  # fmt: skip


@pytest.mark.parametrize(("there", "instead", "beyond"), ANSWERS.values(), ids=ANSWERS)
def test_answers_are_wrong_without(tracer, there, instead, beyond) -> None:
    assert not _differs_from_the_horizon(tile.solve, tracer, beyond)
    assert _differs_from_the_horizon(_without(tile, there, instead).solve, tracer, beyond)


def _codes_and_exposure(make_plan, tracer, z: np.ndarray, size: int, **options) -> tuple[np.ndarray, np.ndarray]:
    suns = options.pop("suns", SUNS)
    made = make_plan(Grid(*z.shape, *STEPS), suns, lambda window: z[window], size, **options)
    codes, exposure = np.zeros((len(suns.stamps), *z.shape), np.uint8), np.zeros(z.shape)
    for number, which in enumerate(made.tiles):
        found = tile.solve(made.tile(number, lambda window: z[window]), tracer)
        codes[:, which.answered[0], which.answered[1]] = found.codes
        exposure[which.answered] = found.exposure
    return codes, exposure


TILES = {
    "far_enough": ("grid.cells((x, y), relief / up)", "grid.cells((x, y), 0.4 * relief / up)", SUNS),
    "from_the_lowest": ("lowest.append(float(known.min())", "lowest.append(float(known.max())", SUNS),
    "neighbours": ("_SPARE = 2 ", "_SPARE = 0 ", sky([(90, 30)])),
}


@pytest.mark.parametrize(("there", "instead", "suns"), TILES.values(), ids=TILES)
def test_tiles_are_not_the_whole_without(tracer, there, instead, suns) -> None:
    z = hills(48, 48, seed=3, height=9.0)
    careless = _without(plan, there, instead).make_plan
    whole = _codes_and_exposure(plan.make_plan, tracer, z, 64, suns=suns)
    right, wrong = (_codes_and_exposure(make, tracer, z, 16, suns=suns) for make in (plan.make_plan, careless))
    assert all(np.array_equal(a, b) for a, b in zip(whole, right, strict=True))
    assert not all(np.array_equal(a, b) for a, b in zip(whole, wrong, strict=True))


def test_a_block_that_is_too_small_lights_what_is_dark_without_its_ring(tracer) -> None:
    z = hills(48, 48, seed=3, height=60.0)
    memory = (plan.BYTES_A_SAMPLE + 12) * 16 * 16 + plan.BYTES_A_CELL * 26 * 26
    whole, _ = _codes_and_exposure(plan.make_plan, tracer, z, 64)
    careless = _without(plan, "return True\n    return False", "return False\n    return False").make_plan
    for make, honest in ((plan.make_plan, True), (careless, False)):
        codes, _ = _codes_and_exposure(make, tracer, z, 16, memory=memory)
        assert (codes[codes != whole] == 3).all() == honest
