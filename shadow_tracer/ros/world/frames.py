# SPDX-License-Identifier: Apache-2.0
"""Where camera, lights and meshes are at a time stamp: from tf, from the topic ``camera_pose``, or from parameters.

No ROS here but in :class:`Tf2`, which imports it when it is made.
"""

from __future__ import annotations

import importlib
import time
from bisect import bisect_left, insort
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from shadow_tracer.ros.diagnostics import ERROR, TRANSFORMS, Missing
from shadow_tracer.ros.settings import FloatArray, Settings
from shadow_tracer.ros.wire.messages import MessageError, frame_name, rigid

if TYPE_CHECKING:
    from rclpy.node import Node

NO_TF = "tf2_ros cannot be imported here (install ros-jazzy-tf2-ros-py and source the installation); without it "
STATIC_PERIOD = 1.0  # a static transform may be published again; it is looked up again after this many seconds


class TransformSource(Protocol):
    """What is needed of tf."""

    def lookup(self, target: str, source: str, stamp: int, purpose: str) -> FloatArray:
        """(4, 4) transform from ``source`` to ``target`` at a stamp [ns].

        Raises:
            Missing: it is not known; the text contains ``purpose``, such as "for the depth image at its stamp".
        """

    def is_static(self, target: str, source: str) -> bool:
        """True if every transform between the two is static: known, and the same at all times."""

    def clear(self) -> None:
        """Forget everything that was received with a stamp. Static transforms stay."""

    def close(self) -> None:
        """Stop listening."""


class Tf2:
    """tf2_ros behind a few calls. Raises ImportError if there is no tf2_ros."""

    def __init__(self, node: Node) -> None:
        self._tf2: Any = importlib.import_module("tf2_ros")
        self._time: Any = importlib.import_module("rclpy.time").Time
        # The buffer does without the node: with one it offers a service nobody asked for, and the first releases of
        # Jazzy raise out of its handler when time jumps back. Frames.clear() does what that handler should.
        self._buffer = self._tf2.Buffer()
        self._listener = self._tf2.TransformListener(self._buffer, node, spin_thread=False)

    def lookup(self, target: str, source: str, stamp: int, purpose: str) -> FloatArray:
        """(4, 4) transform from ``source`` to ``target`` at a stamp [ns]. Raises Missing, which may be waited for."""
        try:
            found = self._buffer.lookup_transform(target, source, self._time(nanoseconds=stamp)).transform
        except self._tf2.TransformException as error:
            raise Missing(
                TRANSFORMS,
                f"no transform from {source!r} to {target!r} {purpose}: {str(error).rstrip('. ')}; "
                f"see `ros2 run tf2_ros tf2_echo {target} {source}`, or raise tf_timeout if it comes late",
            ) from error
        t, q = found.translation, found.rotation
        try:
            return rigid((t.x, t.y, t.z), (q.x, q.y, q.z, q.w), f"transform from {source} to {target}")
        except MessageError as error:
            raise Missing(
                TRANSFORMS, f"{error}; correct its publisher, see `ros2 topic info -v /tf`", False, ERROR
            ) from error

    def is_static(self, target: str, source: str) -> bool:
        """True if tf gives the latest common stamp as 0, which it does where there is none but static transforms."""
        try:
            stamp = self._buffer.lookup_transform(target, source, self._time()).header.stamp
        except self._tf2.TransformException:
            return False
        return bool(stamp.sec == 0 and stamp.nanosec == 0)

    def clear(self) -> None:
        """Forget everything that was received with a stamp. Static transforms stay."""
        self._buffer.clear()

    def close(self) -> None:
        """Stop listening."""
        self._listener.unregister()


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


