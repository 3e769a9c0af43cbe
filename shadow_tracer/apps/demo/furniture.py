# SPDX-License-Identifier: Apache-2.0
"""What stands in the demo workshop: racks, drums, pipes, a conveyor, a forklift."""

from __future__ import annotations

import numpy as np

from shadow_tracer.apps.demo.parts import (
    Colour,
    Floats,
    Part,
    box,
    cylinder,
    extrude,
    gear,
    join,
    lathe,
    rotation,
    translation,
    tube,
)
from shadow_tracer.apps.demo.robot import DARK, HAZARD, STEEL, across, along_x

CARDBOARD: tuple[Colour, ...] = ((0.76, 0.58, 0.38), (0.70, 0.52, 0.33), (0.80, 0.64, 0.45), (0.66, 0.50, 0.34))
TAPE = (0.88, 0.82, 0.66)
BLUE = (0.19, 0.37, 0.60)
BEAM = (0.93, 0.45, 0.10)
WOOD = (0.72, 0.56, 0.36)
DRUMS: tuple[Colour, ...] = ((0.12, 0.36, 0.68), (0.74, 0.14, 0.12), (0.10, 0.48, 0.38), (0.90, 0.70, 0.12))
CRATES: tuple[Colour, ...] = ((0.16, 0.46, 0.62), (0.78, 0.22, 0.16), (0.30, 0.33, 0.36), (0.20, 0.52, 0.28))
RUBBER = (0.09, 0.09, 0.10)


def carton(size: tuple[float, float, float], colour: Colour) -> Part:
    """A cardboard box standing on z = 0 with a strip of tape."""
    x, y, z = size
    tape = box((x + 0.004, 0.05, z + 0.004), TAPE, centre=(0, 0, z / 2))
    return join([box(size, colour, 0.012, (0, 0, z / 2)), tape])


def crate(size: tuple[float, float, float], colour: Colour) -> Part:
    """A plastic crate, open above, standing on z = 0."""
    x, y, z = size
    wall = 0.025
    rim = [box((x + 0.03, 0.04, 0.04), colour, 0.01, (0, s * (y / 2), z - 0.02)) for s in (-1, 1)]
    rim += [box((0.04, y + 0.03, 0.04), colour, 0.01, (s * (x / 2), 0, z - 0.02)) for s in (-1, 1)]
    walls = [box((x, wall, z), colour, centre=(0, s * (y - wall) / 2, z / 2)) for s in (-1, 1)]
    walls += [box((wall, y, z), colour, centre=(s * (x - wall) / 2, 0, z / 2)) for s in (-1, 1)]
    return join([box((x, y, wall), colour, centre=(0, 0, wall / 2)), *walls, *rim])


def drum(colour: Colour, height: float = 0.88, radius: float = 0.29) -> Part:
    """A steel drum with two ribs and a bung."""
    h, r = height, radius
    profile = [(0.0, 0.0), (r + 0.01, 0.0), (r + 0.01, 0.025), (r, 0.035)]
    for rib in (h / 3, 2 * h / 3):
        profile += [(r, rib - 0.03), (r + 0.014, rib), (r, rib + 0.03)]
    profile += [(r, h - 0.035), (r + 0.01, h - 0.025), (r + 0.01, h), (r - 0.015, h), (r - 0.02, h - 0.02)]
    return join(
        [lathe([*profile, (0.0, h - 0.02)], colour, 40), cylinder(0.035, 0.035, STEEL, 12).at(0.18, 0, h - 0.03)]
    )


def pallet(length: float = 1.2, width: float = 0.8) -> Part:
    """A wooden pallet, 0.14 m high."""
    deck = [box((length, 0.11, 0.022), WOOD, 0.004, (0, y, 0.129)) for y in np.linspace(-1, 1, 6) * (width / 2 - 0.055)]
    feet = [box((length, 0.09, 0.022), WOOD, 0.004, (0, y, 0.011)) for y in (-width / 2 + 0.05, 0, width / 2 - 0.05)]
    blocks = [
        box((0.12, 0.09, 0.096), WOOD, 0.004, (x, y, 0.07))
        for x in (-length / 2 + 0.06, 0, length / 2 - 0.06)
        for y in (-width / 2 + 0.05, 0, width / 2 - 0.05)
    ]
    return join([*deck, *feet, *blocks])


