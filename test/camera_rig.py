# SPDX-License-Identifier: Apache-2.0
"""A node with several cameras, and publishers for each of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from compressed_images import compressed_msg
from harness import CAMERA_FRAME, FOCAL, Rig, image_msg, info_msg, nanoseconds, reliable
from sensor_msgs.msg import CameraInfo, CompressedImage, Image

from shadow_tracer.ros.diagnostics import DEPTH

NAMES = ("front", "rear")
# Where the two are, without tf: side by side.
POSES = {"front": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], "rear": [0.3, 0.1, 0.0, 0.0, 0.0, 0.0, 1.0]}
PLACED = {"pose_source": "parameter", "camera_names": list(NAMES)} | {
    f"cameras.{name}.pose": pose for name, pose in POSES.items()
}


class CameraRig(Rig):
    """As :class:`Rig`, with cameras ``front`` and ``rear``; those of their topics that no parameter names have the
    names that they have without.

    Args:
        parameters: on top of :data:`PLACED`.
        codec: of packed images, which ``send(packed=True)`` publishes.
    """

    def __init__(self, parameters: Mapping[str, Any] | None = None, *, start: bool = True, **keywords: Any) -> None:
        given = {**PLACED, **(parameters or {})}
        super().__init__(given, start=False, **keywords)
        self.of: dict[str, dict[str, Any]] = {name: {"masks": []} for name in NAMES}
        try:
            for name, of in self.of.items():
                topic = given.get(f"cameras.{name}.depth_topic", f"{name}/depth/image_rect")
                beside = f"{topic.rpartition('/')[0]}/camera_info".lstrip("/" if not topic.startswith("/") else "")
                of["depth"] = self.friend.create_publisher(Image, topic, reliable())
                of["packed"] = self.friend.create_publisher(CompressedImage, f"{topic}/compressedDepth", reliable())
                info = given.get(f"cameras.{name}.info_topic", beside)
                of["info"] = self.friend.create_publisher(CameraInfo, info, reliable())
                self.listen(Image, f"shadow_tracer/{name}/mask", of["masks"])
            if start:
                self.start()
        except BaseException:
            self.close()
            raise

    def connected(self, timeout: float = 60.0) -> None:
        """Wait until the inputs and outputs of both cameras are matched."""
        of = [*self.of.values()]
        self.until(lambda: all(each["info"].get_subscription_count() for each in of), timeout, "camera_info is heard")
        heard = {s.topic_name: s for s in self.friend.subscriptions}
        masks = [self.friend.resolve_topic_name(f"shadow_tracer/{name}/mask") for name in self.of]
        self.until(lambda: all(heard[topic].get_publisher_count() for topic in masks), timeout, "masks are heard")
        for name in self.of:
            self.until(lambda name=name: self._taken(name), timeout, f"the images of {name} are heard")

    def _taken(self, name: str) -> int:
        of = self.of[name]
        return int(of["depth"].get_subscription_count() + of["packed"].get_subscription_count())

    def send(
        self, camera: str, depth: np.ndarray, stamp: int | None = None, *, info: bool = True, packed: bool = False,
        frame: str = CAMERA_FRAME,
    ) -> int:  # fmt: skip
        """Publish an image of a camera and its camera_info; returns the stamp."""
        stamp, of = self.next_stamp() if stamp is None else stamp, self.of[camera]
        if info:
            of["info"].publish(info_msg(depth.shape[1], depth.shape[0], stamp, FOCAL, frame=frame))
        if packed:
            of["packed"].publish(compressed_msg(depth, stamp, frame, "rvl"))
        else:
            of["depth"].publish(image_msg(depth, stamp, frame))
        return stamp

    def seen(self, camera: str, stamp: int) -> np.ndarray | None:
        """The mask of a camera with a stamp, None if it has not come."""
        found = (m for m in self.of[camera]["masks"] if nanoseconds(m.header.stamp) == stamp)
        return next((np.frombuffer(m.data, np.uint8).reshape(m.height, m.width) for m in found), None)

    def mask(self, camera: str, stamp: int, timeout: float = 10.0) -> np.ndarray:
        """Wait for it."""
        found: list[np.ndarray] = []

        def come() -> bool:
            mask = self.seen(camera, stamp)
            found.extend([mask] if mask is not None else [])
            return bool(found)

        self.until(come, timeout, f"a mask of {camera} with stamp {stamp} ns")
        return found[0]

    def look(self, camera: str, depth: np.ndarray, **keywords: Any) -> np.ndarray:
        """Send an image and wait for its mask."""
        return self.mask(camera, self.send(camera, depth, **keywords))

    def number(self, camera: str, key: str) -> int:
        """What ``/diagnostics`` counts of a camera."""
        return int(self.value(f"{DEPTH} {camera}", key) or 0)
