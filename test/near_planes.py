# SPDX-License-Identifier: Apache-2.0
"""Samples whose biased starts lie within a few roundings of float32 of a triangle's plane: what the filter's bound of
that plane is there for. Each family is hard on another part of the bound."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import geometry
import numpy as np

from shadow_tracer import DirectionalLight, PointLight
from shadow_tracer.gpu.exact.light_frame import Anchor, make_light_frame

EACH = 16  # samples per triangle
_U, _SETUP = 2.0**-24, 2.0**-46


@dataclass(frozen=True)
class Pairs:
    """``corners`` (T, 3, 3), and of each triangle ``samples`` (T, 16, 4): x, y, z, bias."""

    light: PointLight | DirectionalLight
    anchor: Anchor
    corners: np.ndarray
    samples: np.ndarray


def _aim(
    rng: np.random.Generator,
    light: PointLight | DirectionalLight,
    anchor: Anchor,
    corners: np.ndarray,
    bias: float,
    reach: float = 2.5,
    spread: float = 0.6,
) -> Pairs:
    """Starts inside of each triangle, off its plane by up to ``reach`` times what float32 may be off."""
    count = len(corners)
    shares = (1.0 - spread) / 3.0 + spread * rng.dirichlet((1.0, 1.0, 1.0), (count, EACH))
    on = np.einsum("tsk,tkx->tsx", shares, corners)
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(e1, e2)
    length = np.linalg.norm(normal, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = normal / length[:, None]
    frame = make_light_frame(light, anchor)
    axes = np.array([[float(x) for x in axis] for axis in (frame.r, frame.s, frame.f)])
    largest = np.abs(unit @ axes.T).max(axis=1)
    coordinates = np.abs((on - np.array(anchor.center)) / anchor.scale @ axes.T)
    corner = np.abs((corners[:, 0] - np.array(anchor.center)) / anchor.scale @ axes.T).sum(axis=1)
    offset = np.abs(np.einsum("tx,tx->t", unit, corners[:, 0] - np.array(anchor.center))) / anchor.scale / largest
    eta = _SETUP * np.linalg.norm(e1, axis=1) * np.linalg.norm(e2, axis=1) / (length * largest)
    bound = (4.0 * _U + eta[:, None]) * coordinates.sum(axis=2) + (2.0 * _U * offset + (_SETUP + eta) * corner)[:, None]
    share = np.where(rng.random((count, EACH)) < 0.5, 1.0, 10.0 ** rng.uniform(-3, 0, (count, EACH)))
    off = share * rng.uniform(-reach, reach, (count, EACH)) * bound * (anchor.scale * largest)[:, None]

    def way(points: np.ndarray) -> np.ndarray:
        sun = isinstance(light, DirectionalLight)
        to = np.broadcast_to(-light.direction, points.shape) if sun else light.position - points
        return to / np.linalg.norm(to, axis=2, keepdims=True)

    # Along the ray, so that starts stay inside of thin triangles.
    along = np.einsum("tsx,tx->ts", way(on), unit)
    start = on + (off / along)[:, :, None] * way(on)
    samples = np.concatenate([start - bias * way(start), np.full((count, EACH, 1), bias)], axis=2)
    return Pairs(light, anchor, corners, samples)


def _lights(rng: np.random.Generator) -> PointLight | DirectionalLight:
    direction = geometry.directions(rng, 1)[0]
    choice = rng.integers(0, 4)
    if choice == 0:
        return DirectionalLight("sun", direction)
    return PointLight("lamp", direction * (0.05, 3.0, 1e6)[choice - 1])


def anywhere(rng: np.random.Generator, count: int) -> Pairs:
    """Triangles of all sizes around the anchor, any light, any bias."""
    corners = rng.uniform(-1, 1, (count, 1, 3)) + rng.normal(size=(count, 3, 3)) * 10.0 ** rng.uniform(
        -3, 0, (count, 1, 1)
    )
    anchor = Anchor(tuple(rng.uniform(-0.1, 0.1, 3)), float(rng.uniform(1.0, 2.5)))
    return _aim(rng, _lights(rng), anchor, corners, float(rng.choice([0.0, 0.01, 0.6])))


def at_the_anchor(rng: np.random.Generator, count: int) -> Pairs:
    """Starts next to the anchor: U, V and Z are nothing beside W, which is about 1. Half of them get there by a bias
    that cancels; corners may be far."""
    anchor = Anchor((0.3, -0.2, 0.7), 2.0)
    light = PointLight("lamp", np.array(anchor.center) + 9.0 * geometry.directions(rng, 1)[0])
    size = 10.0 ** rng.uniform(-6, 3, (count, 1, 1))
    shape = rng.normal(size=(count, 3, 3))
    shape -= np.einsum("tk,tkx->tx", rng.dirichlet((4.0, 4.0, 4.0), count), shape)[:, None, :]
    near = 10.0 ** rng.uniform(-12, -5, (count, 1, 1)) * geometry.directions(rng, count)[:, None, :]
    corners = np.array(anchor.center) + near + shape * size
    return _aim(rng, light, anchor, corners, float(rng.choice([0.0, 0.8])), spread=1e-7)


def seen_edge_on(rng: np.random.Generator, count: int) -> Pairs:
    """Planes that nearly contain the light, as of a floor under a low lamp."""
    light = PointLight("lamp", (6.0, 0.3, 0.002)) if rng.random() < 0.5 else DirectionalLight("sun", (-1.0, 0.1, -1e-4))
    corners = np.concatenate([rng.uniform(-3, 3, (count, 3, 2)), rng.normal(size=(count, 3, 1)) * 1e-4], axis=2)
    return _aim(rng, light, Anchor((0.0, 0.0, 0.1), 3.0), corners, float(rng.choice([0.0, 0.01])))


def needles(rng: np.random.Generator, count: int) -> Pairs:
    """Triangles so thin that float64 hardly knows their planes."""
    a, along = rng.uniform(-1, 1, (count, 3)), rng.normal(size=(count, 3))
    thin = 10.0 ** rng.uniform(-13, -6, (count, 1)) * geometry.directions(rng, count)
    corners = np.stack([a, a + along, a + rng.uniform(0.2, 0.8, (count, 1)) * along + thin], axis=1)
    return _aim(rng, _lights(rng), Anchor((0.0, 0.0, 0.0), 1.5), corners, 0.0, reach=6.0)


def far_corners(rng: np.random.Generator, count: int) -> Pairs:
    """Triangles much larger than the scene."""
    size = 10.0 ** rng.uniform(1, 6, (count, 1, 1))
    shape = rng.normal(size=(count, 3, 3))
    shape -= np.einsum("tk,tkx->tx", rng.dirichlet((4.0, 4.0, 4.0), count), shape)[:, None, :]
    corners = rng.uniform(-1, 1, (count, 1, 3)) + shape * size
    return _aim(rng, _lights(rng), Anchor((0.0, 0.0, 0.0), 1.5), corners, 0.01, spread=1e-6)


def _aligned(rng: np.random.Generator, count: int, normal: tuple[float, ...], middle: tuple[float, ...]) -> Pairs:
    """Coordinates of the frame are those of the world, just above a power of two: all roundings are as large as can be
    against what they round."""
    light = DirectionalLight("sun", (0.0, 0.0, -1.0))
    n = np.array(normal) + rng.uniform(0.0, 2.0**-9, (count, 3)) * -np.array(normal)
    first = np.cross(n, geometry.directions(rng, count))
    shape = np.stack([first, -0.5 * first + np.cross(n, first), -0.5 * first - np.cross(n, first)], axis=1)
    centre = np.array(middle) * (1.0 + rng.uniform(0.0, 2.0**-9, (count, 1, 3)))
    if abs(np.dot(normal, middle)) < 1e-9:
        centre -= (
            np.einsum("tsx,tx->ts", centre, n)[:, :, None] * n[:, None, :] / np.einsum("tx,tx->t", n, n)[:, None, None]
        )
    corners = centre + 0.002 * shape
    return _aim(rng, light, Anchor((0.0, 0.0, 0.0), 1.0), corners, 0.0)


def aligned(rng: np.random.Generator, count: int) -> Pairs:
    """Three terms of one sign and an offset as large as their sum."""
    return _aligned(rng, count, (1.0, 1.0, 1.0), (1.0, 1.0, 1.0))


def aligned_through_the_anchor(rng: np.random.Generator, count: int) -> Pairs:
    """Two terms that cancel; the offset is nothing."""
    return _aligned(rng, count, (1.0, -1.0, 0.01), (1.0, 1.0, 0.001))


FAMILIES: dict[str, Callable[[Any, int], Pairs]] = {
    make.__name__: make
    for make in (
        anywhere,
        at_the_anchor,
        seen_edge_on,
        needles,
        far_corners,
        aligned,
        aligned_through_the_anchor,
    )
}
