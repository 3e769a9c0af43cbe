# SPDX-License-Identifier: Apache-2.0
"""Keeps the triangle records of as many lights as there is room for: made again only when the light, the anchor, the
scene or the culling has changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar
from weakref import WeakValueDictionary

import warp as wp

from shadow_tracer.gpu.buffers import FrameBuffers, Slices
from shadow_tracer.gpu.light_frame import LightFrame
from shadow_tracer.gpu.scene_buffers import SceneBuffers
from shadow_tracer.gpu.stages import Stages
from shadow_tracer.gpu.triangle_setup import prepare

_Kind = TypeVar("_Kind")


class TriangleRecords:
    """The records in ``FrameBuffers.records`` and what they were made for.

    ``bounds.max_triangles`` records hold those of several lights if the scene has fewer triangles: light number k uses
    place k modulo the number of places.

    Attributes:
        front_face_culling: whether triangles whose front faces the light cast nothing; may change between frames.
    """

    def __init__(self, frame: FrameBuffers, scene: SceneBuffers) -> None:
        self.front_face_culling = False
        self._frame = frame
        self._scene = scene
        places = frame.bounds.max_lights
        self._degenerate = frame.host.add(wp.zeros(64 * places, dtype=int, device=frame.device))
        self._culled = frame.host.add(wp.zeros(64 * places, dtype=int, device=frame.device))
        self._made_for: dict[int, tuple[object, ...]] = {}
        self._stale: dict[int, bool] = {}
        self._places = 1
        self._slices = Slices()

    def room(self) -> int:
        """Lights whose records, and corners, fit at the same time."""
        bounds, scene = self._frame.bounds, self._scene
        places = min(
            bounds.max_triangles // max(scene.triangle_count, 1),
            3 * bounds.max_triangles // max(scene.vertex_count, 1),
        )
        return max(1, min(places, bounds.max_lights))

    def place(self, light: int) -> int:
        """Where the records of light number ``light`` are."""
        return light % self._places

    def plan(self, frames: Sequence[LightFrame], together: int) -> tuple[bool, ...]:
        """Announce that ``prepare`` will be called for ``frames`` in this order, whose records are needed ``together``
        at a time (at most ``room()``); returns for each whether it will have to make them. So this is known before
        anything is launched."""
        self._places = self.room() // together * together
        for frame in frames:
            key = (
                self._places,
                tuple(frame.light),
                tuple(frame.center),
                frame.inverse_scale,
                self._scene.version,
                self.front_face_culling,
            )
            place = self.place(frame.number)
            self._stale[frame.number] = key != self._made_for.get(place) and self._scene.triangle_count > 0
            self._made_for[place] = key
        return tuple(self._stale[frame.number] for frame in frames)

    def expect(self, stale: Sequence[bool]) -> None:
        """Announce once more what ``plan`` returned for lights 0, 1, ...: what was launched since has not been done."""
        self._stale = dict(enumerate(stale))

    def prepare(self, frame: LightFrame) -> bool:
        """Make the records for the light of ``frame`` unless they are there; returns whether they were made."""
        if not self.begin(frame):
            return False
        prepare(
            self.light_frame(frame.number),
            self._scene,
            self.of(frame.number),
            self.front_face_culling,
            *self.silent_of(frame.number),
        )
        return True

    def begin(self, frame: LightFrame) -> bool:
        """``prepare`` for somebody who makes the records by other means: whether they are to be made."""
        stale = self._stale[frame.number]
        self._stale[frame.number] = False
        return stale

    def light_frame(self, light: int) -> wp.array:
        """The frame of light number ``light``, as kernels read it."""
        found: wp.array = self._frame.light_frame_of[light]
        return found

    def of(self, light: int, lights: int = 1) -> wp.array:
        """Records of ``lights`` lights from number ``light`` on, light after light."""
        count = self._scene.triangle_count
        return self._slices(self._frame.records, self.place(light) * count, lights * count)

    def silent_of(self, light: int, lights: int = 1) -> tuple[wp.array, wp.array]:
        """64 integers for each of ``lights`` lights from number ``light`` on, whose sum is the number of triangles that
        cast nothing because they are degenerate; and because they are culled."""
        first, count = 64 * self.place(light), 64 * lights
        return self._slices(self._degenerate, first, count), self._slices(self._culled, first, count)

    def silent(self, light: int) -> tuple[int, int]:
        """Triangles that cast nothing for light number ``light``, of those that there are records of: degenerate ones,
        and those culled; as it was when the host last fetched it."""
        if self._scene.triangle_count == 0:
            return 0, 0
        rows = slice(64 * self.place(light), 64 * self.place(light) + 64)
        degenerate, culled = (self._frame.host.read(array)[rows].sum() for array in (self._degenerate, self._culled))
        return int(degenerate), int(culled) if self.front_face_culling else 0

    def forget(self) -> None:
        """Make them again next time, whatever is there."""
        self._made_for.clear()


class Shared:
    """What pipelines make of a light beside its records, once for all that work on the scene: one of a kind, which
    lives as long as a pipeline holds it."""

    def __init__(self) -> None:
        self._made: WeakValueDictionary[type[Any], Any] = WeakValueDictionary()

    def take(self, kind: type[_Kind], context: Context) -> _Kind:
        """The one of its kind, made for ``context`` when nobody has it."""
        made = self._made.get(kind)
        if made is None:
            self._made[kind] = made = kind(context)  # type: ignore[call-arg]
        found: _Kind = made
        return found

    def find(self, kind: type[_Kind]) -> _Kind | None:
        """The one of its kind, None if nobody has it."""
        return self._made.get(kind)

    def nbytes(self) -> int:
        """Bytes on the device."""
        return sum(made.nbytes() for made in self._made.values())


@dataclass(frozen=True)
class Context:
    """What a pipeline works on. Scene, records and what is shared belong to all pipelines of a tracer; frame and stages
    to those that work on the same rays."""

    frame: FrameBuffers
    scene: SceneBuffers
    records: TriangleRecords
    stages: Stages
    shared: Shared = field(default_factory=Shared)
