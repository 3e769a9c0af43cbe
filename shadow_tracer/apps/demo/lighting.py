# SPDX-License-Identifier: Apache-2.0
"""Lights of a demo as they are shown: a light of the library with a colour and a strength."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shadow_tracer.scene.lights import DirectionalLight, PointLight, SpotLight

Geometry = PointLight | SpotLight | DirectionalLight


@dataclass(frozen=True)
class StageLight:
    """One light of the demo.

    Attributes:
        light: what the tracer knows of it.
        colour: linear RGB, the brightest channel about 1.
        strength: brightness; for point and spot lights that at 1 m.
    """

    light: Geometry
    colour: tuple[float, float, float]
    strength: float

    @property
    def name(self) -> str:
        """Name of the light, as in topics."""
        return self.light.name

    @property
    def kind(self) -> str:
        """What it is, in a word for labels and parameters."""
        kinds = {PointLight: "point", SpotLight: "spot", DirectionalLight: "directional"}
        return kinds[type(self.light)]

    def parameters(self) -> dict[str, object]:
        """The node parameters below `lights.<name>`."""
        light = self.light
        values: dict[str, object] = {"type": self.kind}
        if not isinstance(light, DirectionalLight):
            values["position"] = [float(v) for v in light.position]
        if not isinstance(light, PointLight):
            values["direction"] = [float(v) for v in light.direction]
        if isinstance(light, SpotLight):
            values["outer_angle"] = float(light.outer_angle)
        return values

    def radiance(self, points: NDArray[np.float32], normals: NDArray[np.float32], relief: float) -> NDArray[np.float32]:
        """Light that arrives at surfaces if nothing is in the way.

        Args:
            points: (..., 3) metres, world frame.
            normals: (..., 3) unit vectors.
            relief: 1 for brightness by the angle of the surface (Lambert), less to lessen that; 0 ignores the normals.

        Returns:
            (..., 3) linear RGB float32, not negative.
        """
        light = self.light
        if isinstance(light, DirectionalLight):
            way = np.asarray(light.direction / np.linalg.norm(light.direction), dtype=np.float32)
            facing = normals @ way
            amount = np.full_like(facing, self.strength)
        else:
            offset = points - light.position.astype(np.float32)
            square = np.maximum(np.einsum("...i,...i->...", offset, offset), np.float32(1e-4))
            offset /= np.sqrt(square)[..., None]
            facing = np.einsum("...i,...i->...", normals, offset)
            amount = self.strength / (square + np.float32(0.15))
            if isinstance(light, SpotLight):
                axis, edge = light.cone
                inner = np.cos(0.75 * light.outer_angle)
                ramp = np.clip((offset @ axis.astype(np.float32) - edge) / (inner - edge), 0, 1)
                amount *= ramp * ramp * (3 - 2 * ramp)
        amount *= (1 - relief) + relief * np.maximum(-facing, 0)
        return np.asarray(amount[..., None] * np.asarray(self.colour, dtype=np.float32), dtype=np.float32)
