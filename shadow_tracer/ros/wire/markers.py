# SPDX-License-Identifier: Apache-2.0
"""What visualization_msgs/Marker messages ask for, as parts that cast shadow. The rules are those of RViz.

- A marker is known by its namespace and id. Of ADD (which also modifies) with three points per triangle
  (TRIANGLE_LIST) it becomes a part; as any other type it casts nothing, and replaces what cast before.
- DELETE removes one marker, DELETEALL those of its namespace, or all if that is empty. Both topics share their names.
- An ADD without points takes the marker away.
- Actions of an array are taken in their order; of several for the same marker the last counts.
- The points are scaled, then posed in the frame of the header. A quaternion of zeros is no rotation.
- A lifetime above zero ends that long after the message came; zero or less never ends.

A message is refused whole. No ROS here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from math import isfinite

import numpy as np

from shadow_tracer.ros.settings import FloatArray
from shadow_tracer.ros.wire.cdr import check_coordinates
from shadow_tracer.ros.wire.cdr_markers import ADD, DELETE, DELETEALL, TRIANGLE_LIST, MarkerMessage
from shadow_tracer.ros.wire.messages import rigid
from shadow_tracer.ros.wire.parts import Changes, Part, PartError, soup_triangles
from shadow_tracer.scene.checks import LARGEST

PREFIX = "markers/"
_BLOCK = 64  # points compared before all are; most meshes that move differ there


def marker_key(ns: str, marker_id: int) -> str:
    """Name of the part that a marker becomes. No two markers share one: the id is what follows the last slash."""
    return f"{PREFIX}{ns}/{marker_id}"


@dataclass
class _Wanted:
    """What the actions of one message come to, before any of its points is looked at."""

    everything: bool = False
    namespaces: set[str] = field(default_factory=set)
    gone: set[str] = field(default_factory=set)
    shown: dict[str, dict[int, MarkerMessage]] = field(default_factory=dict)

    def take(self, message: MarkerMessage, topic: str) -> None:
        """The next action."""
        if message.action == DELETEALL:
            self._delete_all(message.ns)
        elif message.action == DELETE:
            self._delete(message)
        elif message.action != ADD:
            raise PartError(
                f"action of {_label(message, topic)}: expected 0 (add or modify), 2 (delete) or 3 (delete all), got "
                f"{message.action}"
            )
        elif message.type != TRIANGLE_LIST or not len(message.points):
            self._delete(message)
        else:
            self.shown.setdefault(message.ns, {})[message.id] = message

    def _delete_all(self, ns: str) -> None:
        if ns:
            self.namespaces.add(ns)
            self.shown.pop(ns, None)
        else:
            self.everything = True
            self.shown.clear()

    def _delete(self, message: MarkerMessage) -> None:
        self.gone.add(marker_key(message.ns, message.id))
        self.shown.get(message.ns, {}).pop(message.id, None)

    def messages(self) -> list[MarkerMessage]:
        """Those that become parts."""
        return [message for group in self.shown.values() for message in group.values()]

    def removed(self, parts: Mapping[str, Part]) -> set[str]:
        """Keys of the parts that go, beside those that :attr:`everything` takes."""
        if self.everything:
            return set()
        gone = {key for key in self.gone if key in parts}
        if self.namespaces:
            for key in parts:
                if key.startswith(PREFIX) and key[len(PREFIX) :].rpartition("/")[0] in self.namespaces:
                    gone.add(key)
        return gone


def marker_changes(messages: Sequence[MarkerMessage], parts: Mapping[str, Part], now_ns: int, topic: str) -> Changes:
    """What the markers of one message ask for.

    Args:
        messages: in their order.
        parts: the present parts; a marker with the same points as before keeps its arrays.
        now_ns: time of the node's clock [ns], from which lifetimes count.
        topic: what errors call the message.

    Raises:
        PartError: an unknown action, points that do not make triangles, a number that is not finite or beyond 1e50, a
            scale of zero, a quaternion that is neither of length 1 nor zero, a negative stamp.
    """
    wanted = _Wanted()
    for message in messages:
        wanted.take(message, topic)
    put = tuple(_part(message, parts, now_ns, topic) for message in wanted.messages())
    removed = wanted.removed(parts).difference(part.key for part in put)
    return Changes(put, tuple(sorted(removed)), PREFIX if wanted.everything else None)


def count_ignored(messages: Iterable[MarkerMessage]) -> int:
    """How many of the markers cast nothing because they show something else than a list of triangles."""
    return sum(message.action == ADD and message.type != TRIANGLE_LIST for message in messages)


def _label(message: MarkerMessage, topic: str) -> str:
    ns = message.ns if len(message.ns) <= 40 else message.ns[:40] + "..."
    return f"{topic} {ns!r} {message.id}"


def _part(message: MarkerMessage, parts: Mapping[str, Part], now_ns: int, topic: str) -> Part:
    label = _label(message, topic)
    if len(message.points) % 3:
        raise PartError(
            f"points of {label}: expected three per triangle, got {len(message.points)}, which is no multiple of 3"
        )
    if message.stamp < 0:
        raise PartError(f"header.stamp of {label}: expected 0 or later, got {message.stamp} ns")
    key = marker_key(message.ns, message.id)
    known = parts.get(key)
    vertices = _vertices(message, known, label)
    count = len(vertices) // 3
    try:
        pose = _pose(message.position, message.orientation)
    except PartError as error:
        raise PartError(f"pose of {label}: {error}") from None
    keeps = known is not None and len(known.triangles) == count
    return Part(
        key=key,
        vertices=vertices,
        triangles=known.triangles if known is not None and keeps else soup_triangles(count),
        frame=message.frame,
        stamp=message.stamp,
        pose=pose,
        locked=message.frame_locked,
        expires=now_ns + message.lifetime if message.lifetime > 0 else None,
        field=f"header.frame_id of {label}",
    )


@lru_cache(maxsize=1024)
def _pose(position: tuple[float, ...], orientation: tuple[float, ...]) -> FloatArray:
    """(4, 4), read-only. Most markers stay where they are, or do not use their pose at all."""
    if not all(abs(value) <= LARGEST for value in position):
        raise PartError(f"expected a finite position of at most {LARGEST:g} m, got {list(position)}")
    if not all(abs(value) <= 2.0 for value in orientation):  # the length of a huge one is not even a number
        raise PartError(f"expected a unit quaternion, got {list(orientation)}")
    try:
        pose = rigid(position, orientation if any(orientation) else (0.0, 0.0, 0.0, 1.0), "pose")
    except ValueError as error:
        raise PartError(str(error).removeprefix("pose: ")) from None
    pose.setflags(write=False)
    return pose


def _vertices(message: MarkerMessage, known: Part | None, label: str) -> FloatArray:
    scale = message.scale
    if not all(scale) or not all(map(isfinite, scale)):
        raise PartError(f"scale of {label}: expected three finite numbers other than 0, got {list(scale)}")
    old = known.vertices if known is not None and len(known.vertices) == len(message.points) else None
    unit = scale == (1.0, 1.0, 1.0)
    if unit and old is not None and _same(message.points, old):
        return old
    vertices = np.empty(message.points.shape)
    vertices[...] = message.points
    if not unit:
        _scale(vertices, scale)
        if old is not None and _same(vertices, old):
            return old
    check_coordinates(vertices, f"points of {label}", "point")
    vertices.setflags(write=False)  # the scene keeps a read-only array instead of copying it
    return vertices


def _scale(vertices: FloatArray, scale: tuple[float, ...]) -> None:
    with np.errstate(over="ignore", invalid="ignore"):  # what comes of that is refused
        if scale[0] == scale[1] == scale[2]:
            vertices *= scale[0]
        else:
            # By columns: a row of three is too short for the vector units (3 times slower).
            for axis in range(3):
                vertices[:, axis] *= scale[axis]


def _same(points: FloatArray, vertices: FloatArray) -> bool:
    # What moves mostly differs at its beginning; that is told without reading all of it.
    start = slice(_BLOCK)
    return bool((points[start] == vertices[start]).all()) and bool((points == vertices).all())
