# SPDX-License-Identifier: Apache-2.0
"""Cones from points to lights: which certainly are free, and which certainly are blocked. No ROS here."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer import Outcome, ShadowTracer
from shadow_tracer.ros.settings import FloatArray
from shadow_tracer.scene.checks import LARGEST
from shadow_tracer.scene.cone_checks import STEEPEST, WIDEST, place_of
from shadow_tracer.scene.lights import Light

MOST = {"radius": LARGEST, "half_angle": WIDEST}
"""The largest that a query may ask for."""

_NEAREST = 1e-15  # [m]

Bits = npt.NDArray[np.uint32]


def cone_bits(
    tracer: ShadowTracer,
    points: FloatArray,
    cone: tuple[str, FloatArray],
    lights: Iterable[tuple[int, Light]],
    bias: float,
) -> tuple[Bits, Bits]:
    """(N,) bits of the lights the cones to which are free, and of those to which they are blocked.

    A cone begins where the ray from the point to the light does: ``bias`` along it. It ends in the light's middle; that
    to a light at infinity has no end. Neither bit is set where there is no such cone: of a radius to a light at
    infinity, of more than :data:`WIDEST` rad, or from a point no farther off than the bias.

    Args:
        tracer: whose scene is as it is to be asked about.
        points: (N, 3) in the world [m].
        cone: "radius" or "half_angle", and (N,) of it.
        lights: bits and lights.
        bias: [m].
    """
    name, sizes = cone
    free, blocked = np.zeros(len(points), np.uint32), np.zeros(len(points), np.uint32)
    for bit, light in lights:
        apices, asked = _apices(points, cone, place_of(light), bias)
        if asked.any():
            wide: dict[str, Any] = {name: sizes[asked]}
            outcomes = np.asarray(tracer.cones(apices[asked], light, **wide))
            free[asked] |= (outcomes == Outcome.FREE).astype(np.uint32) << np.uint32(bit)
            blocked[asked] |= (outcomes == Outcome.BLOCKED).astype(np.uint32) << np.uint32(bit)
    return free, blocked


def _apices(
    points: FloatArray, cone: tuple[str, FloatArray], place: FloatArray, bias: float
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Where cones to the homogeneous ``place`` of a light begin, and whether there is such a cone."""
    name, sizes = cone
    with np.errstate(over="ignore", invalid="ignore"):
        if place[3] == 0.0:
            apices = points + bias * (place[:3] / np.linalg.norm(place[:3]))
            asked = np.full(len(points), name == "half_angle")
        else:
            ways = place[:3] - points
            far = np.sqrt((ways * ways).sum(axis=1))
            asked = far > bias
            apices = points + ways * (bias / np.where(asked, far, 1.0))[:, None]
            left = np.sqrt(((place[:3] - apices) ** 2).sum(axis=1))
            asked &= left > _NEAREST
            if name == "radius":
                asked &= sizes <= (1.0 - 1e-9) * STEEPEST * left
    return apices, asked & (np.abs(apices) <= LARGEST).all(axis=1)
