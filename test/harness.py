# SPDX-License-Identifier: Apache-2.0
"""The package's harness with what only its own tests want: small buffers, packed images, a look inside the node."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from compressed_images import compressed_msg
from node_process import SMALL
from node_process import NodeProcess as NodeProcess  # for those who import it from here
from sensor_msgs.msg import CompressedImage, Image, PointCloud2

from shadow_tracer import testing
from shadow_tracer.ros.diagnostics import MESH
from shadow_tracer.ros.node.core import Core

# For those who import them from here.
from shadow_tracer.testing.messages import CAMERA_FRAME, FOCAL, HEIGHT, WIDTH
from shadow_tracer.testing.messages import image_msg as image_msg
from shadow_tracer.testing.messages import info_msg as info_msg
from shadow_tracer.testing.messages import nanoseconds as nanoseconds
from shadow_tracer.testing.messages import plate as plate
from shadow_tracer.testing.messages import reliable as reliable
from shadow_tracer.testing.messages import time_msg as time_msg
from shadow_tracer.testing.messages import wall as wall

__all__ = ["FOCAL", "HEIGHT", "SMALL", "WIDTH", "NodeProcess", "Rig"]


class Rig(testing.Harness):
    """As the package's, on top of :data:`SMALL`.

    Args:
        codec: png or rvl: depth images are sent packed, as compressedDepth.
        keywords: as for :class:`shadow_tracer.testing.Harness`.
    """

    defaults = {**testing.DEFAULTS, **SMALL}

    def __init__(self, parameters: Mapping[str, Any] | None = None, *, codec: str = "", **keywords: Any) -> None:
        self.codec = codec
        super().__init__(parameters, **keywords)

    def _connect(self, durability: Any) -> None:
        super()._connect(durability)
        if self.codec:
            self.friend.destroy_publisher(self.depth)
            topic = "depth/image_rect/compressedDepth"
            self.depth = self.friend.create_publisher(CompressedImage, topic, reliable())

    @property
    def core(self) -> Core:
        """What is behind the node, for tests that look at what no topic tells."""
        assert self.node is not None
        return self.node.core

    def depth_msg(self, depth: np.ndarray, stamp: int, frame: str = CAMERA_FRAME) -> Image | CompressedImage:
        """A depth image as it is sent now, packed or not."""
        return compressed_msg(depth, stamp, frame, self.codec) if self.codec else image_msg(depth, stamp, frame)

    def mask_msg(self, *arguments: Any, **keywords: Any) -> Image:
        """As the package's; the mask must be in the frame of the camera."""
        msg = super().mask_msg(*arguments, **keywords)
        assert msg.header.frame_id == CAMERA_FRAME
        return msg

    def send_mesh_bytes(self, data: bytes, timeout: float = testing.friend.TIMEOUT) -> None:
        """As the package's, when its diagnostics know of the meshes before: a late word of those is none of this one.
        To a node that was not started here, or not yet, without waiting."""
        if self.node is None:
            self.mesh.publish(data)
            return
        meshes = self.core.inputs.meshes
        self.until(lambda: self.value(MESH, "received") == str(meshes.received), timeout, "diagnostics are up to date")
        super().send_mesh_bytes(data, timeout)

    def send_part(self, topic: str, kind: Any, message: Any) -> None:
        """Publish a mesh on one of its topics, as a message or as bytes, and wait until the node has taken it."""
        source = self.core.inputs.meshes.sources[topic]
        publisher, before = self.publisher(kind, topic), source.arrivals.count
        publisher.publish(message)
        self.until(lambda: source.arrivals.count > before, what=f"{topic} is received")

    def ask(self, cloud: PointCloud2, timeout: float = testing.friend.TIMEOUT) -> PointCloud2:
        """Publish a query and wait for its answer."""
        answers = self.collect(PointCloud2, "shadow_tracer/query/visibility")
        publisher, before = self.publisher(PointCloud2, "query"), len(answers)
        publisher.publish(cloud)
        self.until(lambda: len(answers) > before, timeout, "the query is answered")
        return answers[-1]

    def set(self, **values: Any) -> str:
        """Set parameters of the node in one go, ``__`` standing for a dot; "" or why it was refused."""
        return self.set_parameters({name.replace("__", "."): value for name, value in values.items()})

    def settle(self, seconds: float = 0.3) -> None:
        """Spin on, to see that something does not happen."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            self.executor.spin_once(timeout_sec=0.02)
