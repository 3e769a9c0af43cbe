# SPDX-License-Identifier: Apache-2.0
"""What of the ground that a grid map gives is in the light: a grid for planners, and a map with hours of sun. No ROS
here.

A cell is asked about at the point ``grid_map.height_above`` over its middle: that is exact without a bias, and where
the ground falls away from the light, it is the ground that is in between. Everything in the world casts shadow on it.
Beyond the map, and in its holes, there is nothing.

The hours are those of the ground alone, as it lies now: what else there is moves. They are counted on a separate copy
of it, one place of the sun a turn, so that frames come in between; a map that comes meanwhile waits for the next sum.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer import ShadowTracer
from shadow_tracer.ros.diagnostics import ERROR, PROCESSING, Missing
from shadow_tracer.ros.node.processing import check_meshes, forget_surface
from shadow_tracer.ros.settings import FloatArray, LightSettings, Settings
from shadow_tracer.ros.wire.grid_map import KEY, GridPart, encode_grid_map, encode_shadow_grid
from shadow_tracer.ros.world.frames import Frames, Poses
from shadow_tracer.ros.world.lighting import Lighting
from shadow_tracer.ros.world.marker_feed import Sink
from shadow_tracer.ros.world.mesh_store import MeshStore

Floats = npt.NDArray[np.float32]

_SHORTEST_WAIT = 0.1
_HOUR = 3600 * 10**9
_FAILED = "if it stays so, set another pipeline, or restart the node"


@dataclass(frozen=True, eq=False)
class _Seen:
    """The ground at a moment.

    Attributes:
        part: it.
        to_world: (4, 4) transform of its frame.
        poses: of everything; None where something is missing.
        when: time of the lights [ns].
        share: (R, C) largest part of a light that reaches each cell, 0 to 1; NaN unknown.
    """

    part: GridPart
    to_world: FloatArray
    poses: Poses | None
    when: int
    share: Floats


class _Due:
    """When one of the two topics is to be sent: to somebody, and after a time."""

    def __init__(self, sink: Sink | None) -> None:
        self.sink = sink
        self._listeners = 0
        self._last = float("-inf")

    def listened(self) -> bool:
        """Whether anybody listens."""
        return self.sink is not None and self.sink.get_subscription_count() > 0

    def now(self, now: float, period: float) -> bool:
        """Whether it is time; whoever has just come is not kept waiting."""
        listeners = self.sink.get_subscription_count() if self.sink is not None else 0
        came, self._listeners = listeners > self._listeners, min(listeners, self._listeners)
        return listeners > 0 and (came or now - self._last >= period)

    def begun(self, now: float) -> None:
        """A message is being made."""
        assert self.sink is not None
        self._last, self._listeners = now, self.sink.get_subscription_count()


class Ground:
    """Both topics.

    Args:
        frames, meshes, lighting: the world.
        grid: where bytes of a nav_msgs/OccupancyGrid go.
        sun_map: where bytes of a grid_map_msgs/GridMap go; None where there is no such type.

    Attributes:
        grids, maps: how many were sent.
        missing: why nothing was known of the last one; None if all is well.
    """

    def __init__(self, frames: Frames, meshes: MeshStore, lighting: Lighting, grid: Sink, sun_map: Sink | None) -> None:
        self.grids = self.maps = 0
        self.missing: Missing | None = None
        self._frames = frames
        self._meshes = meshes
        self._lighting = lighting
        self._grid = _Due(grid)
        self._map = _Due(sun_map)
        self._hours: SunHours | None = None
        self._tracer: ShadowTracer | None = None  # of the hours
        self._since: float | None = None  # steady time since when something is waited for [s]

    def step(
        self, settings: Settings, tracer: ShadowTracer, camera_frame: str, stamp: int, now: float, now_ns: int,
        patient: bool = True,
    ) -> bool:  # fmt: skip
        """One turn of work, if somebody listens. True if there is another one to be had at once.

        Args:
            camera_frame: optical frame of the depth images, "" if none has come.
            stamp: of the last of them [ns], 0 if none has come.
            now: steady time [s].
            now_ns: time of the node's clock [ns].
            patient: False: nothing that is missing now will come.
        """
        part = self._meshes.parts.get(KEY)
        if not isinstance(part, GridPart):
            self._hours, self.missing, self._since = None, None, None
            return False
        if not self._map.listened():
            self._hours = None
        wants_map = self._hours is None and self._map.now(now, settings.sun_map_period)
        if not (wants_map or self._grid.now(now, settings.grid_map_period)):
            return self._count(settings)
        self._since = now if self._since is None else self._since
        last_chance = not patient or now - self._since >= max(settings.tf_timeout, _SHORTEST_WAIT)
        try:
            when = max(stamp, part.stamp) or now_ns
            seen = self._look(settings, tracer, part, camera_frame, when, last_chance, now_ns)
            self.missing = None
        except Missing as missing:
            if missing.wait and not last_chance:
                return self._count(settings)
            seen = self._unknown(part, when, missing)
        except Exception as error:  # whatever it is, the node goes on, and what is not known is not lit
            seen = self._unknown(part, when, _failed(error))
        self._since = None
        self._send_grid(seen, settings.grid_map_dark_value, now)
        if wants_map:
            self._map.begun(now)
            self._hours = self._begin(settings, tracer, seen)
        return self._count(settings)

    def skip(self, settings: Settings, now: float) -> None:
        """A turn of :meth:`step` that was taken elsewhere, with all its work: only when what was sent is noted."""
        if not isinstance(self._meshes.parts.get(KEY), GridPart):
            return
        wants_map = self._map.now(now, settings.sun_map_period)
        if not (wants_map or self._grid.now(now, settings.grid_map_period)):
            return
        if self._grid.listened():
            self._grid.begun(now)
        if wants_map:
            self._map.begun(now)

    def _look(
        self, settings: Settings, tracer: ShadowTracer, part: GridPart, camera_frame: str, when: int, last_chance: bool,
        now_ns: int,
    ) -> _Seen:  # fmt: skip
        check_meshes(self._meshes, settings, now_ns)
        if not camera_frame and settings.pose_source == "tf" and not settings.fixed_frame:
            camera_frame = part.frame  # no image has come: the world is where the map is
        poses = self._frames.at(settings, camera_frame, when, last_chance)
        lit = self._lighting.at(settings, poses, when)
        forget_surface(tracer.scene, settings)
        self._meshes.update(tracer.scene, poses, settings.mesh_frame, settings.uses_meshes)
        to_world = self._meshes.place(part, poses, settings.mesh_frame)
        share = np.zeros(part.map.values.shape, np.float32)
        share[~part.surface.valid] = np.nan
        points = _points(part, to_world, settings.grid_map_height_above)
        if lit.lights and len(points):
            tracer.front_face_culling = settings.front_face_culling
            share[part.surface.valid] = tracer.visibility(points, lit.lights, samples=settings.samples).max(axis=0)
        return _Seen(part, to_world, poses, when, share)

    def _unknown(self, part: GridPart, when: int, missing: Missing) -> _Seen:
        self.missing = missing
        nothing = np.full(part.map.values.shape, np.nan, np.float32)
        return _Seen(part, np.eye(4), None, when, nothing)

    def _send_grid(self, seen: _Seen, most: int, now: float) -> None:
        if not self._grid.listened():
            return
        assert self._grid.sink is not None
        known = ~np.isnan(seen.share)
        dark = np.full(seen.share.shape, -1, np.int8)
        dark[known] = np.rint(most - most * seen.share[known].astype(np.float64)).astype(np.int8)
        self._grid.begun(now)
        self._grid.sink.publish(encode_shadow_grid(seen.part.map, dark, seen.when))
        self.grids += 1

    def _begin(self, settings: Settings, tracer: ShadowTracer, seen: _Seen) -> SunHours:
        light = next((light for light in settings.enabled_lights if light.type == "sun"), None)
        if light is not None and seen.poses is not None and seen.part.surface.valid.any():
            try:
                self._tracer = _tracer_for(seen.part, settings, tracer, self._tracer)
                to_world = seen.poses.frame_to_world(light.frame, f"lights.{light.name}.frame")
                return SunHours(seen, settings, Course(light, to_world, self._lighting), self._tracer)
            except Missing as missing:
                self.missing = missing
            except Exception as error:  # as of its buffers
                self.missing = _failed(error)
        return SunHours(seen, settings)

    def _count(self, settings: Settings) -> bool:
        """Another place of the sun; whether there are more."""
        hours = self._hours
        if hours is None:
            return False
        try:
            if hours.step():
                return True
        except Missing as missing:
            self.missing = missing
            hours.give_up()
        except Exception as error:
            self.missing = _failed(error)
            hours.give_up()
        self._hours = None
        if self._map.sink is not None:
            self._map.sink.publish(hours.message())
            self.maps += 1
        return False


def _failed(error: Exception) -> Missing:
    return Missing(PROCESSING, f"the ground could not be traced: {error}; {_FAILED}", False, ERROR)


@dataclass(frozen=True, eq=False)
class Course:
    """A sun, the (4, 4) transform of its frame to the world, and what finds it at a time."""

    light: LightSettings
    to_world: FloatArray
    lighting: Lighting


class SunHours:
    """A sum over places of the sun.

    Args:
        seen: the ground.
        course: the sun; None: nothing is known of its hours.
        tracer: what it is counted with; its scene is replaced.
    """

    def __init__(
        self, seen: _Seen, settings: Settings, course: Course | None = None, tracer: ShadowTracer | None = None
    ) -> None:
        self._seen = seen
        self._course = course
        self._tracer = tracer
        self._hours = np.full(seen.share.shape, np.nan)
        self._count = max(round(settings.sun_map_hours * 60.0 / settings.sun_map_step), 1)
        self._each = settings.sun_map_hours / self._count
        self._next = 0
        if course is None or tracer is None:
            self._next = self._count
            return
        fixed = course.light.sun.time
        self._begin = seen.when if fixed is None else fixed
        self._hours[seen.part.surface.valid] = 0.0
        self._points = _points(seen.part, seen.to_world, settings.grid_map_height_above)
        tracer.scene.clear()
        tracer.scene.put_surface(KEY, seen.part.surface, pose=seen.to_world)
        tracer.front_face_culling = settings.front_face_culling

    def step(self) -> bool:
        """Add the next place. False if there is none. Raises Missing."""
        if self._next >= self._count:
            return False
        assert self._course is not None and self._tracer is not None
        when = self._begin + round((self._next + 0.5) * self._each * _HOUR)
        self._next += 1
        sun = self._course.lighting.sun(self._course.light, self._course.to_world, when)
        if sun is not None:
            share = self._tracer.visibility(self._points, [sun])[0]
            self._hours[self._seen.part.surface.valid] += self._each * share.astype(np.float64)
        return self._next < self._count

    def give_up(self) -> None:
        """Nothing is known of the hours."""
        self._hours[:] = np.nan
        self._next = self._count

    def message(self) -> bytes:
        """Bytes of the grid_map_msgs/GridMap with the layers elevation, sunlit and hours."""
        grid_map = self._seen.part.map
        layers = {"elevation": grid_map.values, "sunlit": self._seen.share, "hours": self._hours.astype(np.float32)}
        return encode_grid_map(grid_map, layers, ["elevation"])


def _points(part: GridPart, to_world: FloatArray, above: float) -> FloatArray:
    """(N, 3) in the world, over the cells that have a height."""
    points = part.vertices[part.surface.valid.reshape(-1)].copy()
    points[:, 2] += above
    turned: FloatArray = points @ to_world[:3, :3].T + to_world[:3, 3]
    return turned


def _tracer_for(part: GridPart, settings: Settings, like: ShadowTracer, known: ShadowTracer | None) -> ShadowTracer:
    """A tracer for the ground alone, by the pipeline whose kernels are there already; the one that is known if it will
    do."""
    names = ("light_grid", None) if like.pipeline == "auto" else (like.pipeline, like.variant)
    needed = max(len(part.triangles), part.surface.valid.size, 64)
    if known is not None and names[0] == known.pipeline and names[1] in (None, known.variant):
        if known.scene.bounds.max_triangles >= needed:
            return known
    bounds = replace(
        settings.bounds,
        max_triangles=needed,
        max_rays=min(settings.max_rays, needed),
        max_lights=1,
        grid_entries=min(settings.grid_entries, 8 * needed),
        max_sample_sets=1,
    )
    options: dict[str, Any] = {"device": like.device, "bounds": bounds, "threads": like.threads}
    return ShadowTracer(*names, **options)
