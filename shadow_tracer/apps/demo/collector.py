# SPDX-License-Identifier: Apache-2.0
"""Listens to publisher and node, and puts together what belongs to one frame."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shadow_tracer.apps.demo import publisher
from shadow_tracer.scene.camera import Camera

PENDING = 16


@dataclass(frozen=True)
class Shot:
    """Everything about one frame.

    Attributes:
        stamp: nanoseconds, of all its messages.
        camera: pinhole camera with its pose in the world.
        depth: (H, W) float32 metres, NaN where invalid.
        colour: (H, W, 3) uint8 sRGB.
        masks: light name -> (H, W) uint8, of the node or of the library.
        stages: stage name -> milliseconds.
        counters: the other numbers of the frame.
        way: milliseconds from the stamp until the last mask was here.
    """

    stamp: int
    camera: Camera
    depth: NDArray[np.float32]
    colour: NDArray[np.uint8]
    masks: dict[str, NDArray[np.uint8]]
    stages: dict[str, float]
    counters: dict[str, float]
    way: float


@dataclass
class _Pieces:
    messages: dict[str, Any] = field(default_factory=dict)
    arrived: float = 0.0


class Collector:
    """Subscribes to all topics of the demo.

    Args:
        node: an rclpy node.
        lights: names of the lights whose masks are awaited.

    Attributes:
        health: status name -> (level, message) of the latest /diagnostics.
        unknown: how many frames the node answered without tracing them, and why the last time.
    """

    def __init__(self, node: Any, lights: Sequence[str]) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import PoseStamped
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from sensor_msgs.msg import CameraInfo, Image

        self._shots: list[Shot] = []
        self.health: dict[str, tuple[int, str, dict[str, str]]] = {}
        self.unknown = 0
        self.unknown_because = ""
        self._lights = tuple(lights)
        self._pieces: dict[int, _Pieces] = {}
        qos = QoSProfile(depth=publisher.KEPT, reliability=ReliabilityPolicy.RELIABLE)
        kinds = {
            publisher.DEPTH_TOPIC: Image,
            publisher.INFO_TOPIC: CameraInfo,
            publisher.POSE_TOPIC: PoseStamped,
            publisher.COLOUR_TOPIC: Image,
            "/shadow_tracer/timing": DiagnosticArray,
            **{f"{publisher.MASK_TOPIC}/{name}": Image for name in lights},
        }
        self._wanted = frozenset(kinds)
        self._subscriptions = [
            node.create_subscription(kind, topic, self._keeper(topic), qos) for topic, kind in kinds.items()
        ]
        self._subscriptions.append(node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10))

    def take(self) -> list[Shot]:
        """The frames completed since the last call, in order of completion."""
        shots, self._shots = self._shots, []
        return shots

    def _keeper(self, topic: str) -> Any:
        def keep(message: Any) -> None:
            stamp = publisher.stamp_ns(message.header.stamp)
            pieces = self._pieces.setdefault(stamp, _Pieces())
            pieces.messages[topic] = message
            if topic.startswith(publisher.MASK_TOPIC):
                pieces.arrived = time.time()
            if self._wanted <= pieces.messages.keys():
                del self._pieces[stamp]
                self._complete(stamp, pieces)
            while len(self._pieces) > PENDING:
                del self._pieces[min(self._pieces)]

        return keep

    def _complete(self, stamp: int, pieces: _Pieces) -> None:
        m = pieces.messages
        status = m["/shadow_tracer/timing"].status[0]
        if level(status) != 0:
            self.unknown += 1
            self.unknown_because = status.message
            return
        stages, counters = split_timing({v.key: v.value for v in status.values})
        masks = {name: pixels(m[f"{publisher.MASK_TOPIC}/{name}"]) for name in self._lights}
        self._shots.append(
            Shot(
                stamp,
                camera_of(m[publisher.INFO_TOPIC], m[publisher.POSE_TOPIC].pose),
                metres(pixels(m[publisher.DEPTH_TOPIC])),
                pixels(m[publisher.COLOUR_TOPIC]),
                masks,
                stages,
                counters,
                1e3 * (pieces.arrived - stamp / 1e9),
            )
        )

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            name = status.name.split(":")[-1].strip()
            self.health[name] = (level(status), status.message, {v.key: v.value for v in status.values})


def level(status: Any) -> int:
    """Level of a DiagnosticStatus (a single byte in Python) as a number: 0 is OK."""
    return int.from_bytes(status.level, "little") if isinstance(status.level, bytes) else int(status.level)


def split_timing(values: dict[str, str]) -> tuple[dict[str, float], dict[str, float]]:
    """Stages in ms and other numbers of a timing message; what is no number is left out."""
    stages: dict[str, float] = {}
    others: dict[str, float] = {}
    for key, text in values.items():
        try:
            value = float(text)
        except ValueError:
            continue
        if key.endswith("[ms]"):
            stages[key[: -len("[ms]")].strip()] = value
        else:
            others[key] = value
    return stages, others


def pixels(message: Any) -> NDArray[Any]:
    """Array of a sensor_msgs/Image as the demo's processes send it: (H, W) or (H, W, 3), tightly packed."""
    kinds: dict[str, tuple[type, tuple[int, ...]]] = {
        "mono8": (np.uint8, ()),
        "rgb8": (np.uint8, (3,)),
        "16UC1": (np.uint16, ()),
        "32FC1": (np.float32, ()),
    }
    dtype, channels = kinds[message.encoding]
    return np.frombuffer(message.data, dtype=dtype).reshape(message.height, message.width, *channels)


def metres(depth: NDArray[Any]) -> NDArray[np.float32]:
    """Depth in metres with NaN where invalid, from either encoding."""
    if depth.dtype == np.uint16:
        return np.where(depth > 0, depth / np.float32(1000), np.float32(np.nan)).astype(np.float32)
    return np.asarray(depth, dtype=np.float32)


def camera_of(info: Any, pose: Any) -> Camera:
    """The camera that a CameraInfo and a Pose describe."""
    x, y, z, w = pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = pose.position.x, pose.position.y, pose.position.z
    return Camera(info.width, info.height, info.k[0], info.k[4], info.k[2], info.k[5], matrix)
