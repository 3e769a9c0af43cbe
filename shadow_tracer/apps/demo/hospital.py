# SPDX-License-Identifier: Apache-2.0
"""A hospital room and a robot with a lamp, made by code: the stage of `shadow_tracer demo --uv`."""

from __future__ import annotations

from shadow_tracer.apps.demo.parts import Colour, Part, box, cylinder, join, rotation, tube

WIDE, DEEP, HIGH = 7.2, 5.2, 2.7  # of the room [m]
WHITE: Colour = (0.93, 0.94, 0.95)
STEEL: Colour = (0.66, 0.68, 0.70)
BODY: Colour = (0.20, 0.32, 0.42)
GLASS: Colour = (0.86, 0.72, 1.0)
RADIUS = 0.27  # of the robot [m]
LAMP = (0.55, 1.55, 0.03)  # where the tube begins and ends above the floor, and its radius [m]


def _inwards(part: Part) -> Part:
    """Seen from within."""
    return Part(part.vertices, part.triangles[:, ::-1].copy(), part.colours)


def _bed() -> Part:
    """Two metres along x from the wall at x = 0, one across, with rails and a pillow."""
    parts = [box((2.0, 0.9, 0.16), WHITE, 0.03, (1.05, 0, 0.58)), box((1.9, 0.8, 0.10), STEEL, 0.02, (1.05, 0, 0.42))]
    parts += [box((0.05, 0.95, 0.5), STEEL, 0.015, (x, 0, 0.72)) for x in (0.05, 2.08)]
    parts += [box((1.0, 0.04, 0.2), STEEL, 0.01, (1.2, s * 0.5, 0.74)) for s in (-1, 1)]
    parts += [cylinder(0.04, 0.38, STEEL, 10).at(x, y, 0.0) for x in (0.2, 1.9) for y in (-0.35, 0.35)]
    return join([*parts, box((0.4, 0.6, 0.12), WHITE, 0.05, (0.35, 0, 0.72))])


def _table() -> Part:
    """For over a bed, on one leg."""
    top = box((0.5, 0.8, 0.04), WHITE, 0.01, (0, 0, 0.95))
    return join(
        [
            top,
            box((0.06, 0.06, 0.9), STEEL, 0.01, (-0.2, -0.33, 0.5)),
            box((0.45, 0.7, 0.05), STEEL, 0.01, (0, 0, 0.08)),
        ]
    )


def _chair() -> Part:
    seat = [box((0.45, 0.45, 0.05), WHITE, 0.015, (0, 0, 0.45)), box((0.05, 0.45, 0.5), WHITE, 0.015, (-0.21, 0, 0.75))]
    return join([*seat, *(cylinder(0.02, 0.43, STEEL, 8).at(x, y, 0) for x in (-0.18, 0.18) for y in (-0.18, 0.18))])


def _stand() -> Part:
    """For infusions."""
    legs = [box((0.5, 0.03, 0.03), STEEL, 0.005, (0, 0, 0.05)).moved(rotation("z", a)) for a in (0.0, 1.05, 2.1)]
    bag = box((0.10, 0.04, 0.2), WHITE, 0.015, (0.12, 0, 1.62))
    return join(
        [*legs, cylinder(0.015, 1.75, STEEL, 8), tube([(-0.13, 0, 1.75), (0.13, 0, 1.75)], 0.01, STEEL, 6), bag]
    )


def room() -> Part:
    """Floor, walls, ceiling and what stands there; all of it is seen from where one can stand. The floor is z = 0."""
    shell = _inwards(box((WIDE, DEEP, HIGH), WHITE, centre=(0, 0, HIGH / 2)))
    left = -WIDE / 2 + 0.02
    parts = [shell]
    for y in (-1.45, 1.35):
        parts += [_bed().at(left, y, 0), box((0.45, 0.45, 0.7), WHITE, 0.015, (left + 0.26, y + 0.85, 0.35))]
        parts.append(_stand().at(left + 0.45, y - 0.75, 0))
    parts += [_table().at(left + 1.5, -0.55, 0), _chair().moved(rotation("z", 2.4)).at(left + 2.1, 2.15, 0)]
    parts.append(box((1.6, 0.04, 1.9), WHITE, 0.01, (left + 1.2, -0.02, 1.25)))  # a screen between the beds
    parts.append(box((0.6, 1.2, 2.0), WHITE, 0.015, (WIDE / 2 - 0.31, 1.7, 1.0)))  # a cupboard
    parts.append(box((0.55, 1.5, 0.85), WHITE, 0.015, (WIDE / 2 - 0.29, -1.6, 0.425)))  # a chest with a basin
    parts.append(box((0.35, 0.5, 0.12), STEEL, 0.02, (WIDE / 2 - 0.29, -1.6, 0.92)))
    parts += [box((0.9, 0.9, 0.04), WHITE, 0.01, (1.6, 1.6, 0.74)), cylinder(0.05, 0.72, STEEL, 12).at(1.6, 1.6, 0)]
    parts += [_chair().at(0.85, 1.6, 0), _chair().moved(rotation("z", 1.57)).at(1.6, 0.85, 0)]
    return join(parts)


def robot() -> tuple[Part, Part]:
    """What of it casts shadows, and the tube, which is the lamp."""
    low, high, radius = LAMP
    base = [cylinder(RADIUS, 0.28, BODY, 28, 0.03).at(0, 0, 0.05), cylinder(0.16, 0.2, BODY, 24, 0.02).at(0, 0, 0.3)]
    ends = [cylinder(0.06, 0.05, STEEL, 16).at(0, 0, low - 0.05), cylinder(0.06, 0.04, STEEL, 16).at(0, 0, high)]
    return join([*base, *ends]), cylinder(radius, high - low, GLASS, 12).at(0, 0, low)
