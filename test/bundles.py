# SPDX-License-Identifier: Apache-2.0
"""Rays in bundles: samples whose directions from a light fill narrow or wide cones, with triangles aimed at them."""

from __future__ import annotations

import geometry
import numpy as np

# Along axes, face diagonals and cube corners, where faces of a cube of directions meet, and anywhere.
AXES = np.array(
    [(0, 0, -1), (0, 0, 1), (1, 0, 0), (0, -1, 0), (1, 1, 0), (-1, 0, 1), (1, -1, 1), (-1, -1, -1), (0.3, 0.2, -0.9)],
    float,
)


def frame_of(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Three orthonormal vectors, the last along ``axis``."""
    forward = axis / np.linalg.norm(axis)
    right = np.cross(forward, (0.0, 1.0, 0.0) if abs(forward[1]) < 0.9 else (1.0, 0.0, 0.0))
    right /= np.linalg.norm(right)
    return right, np.cross(forward, right), forward


def grid(axis: np.ndarray, spacing: float, count: int, distance: float) -> np.ndarray:
    """(count^2, 3): a square grid across ``axis``, ``distance`` away, neighbours ``spacing`` radians apart."""
    right, down, forward = frame_of(axis)
    steps = (np.arange(count) - 0.5 * (count - 1)) * spacing
    u, v = np.meshgrid(steps, steps)
    points: np.ndarray = distance * (forward + u.reshape(-1, 1) * right + v.reshape(-1, 1) * down)
    return points


def cone(rng: np.random.Generator, axis: np.ndarray, half_angle: float, count: int) -> np.ndarray:
    """(count, 3) unit directions at most ``half_angle`` from ``axis``; up to pi."""
    right, down, forward = frame_of(axis)
    angle, turn = half_angle * np.sqrt(rng.random((count, 1))), rng.uniform(0.0, 2.0 * np.pi, (count, 1))
    side = np.cos(turn) * right + np.sin(turn) * down
    ways: np.ndarray = np.cos(angle) * forward + np.sin(angle) * side
    return ways


def edges_across(rng: np.random.Generator, axis: np.ndarray, width: float, count: int) -> geometry.Geometry:
    """Triangles at distance 0.5 to 1.5, larger than a bundle of the given width [rad], each with an edge through it."""
    right, down, forward = frame_of(axis)
    turn = rng.uniform(0.0, 2.0 * np.pi, count)
    along = np.cos(turn)[:, None] * right + np.sin(turn)[:, None] * down
    aside = -np.sin(turn)[:, None] * right + np.cos(turn)[:, None] * down
    at = rng.uniform(0.5, 1.5, (count, 1)) * (forward + rng.uniform(-width, width, (count, 1)) * aside)
    tilt = rng.uniform(-0.5, 0.5, (count, 1)) * forward
    corners = np.stack([at - 0.7 * along, at + 0.6 * along + tilt, at + 0.5 * aside - tilt], axis=1)
    return corners.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def straddling(rng: np.random.Generator, axis: np.ndarray, width: float, count: int) -> geometry.Geometry:
    """Triangles with one or two corners behind the light, seen along the axis, and an edge through the bundle of the
    given width [rad]."""
    right, down, forward = frame_of(axis)
    aside = rng.normal(size=(count, 2)) @ np.stack([right, down]) * 0.4 * width
    hit = rng.uniform(0.3, 3.0, (count, 1)) * (forward + aside)
    behind = rng.normal(size=(count, 3)) * 4.0 - rng.uniform(1.0, 20.0, (count, 1)) * forward
    other = rng.normal(size=(count, 3)) * 4.0 + rng.uniform(-20.0, 20.0, (count, 1)) * forward
    weights = rng.uniform(0.1, 0.8, (count, 3))
    weights[np.arange(count), rng.integers(0, 2, count)] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    ahead = (hit - weights[:, :1] * behind - weights[:, 1:2] * other) / weights[:, 2:]
    corners = np.stack([behind, other, ahead], axis=1)
    return corners.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
