# SPDX-License-Identifier: Apache-2.0
"""A stand-in for the module tf2_ros, which the wheels do not have: stamped transforms, and its exceptions."""

from __future__ import annotations

import math
from types import ModuleType
from typing import Any

from geometry_msgs.msg import TransformStamped


class TransformException(Exception):
    """Base of what a lookup raises, as in tf2_ros."""


class LookupException(TransformException):
    """A frame does not exist."""


class ExtrapolationException(TransformException):
    """The stamp is outside of what is known."""


class Buffer:
    """Transforms to a target from a source: static, or known from one stamp to another."""

    def __init__(self, cache_time: Any = None, node: Any = None) -> None:
        self.node = node
        self.cleared = 0
        self.known: dict[tuple[str, str], tuple[TransformStamped, int, int]] = {}

    def put(self, target: str, source: str, x: float, until: int, since: int = 0) -> None:
        """A transform along x, turned by 90 degrees about z, known between two stamps [ns]."""
        msg = TransformStamped(child_frame_id=source)
        msg.header.frame_id = target
        msg.transform.translation.x = x
        msg.transform.rotation.z = msg.transform.rotation.w = math.sqrt(0.5)
        self.known[target, source] = (msg, since, until)

    def lookup_transform(
        self, target_frame: str, source_frame: str, time: Any, timeout: Any = None
    ) -> TransformStamped:
        """As tf2_ros: the transform that takes coordinates of ``source_frame`` to ``target_frame``."""
        if (target_frame, source_frame) not in self.known:
            raise LookupException(f'"{source_frame}" passed to lookupTransform argument source_frame does not exist.')
        msg, since, until = self.known[target_frame, source_frame]
        if not since <= time.nanoseconds <= until:
            raise ExtrapolationException(
                f"Lookup would require extrapolation into the future. Requested {time.nanoseconds}"
            )
        return msg

    def clear(self) -> None:
        """As tf2_ros: forget everything that is not static."""
        self.cleared += 1
        self.known.clear()


def module() -> tuple[ModuleType, list[Buffer]]:
    """A module to put in place of tf2_ros, and the buffers that will be made with it."""
    made: list[Buffer] = []
    double = ModuleType("tf2_ros")

    def make(*args: Any, **kwargs: Any) -> Buffer:
        made.append(Buffer(*args, **kwargs))
        return made[-1]

    class TransformListener:
        def __init__(self, buffer: Buffer, node: Any, *, spin_thread: bool = False) -> None:
            assert isinstance(buffer, Buffer) and not spin_thread

    contents = {
        "Buffer": make,
        "TransformListener": TransformListener,
        "TransformException": TransformException,
        "LookupException": LookupException,
        "ExtrapolationException": ExtrapolationException,
    }
    vars(double).update(contents)
    return double, made
