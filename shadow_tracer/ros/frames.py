# SPDX-License-Identifier: Apache-2.0
"""Where camera, lights and meshes are at a time stamp: from tf, from the topic ``camera_pose``, or from parameters."""

from __future__ import annotations

import importlib
from bisect import bisect_left, insort
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from rclpy.node import Node
from rclpy.time import Time

from shadow_tracer.ros.diagnostics import ERROR, TRANSFORMS, Missing
from shadow_tracer.ros.messages import MessageError, rigid
from shadow_tracer.ros.settings import FloatArray, Settings

NO_TF = "tf2_ros cannot be imported here (install ros-jazzy-tf2-ros-py and source the installation); without it "


class TransformSource(Protocol):
    """What the node needs of tf."""

    def lookup(self, target: str, source: str, stamp: int) -> FloatArray:
        """(4, 4) transform from ``source`` to ``target`` at a stamp [ns]. Raises Missing."""

    def clear(self) -> None:
        """Forget everything that was received."""


class Tf2:
    """tf2_ros behind two calls. Raises ImportError if there is no tf2_ros."""

    def __init__(self, node: Node) -> None:
        self._tf2: Any = importlib.import_module("tf2_ros")
        self._buffer = self._tf2.Buffer(node=node)
        self._listener = self._tf2.TransformListener(self._buffer, node, spin_thread=False)

    def lookup(self, target: str, source: str, stamp: int) -> FloatArray:
        """(4, 4) transform from ``source`` to ``target`` at a stamp [ns]. Raises Missing, which may be waited for."""
        try:
            found = self._buffer.lookup_transform(target, source, Time(nanoseconds=stamp)).transform
        except self._tf2.TransformException as error:
            raise Missing(
                TRANSFORMS,
                f"no transform from {source!r} to {target!r} at the stamp of the image: {error}; "
                f"see `ros2 run tf2_ros tf2_echo {target} {source}`, or raise tf_timeout if it comes late",
            ) from error
        t, q = found.translation, found.rotation
        try:
            return rigid((t.x, t.y, t.z), (q.x, q.y, q.z, q.w), f"transform from {source} to {target}")
        except MessageError as error:
            raise Missing(
                TRANSFORMS, f"{error}; correct its publisher, see `ros2 topic info -v /tf`", False, ERROR
            ) from error

    def clear(self) -> None:
        """Forget everything that was received."""
        self._buffer.clear()


class PoseBuffer:
    """Poses by stamp, a bounded number of them; the nearest one answers. A pose with stamp 0 holds at all times."""

    def __init__(self, capacity: int = 512) -> None:
        self._capacity = capacity
        self._stamps: list[int] = []
        self._poses: dict[int, FloatArray] = {}
        self._always: FloatArray | None = None

    def __len__(self) -> int:
        return len(self._stamps) + (self._always is not None)

    def add(self, stamp: int, pose: FloatArray) -> None:
        """Add a pose at a stamp [ns]. Poses with stamps and one without replace each other."""
        if stamp == 0:
            self.clear()
            self._always = pose
            return
        self._always = None
        if stamp not in self._poses:
            insort(self._stamps, stamp)
        self._poses[stamp] = pose
        if len(self._stamps) > self._capacity:
            del self._poses[self._stamps.pop(0)]

    def clear(self) -> None:
        """Forget all poses with stamps; one that holds at all times stays."""
        self._stamps.clear()
        self._poses.clear()

    def nearest(self, stamp: int, tolerance: float, last_chance: bool) -> FloatArray:
        """The pose nearest to a stamp [ns], at most ``tolerance`` [s] away.

        Until ``last_chance``, a pose before the stamp is not taken as long as a nearer one may come.

        Raises:
            Missing: there is none.
        """
        if self._always is not None:
            return self._always
        if not self._stamps:
            raise Missing(
                TRANSFORMS, "no pose has arrived on camera_pose; publish one, or set pose_source to parameter"
            )
        place = bisect_left(self._stamps, stamp)
        found = min(self._stamps[max(place - 1, 0) : place + 1], key=lambda other: abs(other - stamp))
        distance = abs(found - stamp) * 1e-9
        final = place < len(self._stamps)
        if found == stamp or (distance <= tolerance and (final or last_chance)):
            return self._poses[found]
        raise Missing(
            TRANSFORMS,
            f"the nearest camera_pose is {distance:.3f} s away from the stamp of the image; publish it at the rate of "
            f"the image with stamps of the same clock, or raise tf_timeout (now {tolerance:g} s)",
            wait=not final,
        )