class Poses:
    """Everything's place at the stamp of one depth image, looked up when it is first asked for, and kept.

    Args:
        world: name of the fixed frame, "" where it has none.
        camera_frame: optical frame of the depth image.
        camera: pose of the camera at a stamp [ns], None being that of the image; may raise Missing.
        lookup: frame, field and stamp to (4, 4) transform to the world; may raise Missing.
        others: frame -> pose at a stamp, of the optical frames of other cameras that are not looked up.
    """

    def __init__(
        self,
        world: str,
        camera_frame: str,
        camera: Callable[[int | None], FloatArray],
        lookup: Callable[[str, str, int | None], FloatArray],
        others: Mapping[str, Callable[[int | None], FloatArray]] | None = None,
    ) -> None:
        self.world = world
        self.camera_frame = frame_name(camera_frame)
        self._camera = camera
        self._lookup = lookup
        self._others = others or {}
        self._kept: dict[tuple[str, int | None], FloatArray] = {}

    @property
    def camera_to_world(self) -> FloatArray:
        """(4, 4) pose of the optical frame, read-only. Raises Missing."""
        return self._keep(("", None), lambda: self._camera(None))

    def frame_to_world(self, frame: str, field: str, stamp: int | None = None) -> FloatArray:
        """(4, 4) transform of a frame, "" being the world itself, read-only.

        Args:
            frame: name of the frame.
            field: the parameter or message field that asks for it.
            stamp: when [ns]; None is the stamp of the image.

        Raises:
            Missing: it cannot be found; the text names ``field``.
        """
        frame = frame_name(frame)
        if frame in ("", self.world):
            return _IDENTITY
        if frame == self.camera_frame:
            return self.camera_to_world if stamp is None else self._camera(stamp)
        if frame in self._others:
            return self._keep((frame, stamp), lambda: self._others[frame](stamp))
        if not self.world:
            raise Missing(TRANSFORMS, f"{field} is {frame!r} but fixed_frame is empty; set fixed_frame", False, ERROR)
        return self._keep((frame, stamp), lambda: self._lookup(frame, field, stamp))

    def _keep(self, key: tuple[str, int | None], find: Callable[[], FloatArray]) -> FloatArray:
        found = self._kept.get(key)
        if found is None:
            self._kept[key] = found = find()
            found.setflags(write=False)  # several lights and meshes share it
        return found


_IDENTITY: FloatArray = np.eye(4)
_IDENTITY.setflags(write=False)


