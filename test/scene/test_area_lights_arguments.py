# SPDX-License-Identifier: Apache-2.0
"""Lights with size: where their points lie, and what arguments are refused."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import geometry
import numpy as np
import pytest

from shadow_tracer import (
    DirectionalLight,
    DiscLight,
    PointLight,
    RectangleLight,
    SphereLight,
    SpotLight,
    SunDisc,
    TubeLight,
)
from shadow_tracer.scene import patterns

_GOOD: dict[Any, dict[str, Any]] = {
    DiscLight: {"position": (0, 0, 3), "normal": (0, 0, -1), "radius": 0.5},
    RectangleLight: {"position": (0, 0, 3), "u": (1, 0, 0), "v": (0, 2, 0)},
    TubeLight: {"start": (0, 0, 3), "end": (1, 0, 3)},
    SunDisc: {"direction": (0, 0, -1)},
    SphereLight: {"position": (0, 0, 3), "radius": 0.5},
    PointLight: {"position": (0, 0, 3)},
    SpotLight: {"position": (0, 0, 3), "direction": (0, 0, -1), "outer_angle": 0.5},
    DirectionalLight: {"direction": (0, 0, -1)},
}
_AREA = (DiscLight, RectangleLight, TubeLight, SunDisc)
_SIZED = (*_AREA, SphereLight)


@pytest.mark.parametrize("count", [2, 3, 7, 16, 33, 64])
def test_points_lie_on_their_light(count: int) -> None:
    rng = np.random.default_rng(180)
    for _ in range(5):
        turn, at = geometry.rotation(rng), rng.normal(0, 5, 3)
        x, y, z = turn.T
        disc = DiscLight("d", at, 3.0 * z, 0.5, samples=count)
        local = (disc.points - at) @ turn
        assert abs(local[:, 2]).max() < 1e-14 and np.linalg.norm(local, axis=1).max() < 0.5
        panel = RectangleLight("r", at, 0.5 * x, 0.25 * y, samples=count)
        local = (panel.points - at) @ turn / (0.5, 0.25, 1.0)
        assert abs(local[:, 2]).max() < 1e-14 and abs(local[:, :2]).max() < 1.0
        np.testing.assert_allclose(panel.normal, z, atol=1e-14)
        tube = TubeLight("t", at - 2.0 * z, at + 2.0 * z, 0.1, samples=count)
        local = (tube.points - at) @ turn
        assert abs(local[:, 2]).max() < 2.0 and np.linalg.norm(local[:, :2], axis=1).max() < 0.1
        line = TubeLight("t", at - 2.0 * z, at + 2.0 * z, samples=count)
        np.testing.assert_allclose(
            (line.points - at) @ turn, np.outer(patterns.cylinder(count)[:, 2], (0, 0, 2.0)), atol=1e-14
        )
        sun = SunDisc("s", 7.0 * z, 0.25, count)
        angle = np.arccos(np.clip(sun.directions @ z / np.linalg.norm(sun.directions, axis=1), -1, 1))
        assert 0.05 < angle.max() < 0.125
        np.testing.assert_allclose(sun.directions @ z, 1.0, atol=1e-14)
        for light in (disc, panel, tube, line, sun):
            assert light.homogeneous_points.shape == (count, 4) and len(light.hard_lights()) == count
            for hard, point in zip(light.hard_lights(), light.homogeneous_points, strict=True):
                assert np.array_equal(hard.homogeneous, point)


def test_a_hammersley_set_of_64_fills_every_box() -> None:
    """One point in each of the 64 equal boxes of any shape; 64 different places along either side."""
    points = patterns.square(64)
    for digits in range(7):
        cells = np.floor((points + 1.0) / 2.0 * (2**digits, 2 ** (6 - digits))).astype(int)
        assert len({tuple(cell) for cell in cells.tolist()}) == 64
    assert all(len(np.unique(points[:, k])) == 64 for k in range(2))


def test_an_edge_along_a_side_takes_all_shares() -> None:
    seen = {int((patterns.square(64)[:, 0] < edge).sum()) for edge in np.linspace(-1, 1, 1000)}
    assert seen == set(range(65))


def test_patterns_are_even() -> None:
    """Any line through the disc's pattern has about as many points on a side as there is area; a tube is of even
    brightness across, seen from any side."""
    disc, tube = patterns.spiral(64), patterns.cylinder(64)
    for angle in np.linspace(0.0, 2.0 * np.pi, 100):
        across = np.array((np.cos(angle), np.sin(angle)))
        for at in np.linspace(-0.9, 0.9, 13):
            area = (np.arccos(at) - at * np.sqrt(1.0 - at * at)) / np.pi
            assert abs((disc @ across > at).mean() - area) < 0.06
            assert abs((tube[:, :2] @ across > at).mean() - (1.0 - at) / 2.0) < 0.07
    for half in (tube[:32], tube[32:]):  # the same along it
        assert np.linalg.norm(half[:, :2].mean(axis=0)) < 0.1


def test_the_tangent_is_right_to_the_last_bits() -> None:
    for angle in np.linspace(1e-9, math.pi / 4, 500):
        assert patterns.tangent(float(angle)) == pytest.approx(math.tan(angle), rel=4e-16)


def _middle(light: Any) -> np.ndarray:
    return (light.shines if isinstance(light, _SIZED) else light).homogeneous


@pytest.mark.parametrize("kind", _GOOD, ids=lambda kind: kind.__name__)
def test_what_all_lights_have(kind: Any) -> None:
    light = kind("lamp", **_GOOD[kind], ignore=["shade", "foot", "shade"])
    assert light.name == "lamp" and light.ignore == ("foot", "shade")
    assert kind("lamp", **_GOOD[kind]).ignore == ()
    moved = replace(light, ignore=["foot"])
    assert moved.ignore == ("foot",) and np.array_equal(_middle(moved), _middle(light))
    with pytest.raises(ValueError, match="^name: expected"):
        kind("", **_GOOD[kind])
    with pytest.raises(ValueError, match="^strength: expected a Strength"):
        kind("lamp", **_GOOD[kind], strength=30.0)
    with pytest.raises(ValueError, match=r"^ignore: expected.*write \['shade'\]"):
        kind("lamp", **_GOOD[kind], ignore="shade")
    with pytest.raises(ValueError, match="^ignore: expected"):
        kind("lamp", **_GOOD[kind], ignore=3)
    with pytest.raises(ValueError, match=r"^ignore\[1\]: expected"):
        kind("lamp", **_GOOD[kind], ignore=["shade", ""])


_NOT_LENGTHS = (0.0, -1.0, math.nan, math.inf, "wide", None, True, 2e50)
_BAD: list[tuple[Any, str, dict[str, Any]]] = [
    *[(kind, "samples", {"samples": value}) for kind in _AREA for value in (1, 0, 65, 3.0, True, None)],
    *[(kind, "range", {"range": value}) for kind in _AREA[:3] for value in (0.0, -1.0, math.nan, "far")],
    *[(kind, "two_sided", {"two_sided": value}) for kind in _AREA[:2] for value in (1, None, "yes")],
    *[(DiscLight, "radius", {"radius": value}) for value in _NOT_LENGTHS],
    (DiscLight, "radius", {"position": (0.0, 1e50, 0.0), "radius": 1e49}),
    (DiscLight, "normal", {"normal": (0, 0, 0)}),
    (DiscLight, "position", {"position": (0, 0)}),
    (RectangleLight, "u", {"u": (0, 0, 0)}),
    (RectangleLight, "v", {"v": (0, math.nan, 0)}),
    (RectangleLight, "v", {"v": (1, 1, 0)}),
    *[(TubeLight, "radius", {"radius": value}) for value in _NOT_LENGTHS if value != 0.0],
    (TubeLight, "end", {"end": (0, 0, 3)}),
    (TubeLight, "start", {"start": (0, 0, math.inf)}),
    *[(SunDisc, "angular_diameter", {"angular_diameter": value}) for value in (0.0, -1.0, 1.6, math.nan, "0.5", None)],
    (SunDisc, "direction", {"direction": (0, 0, 0)}),
]


@pytest.mark.parametrize(
    "kind,field,change", _BAD, ids=[f"{kind.__name__}-{field}-{k}" for k, (kind, field, _) in enumerate(_BAD)]
)
def test_errors_name_the_argument(kind: Any, field: str, change: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"^{field}: expected"):
        kind("lamp", **{**_GOOD[kind], **change})


def test_defaults() -> None:
    for kind in _AREA:
        light = kind("lamp", **_GOOD[kind])
        assert (light.range, light.samples) == (math.inf, 64)
    assert math.degrees(SunDisc("sun", (0, 0, -1)).angular_diameter) == pytest.approx(0.533)
    assert isinstance(DiscLight("d", **_GOOD[DiscLight]).shines, SpotLight)
    assert isinstance(DiscLight("d", **_GOOD[DiscLight], two_sided=True).shines, PointLight)
    assert not DiscLight("d", **_GOOD[DiscLight]).normal.flags.writeable
    assert not RectangleLight("r", **_GOOD[RectangleLight]).normal.flags.writeable
    assert not TubeLight("t", **_GOOD[TubeLight]).position.flags.writeable
