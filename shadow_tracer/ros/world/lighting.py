# SPDX-License-Identifier: Apache-2.0
"""The lights of one moment: from parameters, poses that arrived on topics, frames and the sun. No ROS here."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shadow_tracer.ros.diagnostics import ERROR, PROCESSING, Missing
from shadow_tracer.ros.settings import FloatArray, LightSettings, Settings
from shadow_tracer.ros.world.frames import Poses
from shadow_tracer.scene.lights import Light
from shadow_tracer.scene.sun import Sun


@dataclass(frozen=True, eq=False)
class LightPose:
    """Where a topic put a light: a pose in a frame, "" being the light's own; it shines along +x, and its axis is
    along +y."""

    frame: str
    pose: FloatArray


@dataclass(frozen=True)
class Lit:
    """The enabled lights at a time: those that shine, and the names of those that cannot reach anything (a sun below
    the horizon)."""

    lights: list[Light]
    dark: tuple[str, ...]


class Lighting:
    """Knows the poses that lights were given, and finds all lights at a time stamp."""

    def __init__(self) -> None:
        self._poses: dict[str, LightPose] = {}
        self._sun = Sun()

    def move(self, name: str, pose: LightPose) -> None:
        """A light was given a pose; it holds until the next one or until its parameters are set again."""
        self._poses[name] = pose

    def moved(self) -> tuple[str, ...]:
        """Names of lights that a topic has placed."""
        return tuple(self._poses)

    def configure(self, old: Settings, new: Settings) -> None:
        """Forget the poses of lights whose parameters for place and direction are other ones now: the last wish
        counts."""
        before = {light.name: _place_of(light) for light in old.lights}
        after = {light.name: _place_of(light) for light in new.lights}
        self._poses = {
            name: pose for name, pose in self._poses.items() if name in after and before.get(name) == after[name]
        }

    def at(self, settings: Settings, poses: Poses, stamp: int) -> Lit:
        """The enabled lights in the world.

        Args:
            poses: frames at the same time.
            stamp: time [ns].

        Raises:
            Missing: no light is enabled, a frame cannot be found, or the sun cannot be computed.
        """
        if not settings.enabled_lights:
            raise Missing(
                PROCESSING,
                "no light is enabled; name one in the parameter light_names and set lights.<name>.enabled",
                False,
            )
        shining, dark = [], []
        for light in settings.enabled_lights:
            placed = self._placed(light)
            given = self._poses.get(light.name)
            by_topic = given is not None and given.frame
            field = f"header.frame_id of lights/{light.name}/pose" if by_topic else f"lights.{light.name}.frame"
            to_world = poses.frame_to_world(placed.frame, field)
            direction = None
            if light.type == "sun":
                direction = self._sun_direction(light, stamp)
                if direction is None:
                    dark.append(light.name)
                    continue
            shining.append(placed.light(to_world, direction))
        return Lit(shining, tuple(dark))

    def sun(self, light: LightSettings, to_world: FloatArray, when: int) -> Light | None:
        """A light of type ``sun`` at another time than that of its parameters [ns]; None below the horizon.

        Args:
            to_world: (4, 4) transform of its frame.

        Raises:
            Missing: it cannot be computed.
        """
        direction = self._sun_direction(replace(light, sun=replace(light.sun, time=when)), when)
        return None if direction is None else light.light(to_world, direction)

    def placed(self, light: LightSettings, stamp: int) -> LightSettings | None:
        """A light with the frame, position and direction that parameters, a topic or the sun give it.

        Args:
            stamp: time [ns], 0 being unknown.

        Returns:
            None for a sun that is below the horizon, or of which place or time is unknown.
        """
        if light.type != "sun":
            return self._placed(light)
        if not stamp and light.sun.time is None:
            return None
        try:
            direction = self._sun_direction(light, stamp)
        except Missing:  # frames say so
            return None
        if direction is None:
            return None
        u, v, w = (float(value) for value in direction)
        return replace(light, direction=(u, v, w))

    def _placed(self, light: LightSettings) -> LightSettings:
        given = self._poses.get(light.name)
        if given is None:
            return light
        x, y, z = (float(value) for value in given.pose[:3, 3])
        u, v, w = (float(value) for value in given.pose[:3, 0])
        a, b, c = (float(value) for value in given.pose[:3, 1])
        frame = given.frame or light.frame
        return replace(light, frame=frame, position=(x, y, z), direction=(u, v, w), axis=(a, b, c))

    def _sun_direction(self, light: LightSettings, stamp: int) -> FloatArray | None:
        """(3,) the way sunlight travels, east, north, up; None at night."""
        sun = light.sun
        try:
            when = stamp if sun.time is None else sun.time
            direction, elevation = self._sun.at(when, sun.latitude, sun.longitude)
        except (ImportError, ValueError) as error:
            text = f"lights.{light.name}: {error}; correct lights.{light.name}.sun.*, or install what is named"
            raise Missing(PROCESSING, text, False, ERROR) from error
        return None if elevation <= 0.0 else np.asarray(direction)


def _place_of(light: LightSettings) -> tuple[object, ...]:
    # The sun has no pose, only a frame.
    return (light.frame, light.position, light.direction, light.axis, light.type == "sun")
