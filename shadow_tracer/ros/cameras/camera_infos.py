# SPDX-License-Identifier: Apache-2.0
"""camera_info messages by stamp, and which of them belongs to an image. No ROS here."""

from __future__ import annotations

from collections import OrderedDict, deque
from typing import TYPE_CHECKING, Any

from shadow_tracer.ros.diagnostics import DEPTH, Missing
from shadow_tracer.ros.wire.messages import info_content, stamp_ns

if TYPE_CHECKING:
    from sensor_msgs.msg import CameraInfo

POLICIES = ("auto", "exact", "latest")
_PAIRED = 2  # so many images before this one had their camera_info: it will have one, too
_SETTLED = 8  # so many images later a camera_info that differs from the one before it is believed
_REMAP = "remap depth/camera_info to its topic"


class CameraInfos:
    """The last ones that arrived, a bounded number of them.

    Args:
        cure: what helps where none arrives.
    """

    def __init__(self, cure: str = _REMAP) -> None:
        self._cure = cure
        self._kept: OrderedDict[int, tuple[CameraInfo, tuple[Any, ...]]] = OrderedDict()
        self._images: deque[int] = deque(maxlen=32)
        self._agreeing = True  # the newest one and the one that arrived before it
        self._images_since = 0

    def clear(self) -> None:
        """Forget all."""
        self.__init__(self._cure)  # type: ignore[misc]

    def put(self, info: CameraInfo, capacity: int) -> None:
        """Remember one, the last of each stamp, and at most ``capacity`` of them."""
        stamp, content = stamp_ns(info.header.stamp), info_content(info)
        if self._kept:
            self._agreeing = next(reversed(self._kept.values()))[1] == content
            self._images_since = self._images_since if self._agreeing else 0
        self._kept.pop(stamp, None)
        self._kept[stamp] = info, content
        while len(self._kept) > capacity:
            self._kept.popitem(last=False)

    def note_image(self, stamp: int) -> None:
        """An image with this stamp [ns] has arrived."""
        self._images.append(stamp)
        self._images_since += 1

    def find(self, stamp: int, policy: str, last_chance: bool) -> CameraInfo:
        """The camera_info of an image.

        Args:
            stamp: that of the image [ns].
            policy: ``exact``: the one with that stamp. ``latest``: the one that arrived last. ``auto``: the one with
                that stamp; where there is none, the one after it in time if it equals the one before it; where there is
                none on one side, the one that arrived last if it equals the one before, or has been in force for a
                while.
            last_chance: nothing that is missing now will come: ``auto`` waits no longer for the stamp itself, which it
                does where the images before had theirs.

        Raises:
            Missing: none has arrived, or none that fits.
        """
        if not self._kept:
            raise Missing(DEPTH, f"no camera_info has arrived; start its publisher, or {self._cure}")
        last = next(reversed(self._kept.values()))[0]
        if policy == "latest":
            return last
        if stamp in self._kept:
            return self._kept[stamp][0]
        distance = (stamp_ns(last.header.stamp) - stamp) * 1e-6
        text = f"no camera_info has the stamp of the image (the last one differs by {distance:+.3f} ms)"
        if policy == "exact":
            raise Missing(DEPTH, f"{text}; set camera_info_policy to auto, or to latest if the lens does not move")
        if not last_chance and self._is_paired(stamp):
            raise Missing(DEPTH, f"{text}; it may still come")
        before = max((other for other in self._kept if other < stamp), default=None)
        after = min((other for other in self._kept if other > stamp), default=None)
        if before is not None and after is not None:
            if self._kept[before][1] == self._kept[after][1]:
                return self._kept[after][0]
        elif self._agreeing or self._images_since >= _SETTLED:
            return last
        raise Missing(
            DEPTH,
            f"{text}, and those around it differ; publish it with each image, or set camera_info_policy to latest",
        )

    def _is_paired(self, stamp: int) -> bool:
        """Whether the images before this one had a camera_info of their stamp; of the first ones it is expected."""
        if stamp not in self._images:
            return False
        images = list(self._images)
        place = images.index(stamp)
        return all(other in self._kept for other in images[max(0, place - _PAIRED) : place])
