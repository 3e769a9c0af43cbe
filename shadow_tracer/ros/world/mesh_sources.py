# SPDX-License-Identifier: Apache-2.0
"""Where meshes come from: five topics and files. Each keeps its own figures; what they bring lands in one store."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from shadow_tracer.ros.diagnostics import Complaint, RateMeter, Window
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.wire.cdr import MeshMessage
from shadow_tracer.ros.wire.clouds import CLOUD, soup_part
from shadow_tracer.ros.wire.grid_map import KEY as GRID_KEY
from shadow_tracer.ros.wire.grid_map import grid_part
from shadow_tracer.ros.wire.layouts import Layouts
from shadow_tracer.ros.wire.markers import PREFIX, count_ignored, marker_changes
from shadow_tracer.ros.wire.mesh_files import FilePart, file_parts
from shadow_tracer.ros.wire.parts import FILES, Changes, Part, PartError
from shadow_tracer.ros.world.mesh_store import MeshStore

MESH_KEY = "mesh"
TOPICS = ("mesh", "mesh_markers", "mesh_marker", "mesh_cloud", "grid_map")
# How the keys of the parts begin that a topic brings.
_KEYS = {
    "mesh": MESH_KEY, "mesh_markers": PREFIX, "mesh_marker": PREFIX, "mesh_cloud": CLOUD, "grid_map": GRID_KEY,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class _MessagePart(Part):
    """The mesh of a topic, with the message that it came in: the next one mostly has the same triangles."""

    message: MeshMessage | None = None


class MeshSource:
    """One topic that brings meshes.

    Attributes:
        arrivals: meter of everything that arrives, good or not.
        refused: what was refused, and why.
        parsing: milliseconds of taking good messages.
    """

    def __init__(self) -> None:
        self.arrivals = RateMeter()
        self.refused = Complaint()
        self.parsing = Window()


class MeshSources:
    """Takes messages, keeps what is good of them in the store.

    Args:
        max_triangles: capacity of all meshes together.
        layer: of a grid map that is the ground.

    Attributes:
        store: the parts.
        sources: figures by topic.
        layouts: which raw layouts have been found as expected.
        files: what is wrong with mesh files.
        ignored_markers: markers that are no lists of triangles.
    """

    def __init__(self, max_triangles: int, layer: str) -> None:
        self.store = MeshStore(max_triangles)
        self.sources = {name: MeshSource() for name in TOPICS}
        self.layouts = Layouts()
        self.files = ""
        self.ignored_markers = 0
        self._max_triangles = max_triangles
        self._layer = layer
        self._grid_map: bytes | None = None  # the last one, of which another layer may be wanted
        self._readers: dict[str, Callable[[Any, int], Changes]] = {
            "mesh": self._mesh,
            "mesh_markers": self._markers,
            "mesh_marker": self._marker,
            "mesh_cloud": self._cloud,
            "grid_map": self._ground,
        }

    @property
    def received(self) -> int:
        """Messages that arrived on all topics."""
        return sum(source.arrivals.count for source in self.sources.values())

    @property
    def refused(self) -> int:
        """Messages that were refused on all topics."""
        return sum(source.refused.count for source in self.sources.values())

    def receive(self, topic: str, message: Any, now: float, now_ns: int) -> None:
        """Take a message; one that cannot be used changes nothing and is counted.

        Args:
            topic: one of :data:`TOPICS`.
            message: bytes, or a sensor_msgs/PointCloud2 for ``mesh_cloud``.
            now: steady time [s].
            now_ns: time of the node's clock [ns].
        """
        self.sources[topic].arrivals.tick(now)
        if topic == "grid_map":
            self._grid_map = message
        self._take(topic, message, now, now_ns)

    def choose_layer(self, layer: str, now: float, now_ns: int) -> None:
        """Take another layer of grid maps, of the last one as well if it has that."""
        if layer != self._layer:
            self._layer = layer
            if self._grid_map is not None:
                self._take("grid_map", self._grid_map, now, now_ns)

    def _take(self, topic: str, message: Any, now: float, now_ns: int) -> None:
        source = self.sources[topic]
        start = time.perf_counter()
        try:
            self.store.commit(self._readers[topic](message, now_ns), now_ns)
        except PartError as error:
            source.refused.add(str(error), now)
            self.store.lacking = f"{error}; correct its publisher, or call ~/clear_meshes"
            return
        self.store.lacking = ""
        source.parsing.add((time.perf_counter() - start) * 1e3)

    def load_files(self, settings: Settings, now_ns: int) -> None:
        """Bring the parts from ``mesh.files`` up to date; what is wrong is remembered in ``files``."""
        old = tuple(part for key, part in self.store.parts.items() if key.startswith(FILES))
        try:
            new = file_parts(settings.mesh_files, settings.mesh_files_scale, old)
            self.store.commit(Changes(new, clear=FILES), now_ns)
            self.files = ""
            self.store.lacking = ""
        except PartError as error:
            self.files = str(error)
            self.store.lacking = f"{error}; correct mesh.files"

    def in_force(self, topic: str) -> bool:
        """Whether anything that came by a topic casts shadow now; both topics of markers count as one."""
        return any(key.startswith(_KEYS[topic]) for key in self.store.parts)

    @property
    def left_out(self) -> tuple[str, ...]:
        """What files in force hold that casts no shadow, a text for each such file."""
        texts = (part.left_out for part in self.store.parts.values() if isinstance(part, FilePart))
        return tuple(dict.fromkeys(text for text in texts if text))

    def clear(self, now_ns: int) -> int:
        """Drop every mesh that was received, refused ones too; those of files stay. Returns how many parts went."""
        self.store.lacking = ""
        self._grid_map = None
        keys = tuple(key for key in self.store.parts if not key.startswith(FILES))
        self.store.commit(Changes(remove=keys), now_ns)
        return len(keys)

    def _mesh(self, data: bytes, _now_ns: int) -> Changes:
        known = self.store.parts.get(MESH_KEY)
        mesh = self.layouts.mesh(data, self._max_triangles, known.message if isinstance(known, _MessagePart) else None)
        if not len(mesh.triangles):
            return Changes(remove=(MESH_KEY,))
        return Changes((_MessagePart(MESH_KEY, mesh.vertices, mesh.triangles, message=mesh),))

    def _markers(self, data: bytes, now_ns: int) -> Changes:
        return self._take_markers(self.layouts.markers(data, self._max_triangles), now_ns, "mesh_markers")

    def _marker(self, data: bytes, now_ns: int) -> Changes:
        return self._take_markers([self.layouts.marker(data, self._max_triangles)], now_ns, "mesh_marker")

    def _take_markers(self, messages: Any, now_ns: int, topic: str) -> Changes:
        changes = marker_changes(messages, self.store.parts, now_ns, topic)
        self.ignored_markers += count_ignored(messages)
        return changes

    def _ground(self, data: bytes, _now_ns: int) -> Changes:
        grid_map = self.layouts.grid_map(data, self._layer, self._max_triangles)
        return grid_part(grid_map, self.store.parts.get(GRID_KEY))

    def _cloud(self, message: Any, _now_ns: int) -> Changes:
        if isinstance(message, bytes):
            message = self.layouts.cloud(message)
        return soup_part(message, self.store.parts, self._max_triangles)
