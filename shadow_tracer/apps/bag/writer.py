# SPDX-License-Identifier: Apache-2.0
"""Writes what the node would publish into a bag. It appears under its name once it is whole, or not at all."""

from __future__ import annotations

import hashlib
import os
import secrets
import shutil
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import numpy.typing as npt
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer, WriterError
from rosbags.typesys import TypesysError

from shadow_tracer.apps.bag.files import BagError
from shadow_tracer.apps.bag.types import USUAL
from shadow_tracer.ros.wire.dose_messages import FIELDS, STEP
from shadow_tracer.ros.wire.messages import image_layout

IMAGE = "sensor_msgs/msg/Image"
TIMING = "diagnostic_msgs/msg/DiagnosticArray"


class Output:
    """A new bag. Use as a context manager: it is kept if the block ends without an exception.

    Args:
        path: file ``*.mcap``, or a folder, which then gets a ``metadata.yaml`` too.
        overwrite: whether something that has that name may be replaced.

    Attributes:
        counts: messages written, by topic.

    Raises:
        BagError: there is something of that name, or it cannot be written.
    """

    def __init__(self, path: Path, overwrite: bool = False) -> None:
        self.path = path
        self.counts: Counter[str] = Counter()
        if path.exists() and not overwrite:
            raise BagError(f"{path}: exists already; choose another name, or give --overwrite")
        self._types = USUAL
        self._folder = path.parent / f".{path.name}.{os.getpid()}-{secrets.token_hex(4)}.part"
        self._bag = self._folder / path.stem
        self._connections: dict[str, Any] = {}
        self._digest = hashlib.sha256()
        try:
            self._folder.mkdir(parents=True)
            self._writer = Writer(self._bag, version=9, storage_plugin=StoragePlugin.MCAP)
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
        except (OSError, WriterError) as error:
            self._discard()
            raise BagError(f"{path}: cannot be written: {error}") from error

    def __enter__(self) -> Output:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._writer.close()
            if kind is None:
                self._keep()
        except (OSError, WriterError) as fault:
            if kind is None:
                raise BagError(f"{self.path}: cannot be written: {fault}") from fault
        finally:
            self._discard()

    def image(self, topic: str, time: int, pixels: npt.NDArray[Any], encoding: str, header: Any) -> None:
        """Write an image.

        Args:
            topic: full name.
            time: log time [ns].
            pixels: (H, W) or (H, W, channels), uint8, uint16 or float32.
            encoding: what ROS calls that: mono8, rgb8, 16UC1, 32FC1.
            header: header of the depth image it belongs to.
        """
        data = np.ascontiguousarray(pixels).reshape(-1).view(np.uint8)
        self._write(topic, time, IMAGE, header=self._header(header), data=data, **image_layout(pixels, encoding))

    def timing(
        self, topic: str, time: int, header: Any, name: str, level: bytes, text: str, device: str,
        values: Mapping[str, str],
    ) -> None:  # fmt: skip
        """Write one status as the node publishes them on ``~/timing``, at the stamp of a header."""
        types = self._types.types
        pair = types["diagnostic_msgs/msg/KeyValue"]
        status = types["diagnostic_msgs/msg/DiagnosticStatus"](
            level=level[0],
            name=name,
            message=text,
            hardware_id=device,
            values=[pair(key=key, value=value) for key, value in values.items()],
        )
        stamped = self._header(header)
        stamped.frame_id = ""
        self._write(topic, time, TIMING, header=stamped, status=[status])

    def message(self, topic: str, time: int, content: Any) -> None:
        """Write a message of ROS 2 Jazzy."""
        kind = content.__msgtype__
        self._put(topic, time, kind, self._types.serialize_cdr(content, kind), typestore=self._types)

    def cloud(self, topic: str, time: int, rows: npt.NDArray[Any], stamp: Any, frame: str) -> None:
        """Write texels as a cloud, rows as of :mod:`dose_messages`, in a frame at the stamp of an image."""
        types = self._types.types
        make = types["sensor_msgs/msg/PointField"]
        fields = [make(name=name, offset=offset, datatype=kind, count=1) for name, offset, kind, _ in FIELDS]
        when = types["builtin_interfaces/msg/Time"](sec=stamp.sec, nanosec=stamp.nanosec)
        header = types["std_msgs/msg/Header"](stamp=when, frame_id=frame)
        self._write(
            topic, time, "sensor_msgs/msg/PointCloud2", header=header, height=1, width=len(rows), fields=fields,
            is_bigendian=False, point_step=STEP, row_step=STEP * len(rows), data=rows.view(np.uint8), is_dense=False,
        )  # fmt: skip

    def value(self, topic: str, time: int, kind: str, data: Any) -> None:
        """Write a message of std_msgs that holds a single value."""
        self._write(topic, time, kind, data=data)

    def raw(self, topic: str, time: int, kind: str, data: bytes) -> None:
        """Write the bytes of a message of ROS 2 Jazzy."""
        self._put(topic, time, kind, data, typestore=self._types)

    def copy(self, topic: str, time: int, kind: str, data: bytes, typestore: Any, qos: Any) -> None:
        """Write a message as it was read.

        Args:
            topic: full name.
            time: log time [ns].
            kind: its type.
            data: its bytes, plain CDR.
            typestore: what defines the type.
            qos: profiles that its publishers offered.
        """
        self._put(topic, time, kind, data, typestore=typestore, offered_qos_profiles=qos)

    @property
    def checksum(self) -> str:
        """SHA-256 of topics, times and bytes of all messages so far but those of :data:`TIMING`, in order."""
        return self._digest.hexdigest()

    def note(self, name: str, text: str) -> None:
        """Put a text beside the messages, into the custom data of the bag."""
        self._writer.set_custom_data(name, text)

    def _header(self, header: Any) -> Any:
        types = self._types.types
        stamp = types["builtin_interfaces/msg/Time"](sec=header.stamp.sec, nanosec=header.stamp.nanosec)
        return types["std_msgs/msg/Header"](stamp=stamp, frame_id=header.frame_id)

    def _write(self, topic: str, time: int, kind: str, **fields: Any) -> None:
        data = self._types.serialize_cdr(self._types.types[kind](**fields), kind)
        self._put(topic, time, kind, data, typestore=self._types)

    def _put(self, topic: str, time: int, kind: str, data: Any, **how: Any) -> None:
        try:
            if topic not in self._connections:
                self._connections[topic] = self._writer.add_connection(topic, kind, **how)
            self._writer.write(self._connections[topic], time, data)
        except (OSError, WriterError, TypesysError, KeyError) as error:
            raise BagError(f"{self.path}: {topic} cannot be written: {error}") from error
        self.counts[topic] += 1
        if kind != TIMING:
            self._digest.update(f"{topic} {time} {len(data)} ".encode())
            self._digest.update(data)

    def _keep(self) -> None:
        made = self._bag / f"{self._bag.name}.mcap" if self.path.suffix == ".mcap" else self._bag
        if self.path.is_dir():
            shutil.rmtree(self.path)
        elif self.path.exists() and made.is_dir():
            self.path.unlink()
        if made.is_file():
            with made.open("rb") as file:
                os.fsync(file.fileno())  # a name is not to outlive the contents when the power fails
        os.replace(made, self.path)

    def _discard(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)
