# SPDX-License-Identifier: Apache-2.0
"""Height fields."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.height_field.charts import Charts, Structure
from shadow_tracer.gpu.accelerators.height_field.silent import Silent
from shadow_tracer.gpu.accelerators.height_field.sweep import Sweeps
from shadow_tracer.gpu.accelerators.interface import Accelerator, Context
from shadow_tracer.gpu.accelerators.union import Rest
from shadow_tracer.gpu.accelerators.walker import Walk
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.exact.light_frame import LightFrame
from shadow_tracer.gpu.samples.passes import Pass
from shadow_tracer.gpu.visibility.queries import IN_PLACE, InPlace

_SIXTEEN = Walk("accelerators/height_field/walk16.h", Structure, queries=(IN_PLACE,))
_ONE = Walk("accelerators/height_field/walk.h", Structure, queries=(IN_PLACE,))


class HeightFields(Accelerator):
    """The ``height_field`` pipeline."""

    def __init__(self, variant: str, context: Context) -> None:
        super().__init__(context)
        bounds, device = context.frame.bounds, context.frame.device
        self._charts: Charts = context.shared.take(Charts, lambda: Charts(context.records.bounds, context.scene))
        self._silent: Silent = context.shared.take(Silent, lambda: Silent(context.records.bounds, context.scene))
        self._sweeps: Sweeps = context.shared.take(Sweeps, lambda: Sweeps(context.records.bounds, context.scene))
        self._rest = Rest(context, ("mesh_bvh", "refit"))
        self.walk = _SIXTEEN if forms.wide(device) else _ONE

    def follow(self) -> None:
        """Charts of surfaces that have changed; the others go with the meshes."""
        with self._context.stages.stage("build"):
            self._charts.follow()
        self._rest.follow(self._charts.others)

    def aim(self, work: Pass) -> None:
        """Records of the meshes, and the sweep of a sun."""
        self._rest.aim(work)
        context, charts, sweeps = self._context, self._charts, self._sweeps
        with context.stages.stage("setup"):
            sweeps.make(charts, work.light, context.frame.count, context.records.front_face_culling)
            charts.structure.sweep, charts.structure.bounds = sweeps.sweep, sweeps.bounds

    def show(self, work: Pass) -> None:
        """Send the rays of the light through the meshes, and those that are left down the charts."""
        context, frame, asked = self._context, self._context.frame, InPlace()
        self._rest.show(work)
        if not self._charts.placed:
            return
        asked.light, asked.cull = work.light.light, int(context.records.front_face_culling)
        asked.triangle_count = context.scene.triangle_count
        asked.positions, asked.rays, asked.states = frame.samples, frame.rays, frame.states_of(work.first)
        asked.vertices, asked.triangles = context.scene.vertices, context.scene.triangles
        asked.counters = frame.counters
        with context.stages.stage("trace"):
            self.walk.launch(IN_PLACE, frame.count, self._charts.structure, asked, frame.device)

    def silent(self, light: LightFrame) -> tuple[int, int]:
        """Of the meshes, as their records say, and of the charts."""
        rest = self._rest.silent(light)
        ours = self._silent.count(self._charts, light, self._context.records.front_face_culling)
        return rest[0] + ours[0], rest[1] + ours[1]

    def learn(self, counters: dict[str, int]) -> None:
        """Nothing: what the meshes' own tree tests is not told from what charts do."""

    def nbytes(self) -> int:
        """Bytes on the device, those that all shares have in common aside."""
        return self._rest.nbytes()
