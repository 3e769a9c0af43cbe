# SPDX-License-Identifier: Apache-2.0
"""Irradiance by other ways than the package's: sums over a hundred thousand pieces of a lamp, and formulas from books;
and IES files.

Pieces are made with random numbers or grids; nothing here uses a light's own points.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from shadow_tracer import DiscLight, RectangleLight, SphereLight, TubeLight
from shadow_tracer.scene.checks import FloatArray
from shadow_tracer.scene.patterns import across

ALL = np.uint64(2**64 - 1)
_FILE = """IESNA:LM-63-2002
[TEST] none
[TESTLAB] none
[ISSUEDATE] 2026
[MANUFAC] nobody
TILT=NONE
1 -1 {multiplier} {vertical} {horizontal} {kind} 2 0 0 0
{ballast} 1 0
{angles}
{around}
{values}
"""


def keitz(power: float, length: float, distance: float) -> float:
    """Of a Lambertian tube, opposite its middle, on a plane that faces it [W/m2]."""
    angle = math.atan(0.5 * length / distance)
    return power * (2.0 * angle + math.sin(2.0 * angle)) / (2.0 * math.pi**2 * distance * length)


def disc_parallel(radiance: float, radius: float, height: float, aside: float) -> float:
    """Of a Lambertian disc, on a plane parallel to it, ``aside`` from its axis (Naylor's or Foote's formula)."""
    h2, r2, a2 = height**2, radius**2, aside**2
    return 0.5 * math.pi * radiance * (1.0 - (a2 + h2 - r2) / math.sqrt((a2 + h2 + r2) ** 2 - 4.0 * a2 * r2))


def rectangle_corner(radiance: float, width: float, height: float, distance: float) -> float:
    """Of a Lambertian rectangle, on a plane parallel to it, opposite a corner."""
    x, y = width / distance, height / distance
    return (
        0.5
        * radiance
        * (
            x / math.sqrt(1.0 + x * x) * math.atan(y / math.sqrt(1.0 + x * x))
            + y / math.sqrt(1.0 + y * y) * math.atan(x / math.sqrt(1.0 + y * y))
        )
    )


def pieces(light: Any, count: int, seed: int = 1) -> tuple[FloatArray, FloatArray]:
    """(count, 3) random places, even over the surface of a lamp, and their (count, 3) normals."""
    random = np.random.default_rng(seed)
    a, b = random.uniform(-1.0, 1.0, (2, count))[..., None]
    if isinstance(light, RectangleLight):
        return light.position + a * light.u + b * light.v, np.broadcast_to(light.normal, (count, 3))
    turn = math.pi * b
    if isinstance(light, DiscLight):
        forward, u, v = across(*light.normal.tolist())
        ring = light.radius * np.sqrt(0.5 * (a + 1.0))
        return light.position + ring * (np.cos(turn) * u + np.sin(turn) * v), np.broadcast_to(forward, (count, 3))
    if isinstance(light, SphereLight):
        ring = np.sqrt(1.0 - a * a)
        out = np.concatenate([ring * np.cos(turn), ring * np.sin(turn), a], axis=1)
        return light.position + light.radius * out, out
    assert isinstance(light, TubeLight)
    half = 0.5 * (light.end - light.start)
    _, u, v = across(*half.tolist())
    out = np.cos(turn) * u + np.sin(turn) * v
    return light.position + a * half + light.radius * out, out


def contributions(light: Any, area: float, point: Any, normal: Any, count: int) -> tuple[FloatArray, FloatArray]:
    """(count, 3) pieces of a Lambertian lamp of radiance 1 W/m2/sr, and (count,) what each gives to a sample [W/m2]."""
    places, normals = pieces(light, count)
    v = places - point
    square = (v * v).sum(axis=1)
    turned = -(v * normals).sum(axis=1)
    turned = np.abs(turned) if getattr(light, "two_sided", False) else np.maximum(turned, 0.0)
    return places, area / count * turned * np.maximum(v @ normal, 0.0) / square**2


def ies(
    folder: Path,
    around: tuple[float, ...] = (0.0,),
    values: Any = ((100.0, 50.0, 0.0),),
    kind: int = 1,
    multiplier: float = 1.0,
    ballast: float = 1.0,
) -> Path:
    """A file of the vertical angles 0, 45 and 90 degrees."""
    path = folder / "lamp.ies"
    rows = "\n".join(" ".join(f"{value:g}" for value in row) for row in values)
    path.write_text(
        _FILE.format(
            multiplier=multiplier,
            vertical=3,
            horizontal=len(around),
            kind=kind,
            ballast=ballast,
            angles="0 45 90",
            around=" ".join(f"{angle:g}" for angle in around),
            values=rows,
        )
    )
    return path