class Frames:
    """Finds poses as the settings say.

    Args:
        open_tf: called once tf is needed; may raise ImportError.
        static_period: seconds for which a transform is kept if it is static; 0 keeps none.
        clock: steady time [s].

    Attributes:
        poses_of: poses that came by topic, by camera.
    """

    def __init__(
        self,
        open_tf: Callable[[], TransformSource],
        static_period: float = STATIC_PERIOD,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.poses_of: dict[str, PoseBuffer] = {"": PoseBuffer()}
        self._optical: dict[str, str] = {}
        self._open_tf = open_tf
        self._tf: TransformSource | None = None
        self._tried = False
        self._period = static_period
        self._clock = clock
        # (target, source) -> transform if it is static, None if it is not; and when that was found out
        self._static: dict[tuple[str, str], tuple[FloatArray | None, float]] = {}

    @property
    def camera_poses(self) -> PoseBuffer:
        """Poses that came of the camera without a name."""
        return self.poses_of[""]

    def note_camera(self, camera: str, frame: str) -> None:
        """An image of a camera has come in this optical frame."""
        self._optical[camera] = frame_name(frame)

    @property
    def has_tf(self) -> bool:
        """True once tf is listened to."""
        return self._tf is not None

    def configure(self, settings: Settings) -> None:
        """Start to listen to tf if these settings need it, so that its buffer fills before the first frame asks."""
        if settings.needs_tf:
            self._open()

    def clear(self) -> None:
        """Forget everything that was received with a stamp: time has jumped back."""
        for poses in self.poses_of.values():
            poses.clear()
        self._static.clear()
        if self._tf is not None:
            self._tf.clear()

    def close(self) -> None:
        """Stop listening to tf; :meth:`configure` starts again."""
        self.clear()
        if self._tf is not None:
            self._tf.close()
        self._tf, self._tried = None, False

    def at(self, settings: Settings, camera_frame: str, stamp: int, last_chance: bool = False) -> Poses:
        """Poses at a stamp [ns] for a depth image in ``camera_frame``. What is missing is said by what is asked for.

        Args:
            settings: those of the camera, where it has a name.
        """
        camera_frame = frame_name(camera_frame)
        by_tf = settings.pose_source == "tf"
        world = settings.fixed_frame or (camera_frame if by_tf else "")

        def camera(at: int | None) -> FloatArray:
            if not by_tf:
                return self._given(settings, stamp if at is None else at, last_chance)
            if world == camera_frame:
                return np.eye(4)
            return self._lookup(
                world, camera_frame, stamp, at, "the depth image", "set pose_source to topic or parameter"
            )

        def lookup(frame: str, field: str, at: int | None) -> FloatArray:
            hint = f"leave {field} empty and give its geometry in the fixed frame"
            return self._lookup(world, frame, stamp, at, field, hint)

        others = {} if by_tf else self._others(settings, stamp, last_chance)
        return Poses(world, camera_frame, camera, lookup, others)

    def _given(self, settings: Settings, stamp: int, last_chance: bool) -> FloatArray:
        """Pose of a camera that does not come from tf."""
        if settings.pose_source == "parameter":
            return rigid(settings.camera_pose[:3], settings.camera_pose[3:], "camera_pose")
        poses = self.poses_of.setdefault(settings.camera, PoseBuffer())
        return poses.nearest(stamp, settings.tf_timeout, last_chance)

    def _others(
        self, settings: Settings, stamp: int, last_chance: bool
    ) -> dict[str, Callable[[int | None], FloatArray]]:
        """Poses of the cameras that have names, but for that of these settings, by their optical frames."""

        def pose(camera: str) -> Callable[[int | None], FloatArray]:
            of = settings.of(camera)
            return lambda at: self._given(of, stamp if at is None else at, last_chance)

        there = {camera: self._optical[camera] for camera in settings.camera_names if camera in self._optical}
        return {frame: pose(camera) for camera, frame in there.items() if camera != settings.camera}

    def _open(self) -> TransformSource | None:
        if not self._tried:
            self._tried = True
            try:
                self._tf = self._open_tf()
            except ImportError:
                self._tf = None
        return self._tf

    def _lookup(self, target: str, source: str, stamp: int, at: int | None, field: str, hint: str) -> FloatArray:
        if not source:
            raise Missing(
                TRANSFORMS, f"header.frame_id of {field} is empty; set it in the driver, or {hint}", False, ERROR
            )
        tf = self._open()  # a mesh may come in a frame no parameter names
        if tf is None:
            raise Missing(TRANSFORMS, f"{NO_TF}{source!r} of {field} is not found in {target!r}; {hint}", False, ERROR)
        now = self._clock()
        kept, since = self._static.get((target, source), (None, -np.inf))
        if kept is not None and now - since < self._period:
            return kept
        when = stamp if at is None else at
        purpose = f"for {field} at the stamp of {'the image' if at is None else 'its message'}"
        found = self._find(tf, target, source, when, purpose)
        if self._period > 0.0 and now - since >= self._period:
            self._static[target, source] = (found if tf.is_static(target, source) else None, now)
        return found

    def _find(self, tf: TransformSource, target: str, source: str, stamp: int, purpose: str) -> FloatArray:
        # tf takes 0 for "the latest", and nothing here may silently be the latest; below 0 it raises.
        if stamp <= 0 and not tf.is_static(target, source):
            raise Missing(
                TRANSFORMS,
                f"no transform from {source!r} to {target!r} {purpose}: header.stamp is {stamp * 1e-9:g} s; set it in "
                "the driver",
                wait=False,
            )
        return tf.lookup(target, source, max(stamp, 0), purpose)
