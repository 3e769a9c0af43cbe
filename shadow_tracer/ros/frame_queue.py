# SPDX-License-Identifier: Apache-2.0
"""Depth images that wait for what belongs to them, newest first, a bounded number of them; and camera_info by stamp."""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy.typing as npt
from sensor_msgs.msg import CameraInfo, Image

from shadow_tracer.ros.diagnostics import DEPTH, Missing
from shadow_tracer.ros.messages import stamp_ns


@dataclass(frozen=True, eq=False)
class WaitingFrame:
    """A depth image that has arrived.

    Attributes:
        image: the message; its header goes to everything made from it.
        depth: its pixels, (H, W) uint16 millimetres or float32 metres.
        stamp: its stamp [ns].
        arrived: steady time of arrival [s].
        decoding: time decoding took [ms].
    """

    image: Image
    depth: npt.NDArray[Any]
    stamp: int
    arrived: float
    decoding: float = 0.0


class FrameQueue:
    """Always the newest frame: taking one drops those before it, and they are counted.

    More than one has to wait because a frame whose transform comes late would otherwise be displaced for ever by frames
    whose transforms come later still.
    """

    def __init__(self, capacity: int = 8, infos: int = 32) -> None:
        self.dropped = 0
        self._frames: deque[WaitingFrame] = deque()
        self._capacity = capacity
        self._infos: OrderedDict[int, CameraInfo] = OrderedDict()
        self._info_capacity = infos

    def __len__(self) -> int:
        return len(self._frames)

    def newest_first(self) -> Iterator[WaitingFrame]:
        """The waiting frames, the last arrived first."""
        return iter(tuple(reversed(self._frames)))

    def put(self, frame: WaitingFrame) -> None:
        """Append a frame; the oldest is dropped if there is no room."""
        if len(self._frames) == self._capacity:
            self._frames.popleft()
            self.dropped += 1
        self._frames.append(frame)

    def take(self, frame: WaitingFrame) -> None:
        """Remove a frame, and drop those that arrived before it."""
        while self._frames:
            if self._frames.popleft() is frame:
                return
            self.dropped += 1

    def keep_newest(self) -> None:
        """Drop all frames but the last arrived."""
        while len(self._frames) > 1:
            self._frames.popleft()
            self.dropped += 1

    def clear(self) -> None:
        """Drop all frames and forget every camera_info."""
        self.dropped += len(self._frames)
        self._frames.clear()
        self._infos.clear()

    def put_info(self, info: CameraInfo) -> None:
        """Remember a camera_info, the last of each stamp."""
        stamp = stamp_ns(info.header.stamp)
        self._infos.pop(stamp, None)
        self._infos[stamp] = info
        if len(self._infos) > self._info_capacity:
            self._infos.popitem(last=False)

    def info_for(self, frame: WaitingFrame, policy: str) -> CameraInfo:
        """The camera_info of a frame by the policy ``exact`` or ``latest``.

        Raises:
            Missing: none has arrived, or none with its stamp.
        """
        if not self._infos:
            raise Missing(
                DEPTH, "no camera_info has arrived; start its publisher, or remap depth/camera_info to its topic"
            )
        last = next(reversed(self._infos.values()))
        if policy == "latest":
            return last
        info = self._infos.get(frame.stamp)
        if info is None:
            distance = (stamp_ns(last.header.stamp) - frame.stamp) * 1e-6
            raise Missing(
                DEPTH,
                f"no camera_info has the stamp of the image (the last one differs by {distance:+.3f} ms); "
                "set camera_info_policy to latest if the camera does not move its lens",
            )
        return info
