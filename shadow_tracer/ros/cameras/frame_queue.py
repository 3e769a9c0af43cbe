# SPDX-License-Identifier: Apache-2.0
"""Depth images that wait for what belongs to them, a bounded number of them. No ROS here."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy.typing as npt

from shadow_tracer.ros.cameras.camera_infos import CameraInfos
from shadow_tracer.ros.wire.parts import Part

if TYPE_CHECKING:
    from sensor_msgs.msg import CameraInfo, Image


@dataclass(frozen=True, eq=False)
class WaitingFrame:
    """A depth image that has arrived.

    Attributes:
        image: the message; its header goes to everything made from it.
        depth: its pixels, (H, W) uint16 millimetres or float32 metres.
        stamp: its stamp [ns].
        arrived: steady time of arrival [s].
        decoding: time decoding took [ms].
        parts: the meshes that it is to be traced with; None is the newest there are then.
        topic: what it came on.
    """

    image: Image
    depth: npt.NDArray[Any]
    stamp: int
    arrived: float
    decoding: float = 0.0
    parts: Mapping[str, Part] | None = None
    topic: str = ""


class FrameQueue:
    """Always the newest frame: taking one drops those before it, and they are counted. With ``every`` the oldest is
    next, and none is dropped as long as there is room.

    More than one has to wait because a frame whose transform comes late would otherwise be displaced for ever by frames
    whose transforms come later still.

    Args:
        camera: name of the camera, "" if it has none.

    Attributes:
        every: whether all frames are answered in order, or always the newest.
        dropped: frames that were not answered.
    """

    CAPACITY = 8
    CAPACITY_EVERY = 256

    def __init__(self, camera: str = "") -> None:
        self.every = False
        self.dropped = 0
        self._frames: deque[WaitingFrame] = deque()
        self._infos = CameraInfos(f"set cameras.{camera}.info_topic") if camera else CameraInfos()

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def capacity(self) -> int:
        """The most frames that wait."""
        return self.CAPACITY_EVERY if self.every else self.CAPACITY

    def candidates(self) -> Iterator[WaitingFrame]:
        """The frames that may be next, the best first: the last arrived first, or with ``every`` the first alone."""
        return iter(tuple(self._frames)[:1] if self.every else tuple(reversed(self._frames)))

    def put(self, frame: WaitingFrame) -> None:
        """Append a frame; the oldest are dropped if there is no room."""
        while len(self._frames) >= self.capacity:
            self._frames.popleft()
            self.dropped += 1
        self._frames.append(frame)
        self._infos.note_image(frame.stamp)

    def take(self, frame: WaitingFrame) -> None:
        """Remove a frame, and drop those that arrived before it."""
        while self._frames:
            if self._frames.popleft() is frame:
                return
            self.dropped += 1

    def keep_newest(self) -> None:
        """Drop all frames but the last arrived; with ``every`` none."""
        while len(self._frames) > 1 and not self.every:
            self._frames.popleft()
            self.dropped += 1

    def clear(self) -> None:
        """Drop all frames and forget every camera_info."""
        self.dropped += len(self._frames)
        self._frames.clear()
        self._infos.clear()

    def note_image(self, stamp: int) -> None:
        """An image with this stamp [ns] has arrived that is not to wait here."""
        self._infos.note_image(stamp)

    def put_info(self, info: CameraInfo) -> None:
        """Remember a camera_info, the last of each stamp."""
        self._infos.put(info, 4 * self.capacity)

    def info_for(self, frame: WaitingFrame, policy: str, last_chance: bool = True) -> CameraInfo:
        """The camera_info of a frame; see :meth:`CameraInfos.find`. Raises Missing."""
        return self._infos.find(frame.stamp, policy, last_chance)
