# SPDX-License-Identifier: Apache-2.0
"""A robot with a UV-C tube in a room: where plans let it stand, and what the room has received then.

    python benchmark/pictures_dose.py

prints the plans and what is remaining, and draws ``docs/images/dose.png``. With ``--accuracy`` it prints how far sums
over the points of lamps are from sums over a million pieces of them, as in ``docs/dose.md``.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from shadow_tracer import (
    DiscLight,
    DoseMap,
    RectangleLight,
    ShadowTracer,
    SphereLight,
    Stop,
    Strength,
    TubeLight,
    irradiance_matrix,
    plan_positions,
)
from shadow_tracer.gpu.visibility.irradiance import irradiance_of
from shadow_tracer.scene.patterns import across

_OUT = Path(__file__).resolve().parents[1] / "docs" / "images" / "dose.png"
_TARGET = 280.0  # J/m2: 28 mJ/cm2
_FURNITURE = {
    "bed": ((-2.9, -1.0, 0.3), (-0.9, 0.0, 0.55)),
    "cabinet": ((2.4, -1.9, 0.0), (2.95, -0.7, 1.6)),
    "table": ((0.6, 0.7, 0.68), (1.8, 1.4, 0.74)),
}


def _box(low: Any, high: Any, inwards: bool = False) -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([[(low, high)[k >> axis & 1][axis] for axis in range(3)] for k in range(8)], float)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = np.array([part for a, b, c, d in quads for part in ((a, b, c), (a, c, d))])
    return corners, triangles[:, ::-1] if inwards else triangles


def _stop(x: float, y: float) -> Stop:
    lamp = TubeLight("uv", (x, y, 0.5), (x, y, 1.5), 0.013, strength=Strength(power=60.0))
    pose = np.eye(4)
    pose[:2, 3] = x, y
    return Stop([lamp], {"robot": pose})


def draw() -> None:
    """Plan, expose, draw."""
    tracer = ShadowTracer()
    tracer.scene.put("room", *_box((-3, -2, 0), (3, 2, 2.5), inwards=True))
    for name, sides in _FURNITURE.items():
        tracer.scene.put(name, *_box(*sides))
    tracer.scene.put("robot", *_box((-0.25, -0.25, 0.05), (0.25, 0.25, 0.4)))
    stops = [_stop(x, y) for x in (-2.4, -1.2, 0.0, 1.2, 2.0) for y in (-1.5, 0.3, 1.6)]
    coarse, fine = DoseMap(tracer, "room", 0.2), DoseMap(tracer, "room", 0.04)
    matrix = irradiance_matrix(coarse, stops)
    plans = {
        name: plan_positions(coarse, stops, _TARGET, 0.9, 20.0, name, matrix=matrix) for name in ("greedy", "highs")
    }
    for name, plan in plans.items():
        print(f"{name}: {len(plan.stops)} places, {plan.total:.0f} s, covers {100 * plan.coverage[-1]:.1f} %")
    plan = plans["highs"]
    images = []
    for part in (0.4, 0.6):
        for number, seconds in zip(plan.stops, plan.seconds, strict=True):
            tracer.scene.move("robot", stops[number].poses["robot"])
            fine.add(stops[number].lights, part * seconds)
        fine.picture(_OUT, _TARGET)
        images.append(Image.open(_OUT).convert("RGB"))
    left = fine.remaining(stops[plan.stops[-1]].lights, _TARGET)
    print(f"{len(fine)} texels of {fine.area.sum():.1f} m2, {100 * fine.coverage(_TARGET):.1f} % has {_TARGET:g} J/m2")
    print(f"never reached: {fine.area[fine.never_reached].sum():.2f} m2; for ever out of reach from there: "
          f"{fine.area[np.isinf(left)].sum():.2f} m2")  # fmt: skip
    sheet = Image.new("RGB", (sum(image.width for image in images), images[0].height), "white")
    for number, image in enumerate(images):
        sheet.paste(image, (number * image.width, 0))
    sheet = sheet.resize((1480, sheet.height * 1480 // sheet.width), Image.Resampling.LANCZOS)
    sheet.quantize(224, dither=Image.Dither.NONE).save(_OUT, optimize=True)
    print(_OUT, _OUT.stat().st_size)


def _pieces(light: Any, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Places on a lamp, evenly in a grid, and their normals."""
    k = np.arange(count) + 0.5
    a, b = (2.0 * axis.ravel() / count - 1.0 for axis in np.meshgrid(k, k))
    a, b = a[:, None], b[:, None]
    if isinstance(light, RectangleLight):
        return light.position + a * light.u + b * light.v, light.normal
    if isinstance(light, DiscLight):
        forward, u, v = across(*light.normal.tolist())
        ring = light.radius * np.sqrt(0.5 * (a + 1.0))
        return light.position + ring * (np.cos(math.pi * b) * u + np.sin(math.pi * b) * v), forward
    if isinstance(light, TubeLight):
        half = 0.5 * (light.end - light.start)
        _, u, v = across(*half.tolist())
        out = np.cos(math.pi * b) * u + np.sin(math.pi * b) * v
        return light.position + a * half + light.radius * out, out
    ring = np.sqrt(1.0 - a * a)
    out = np.concatenate([ring * np.cos(math.pi * b), ring * np.sin(math.pi * b), a], axis=1)
    return light.position + light.radius * out, out


