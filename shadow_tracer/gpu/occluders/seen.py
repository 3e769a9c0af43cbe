# SPDX-License-Identifier: Apache-2.0
"""Keeps the triangle records of as many lights as there is room for: made again only when the light, the anchor, the
scene or the culling has changed."""

from __future__ import annotations

from collections.abc import Sequence

import warp as wp

from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.slices import Slices
from shadow_tracer.gpu.device.transfers import HostCopies
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.exact.records import BLOCK, FILTER_FACTOR, prepare_blocks, prepare_triangles
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.scene.bounds import Bounds


def prepare(
    light: wp.array,
    scene: SceneBuffers,
    records: wp.array,
    front_face_culling: bool,
    degenerate: wp.array,
    culled: wp.array,
) -> None:
    """Make the records of all triangles of the scene for a light (one LightFrame on the device); ``degenerate`` and
    ``culled``, 64 integers each, sum up to the number of triangles that cast nothing for the one or the other
    reason."""
    degenerate.zero_()
    culled.zero_()
    inputs = [
        light,
        FILTER_FACTOR,
        scene.vertices,
        scene.triangles,
        records,
        int(front_face_culling),
        degenerate,
        culled,
    ]
    count = scene.triangle_count
    if forms.wide(records.device):
        blocks = -(-count // BLOCK)
        wp.launch(prepare_blocks, dim=blocks, inputs=[count, *inputs], device=records.device)
    else:
        wp.launch(prepare_triangles, dim=count, inputs=inputs, device=records.device)


class TriangleRecords:
    """Owns the records, and knows what they were made for.

    ``bounds.max_triangles`` records hold those of several lights if the scene has fewer triangles: light number k uses
    place k modulo the number of places.

    Args:
        light_frames: the frame of each light on the device, by its number.
        host: copies its counts of triangles that cast nothing.

    Attributes:
        memory: (``bounds.max_triangles``, 4) vec4, on the device.
        front_face_culling: whether triangles whose front faces the light cast nothing; may change between frames.
    """

    def __init__(self, bounds: Bounds, scene: SceneBuffers, light_frames: Sequence[wp.array], host: HostCopies) -> None:
        self.front_face_culling = False
        self.bounds = bounds
        self.scene = scene
        self._light_frames = light_frames
        self._host = host
        places, device = bounds.max_lights, scene.device
        self.memory = wp.empty((bounds.max_triangles, 4), dtype=wp.vec4, device=device)
        self._degenerate = host.add(wp.zeros(64 * places, dtype=int, device=device))
        self._culled = host.add(wp.zeros(64 * places, dtype=int, device=device))
        self._made_for: dict[int, tuple[object, ...]] = {}
        self._stale: dict[int, bool] = {}
        self._places = 1
        self._slices = Slices()

    def room(self) -> int:
        """Lights whose records, and corners, fit at the same time."""
        bounds, scene = self.bounds, self.scene
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
                self.scene.revision,
                self.front_face_culling,
            )
            place = self.place(frame.number)
            self._stale[frame.number] = key != self._made_for.get(place) and self.scene.triangle_count > 0
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
            self.scene,
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
        found: wp.array = self._light_frames[light]
        return found

    def of(self, light: int, lights: int = 1) -> wp.array:
        """Records of ``lights`` lights from number ``light`` on, light after light."""
        count = self.scene.triangle_count
        return self._slices(self.memory, self.place(light) * count, lights * count)

    def silent_of(self, light: int, lights: int = 1) -> tuple[wp.array, wp.array]:
        """64 integers for each of ``lights`` lights from number ``light`` on, whose sum is the number of triangles that
        cast nothing because they are degenerate; and because they are culled."""
        first, count = 64 * self.place(light), 64 * lights
        return self._slices(self._degenerate, first, count), self._slices(self._culled, first, count)

    def silent(self, light: int) -> tuple[int, int]:
        """Triangles that cast nothing for light number ``light``, of those that there are records of: degenerate ones,
        and those culled; as it was when the host last fetched it."""
        if self.scene.triangle_count == 0:
            return 0, 0
        rows = slice(64 * self.place(light), 64 * self.place(light) + 64)
        degenerate, culled = (self._host.read(array)[rows].sum() for array in (self._degenerate, self._culled))
        return int(degenerate), int(culled) if self.front_face_culling else 0

    def forget(self) -> None:
        """Make them again next time, whatever is there."""
        self._made_for.clear()

    def nbytes(self) -> int:
        """Bytes of the records on the device."""
        return int(self.memory.capacity)
