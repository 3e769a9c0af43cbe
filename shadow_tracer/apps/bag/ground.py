# SPDX-License-Identifier: Apache-2.0
"""``~/shadow_grid`` and ``~/sun_map`` of a recording's grid maps, as the node sends them, by the time of the log."""

from __future__ import annotations

from shadow_tracer import ShadowTracer
from shadow_tracer.apps.bag.names import Names
from shadow_tracer.apps.bag.writer import Output
from shadow_tracer.ros.node.ground import Ground
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.wire.grid_map import GRID_MAP
from shadow_tracer.ros.world.frames import Frames
from shadow_tracer.ros.world.lighting import Lighting
from shadow_tracer.ros.world.mesh_store import MeshStore


class _Written:
    """Takes what a publisher would, at the time that is set [ns]."""

    def __init__(self, output: Output, topic: str, kind: str) -> None:
        self.now_ns = 0
        self._where = output, topic, kind

    def get_subscription_count(self) -> int:
        """The bag listens."""
        return 1

    def publish(self, data: bytes) -> None:
        """Write a serialised message."""
        output, topic, kind = self._where
        output.raw(topic, self.now_ns, kind, data)


class BagGround:
    """Looks at the ground after each image and each map.

    Args:
        sun_map: whether hours of sun are counted.
    """

    def __init__(
        self, frames: Frames, meshes: MeshStore, lighting: Lighting, output: Output, names: Names, sun_map: bool
    ) -> None:
        self._sinks = [_Written(output, names.topic("~/shadow_grid"), "nav_msgs/msg/OccupancyGrid")]
        if sun_map:
            self._sinks.append(_Written(output, names.topic("~/sun_map"), GRID_MAP))
        self._made_of = frames, meshes, lighting, self._sinks[0], self._sinks[1] if sun_map else None
        self.restart()

    def restart(self) -> None:
        """Nothing was written yet."""
        self._ground = Ground(*self._made_of)

    def skip(self, settings: Settings, now_ns: int) -> None:
        """As :meth:`look` where everything was written elsewhere."""
        self._ground.skip(settings, now_ns * 1e-9)

    def look(self, settings: Settings, tracer: ShadowTracer, camera_frame: str, stamp: int, now_ns: int) -> str:
        """Write what is due at a time of the log [ns]; ``stamp``: of the last image [ns]. Returns what is missing of
        what was written, "" if nothing."""
        for sink in self._sinks:
            sink.now_ns = now_ns
        ground = self._ground
        before = ground.grids + ground.maps
        while ground.step(settings, tracer, camera_frame, stamp, now_ns * 1e-9, now_ns, patient=False):
            pass
        said = ground.missing is not None and ground.grids + ground.maps > before
        return ground.missing.text if said and ground.missing is not None else ""