@dataclass(frozen=True)
class Poses:
    """Everything's place at one time stamp. ``world`` is the fixed frame, "" where it has no name."""

    camera_to_world: FloatArray
    camera_frame: str
    world: str
    lookup: Callable[[str, str], FloatArray]

    def frame_to_world(self, frame: str, field: str) -> FloatArray:
        """(4, 4) transform of a frame, "" being the world itself.

        Raises:
            Missing: it cannot be found; the text names ``field``, the parameter that asks for it.
        """
        if frame in ("", self.world):
            return np.eye(4)
        if frame == self.camera_frame:
            return self.camera_to_world
        if not self.world:
            raise Missing(TRANSFORMS, f"{field} is {frame!r} but fixed_frame is empty; set fixed_frame", False, ERROR)
        return self.lookup(frame, field)


class Frames:
    """Finds poses as the settings say. ``open_tf`` is called once tf is needed and may raise ImportError."""

    def __init__(self, open_tf: Callable[[], TransformSource]) -> None:
        self.camera_poses = PoseBuffer()
        self._open_tf = open_tf
        self._tf: TransformSource | None = None
        self._tried = False

    @property
    def has_tf(self) -> bool:
        """True once tf is listened to."""
        return self._tf is not None

    def configure(self, settings: Settings) -> None:
        """Start to listen to tf if these settings need it, so that its buffer fills before the first frame asks."""
        if settings.needs_tf and not self._tried:
            self._tried = True
            try:
                self._tf = self._open_tf()
            except ImportError:
                self._tf = None

    def clear(self) -> None:
        """Forget everything that was received: time has jumped back."""
        self.camera_poses.clear()
        if self._tf is not None:
            self._tf.clear()

    def at(self, settings: Settings, camera_frame: str, stamp: int, last_chance: bool = False) -> Poses:
        """Poses at a stamp [ns] for a depth image in ``camera_frame``.

        Raises:
            Missing: the camera's pose cannot be found.
        """
        world = settings.fixed_frame
        if settings.pose_source == "parameter":
            camera = rigid(settings.camera_pose[:3], settings.camera_pose[3:], "camera_pose")
        elif settings.pose_source == "topic":
            camera = self.camera_poses.nearest(stamp, settings.tf_timeout, last_chance)
        else:
            world = world or camera_frame
            hint = "set pose_source to topic or parameter"
            camera = (
                np.eye(4)
                if world == camera_frame
                else self._lookup(world, camera_frame, stamp, "the depth image", hint)
            )

        def lookup(frame: str, field: str) -> FloatArray:
            return self._lookup(
                world, frame, stamp, field, f"leave {field} empty and give its geometry in the fixed frame"
            )

        return Poses(camera, camera_frame, world, lookup)

    def _lookup(self, target: str, source: str, stamp: int, field: str, hint: str) -> FloatArray:
        if not source:
            raise Missing(
                TRANSFORMS, f"header.frame_id of {field} is empty; set it in the driver, or {hint}", False, ERROR
            )
        if self._tf is None:
            raise Missing(TRANSFORMS, f"{NO_TF}{source!r} of {field} is not found in {target!r}; {hint}", False, ERROR)
        return self._tf.lookup(target, source, stamp)
