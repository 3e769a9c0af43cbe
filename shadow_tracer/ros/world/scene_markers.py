# SPDX-License-Identifier: Apache-2.0
"""The parts that cast shadow, as markers for a viewer: each in the frame it moves with. No ROS here.

What is too much for a viewer is shown as the box around it, and a text in it says so.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.ros.settings import FloatArray, Settings
from shadow_tracer.ros.wire.cdr_markers import CLEARED, LINE_LIST, TEXT, MarkerMessage, MarkersWriter
from shadow_tracer.ros.wire.messages import frame_name, quaternion_of
from shadow_tracer.ros.world.mesh_store import MeshStore

TURN = 16_384  # triangles between two breaks: 1 to 5 ms
_EACH = 512  # triangles that take as long as what each part costs, however small
_COLOUR = (0.55, 0.6, 0.68, 1.0)
_BOX_COLOUR = (0.95, 0.5, 0.1, 1.0)
_LONGEST_NAME = 80
_CORNERS = np.array([[k & 1, k >> 1 & 1, k >> 2] for k in range(8)], np.float64)
_EDGES = [k for a in range(8) for bit in (1, 2, 4) if not a & bit for k in (a, a | bit)]


@dataclass(frozen=True, eq=False)
class ShownPart:
    """A part as it is to be shown.

    Attributes:
        key: its name in the store.
        frame: frame of ``pose``, with which it moves.
        pose: (4, 4) rigid transform to ``frame``.
        vertices: (V, 3) [m].
        triangles: (T, 3).
        most: triangles that are shown of all parts together.
        whole: False: its box is shown.
    """

    key: str
    frame: str
    pose: FloatArray
    vertices: FloatArray
    triangles: npt.NDArray[np.int32]
    most: int
    whole: bool = True

    def same(self, other: ShownPart) -> bool:
        """Whether it looks as another one does."""
        return (
            (self.key, self.frame, self.whole) == (other.key, other.frame, other.whole)
            and (self.whole or self.most == other.most)
            and _equal(self.pose, other.pose)
            and _equal(self.triangles, other.triangles)
            and _equal(self.vertices, other.vertices)
        )


def _equal(one: npt.NDArray[Any], other: npt.NDArray[Any]) -> bool:
    """Bit by bit; what differs mostly does so from the beginning, which is told without looking at the rest."""
    if one is other:
        return True
    if one.shape != other.shape or one.dtype != other.dtype:
        return False
    kind = f"u{one.itemsize}"
    a, b = one.view(kind), other.view(kind)
    return np.array_equal(a[:64], b[:64]) and np.array_equal(a, b)


def world_name(settings: Settings, camera_frame: str) -> str:
    """Name of the frame that everything is in; "" if it has none, or none that is known yet.

    Args:
        camera_frame: optical frame of the last depth image, "" before there is one.
    """
    return settings.fixed_frame or (frame_name(camera_frame) if settings.pose_source == "tf" else "")


def shown_parts(store: MeshStore, settings: Settings, world: str) -> tuple[list[ShownPart], int]:
    """What casts shadow now, and how many parts cannot be shown because their world has no name.

    Parts that stay where their frame was at some time are among them once a frame was traced with them.
    """
    shown, nameless = [], 0
    for part in store.parts.values() if settings.uses_meshes else ():
        if not len(part.drawn):
            continue
        frame, pose = frame_name(part.frame or settings.mesh_frame) or world, part.pose
        if not part.locked:
            placed = store.placed(part)
            if placed is None:
                continue
            frame, pose = placed
        if not frame:
            nameless += 1
            continue
        shown.append(ShownPart(part.key, frame, pose, part.vertices, part.drawn, settings.markers_max_triangles))
    left = settings.markers_max_triangles
    for place in sorted(range(len(shown)), key=lambda place: len(shown[place].triangles)):
        left -= len(shown[place].triangles)
        if left < 0:
            shown[place] = replace(shown[place], whole=False)
    return shown, nameless


def draw_parts(parts: Sequence[ShownPart]) -> Generator[None, None, bytes]:
    """The bytes of a MarkerArray that replaces all before it. It yields, so that no more than some milliseconds pass
    between two values, whatever the parts are."""
    writer = MarkersWriter(1 + sum(1 if part.whole else 2 for part in parts))
    writer.add(CLEARED)
    left = TURN
    for part in parts:
        if part.whole:
            points = yield from _corners(part)
            writer.add(_marker(part, points=points))
        else:
            for marker in (yield from _box(part)):
                writer.add(marker)
        left -= _EACH + min(len(part.triangles), TURN)
        if left <= 0:
            left = TURN
            yield
    data = writer.message()
    yield
    return data


def _marker(part: ShownPart, **fields: Any) -> MarkerMessage:
    name, _, number = part.key.rpartition("/")
    if not name:
        name, number = part.key, "0"
    x, y, z = part.pose[:3, 3].tolist()
    usual = {"position": (x, y, z), "orientation": quaternion_of(part.pose), "color": _COLOUR}
    return MarkerMessage(ns=name, id=int(number), frame=part.frame, frame_locked=True, **{**usual, **fields})


def _corners(part: ShownPart) -> Generator[None, None, FloatArray]:
    """(3 T, 3) corners, three a triangle."""
    points = np.empty((3 * len(part.triangles), 3))
    for start in range(0, len(part.triangles), TURN):
        if start:
            yield
        some = part.triangles[start : start + TURN].reshape(-1)
        part.vertices.take(some, axis=0, out=points[3 * start : 3 * start + len(some)], mode="clip")
    return points


def _box(part: ShownPart) -> Generator[None, None, list[MarkerMessage]]:
    """The box around the corners of its triangles, and what it stands for."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for start in range(0, len(part.triangles), TURN):
        if start:
            yield
        some = part.vertices.take(part.triangles[start : start + TURN].reshape(-1), axis=0)
        low, high = np.minimum(low, some.min(axis=0)), np.maximum(high, some.max(axis=0))
    size = float(np.linalg.norm(high - low))
    lines = (low + _CORNERS * (high - low))[_EDGES]
    middle = part.pose[:3, :3] @ ((low + high) / 2) + part.pose[:3, 3]
    text = (
        f"{part.key[:_LONGEST_NAME]}: {len(part.triangles):,} triangles, shown as a box\n"
        f"markers.max_triangles is {part.most:,} for all parts"
    )
    box = _marker(part, type=LINE_LIST, points=lines, scale=(max(0.002, 0.002 * size), 1.0, 1.0), color=_BOX_COLOUR)
    return [
        box,
        replace(
            box,
            ns=f"{box.ns} (text)",
            type=TEXT,
            position=tuple(float(value) for value in middle),
            scale=(1.0, 1.0, max(0.03, 0.03 * size)),
            points=np.empty((0, 3)),
            text=text,
        ),
    ]
