# SPDX-License-Identifier: Apache-2.0
"""Dose maps of one surface add up, in any order, to what was received in all."""

from __future__ import annotations

from fractions import Fraction
from itertools import permutations

import geometry
import numpy as np
import pytest

from shadow_tracer import DoseMap, PointLight, ShadowTracer, Strength


def lamp(x: float) -> PointLight:
    return PointLight("lamp", (x, 0.1, 1.0), strength=Strength(intensity=0.7))


def exposed(tracer: ShadowTracer, x: float, seconds: float) -> DoseMap:
    made = DoseMap(tracer, "table", 0.5)
    made.add([lamp(x)], seconds)
    return made


def test_sums_are_the_nearest_to_the_exact_ones_in_any_order(reference: ShadowTracer) -> None:
    reference.scene.put("table", *geometry.square(2, 0.0, 1.0))
    reference.scene.put("shelf", *geometry.square(2, 0.5, 0.2))
    maps = [exposed(reference, x, seconds) for x, seconds in ((0.0, 1e-7), (0.4, 1e9), (-0.3, 0.1))]
    exact = [float(sum(map(Fraction, row))) for row in zip(*(each.dose.tolist() for each in maps), strict=True)]
    assert 0.0 in maps[0].dose and max(exact) > 0.0
    for order in permutations(maps):
        total = DoseMap.merge(order)
        assert total.dose.tolist() == exact
        assert total.seconds == float(sum(Fraction(each.seconds) for each in maps))
        assert (total.seconds_lit >= maps[1].seconds_lit).all()
        assert np.isnan(total.irradiance).all()
    total.add([lamp(0.0)], 2.0)
    assert total.seconds > 1e9 + 2.0 and not np.isnan(total.irradiance).any()


def test_maps_that_do_not_belong_together_are_named(reference: ShadowTracer) -> None:
    reference.scene.put("table", *geometry.square(2, 0.0, 1.0))
    reference.scene.put("other", *geometry.square(2, 0.5, 1.0))
    first = DoseMap(reference, "table", 0.5)
    with pytest.raises(ValueError, match="at least one"):
        DoseMap.merge([])
    for wrong, what in (
        (DoseMap(reference, "other", 0.5), "the mesh"),
        (DoseMap(reference, "table", 0.5, side="both"), "side"),
        (DoseMap(reference, "table", 0.4), "max_edge"),
        (DoseMap(reference, "table", 0.5, offset=0.01), "offset"),
    ):
        with pytest.raises(ValueError, match=f"{what} of number 1 is another"):
            DoseMap.merge([first, wrong])