def accuracy() -> None:
    """Worst difference over places and normals, as a share of what the lamp gives to a surface that faces it."""
    power = Strength(power=math.pi)
    lamps: dict[str, tuple[Any, float]] = {
        "tube": (TubeLight("tube", (-0.5, 0, 0), (0.5, 0, 0), 0.013, strength=power), 1.0),
        "disc": (DiscLight("disc", (0, 0, 0), (0, 0, -1), 0.5, strength=power), 1.0),
        "rectangle": (RectangleLight("panel", (0, 0, 0), (0.5, 0, 0), (0, -0.5, 0), strength=power), 1.0),
        "sphere": (SphereLight("bulb", (0, 0, 0), 0.5, samples=64, strength=power), 1.0),
        "sphere, 32": (SphereLight("bulb", (0, 0, 0), 0.5, strength=power), 1.0),
    }
    random = np.random.default_rng(4)
    for name, (light, size) in lamps.items():
        for distance in (0.25, 0.5, 1.0, 2.0):
            worst = {"all of it above": 0.0, "cut": 0.0}
            places, normals = _pieces(light, 600)
            for _ in range(60):
                point = np.array([*random.uniform(-0.5, 0.5, 2), 0.0]) * size
                point[2] = -distance * size - (light.radius if isinstance(light, SphereLight) else 0.0)
                normal = random.normal(size=(1, 3))
                normal[0, 2] = abs(normal[0, 2])
                normal /= np.linalg.norm(normal)
                v = places - point
                square = (v * v).sum(axis=1)
                turned = np.maximum(-(v * normals).sum(axis=1), 0.0) / square**2 / len(places)
                facing = np.sqrt(((turned[:, None] * v).sum(axis=0) ** 2).sum())
                cosine = v @ normal[0]
                expected = (turned * np.maximum(cosine, 0.0)).sum() / facing
                scale = 1.0 / facing / (math.pi * math.pi / math.pi)
                bits = np.array([2**64 - 1], np.uint64)
                found = irradiance_of(light, point[None], normal, bits)[0] * scale * math.pi
                key = "all of it above" if cosine.min() > 0.0 else "cut"
                worst[key] = max(worst[key], abs(found - expected))
            print(f"{name:12} {distance:5} m", {key: f"{100 * value:.2f} %" for key, value in worst.items()})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--accuracy", action="store_true", help="print how exact irradiance is, in place of the picture"
    )
    accuracy() if parser.parse_args().accuracy else draw()
