# SPDX-License-Identifier: Apache-2.0
"""Keeps the triangle records of one light: made again only when the light, the anchor, the scene or the
culling has changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import warp as wp

from shadow_tracer.gpu.buffers import FrameBuffers, SceneBuffers
from shadow_tracer.gpu.light_frame import LightFrame
from shadow_tracer.gpu.stages import Stages
from shadow_tracer.gpu.triangle_setup import prepare


class TriangleRecords:
    """The records in ``FrameBuffers.records`` and what they were made for.

    Attributes:
        front_face_culling: whether triangles whose front faces the light cast nothing; may change between frames.
    """

    def __init__(self, frame: FrameBuffers, scene: SceneBuffers) -> None:
        self.front_face_culling = False
        self._frame = frame
        self._scene = scene
        self._culled = wp.zeros(frame.degenerate.shape[0], dtype=int, device=frame.device)
        self._made_for: tuple[object, ...] | None = None
        self._stale: dict[int, bool] = {}

    @property
    def culled(self) -> int:
        """Triangles that cast nothing for the last light because of front-face culling. Waits for the device."""
        return int(self._culled.numpy().sum()) if self.front_face_culling else 0

    def plan(self, frames: Sequence[LightFrame]) -> tuple[bool, ...]:
        """Announce that ``prepare`` will be called for ``frames`` in this order; returns for each whether it will have
        to make the records. So this is known before anything is launched."""
        for frame in frames:
            key = (
                tuple(frame.light),
                tuple(frame.center),
                frame.inverse_scale,
                self._scene.version,
                self.front_face_culling,
            )
            self._stale[frame.number] = key != self._made_for and self._scene.triangle_count > 0
            self._made_for = key
        return tuple(self._stale[frame.number] for frame in frames)

    def prepare(self, frame: LightFrame) -> bool:
        """Make the records for the light of ``frame`` unless they are there; returns whether they were made."""
        if not self._stale[frame.number]:
            return False
        self._stale[frame.number] = False
        prepare(frame.number, self._scene, self._frame, self.front_face_culling, self._culled)
        return True

    def forget(self) -> None:
        """Make them again next time, whatever is there."""
        self._made_for = None


@dataclass(frozen=True)
class Context:
    """What a pipeline works on; shared by all pipelines of a tracer."""

    frame: FrameBuffers
    scene: SceneBuffers
    records: TriangleRecords
    stages: Stages
