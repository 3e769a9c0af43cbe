# SPDX-License-Identifier: Apache-2.0
"""Where rays start: a little before their sample."""

from __future__ import annotations

from dataclasses import dataclass

from shadow_tracer.scene.checks import LARGEST, finite


@dataclass(frozen=True)
class Bias:
    """How far a ray starts from its sample, towards the light: ``constant + quadratic * z**2`` with z the depth [m].

    Measured depth lies before and behind the true surface, so without a bias surfaces shadow themselves; stereo and
    structured light noise grows with z squared.

    Args:
        constant: metres, at least 0.
        quadratic: metres per square metre, at least 0.

    Raises:
        ValueError: a value is negative or not finite; the message names it.
    """

    constant: float = 0.01
    quadratic: float = 0.0

    def __post_init__(self) -> None:
        for name in ("constant", "quadratic"):
            value = finite(getattr(self, name), f"bias.{name}")
            if not 0.0 <= value <= LARGEST:
                raise ValueError(f"bias.{name}: expected a number from 0 to {LARGEST:g}, got {value!r}")
            object.__setattr__(self, name, value)
