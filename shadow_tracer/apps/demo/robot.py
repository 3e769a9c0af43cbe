# SPDX-License-Identifier: Apache-2.0
"""A six-axis robot arm made of rigid links, posed by forward kinematics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from shadow_tracer.apps.demo.parts import (
    Floats,
    Part,
    box,
    capsule_outline,
    cylinder,
    extrude,
    gear,
    join,
    lathe,
    rotation,
    translation,
    tube,
)

ORANGE = (0.92, 0.46, 0.14)
DARK = (0.17, 0.18, 0.20)
STEEL = (0.66, 0.68, 0.70)
HAZARD = (0.95, 0.76, 0.10)

# Each joint: fixed offset from the joint before [m], then the axis it turns about.
JOINTS = (
    ((0.0, 0.0, 0.42), "z"),
    ((0.28, 0.0, 0.62), "y"),
    ((0.0, 0.0, 1.15), "y"),
    ((0.32, 0.0, 0.16), "x"),
    ((0.78, 0.0, 0.0), "y"),
    ((0.16, 0.0, 0.0), "x"),
)


def forward_kinematics(base: Floats, angles: Sequence[float]) -> list[Floats]:
    """Poses of the base and the six links, (4, 4) each.

    Args:
        base: (4, 4) pose of the robot's foot.
        angles: six joint angles, radians.

    Raises:
        ValueError: if there are not six angles.
    """
    if len(angles) != len(JOINTS):
        raise ValueError(f"angles: must hold {len(JOINTS)} joint angles, got {len(angles)}")
    poses = [np.asarray(base, dtype=np.float64)]
    for (offset, axis), angle in zip(JOINTS, angles, strict=True):
        poses.append(poses[-1] @ translation(*offset) @ rotation(axis, angle))
    return poses


def across(part: Part) -> Part:
    """Lays a part standing on z over to the y axis (x stays, z becomes -y)."""
    return part.moved(rotation("x", np.pi / 2))


def upright(part: Part) -> Part:
    """Turns a part that reaches along x so that it reaches along z."""
    return part.moved(rotation("y", -np.pi / 2))


def along_x(part: Part) -> Part:
    """Turns a part standing on z so that it reaches along x."""
    return part.moved(rotation("y", np.pi / 2))


def _joint(radius: float, width: float, cap: tuple[float, float, float] = DARK) -> Part:
    """A joint housing about the y axis with dark caps and a ring of bolts."""
    shell = cylinder(radius, width, ORANGE, 40, bevel=0.03).at(0, 0, -width / 2)
    lid = cylinder(radius * 0.72, 0.05, cap, 36, bevel=0.015)
    parts = [shell, lid.at(0, 0, width / 2 - 0.005), lid.at(0, 0, -width / 2 - 0.045)]
    for angle in np.linspace(0, 2 * np.pi, 8, endpoint=False):
        bolt = cylinder(0.018, 0.03, STEEL, 8)
        x, y = 0.86 * radius * np.cos(angle), 0.86 * radius * np.sin(angle)
        parts += [bolt.at(x, y, width / 2 - 0.01), bolt.at(x, y, -width / 2 - 0.02)]
    return across(join(parts))


def _base() -> Part:
    foot = cylinder(0.46, 0.10, DARK, 48, bevel=0.03)
    cone = lathe([(0.0, 0.09), (0.40, 0.09), (0.40, 0.14), (0.31, 0.30), (0.31, 0.42), (0.0, 0.42)], ORANGE, 48)
    socket = box((0.30, 0.24, 0.18), DARK, 0.03, (-0.36, 0.0, 0.19))
    bolts = [cylinder(0.03, 0.05, STEEL, 6).at(0.41 * np.cos(a), 0.41 * np.sin(a), 0.09)
             for a in np.linspace(0, 2 * np.pi, 10, endpoint=False)]  # fmt: skip
    return join([foot, cone, socket, *bolts])


def _turret() -> Part:
    disc = cylinder(0.37, 0.18, ORANGE, 48, bevel=0.04)
    cheek = extrude(capsule_outline(0.55, 0.30, 0.24), 0.10, ORANGE, 0.03).moved(rotation("z", np.arctan2(0.52, 0.28)))
    cheeks = across(join([cheek.at(0, 0, 0.22), cheek.at(0, 0, -0.22)])).at(0.02, 0, 0.10)
    motor = along_x(cylinder(0.13, 0.36, DARK, 28, bevel=0.03)).at(-0.46, 0.0, 0.32)
    hub = box((0.42, 0.30, 0.34), ORANGE, 0.06, (-0.04, 0.0, 0.32))
    return join([disc, cheeks, motor, hub])


def _upper_arm() -> Part:
    spar = upright(across(extrude(capsule_outline(1.15, 0.23, 0.18, 18), 0.24, ORANGE, 0.04)))
    stripe = upright(across(extrude(capsule_outline(0.62, 0.11, 0.09), 0.27, DARK, 0.02))).at(0, 0, 0.27)
    hose = tube(_arc((-0.05, 0.19, 0.05), (-0.32, 0.24, 0.60), (-0.02, 0.19, 1.15)), 0.028, DARK, 12)
    return join([_joint(0.25, 0.34), spar, stripe, hose])


def _elbow() -> Part:
    barrel = along_x(lathe([(0.0, -0.30), (0.16, -0.30), (0.20, -0.26), (0.20, 0.10), (0.17, 0.22), (0.0, 0.22)],
                           ORANGE, 40)).at(0.10, 0, 0.16)  # fmt: skip
    motors = [along_x(cylinder(0.06, 0.20, DARK, 20, bevel=0.02)).at(-0.38, y, 0.16 + z)
              for y, z in ((0.085, 0.05), (-0.085, 0.05), (0.0, -0.085))]  # fmt: skip
    return join([_joint(0.21, 0.30), barrel, *motors])


def _forearm() -> Part:
    cone = along_x(lathe([(0.0, 0.0), (0.165, 0.0), (0.165, 0.06), (0.105, 0.50), (0.105, 0.62), (0.0, 0.62)],
                         ORANGE, 40))  # fmt: skip
    ring = along_x(lathe([(0.10, 0.0), (0.15, 0.0), (0.15, 0.05), (0.10, 0.05)], DARK, 40, closed=True)).at(0.07, 0, 0)
    fork = [box((0.30, 0.05, 0.17), ORANGE, 0.02, (0.70, y, 0.0)) for y in (-0.105, 0.105)]
    hose = tube(_arc((-0.05, 0.14, 0.10), (0.25, 0.22, 0.20), (0.66, 0.14, 0.06)), 0.022, DARK, 12)
    return join([cone, ring, hose, *fork])


def _wrist() -> Part:
    ball = across(cylinder(0.105, 0.15, DARK, 32, bevel=0.03).at(0, 0, -0.075))
    neck = along_x(cylinder(0.085, 0.16, ORANGE, 32, bevel=0.02))
    return join([ball, neck])


def _tool() -> Part:
    flange = along_x(cylinder(0.10, 0.04, STEEL, 32, bevel=0.01))
    body = box((0.12, 0.34, 0.14), DARK, 0.025, (0.10, 0.0, 0.0))
    fingers = [box((0.24, 0.035, 0.09), STEEL, 0.01, (0.26, y, 0.0)) for y in (-0.135, 0.135)]
    pads = [box((0.10, 0.02, 0.10), HAZARD, 0.005, (0.32, 0.8 * y, 0.0)) for y in (-0.135, 0.135)]
    held = across(gear(0.20, 0.14, 18, STEEL)).at(0.40, 0.0, 0.0)
    return join([flange, body, held, *fingers, *pads])


def _arc(start: Sequence[float], middle: Sequence[float], end: Sequence[float], steps: int = 14) -> Floats:
    """(steps, 3) points of a smooth curve through three points."""
    a, b, c = (np.asarray(p, dtype=np.float64) for p in (start, middle, end))
    t = np.linspace(0, 1, steps)[:, None]
    bend = 2 * b - (a + c) / 2
    return np.asarray((1 - t) ** 2 * a + 2 * t * (1 - t) * bend + t**2 * c)


def links() -> list[Part]:
    """The base and the six links, each in its own frame."""
    return [_base(), _turret(), _upper_arm(), _elbow(), _forearm(), _wrist(), _tool()]


def gesture(phase: float) -> list[float]:
    """Six joint angles [rad] of an endless pick-and-place swing; `phase` 0..1 is one round."""
    a = 2 * np.pi * phase
    return [
        0.25 + 1.15 * np.sin(a),
        0.30 + 0.24 * np.cos(2 * a),
        0.20 - 0.32 * np.cos(2 * a + 0.5),
        0.50 * np.sin(a + 0.4),
        0.75 + 0.30 * np.cos(2 * a + 1.0),
        2.0 * np.sin(a),
    ]
