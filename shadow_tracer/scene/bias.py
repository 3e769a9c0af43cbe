# SPDX-License-Identifier: Apache-2.0
"""Where rays start: a little before their sample, and a little off its surface."""

from __future__ import annotations

from dataclasses import dataclass

from shadow_tracer.scene.checks import LARGEST, finite


@dataclass(frozen=True)
class Bias:
    """How far a ray starts from its sample, towards the light: ``constant + quadratic * z**2`` with z the depth [m].

    Measured depth lies before and behind the true surface, so without a bias surfaces shadow themselves; stereo and
    structured light noise grows with z squared.

    Light that grazes a surface stays near to it for longer than that. ``normal`` first moves the samples of a depth
    image along the normal of their surface, towards the camera, by ``normal`` times the same length. The normals are
    those of the image (:func:`shadow_tracer.scene.normals.depth_normals`); pixels without one stay, and so do points,
    which have none.

    Args:
        constant: metres, at least 0.
        quadratic: metres per square metre, at least 0.
        normal: how often that length along the normal, at least 0.

    Raises:
        ValueError: a value is negative or not finite; the message names it.
    """

    constant: float = 0.01
    quadratic: float = 0.0
    normal: float = 0.0

    def __post_init__(self) -> None:
        for name in ("constant", "quadratic", "normal"):
            object.__setattr__(self, name, _length(getattr(self, name), name))


def constant_bias(value: float) -> float:
    """``Bias(constant=value).constant``."""
    return _length(value, "constant")


def _length(value: float, name: str) -> float:
    if type(value) is not float or not 0.0 <= value <= LARGEST:
        value = finite(value, f"bias.{name}")
        if not 0.0 <= value <= LARGEST:
            raise ValueError(f"bias.{name}: expected a number from 0 to {LARGEST:g}, got {value!r}")
    return value
