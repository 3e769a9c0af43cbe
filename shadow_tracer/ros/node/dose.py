# SPDX-License-Identifier: Apache-2.0
"""The topics and services ``~/dose/*``."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Bool, Float32
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from shadow_tracer import DoseMap
from shadow_tracer.ros.node import qos
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.wire.cdr_markers import MarkerMessage, encode_markers
from shadow_tracer.ros.wire.dose_messages import FIELDS, STEP, cloud_rows, colored_chunks
from shadow_tracer.ros.world.exposure import Exposure
from shadow_tracer.ros.world.scene_markers import CLEARED

if TYPE_CHECKING:
    from shadow_tracer.ros.node.core import Core

_MARKING = 1.0  # least time between two messages of markers [s]


class DoseOutputs:
    """The publishers, of whom only the small ones send what nobody listens to."""

    def __init__(self, node: Node) -> None:
        def publisher(kind: Any, name: str, profile: Any) -> Any:
            return node.create_publisher(kind, f"~/dose/{name}", profile, qos_overriding_options=qos.overridable())

        self.cloud = publisher(PointCloud2, "cloud", qos.newest_reliable())
        self.markers = publisher(MarkerArray, "markers", qos.latched())
        self.coverage = publisher(Float32, "coverage", qos.latched())
        self.done = publisher(Bool, "done", qos.latched())
        self._sent: dict[tuple[str, int], bytes] = {}
        self._listeners = 0
        self._marked = float("-inf")

    def publish(self, exposure: Exposure, settings: Settings, stamp: Any, world: str, now: float) -> None:
        """Send how things are.

        Args:
            stamp: of the image with which this was found.
            world: name of the frame that everything is in; "" has none, and cloud and markers are not sent.
            now: steady time [s].
        """
        target, shown = settings.dose_target, exposure.shown()
        self.coverage.publish(Float32(data=exposure.coverage(target)))
        self.done.publish(Bool(data=exposure.done(settings)))
        if world and self.cloud.get_subscription_count():
            self.cloud.publish(_cloud(shown, target, stamp, world))
        listeners = self.markers.get_subscription_count()
        if not world or not listeners or now - self._marked < _MARKING:
            self._listeners = min(self._listeners, listeners)
            return
        self._marked = now
        message: list[MarkerMessage] = []
        if listeners > self._listeners or {part for part, _ in self._sent} - set(shown):
            self._sent.clear()  # whoever came has seen nothing
            message.append(CLEARED)
        self._listeners = listeners
        for part, each in shown.items():
            pose = each.pose()
            corners = each.corners @ pose[:3, :3].T + pose[:3, 3]
            message += colored_chunks(part, each, target, world, corners, self._sent)
        if message:
            self.markers.publish(encode_markers(message))


def _cloud(shown: dict[str, DoseMap], target: float, stamp: Any, world: str) -> PointCloud2:
    rows = [cloud_rows(each, target) for each in shown.values()]
    data = np.concatenate(rows) if rows else np.zeros(0, np.dtype(f"V{STEP}"))
    cloud = PointCloud2(
        height=1,
        width=len(data),
        fields=[PointField(name=name, offset=offset, datatype=kind, count=1) for name, offset, kind, _ in FIELDS],
        is_bigendian=False,
        point_step=STEP,
        row_step=STEP * len(data),
        is_dense=False,
    )
    cloud.data = array("B", data.tobytes())
    cloud.header.stamp, cloud.header.frame_id = stamp, world
    return cloud


class DoseServices:
    """``~/dose/reset``, ``~/dose/save`` and ``~/dose/load``."""

    def __init__(self, core: Core) -> None:
        self._core = core
        for name, work in (("reset", self._reset), ("save", self._save), ("load", self._load)):
            core.node.create_service(Trigger, f"~/dose/{name}", self._answering(work))

    def _answering(self, work: Callable[[], str]) -> Callable[[Any, Any], Any]:
        def answer(_request: Any, response: Any) -> Any:
            try:
                response.success, response.message = True, work()
                self._core.show_dose()
            except (OSError, ValueError) as error:
                response.success, response.message = False, str(error)
            except Exception as error:
                self._core.note_fault(error)
                response.success, response.message = False, str(error)
            return response

        return answer

    def _reset(self) -> str:
        return f"{self._core.exposure.reset()} dose maps are empty"

    def _save(self) -> str:
        return f"{self._core.exposure.save(self._core.settings)} dose maps saved"

    def _load(self) -> str:
        tracer = self._core.host.tracer
        if tracer is None:
            raise ValueError("the tracer is busy or not made yet; ask again")
        return f"{self._core.exposure.load(self._core.settings, tracer)} dose maps loaded"