def pipe_stack(length: float, rows: int, radius: float, colour: Colour) -> Part:
    """Hollow pipes along x in a pyramid on z = 0."""
    pipe = along_x(lathe([(0.8 * radius, 0), (radius, 0), (radius, length), (0.8 * radius, length)], colour, 20, True))
    items = []
    for row in range(rows):
        for k in range(rows - row):
            y = (k - (rows - row - 1) / 2) * 2.02 * radius
            items.append(pipe.at(-length / 2 + 0.04 * ((k * 7 + row * 3) % 4), y, radius * (1 + row * 1.76)))
    return join(items)


def tyre(radius: float, tube_radius: float, colour: Colour = RUBBER) -> Part:
    """A tyre lying on z = 0."""
    a = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = [(radius - tube_radius + tube_radius * np.cos(t), tube_radius * (1 + 0.8 * np.sin(t))) for t in a]
    return lathe(ring, colour, 28, closed=True)


def wheel(radius: float, width: float) -> Part:
    """A wheel about the y axis with a rim and wheel nuts."""
    rubber = cylinder(radius, width, RUBBER, 36, bevel=0.03).at(0, 0, -width / 2)
    hub = cylinder(0.55 * radius, width + 0.03, HAZARD, 28, bevel=0.02).at(0, 0, -width / 2 - 0.015)
    nuts = [
        cylinder(0.025, width + 0.07, STEEL, 6).at(
            0.36 * radius * np.cos(a), 0.36 * radius * np.sin(a), -width / 2 - 0.035
        )
        for a in np.linspace(0, 2 * np.pi, 5, endpoint=False)
    ]
    return across(join([rubber, hub, *nuts]))


def rack(bays: int, rng: np.random.Generator, width: float = 2.3, depth: float = 1.0, levels: int = 3) -> Part:
    """A pallet rack along x from x = 0, its back at y = 0 and its front at y = -depth, filled with goods."""
    height, step = 0.45 + levels * 1.05, 1.12
    parts: list[Part] = []
    for i in range(bays + 1):
        x = i * width
        for y in (-0.05, -depth + 0.05):
            parts.append(box((0.09, 0.08, height + 0.3), BLUE, 0.012, (x, y, (height + 0.3) / 2)))
            parts.append(box((0.18, 0.16, 0.02), BLUE, 0.004, (x, y, 0.01)))
        zig = np.linspace(0.2, height, 7)
        ys = np.where(np.arange(7) % 2 == 0, -0.05, -depth + 0.05)
        parts.append(tube(np.column_stack([np.full(7, x), ys, zig]), 0.018, BLUE, 8))
    for i in range(bays):
        for level in range(levels):
            z = 0.15 + level * step
            x = (i + 0.5) * width
            for y in (-0.05, -depth + 0.05):
                parts.append(box((width - 0.09, 0.05, 0.11), BEAM, 0.012, (x, y, z)))
            slats = np.linspace(-depth + 0.12, -0.12, 6)
            parts += [box((width - 0.1, 0.09, 0.025), WOOD, centre=(x, y, z + 0.065)) for y in slats]
            parts.append(_goods(int(rng.integers(0, 5)), width - 0.3, rng).at(x, -depth / 2, z + 0.08))
    return join(parts)


