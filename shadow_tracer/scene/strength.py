# SPDX-License-Identifier: Apache-2.0
"""How much radiation a light gives, and how that falls with the angle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from shadow_tracer.scene.checks import real
from shadow_tracer.scene.intensity_table import IntensityTable

LARGEST_STRENGTH = 1e30
_UNITS = {"power": "W", "intensity": "W/sr", "exitance": "W/m2", "irradiance": "W/m2"}
QUANTITIES = tuple(_UNITS)
MODELS = ISOTROPIC, LAMBERT = "isotropic", "lambert"


@dataclass(frozen=True)
class Strength:
    """What a light radiates, of the wavelengths that matter to the use: give the watts of ultraviolet of a UV lamp, not
    those from the socket.

    Exactly one of four quantities says how much; with a table, which says it itself, at most one, and the table is then
    scaled to it.

    Args:
        power: radiant flux into all directions in which the light shines [W]; of all but lights at infinity.
        intensity: radiant intensity where it is largest, from far away [W/sr]: of a disc or rectangle along its normal,
            of a tube at right angles to its axis; of all but lights at infinity.
        exitance: radiant flux of each square metre of the surface, of each side that shines [W/m2]; of lights with a
            surface.
        irradiance: on a plane at right angles to the light [W/m2]; of lights at infinity alone.
        model: ``"isotropic"``: every part of the light shines alike in all directions in which the light shines;
            ``"lambert"``: its surface looks equally bright from all directions, so intensity falls with the cosine of
            the angle to the normal (of a :class:`SpotLight` to its direction); or an :class:`IntensityTable`, for every
            part of the light alike. None is Lambert for lights with a surface, isotropic for point and spot lights;
            lights at infinity have none.
        output: factor from 0 to 1 for age, dirt, warming up and dimming.

    Raises:
        ValueError: an argument is malformed; the message names it. A light that cannot have such a strength says so
            when it is made.
    """

    power: float | None = None
    intensity: float | None = None
    exitance: float | None = None
    irradiance: float | None = None
    model: str | IntensityTable | None = None
    output: float = 1.0

    def __post_init__(self) -> None:
        given = [name for name in _UNITS if getattr(self, name) is not None]
        table = isinstance(self.model, IntensityTable)
        if not table and self.model not in (None, ISOTROPIC, LAMBERT):
            raise ValueError(
                f"strength.model: expected '{ISOTROPIC}', '{LAMBERT}', an IntensityTable or None, got {self.model!r}"
            )
        if len(given) > 1 or (not given and not table):
            raise ValueError(
                "strength: expected exactly one of power [W], intensity [W/sr], exitance [W/m2] and irradiance [W/m2], "
                f"got {' and '.join(given) or 'none'}"
            )
        for name in given:
            value = real(getattr(self, name))
            if not 0.0 <= value <= LARGEST_STRENGTH:
                raise ValueError(
                    f"strength.{name}: expected a number from 0 to {LARGEST_STRENGTH:g} {_UNITS[name]}, got "
                    f"{getattr(self, name)!r}"
                )
            object.__setattr__(self, name, value)
        output = real(self.output)
        if not 0.0 <= output <= 1.0:
            raise ValueError(f"strength.output: expected a factor from 0 to 1, got {self.output!r}")
        object.__setattr__(self, "output", output)

    @property
    def quantity(self) -> str:
        """Which of the four is given; "" if the table says it."""
        return next((name for name in _UNITS if getattr(self, name) is not None), "")

    def value(self) -> float:
        """Of that quantity, before the factor ``output``."""
        return float(getattr(self, self.quantity))


def check_strength(light: Any, quantities: tuple[str, ...], models: tuple[str, ...]) -> None:
    """Raise ValueError unless a light's ``strength`` is None, or one of these quantities, with one of these models or,
    where there are any, a table."""
    strength, kind = light.strength, type(light).__name__
    if strength is None:
        return
    if not isinstance(strength, Strength):
        raise ValueError(f"strength: expected a Strength or None, got {strength!r}")
    if strength.quantity and strength.quantity not in quantities:
        raise ValueError(
            f"strength.{strength.quantity}: a {kind} has none; expected {' or '.join(quantities)} in its place"
        )
    table = isinstance(strength.model, IntensityTable)
    if strength.model is not None and not (models if table else strength.model in models):
        allowed = f"{', '.join(map(repr, models))} or an IntensityTable" if models else "None"
        got = "a table" if table else repr(strength.model)
        raise ValueError(f"strength.model: expected {allowed} of a {kind}, got {got}")
