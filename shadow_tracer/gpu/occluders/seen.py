# SPDX-License-Identifier: Apache-2.0
"""Keeps the triangle records of as many lights as there is room for: made again only when the light, the anchor, the
culling or what is left out has changed, or else for the blocks of triangles in which the scene has."""

from __future__ import annotations

from collections.abc import Sequence

import warp as wp

from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.device.slices import Slices
from shadow_tracer.gpu.device.transfers import HostCopies
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.exact.records import BLOCK, FILTER_FACTOR, SUMS, add_up, prepare_blocks, prepare_triangles
from shadow_tracer.gpu.occluders.changes import Changed, Revision
from shadow_tracer.gpu.occluders.slots import Range, blocks, few
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.scene.bounds import Bounds


def prepare(
    light: wp.array,
    scene: SceneBuffers,
    records: wp.array,
    front_face_culling: bool,
    silent: wp.array,
    blocks: Range | None = None,
) -> None:
    """Make the records of all triangles of the scene, or of some blocks of them, for a light (one LightFrame on the
    device); ``silent`` (vec2i) gets the numbers of triangles of each block that cast nothing because they are
    degenerate, and because they are culled; in the CUDA form it has to be 0 there."""
    count = scene.triangle_count
    first, last = blocks or (0, -(-count // BLOCK))
    inputs = [light, FILTER_FACTOR, scene.vertices, scene.triangles, records, int(front_face_culling), silent]
    if forms.wide(records.device):
        wp.launch(prepare_blocks, dim=last - first, inputs=[first, count, *inputs], device=records.device)
    else:
        dim = min(last * BLOCK, count) - first * BLOCK
        wp.launch(prepare_triangles, dim=dim, inputs=[first * BLOCK, *inputs], device=records.device)


class TriangleRecords:
    """Owns the records, and knows what they were made for.

    ``bounds.max_triangles`` records hold those of several lights if the scene has fewer triangles: light number k uses
    place k modulo the number of places. Where a place begins does not depend on how many triangles there are.

    Args:
        light_frames: the frame of each light on the device, by its number.
        host: copies its counts of triangles that cast nothing.

    Attributes:
        memory: (``bounds.max_triangles``, 4) vec4, on the device.
        front_face_culling: whether triangles whose front faces the light cast nothing; may change between frames.
        places: lights whose records are kept at the same time.
    """

    def __init__(self, bounds: Bounds, scene: SceneBuffers, light_frames: Sequence[wp.array], host: HostCopies) -> None:
        self.front_face_culling = False
        self.bounds = bounds
        self.scene = scene
        self.places = self._fit = 1
        self._light_frames = light_frames
        self._host = host
        lights, device = bounds.max_lights, scene.device
        self.memory = wp.empty((bounds.max_triangles, 4), dtype=wp.vec4, device=device)
        self._silent = wp.zeros(bounds.max_triangles // BLOCK + lights, dtype=wp.vec2i, device=device)
        self._summed = not forms.wide(device)
        self._sums = wp.zeros(SUMS * lights if self._summed else 1, dtype=wp.vec2i, device=device)
        host.add(self._sums if self._summed else self._silent)
        self._made_for: dict[int, tuple[tuple[object, ...], LightFrame | None, Revision | None]] = {}
        self._stale: dict[int, Changed] = {}
        self._slices = Slices()

    def room(self) -> int:
        """Lights whose records, and corners, fit at the same time."""
        bounds, scene = self.bounds, self.scene
        places = min(
            bounds.max_triangles // max(scene.triangle_count, 1),
            self.most_vertices // max(scene.vertex_count, 1),
        )
        return max(1, min(places, bounds.max_lights))

    @property
    def most_vertices(self) -> int:
        """Vertices of all places together, each with the one that is no mesh's."""
        return 3 * self.bounds.max_triangles + self.bounds.max_lights

    @property
    def stride(self) -> int:
        """Records from a place to the next one."""
        return self.bounds.max_triangles // self._fit

    @property
    def vertex_stride(self) -> int:
        """Vertices from a place to the next one, for those who keep something of them."""
        return self.most_vertices // self._fit

    @property
    def blocks(self) -> int:
        """Blocks of ``BLOCK`` triangles from a place to the next one, where places begin with a block."""
        return -(-self.stride // BLOCK)

    def place(self, light: int) -> int:
        """Where the records of light number ``light`` are."""
        return light % self.places

    def plan(self, frames: Sequence[LightFrame], together: int) -> tuple[Changed, ...]:
        """Announce that ``prepare`` will be called for ``frames`` in this order, whose records are needed ``together``
        at a time (at most ``room()``); returns for each what it will have to make, triangles in whole blocks. So this
        is known before anything is launched."""
        fit = self.room()
        if fit != self._fit:
            self.forget()
        self._fit, self.places = fit, fit // together * together
        key = self.places, self.front_face_culling, self.scene.left_out
        for frame in frames:
            place = self.place(frame.number)
            made_for, known, revision = self._made_for.get(place, ((), None, None))
            same = key == made_for and known is not None and _same(frame, known)
            self._stale[frame.number] = self._changed(revision if same else None)
            self._made_for[place] = key, frame, self.scene.revision
        return tuple(self._stale[frame.number] for frame in frames)

    def _changed(self, revision: Revision | None) -> Changed:
        count, changed = self.scene.triangle_count, self.scene.changed_since(revision)
        if count == 0:
            return Changed()
        touched = few(blocks(changed.triangles, BLOCK, count))
        triangles = tuple((first * BLOCK, min(last * BLOCK, count)) for first, last in touched)
        return Changed(triangles, changed.vertices, changed.everything)

    def expect(self, stale: Sequence[Changed]) -> None:
        """Announce once more what ``plan`` returned for lights 0, 1, ...: what was launched since has not been done."""
        self._stale = dict(enumerate(stale))

    def prepare(self, frame: LightFrame) -> Changed:
        """Make the records for the light of ``frame`` unless they are there; returns what has been made."""
        stale = self.begin(frame)
        if not stale:
            return stale
        number, silent = frame.number, self.silent_of(frame.number)
        for first, last in blocks(stale.triangles, BLOCK, self.scene.triangle_count):
            if self._summed:
                self._slices(self._silent, self.place(number) * self.blocks + first, last - first).zero_()
            light = self.light_frame(number)
            prepare(light, self.scene, self.of(number), self.front_face_culling, silent, (first, last))
        if self._summed:
            sums = self._slices(self._sums, self.place(number) * SUMS, SUMS)
            inputs = [-(-self.scene.triangle_count // BLOCK), silent, sums]
            wp.launch(add_up, dim=SUMS, inputs=inputs, device=self.scene.device)
        return stale

    def begin(self, frame: LightFrame) -> Changed:
        """``prepare`` for somebody who makes the records by other means: what is to be made."""
        stale = self._stale[frame.number]
        self._stale[frame.number] = Changed()
        return stale

    def light_frame(self, light: int) -> wp.array:
        """The frame of light number ``light``, as kernels read it."""
        found: wp.array = self._light_frames[light]
        return found

    def of(self, light: int, lights: int = 1) -> wp.array:
        """Records of ``lights`` lights from number ``light`` on, ``stride`` apart."""
        return self._slices(self.memory, self.place(light) * self.stride, lights * self.stride)

    def silent_of(self, light: int, lights: int = 1) -> wp.array:
        """Of each block of triangles, for ``lights`` lights from number ``light`` on, how many cast nothing because
        they are degenerate, and because they are culled. Lights are ``blocks`` apart."""
        return self._slices(self._silent, self.place(light) * self.blocks, lights * self.blocks)

    def silent(self, light: int) -> tuple[int, int]:
        """Triangles that cast nothing for light number ``light``, of those that there are records of: degenerate ones,
        and those culled; as it was when the host last fetched it."""
        count, place = self.scene.triangle_count, self.place(light)
        if count == 0:
            return 0, 0
        if self._summed:
            counts = self._host.read(self._sums)[place * SUMS : (place + 1) * SUMS]
        else:
            first = place * self.blocks
            counts = self._host.read(self._silent)[first : first + -(-count // BLOCK)]
        return int(counts[:, 0].sum()), int(counts[:, 1].sum()) if self.front_face_culling else 0

    def forget(self) -> None:
        """Make them again next time, whatever is there."""
        self._made_for.clear()

    def nbytes(self) -> int:
        """Bytes of the records on the device."""
        return int(self.memory.capacity)


def _same(one: LightFrame, other: LightFrame) -> bool:
    """Whether records for one light are those for the other."""
    if one is other:  # a light that stays where it is
        return True
    places = [(tuple(frame.light), tuple(frame.center), frame.inverse_scale) for frame in (one, other)]
    return places[0] == places[1]
