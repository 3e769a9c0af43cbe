# SPDX-License-Identifier: Apache-2.0
"""What the parameters amount to once they are checked: frozen values the node works with. No ROS here."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer import (
    Bias,
    Bounds,
    DirectionalLight,
    DiscLight,
    IntensityTable,
    PointLight,
    RectangleLight,
    SphereLight,
    SpotLight,
    Strength,
    SunDisc,
    TubeLight,
)
from shadow_tracer.scene.lights import Light

FloatArray = npt.NDArray[np.float64]

LIGHT_TYPES = ("point", "spot", "directional", "sun", "sphere", "disc", "rectangle", "tube")


@dataclass(frozen=True)
class SunSettings:
    """Where and when the sun is looked up: degrees, and a time [ns] since 1970 UTC, None being that of the image."""

    latitude: float
    longitude: float
    time: int | None


@dataclass(frozen=True)
class LightSettings:
    """One light as the parameters ``lights.<name>.*`` describe it; geometry in its own frame."""

    name: str
    type: str
    enabled: bool
    frame: str
    position: tuple[float, float, float]
    direction: tuple[float, float, float]
    outer_angle: float
    range: float
    radius: float
    sun: SunSettings
    axis: tuple[float, float, float]
    length: float
    size: tuple[float, float]
    two_sided: bool
    angular_diameter: float
    ignore: tuple[str, ...]
    strength: Strength | None

    def light(self, frame_to_world: FloatArray, direction: FloatArray | None = None) -> Light:
        """The light in the world.

        Args:
            frame_to_world: (4, 4) rigid transform from the light's frame.
            direction: (3,) the way its light travels in that frame, where the parameter does not say it (the sun).

        Raises:
            ValueError: the values make no light; the message starts with the key.
        """
        name, turn = self.name, frame_to_world[:3, :3]
        position = turn @ np.asarray(self.position) + frame_to_world[:3, 3]
        way = turn @ (np.asarray(self.direction) if direction is None else direction)
        more: dict[str, Any] = {"ignore": self.ignore, "strength": self._strength(turn)}
        if self.type in ("directional", "sun"):
            if self.angular_diameter > 0.0:
                return SunDisc(name, way, self.angular_diameter, **more)
            return DirectionalLight(name, way, **more)
        more["range"] = self.range if self.range > 0.0 else math.inf
        if self.type == "point":
            return PointLight(name, position, **more)
        if self.type == "spot":
            return SpotLight(name, position, way, self.outer_angle, **more)
        if self.type == "sphere":
            return SphereLight(name, position, self.radius, **more)
        if self.type == "disc":
            return DiscLight(name, position, way, self.radius, self.two_sided, **more)
        if self.type == "rectangle":
            u, v = self.sides
            return RectangleLight(name, position, turn @ u, turn @ v, self.two_sided, **more)
        half = turn @ self.half_length
        return TubeLight(name, position - half, position + half, self.radius, **more)

    @property
    def sides(self) -> tuple[FloatArray, FloatArray]:
        """From the middle of a rectangle to the middles of two of its sides [m]: with them it shines along
        ``direction``."""
        way, u = self._way_and_across
        return 0.5 * self.size[0] * u, 0.5 * self.size[1] * np.cross(way, u)

    @property
    def _way_and_across(self) -> tuple[FloatArray, FloatArray]:
        """Unit vectors along ``direction``, and along the part of ``axis`` across it."""
        way = np.asarray(self.direction) / np.linalg.norm(self.direction)
        axis = np.asarray(self.axis)
        u = axis - (axis @ way) * way
        u /= np.linalg.norm(u)
        u -= (u @ way) * way  # what the rounding of a long axis left
        return way, u

    def _strength(self, turn: FloatArray) -> Strength | None:
        """In the world: a table hangs with its axis along ``direction``, and begins where ``axis`` points."""
        table = None if self.strength is None else self.strength.model
        if self.strength is None or not isinstance(table, IntensityTable):
            return self.strength
        way, across = self._way_and_across
        return replace(self.strength, model=table.hung(turn @ way, turn @ across))

    @property
    def half_length(self) -> FloatArray:
        """(3,) from the middle of a tube to an end [m]."""
        half: FloatArray = 0.5 * self.length / np.linalg.norm(self.axis) * np.asarray(self.axis)
        return half


@dataclass(frozen=True)
class CameraSettings:
    """One camera as the parameters ``cameras.<name>.*`` describe it; its bias is never left to others here."""

    name: str
    depth_topic: str
    info_topic: str
    pose_topic: str
    transport: str
    frame: str
    pose: tuple[float, ...]
    rate: float
    bias_constant: float
    bias_quadratic: float
    bias_normal: float


@dataclass(frozen=True)
class Settings:
    """All parameters of the node, checked and converted. Lengths in metres, times in seconds, angles in radians.

    Where a camera is meant, the settings are those :meth:`of` it, and ``camera`` is its name.
    """

    pipeline: str
    variant: str
    device: str
    threads: int
    fixed_frame: str
    pose_source: str
    camera_frame: str
    camera_pose: tuple[float, ...]
    tf_timeout: float
    mesh_frame: str
    mesh_max_age: float
    mesh_files: tuple[str, ...]
    mesh_cast_no_shadows: tuple[str, ...]
    mesh_files_scale: float
    depth_image_transport: str
    depth_unit: float
    occluders: str
    depth_occluder_step: int
    depth_occluder_max_jump: float
    camera_info_policy: str
    distortion: str
    lights: tuple[LightSettings, ...]
    bias_constant: float
    bias_quadratic: float
    bias_normal: float
    front_face_culling: bool
    unknown_value: int
    mask_publish: str
    mask_dilate: int
    mask_invert: bool
    markers_max_triangles: int
    process: str
    verify_every: int
    max_triangles: int
    max_rays: int
    max_lights: int
    queue_capacity: int
    grid_entries: int
    diagnostics_period: float
    dose_parts: tuple[str, ...]
    dose_target: float
    dose_goal: float
    dose_max_edge: float
    dose_side: str
    dose_folder: str
    grid_map_layer: str
    grid_map_height_above: float
    grid_map_dark_value: int
    grid_map_period: float
    sun_map_hours: float
    sun_map_step: float
    sun_map_period: float
    cameras: tuple[CameraSettings, ...] = ()
    camera: str = ""
    camera_rate: float = 0.0

    def of(self, camera: str) -> Settings:
        """The settings with which images of a camera are answered; "" is the one without a name."""
        return self if camera == self.camera else self._by_camera[camera]

    @cached_property
    def _by_camera(self) -> dict[str, Settings]:
        return {
            each.name: replace(
                self,
                camera=each.name,
                camera_frame=each.frame,
                camera_pose=each.pose,
                camera_rate=each.rate,
                depth_image_transport=each.transport,
                bias_constant=each.bias_constant,
                bias_quadratic=each.bias_quadratic,
                bias_normal=each.bias_normal,
            )
            for each in self.cameras
        }

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names of all cameras; of the only one that has none it is ""."""
        return tuple(each.name for each in self.cameras) or ("",)

    @property
    def samples(self) -> str:
        """Name of the tracer's set of samples: that of the camera. Where none is meant, questions about points share
        that of the first one."""
        return self.camera or self.camera_names[0]

    @property
    def bounds(self) -> Bounds:
        """Capacities of the tracer's device buffers."""
        return Bounds(
            max_triangles=self.max_triangles,
            max_rays=self.max_rays,
            max_lights=self.max_lights,
            queue_capacity=self.queue_capacity,
            grid_entries=self.grid_entries,
            max_sample_sets=len(self.camera_names),
        )

    @property
    def bias(self) -> Bias:
        """Bias of the shadow test, ``constant + quadratic * z^2`` [m], and along normals."""
        return Bias(constant=self.bias_constant, quadratic=self.bias_quadratic, normal=self.bias_normal)

    @property
    def enabled_lights(self) -> tuple[LightSettings, ...]:
        """The lights that shine."""
        return tuple(light for light in self.lights if light.enabled)

    @property
    def uses_meshes(self) -> bool:
        """Whether received meshes and mesh files cast shadow."""
        return self.occluders != "depth"

    @property
    def uses_depth(self) -> bool:
        """Whether the depth image itself casts shadow."""
        return self.occluders != "mesh"

    @property
    def tracer_device(self) -> str | None:
        """Device as the tracer takes it: None is the best there is."""
        return None if self.device == "auto" else self.device

    @property
    def needs_tf(self) -> bool:
        """True if some frame can only be found through tf."""
        frames = {self.mesh_frame, *(light.frame for light in self.enabled_lights)}
        by_tf = self.pose_source == "tf" and bool(self.fixed_frame)
        return by_tf or bool(frames - {"", self.fixed_frame})
