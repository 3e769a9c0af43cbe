# SPDX-License-Identifier: Apache-2.0
"""All lights: those without size (``hard_lights.py``) and those with (``area_lights.py``)."""

from __future__ import annotations

from shadow_tracer.scene.area_lights import AreaLight, DiscLight, RectangleLight, SphereLight, SunDisc, TubeLight
from shadow_tracer.scene.hard_lights import DirectionalLight, HardLight, PointLight, SpotLight

Light = HardLight | AreaLight

__all__ = [
    "AreaLight",
    "DirectionalLight",
    "DiscLight",
    "HardLight",
    "Light",
    "PointLight",
    "RectangleLight",
    "SphereLight",
    "SpotLight",
    "SunDisc",
    "TubeLight",
]