def _goods(kind: int, width: float, rng: np.random.Generator) -> Part:
    """One shelf of goods centred on x = y = 0 above z = 0."""
    if kind == 0:
        colour = DRUMS[int(rng.integers(len(DRUMS)))]
        return join([drum(colour, 0.80, 0.26).at(x, 0.05 * (-1) ** k, 0) for k, x in enumerate((-0.68, -0.08, 0.54))])
    if kind == 1:
        return pipe_stack(width, 4, 0.10, (0.62, 0.64, 0.66))
    if kind == 2:
        stacks = [tyre(0.33, 0.10).at(x, 0.02 * k, 0.19 * k) for x in (-0.66, 0.05, 0.75) for k in range(4)]
        return join(stacks)
    parts: list[Part] = []
    x = -width / 2.0
    while x < width / 2 - 0.35:
        w, d = float(rng.uniform(0.35, 0.6)), float(rng.uniform(0.5, 0.75))
        z = 0.0
        for _ in range(int(rng.integers(1, 3))):
            h = float(rng.uniform(0.24, 0.42))
            turn = rotation("z", rng.uniform(-0.08, 0.08))
            if kind == 3:
                item = carton((w - 0.04, d, h), CARDBOARD[int(rng.integers(len(CARDBOARD)))])
            else:
                item = crate((w - 0.05, d, h * 0.8), CRATES[int(rng.integers(len(CRATES)))])
                h *= 0.8
            parts.append(item.moved(translation(x + w / 2, 0, z) @ turn))
            z += h + 0.004
        x += w
    return join(parts)


def fence(points: Floats, height: float = 1.5) -> Part:
    """A wire fence along a (P, 2) line on the floor: posts, rails and upright bars."""
    parts: list[Part] = []
    for a, b in zip(points, points[1:], strict=False):
        length = float(np.linalg.norm(b - a))
        for p in (a, b):
            parts.append(box((0.07, 0.07, height + 0.08), HAZARD, 0.01, (p[0], p[1], (height + 0.08) / 2)))
        for z in (0.15, height / 2, height):
            parts.append(tube([[*a, z], [*b, z]], 0.016, DARK, 8))
        for s in np.linspace(0, 1, int(length / 0.13) + 1)[1:-1]:
            x, y = a + s * (b - a)
            parts.append(tube([[x, y, 0.15], [x, y, height]], 0.009, DARK, 6))
    return join(parts)


def conveyor(length: float, width: float = 0.8, height: float = 0.8) -> Part:
    """A roller conveyor along x, from x = 0, with a tunnel at both ends."""
    parts: list[Part] = []
    for s in (-1, 1):
        parts.append(box((length, 0.06, 0.16), BLUE, 0.012, (length / 2, s * (width / 2 + 0.05), height - 0.03)))
    roller = across(cylinder(0.045, width, STEEL, 14).at(0, 0, -width / 2))
    parts += [roller.at(x, 0, height - 0.045) for x in np.arange(0.1, length, 0.14).tolist()]
    for x in np.linspace(0.3, length - 0.3, 4).tolist():
        for s in (-1, 1):
            parts.append(box((0.08, 0.08, height - 0.1), DARK, 0.01, (x, s * (width / 2 + 0.02), (height - 0.1) / 2)))
    for end in (0.15, length - 0.15):
        for s in (-1, 1):
            parts.append(box((0.8, 0.05, 0.62), STEEL, 0.015, (end, s * (width / 2 + 0.1), height + 0.24)))
        parts.append(box((0.8, width + 0.25, 0.05), HAZARD, 0.015, (end, 0, height + 0.56)))
    return join(parts)


def bench() -> Part:
    """A work bench with a vice, gears and tins on it, 1.8 m along x, centred, standing on z = 0."""
    parts = [box((1.8, 0.8, 0.06), WOOD, 0.012, (0, 0, 0.87)), box((1.6, 0.6, 0.03), STEEL, 0.005, (0, 0, 0.25))]
    parts += [box((0.07, 0.07, 0.84), BLUE, 0.01, (x, y, 0.42)) for x in (-0.83, 0.83) for y in (-0.33, 0.33)]
    parts.append(gear(0.24, 0.09, 20, STEEL).at(-0.5, 0.05, 0.95))
    parts.append(gear(0.15, 0.09, 13, (0.78, 0.60, 0.30)).at(-0.13, -0.12, 0.95))
    parts.append(gear(0.20, 0.08, 17, (0.55, 0.57, 0.60)).moved(translation(0.1, 0.24, 1.09) @ rotation("x", 1.30)))
    parts += [cylinder(0.06, 0.16, DRUMS[k], 20, 0.01).at(0.42 + 0.16 * k, 0.22 - 0.05 * k, 0.90) for k in range(3)]
    parts += [
        box((0.16, 0.12, 0.16), BLUE, 0.02, (0.55, -0.2, 0.98)),
        box((0.10, 0.2, 0.08), STEEL, 0.01, (0.68, -0.2, 1.06)),
    ]
    return join(parts)


