# SPDX-License-Identifier: Apache-2.0
"""The largest bounds: what is accepted can be counted in 32 bits, what is not is refused by name."""

from __future__ import annotations

import pytest

from shadow_tracer import Bounds

_LIMITS = {"max_triangles": 178_948_778, "max_rays": 2**28, "max_lights": 64}
_LIMITS |= {"queue_capacity": 2**30, "grid_entries": 2**30 - 1}


@pytest.mark.parametrize("name", _LIMITS)
def test_each_bound_has_a_limit(name: str) -> None:
    others = {"max_lights": 1} if name == "max_rays" else {"max_rays": 1}
    assert getattr(Bounds(**{**others, name: _LIMITS[name]}), name) == _LIMITS[name]
    for value in (_LIMITS[name] + 1, 0, -1, 1.5, "1", True):
        with pytest.raises(ValueError, match=f"^bounds.{name}: expected an integer from 1 to {_LIMITS[name]}, got "):
            Bounds(**{**others, name: value})


def test_states_of_all_rays_and_lights_have_a_limit() -> None:
    Bounds(max_rays=2**28, max_lights=6)
    with pytest.raises(ValueError, match=r"^bounds.max_rays: expected at most 1610612736 .* 268435456 \* 7 = "):
        Bounds(max_rays=2**28, max_lights=7)


def test_no_array_of_these_bounds_is_too_large() -> None:
    """The largest of each kind, as documented in ``Bounds``; shares have room for a quarter more rays."""
    most = 2**31 - 1
    assert 12 * (_LIMITS["max_triangles"] + 128 * 64) <= most
    assert 5 * 1.25 * _LIMITS["max_rays"] + 5 * 256 * 64 * 6 <= most
    assert 2 * _LIMITS["grid_entries"] <= most
    assert 1.25 * (2**30 + 2**29) + 64 * 64 <= most
