# SPDX-License-Identifier: Apache-2.0
"""Which pixels of a depth image does each light reach? Exact shadows of moving meshes at camera rate."""

from shadow_tracer.cone_answers import Outcome
from shadow_tracer.depth_camera import DepthCamera, render_depth
from shadow_tracer.dose import DoseMap
from shadow_tracer.frame_surface import NormalSource
from shadow_tracer.gpu.accelerators.registry import available_pipelines
from shadow_tracer.planning import Plan, Stop, irradiance_matrix, plan_positions
from shadow_tracer.scene.bias import Bias
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.checks import BoundsError
from shadow_tracer.scene.intensity_table import IntensityTable
from shadow_tracer.scene.lights import (
    DirectionalLight,
    DiscLight,
    PointLight,
    RectangleLight,
    SphereLight,
    SpotLight,
    SunDisc,
    TubeLight,
)
from shadow_tracer.scene.mesh import Mesh, Scene
from shadow_tracer.scene.strength import Strength
from shadow_tracer.scene.surface import HeightField
from shadow_tracer.terrain.sunlight import sunlight
from shadow_tracer.terrain.suns import Place
from shadow_tracer.tracer import ShadowTracer
from shadow_tracer.visibility import Frame, State

__version__ = "0.1.0"

__all__ = [
    "Bias",
    "Bounds",
    "BoundsError",
    "Camera",
    "DepthCamera",
    "DirectionalLight",
    "DiscLight",
    "DoseMap",
    "Frame",
    "HeightField",
    "IntensityTable",
    "Mesh",
    "NormalSource",
    "Outcome",
    "Place",
    "Plan",
    "PointLight",
    "RectangleLight",
    "Scene",
    "ShadowTracer",
    "SphereLight",
    "SpotLight",
    "State",
    "Stop",
    "Strength",
    "SunDisc",
    "TubeLight",
    "available_pipelines",
    "irradiance_matrix",
    "plan_positions",
    "render_depth",
    "sunlight",
]
