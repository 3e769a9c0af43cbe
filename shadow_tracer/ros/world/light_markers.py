# SPDX-License-Identifier: Apache-2.0
"""The lights, as markers for a viewer: each in its frame, grey if it is switched off. No ROS here."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from shadow_tracer.ros.settings import FloatArray, LightSettings, Settings
from shadow_tracer.ros.wire.cdr_markers import ARROW, CLEARED, LINE_LIST, SPHERE, TEXT, MarkerMessage
from shadow_tracer.ros.wire.messages import frame_name
from shadow_tracer.ros.world.lighting import Lighting

_ON, _OFF = (1.0, 0.85, 0.3, 1.0), (0.45, 0.45, 0.45, 0.7)
_BULB = 0.06  # diameter of a light without a size [m]
_LENGTH = 1.0  # of arrows, and of cones without range [m]
_LONGEST = 5.0  # of a cone [m]
_NORMAL = 0.2  # length of the line that says to which side a flat light shines [m]
_LETTER = 0.08  # height [m]
_RIM, _RIBS = 32, 8  # pieces of the rim of a cone, lines from its apex to it


def light_markers(settings: Settings, lighting: Lighting, world: str, stamp: int) -> tuple[list[MarkerMessage], int]:
    """All lights, after a marker that removes those before; and how many cannot be shown because their world has no
    name. A sun is left out while it is below the horizon.

    Args:
        world: name of the frame of lights without one, "" if it has none.
        stamp: time [ns] at which the sun is looked up, 0 before there is one.
    """
    markers, nameless = [CLEARED], 0
    for light in settings.lights:
        placed = lighting.placed(light, stamp)
        if placed is None:
            continue
        frame = frame_name(placed.frame) or world
        if not frame:
            nameless += 1
            continue
        base = MarkerMessage(ns=light.name, frame=frame, color=_ON if light.enabled else _OFF, frame_locked=True)
        markers += _shapes(placed, base)
    return markers, nameless


def _shapes(light: LightSettings, base: MarkerMessage) -> list[MarkerMessage]:
    position, way = np.asarray(light.position), np.asarray(light.direction)
    way = way / np.linalg.norm(way)
    x, y, z = light.position
    label, shapes = position, []
    if light.type in ("directional", "sun"):  # it has no place: the tip of its arrow is the origin of its frame
        label = -_LENGTH * way
        ends = np.stack([label, np.zeros(3)])
        shapes.append(replace(base, type=ARROW, points=ends, scale=(0.03, 0.08, 0.15)))
    else:
        size = 2.0 * light.radius if light.type == "sphere" else _BULB
        label = position + (0.0, 0.0, size / 2 + _LETTER)
        shapes.append(replace(base, type=SPHERE, position=(x, y, z), scale=(size, size, size)))
    if light.type in ("disc", "rectangle", "tube"):
        lines = position + _outline(light, way)
        label[2] = max(label[2], lines[:, 2].max() + _LETTER)
        shapes.append(replace(base, id=1, type=LINE_LIST, points=lines, scale=(0.008, 1.0, 1.0)))
    if light.type == "spot":
        label = position - 2 * _LETTER * way
        reach = min(light.range, _LONGEST) if light.range > 0.0 else _LENGTH
        lines = position + reach * _cone(way, light.outer_angle)
        shapes.append(replace(base, id=1, type=LINE_LIST, points=lines, scale=(0.008, 1.0, 1.0)))
    x, y, z = (float(value) for value in label)
    text = light.name if light.enabled else f"{light.name} (off)"
    return [*shapes, replace(base, id=2, type=TEXT, position=(x, y, z), scale=(1.0, 1.0, _LETTER), text=text)]


def _outline(light: LightSettings, way: FloatArray) -> FloatArray:
    """(N, 3) ends of the lines of a light with a shape, around 0: its edges, and where its middle shines."""
    if light.type == "tube":
        half = light.half_length
        lines = [np.stack([-half, half])]
        if light.radius > 0.0:
            rim = light.radius * _rim(half / np.linalg.norm(half), math.pi / 2)
            ribs = rim[:: _RIM // _RIBS]
            lines += [_pieces(rim - half), _pieces(rim + half), np.stack([ribs - half, ribs + half], axis=1)]
        return np.concatenate([piece.reshape(-1, 3) for piece in lines])
    if light.type == "disc":
        edges = _pieces(light.radius * _rim(way, math.pi / 2))
    else:
        u, v = light.sides
        edges = _pieces(np.stack([u + v, v - u, -u - v, u - v]))
    sides = (1.0, -1.0) if light.two_sided else (1.0,)
    return np.concatenate([edges, *(np.stack([np.zeros(3), side * _NORMAL * way]) for side in sides)])


def _pieces(corners: FloatArray) -> FloatArray:
    """(2 N, 3) ends of the lines of a closed line through (N, 3) corners."""
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1).reshape(-1, 3)


def _cone(way: FloatArray, angle: float) -> FloatArray:
    """(N, 3) ends of the lines of a cone with its apex at 0 and lines of length 1.

    Args:
        way: (3,) unit vector along its axis.
        angle: between axis and lines [rad], up to pi.
    """
    rim = _rim(way, angle)
    ribs = rim[:: _RIM // _RIBS]
    return np.concatenate([_pieces(rim), np.stack([np.zeros_like(ribs), ribs], axis=1).reshape(-1, 3)])


def _rim(way: FloatArray, angle: float) -> FloatArray:
    """(_RIM, 3) unit vectors at an angle [rad] to the unit vector ``way``, all around it."""
    aside = np.eye(3)[int(np.argmin(np.abs(way)))]
    u = np.cross(way, aside)
    u /= np.linalg.norm(u)
    turn = np.arange(_RIM) * (2.0 * math.pi / _RIM)
    around = np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * np.cross(way, u)
    rim: FloatArray = math.cos(angle) * way + math.sin(angle) * around
    return rim
