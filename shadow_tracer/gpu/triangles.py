# SPDX-License-Identifier: Apache-2.0
"""Keeps the triangle records of one light: made again only when the light, the anchor or the scene has changed."""

from __future__ import annotations

from dataclasses import dataclass

import warp as wp

from shadow_tracer.gpu import light_frame
from shadow_tracer.gpu.buffers import FrameBuffers, SceneBuffers
from shadow_tracer.gpu.light_frame import LightFrame
from shadow_tracer.gpu.stages import Stages


class TriangleRecords:
    """The records in ``FrameBuffers.records`` and what they were made for."""

    def __init__(self, frame: FrameBuffers, scene: SceneBuffers) -> None:
        self._frame = frame
        self._scene = scene
        self._made_for: tuple[object, ...] | None = None

    def prepare(self, frame: LightFrame) -> None:
        """Make the records for the light of ``frame`` unless they are there."""
        buffers, scene = self._frame, self._scene
        key = (tuple(frame.light), tuple(frame.center), frame.inverse_scale, scene.version)
        if key == self._made_for or scene.triangle_count == 0:
            return
        self._made_for = key
        buffers.degenerate.zero_()
        wp.launch(
            light_frame.prepare_triangles,
            dim=scene.triangle_count,
            inputs=[
                frame,
                light_frame.FILTER_FACTOR,
                scene.vertices,
                scene.triangles,
                buffers.records,
                buffers.degenerate,
            ],
            device=buffers.device,
        )


@dataclass(frozen=True)
class Context:
    """What a pipeline works on; shared by all pipelines of a tracer."""

    frame: FrameBuffers
    scene: SceneBuffers
    records: TriangleRecords
    stages: Stages
