# SPDX-License-Identifier: Apache-2.0
"""The topics and services ``~/dose/*``."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rclpy.node import Node
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Bool, Float32
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from shadow_tracer.ros.node import qos
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.wire.cdr_markers import encode_markers
from shadow_tracer.ros.wire.dose_messages import FIELDS, STEP, DoseMarkers, cloud_rows
from shadow_tracer.ros.world.exposure import Exposure

if TYPE_CHECKING:
    from shadow_tracer.ros.node.core import Core

_MARKING = 1.0  # least time between two messages of markers [s]


class DoseOutputs:
    """The publishers. Cloud and markers are made for subscribers alone."""

    def __init__(self, node: Node) -> None:
        def publisher(kind: Any, name: str, profile: Any) -> Any:
            return node.create_publisher(kind, f"~/dose/{name}", profile, qos_overriding_options=qos.overridable())

        self.cloud = publisher(PointCloud2, "cloud", qos.newest_reliable())
        self.markers = publisher(MarkerArray, "markers", qos.latched())
        self.coverage = publisher(Float32, "coverage", qos.latched())
        self.done = publisher(Bool, "done", qos.latched())
        self._drawn = DoseMarkers()
        self._listeners = 0
        self._marked = float("-inf")

    def publish(self, exposure: Exposure, settings: Settings, stamp: Any, world: str) -> None:
        """Send how things are, but for the markers.

        Args:
            stamp: of the image with which this was found.
            world: name of the frame that everything is in; "" has none, and the cloud is not sent.
        """
        target = settings.dose_target
        self.coverage.publish(Float32(data=exposure.coverage(target)))
        self.done.publish(Bool(data=exposure.done(settings)))
        if world and self.cloud.get_subscription_count():
            self.cloud.publish(_cloud(cloud_rows(exposure.shown(), target), stamp, world))

    def mark(self, exposure: Exposure, settings: Settings, world: str, now: float) -> None:
        """Send the markers that are new, all of them to those who came, at most once a second; called all the time.

        Args:
            world: as for :meth:`publish`; without a name nothing is sent.
            now: steady time [s].
        """
        listeners = self.markers.get_subscription_count()
        if not world or not listeners or now - self._marked < _MARKING:
            self._listeners = min(self._listeners, listeners)
            return
        came = listeners > self._listeners  # who have seen nothing
        self._marked, self._listeners = now, listeners
        message = self._drawn.message(exposure.shown(), settings.dose_target, world, everything=came)
        if message:
            self.markers.publish(encode_markers(message))


def _cloud(data: Any, stamp: Any, world: str) -> PointCloud2:
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