def forklift() -> tuple[Part, Part, Part]:
    """Body, wheel and fork carriage of a forklift that faces +x; the body stands on z = 0."""
    yellow, grey = (0.96, 0.72, 0.06), (0.28, 0.29, 0.31)
    weight = across(
        extrude(
            [(-1.15, 0.32), (-0.55, 0.28), (-0.40, 0.55), (-0.45, 1.0), (-1.0, 1.02), (-1.22, 0.75)], 1.06, yellow, 0.07
        )
    )
    parts = [
        weight,
        box((1.5, 0.96, 0.34), grey, 0.05, (0.05, 0, 0.46)),
        box((0.75, 1.0, 0.12), yellow, 0.04, (0.45, 0, 0.64)),
    ]
    parts += [box((0.5, 0.5, 0.12), DARK, 0.05, (-0.15, 0, 0.86)), box((0.12, 0.5, 0.5), DARK, 0.05, (-0.42, 0, 1.15))]
    parts.append(box((0.22, 0.9, 0.5), yellow, 0.05, (0.62, 0, 0.85)))
    for s in (-0.46, 0.46):
        parts.append(
            tube([(-0.55, s, 1.0), (-0.50, s, 1.5), (-0.38, s, 2.08), (0.42, s, 2.10), (0.66, s, 1.0)], 0.032, DARK, 12)
        )
    parts += [tube([(x, -0.46, 2.09), (x, 0.46, 2.09)], 0.022, DARK, 10) for x in np.linspace(-0.34, 0.38, 7)]
    column = tube([(0.50, 0, 0.9), (0.28, 0, 1.22)], 0.025, DARK)
    steer = tyre(0.17, 0.022, DARK).moved(translation(0.28, 0, 1.20) @ rotation("y", -0.6))
    beacon = cylinder(0.07, 0.13, BEAM, 20, 0.02).at(-0.30, 0.3, 2.12)
    parts += [column, steer, beacon]
    for s in (-0.32, 0.32):
        parts.append(box((0.11, 0.09, 2.15), grey, 0.015, (0.90, s, 1.15)))
    parts += [box((0.08, 0.60, 0.10), grey, 0.015, (0.90, 0, z)) for z in (0.25, 2.18)]
    carriage = [
        box((0.05, 0.9, 0.40), DARK, 0.012, (0.99, 0, 0.32)),
        box((0.05, 0.9, 0.06), DARK, 0.01, (0.99, 0, 1.15)),
    ]
    carriage += [box((0.04, 0.04, 0.75), DARK, 0.008, (0.99, y, 0.8)) for y in np.linspace(-0.42, 0.42, 6)]
    carriage += [box((1.15, 0.12, 0.045), STEEL, 0.012, (1.55, y, 0.07)) for y in (-0.25, 0.25)]
    load = [pallet().at(1.62, 0, 0.10), carton((0.56, 0.72, 0.52), CARDBOARD[0]).at(1.34, 0, 0.24)]
    load += [
        drum(DRUMS[1], 0.80, 0.26).at(1.94, 0.05, 0.24),
        carton((0.42, 0.44, 0.34), CARDBOARD[2]).at(1.33, 0.05, 0.764),
    ]
    return join(parts), wheel(0.30, 0.24), join([*carriage, *load])
