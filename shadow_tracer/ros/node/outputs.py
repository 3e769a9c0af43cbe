# SPDX-License-Identifier: Apache-2.0
"""What the node publishes. Images are made only where somebody wants them."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from visualization_msgs.msg import MarkerArray

from shadow_tracer.ros.cameras.overlay import overlay
from shadow_tracer.ros.node import qos
from shadow_tracer.ros.node.answer import MOST_BITS, Answer, published_mask
from shadow_tracer.ros.node.subscriptions import keeps_for_late_joiners
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.wire.layouts import grid_map_type
from shadow_tracer.ros.wire.messages import image_message

_MASK, _SHARE, _POWER = _KINDS = ("mask/", "visibility/", "irradiance/")
_DEPTHS = {"lit": True, "shadowed": False}


class Outputs:
    """The publishers, but for those of :class:`CameraOutputs`.

    Attributes:
        cameras: those of each camera, by name.
        sun_map: None where there is no grid_map_msgs.
    """

    def __init__(self, node: Node, cameras: Iterable[str]) -> None:
        self.cameras = {name: CameraOutputs(node, name) for name in cameras}
        self.visibility = _publisher(node, PointCloud2, "~/query/visibility", qos.burst())
        self.scene_markers = _publisher(node, MarkerArray, "~/scene_markers", qos.latched())
        self.light_markers = _publisher(node, MarkerArray, "~/light_markers", qos.latched())
        self.shadow_grid = _publisher(node, OccupancyGrid, "~/shadow_grid", qos.latched())
        kind = grid_map_type()
        self.sun_map = _publisher(node, kind, "~/sun_map", qos.latched()) if kind is not None else None
        self.diagnostics = _publisher(node, DiagnosticArray, "/diagnostics", qos.report())

    def configure(self, settings: Settings) -> None:
        """Follow the lights of the settings."""
        for camera in self.cameras.values():
            camera.configure(settings)


class CameraOutputs:
    """The publishers of what is found of the images of one camera. Those of single lights come and go with the lights.

    Args:
        node: the node.
        camera: name of the camera, under which the topics are; of one without a name there is no such part.

    Attributes:
        lights, shares, powers: the masks, the visible shares and the irradiances, by light.
        infos: camera_info for them, by what stands before ``camera_info``: "mask/", "visibility/" and "irradiance/" are
            those that image_transport looks for beside every light's.
    """

    def __init__(self, node: Node, camera: str) -> None:
        self._node = node
        self._under = f"~/{camera}/" if camera else "~/"
        self.mask = self._publisher(Image, "mask")
        self.info = self._publisher(CameraInfo, "camera_info")
        self.bits = self._publisher(Image, "light_bits")
        self.overlay = self._publisher(Image, "overlay")
        self.irradiance = self._publisher(Image, "irradiance")
        self.depths = {lit: self._publisher(Image, f"depth_{name}") for name, lit in _DEPTHS.items()}
        self.timing = self._publisher(DiagnosticArray, "timing", qos.report())
        self.lights: dict[str, Publisher] = {}
        self.shares: dict[str, Publisher] = {}
        self.powers: dict[str, Publisher] = {}
        self.infos = {kind: self._publisher(CameraInfo, f"{kind}camera_info") for kind in _KINDS}

    def configure(self, settings: Settings) -> None:
        """For each light a topic of its mask, of its visible share and of its irradiance, and none for others."""
        names = {light.name for light in settings.lights}
        for kind, publishers in zip(_KINDS, (self.lights, self.shares, self.powers), strict=True):
            for name in set(publishers) - names:
                self._node.destroy_publisher(publishers.pop(name))
                self._node.destroy_publisher(self.infos.pop(f"{kind}{name}/"))
            for name in sorted(names - set(publishers)):
                publishers[name] = self._publisher(Image, f"{kind}{name}")
                self.infos[f"{kind}{name}/"] = self._publisher(CameraInfo, f"{kind}{name}/camera_info")

    def publish(self, answer: Answer, settings: Settings) -> dict[str, float]:
        """Send what belongs to a frame, its camera_info last. Returns milliseconds by stage."""
        start = time.perf_counter()
        always = settings.mask_publish == "always"
        images: list[tuple[Publisher, Any, str]] = []
        for publisher, light in [(self.mask, None), *((self.lights.get(name), name) for name in answer.enabled)]:
            if publisher is not None and (always or _wanted(publisher)):
                images.append((publisher, published_mask(answer, light, settings), "mono8"))
        for name in answer.enabled:
            publisher = self.shares.get(name)
            if publisher is not None and _wanted(publisher):
                images.append((publisher, answer.visibility(name), "32FC1"))
        for publisher, light in [(self.irradiance, None), *((self.powers.get(name), name) for name in answer.enabled)]:
            if publisher is not None and _wanted(publisher):
                images.append((publisher, answer.irradiance(light), "32FC1"))
        for lit, publisher in self.depths.items():
            if _wanted(publisher):
                depth = answer.depth(lit, settings.mask_dilate, settings.depth_unit)
                images.append((publisher, depth, answer.frame.image.encoding))
        if len(answer.names) <= MOST_BITS and (always or _wanted(self.bits)):
            bits = answer.bits()
            images.append((self.bits, bits, "mono8" if bits.dtype == np.uint8 else "16UC1"))
        if _wanted(self.overlay):
            images.append((self.overlay, _overlay(answer), "rgb8"))
        made = time.perf_counter()
        for publisher, pixels, encoding in images:
            publisher.publish(image_message(pixels, encoding, answer.frame.image))
        self._publish_info(answer, always)
        end = time.perf_counter()
        return {"masks": (made - start) * 1e3, "publish": (end - made) * 1e3}

    def _publish_info(self, answer: Answer, always: bool) -> None:
        info = answer.mask_info
        if info is None:
            return
        self.info.publish(info)
        for kind in _KINDS:
            for name in ("", *(f"{name}/" for name in answer.enabled)):
                publisher = self.infos.get(kind + name)
                if publisher is not None and ((always and kind == _MASK) or _wanted(publisher)):
                    publisher.publish(info)

    def _publisher(self, kind: Any, topic: str, profile: QoSProfile | None = None) -> Publisher:
        return _publisher(self._node, kind, f"{self._under}{topic}", profile or qos.newest_reliable())


def _publisher(node: Node, kind: Any, topic: str, profile: QoSProfile) -> Publisher:
    return node.create_publisher(kind, topic, profile, qos_overriding_options=qos.overridable())


def _wanted(publisher: Publisher) -> bool:
    # Nobody can tell a mask nobody listens to from one that was not sent, unless it is kept for late joiners.
    return publisher.get_subscription_count() > 0 or keeps_for_late_joiners(publisher.qos_profile)


def _overlay(answer: Answer) -> Any:
    depth, optics = answer.frame.depth, answer.optics
    if optics is None:  # nothing is known, which is shown, too; for the relief a guess will do
        height, width = depth.shape
        return overlay(depth, None, width, width, (width - 1) / 2, (height - 1) / 2)
    return overlay(depth, answer.mask(), optics.fx, optics.fy, optics.cx, optics.cy)
