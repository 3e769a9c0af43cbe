# SPDX-License-Identifier: Apache-2.0
"""Recordings made by code, for benchmarks: depth images with their camera_info, and whatever else is written."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

_FOCAL = 525.0 / 640  # by the width
_KINDS = {
    "/mesh": "shape_msgs/msg/Mesh", "/mesh_marker": "visualization_msgs/msg/Marker",
    "/depth/camera_info": "sensor_msgs/msg/CameraInfo", "/depth/image_rect": "sensor_msgs/msg/Image",
}  # fmt: skip


class Recorder:
    """Writes a recording into a new folder, as mcap. Use as a context manager.

    Args:
        path: the folder.
        width, height: of its images.
        compressed: chunks by zstd.

    Attributes:
        written: bytes of messages.
    """

    def __init__(self, path: Path, width: int, height: int, compressed: bool = False) -> None:
        self.written = 0
        self._size = width, height
        self._types = get_typestore(Stores.ROS2_JAZZY)
        self._writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        if compressed:
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._connections: dict[str, Any] = {}

    def __enter__(self) -> Recorder:
        self._writer.open()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._writer.close()

    def write(self, topic: str, data: bytes, time: int) -> None:
        """Write the bytes of a message at a time of the log [ns]."""
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(topic, _KINDS[topic], typestore=self._types)
        self._writer.write(self._connections[topic], time, data)
        self.written += len(data)

    def image(self, depth: np.ndarray, stamp: int) -> None:
        """Write a depth image of (H, W) millimetres, after its camera_info."""
        (width, height), focal = self._size, _FOCAL * self._size[0]
        time = self._make("builtin_interfaces/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
        header = self._make("std_msgs/Header", stamp=time, frame_id="camera")
        roi = self._make("sensor_msgs/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        k = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
        info = self._make(
            "sensor_msgs/CameraInfo", header=header, height=height, width=width, k=k.reshape(-1),
            p=np.column_stack([k, np.zeros(3)]).reshape(-1), roi=roi, distortion_model="plumb_bob", d=np.zeros(5),
            r=np.eye(3).reshape(-1), binning_x=0, binning_y=0,
        )  # fmt: skip
        data = depth.astype(np.uint16).reshape(-1).view(np.uint8)
        image = self._make(
            "sensor_msgs/Image", header=header, height=height, width=width, encoding="16UC1", is_bigendian=0,
            step=2 * width, data=data,
        )  # fmt: skip
        for topic, message in (("/depth/camera_info", info), ("/depth/image_rect", image)):
            self.write(topic, bytes(self._types.serialize_cdr(message, message.__msgtype__)), stamp)

    def _make(self, kind: str, **fields: Any) -> Any:
        return self._types.types[kind.replace("/", "/msg/")](**fields)
