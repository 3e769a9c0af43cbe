# SPDX-License-Identifier: Apache-2.0
"""Depth images through a walker: the query *closest hit* for the pixels of a camera."""

from __future__ import annotations

import warp as wp

from shadow_tracer.gpu.accelerators.camera_view import CameraView
from shadow_tracer.gpu.accelerators.walker import Walker
from shadow_tracer.gpu.device.counters import ROWS
from shadow_tracer.gpu.exact.depth_slack import measure_slack
from shadow_tracer.gpu.occluders.world import SceneBuffers
from shadow_tracer.gpu.visibility.depth_image import Seen, counted, make_counters, make_image, seen_nothing, seen_on
from shadow_tracer.gpu.visibility.queries import CLOSEST, Closest
from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.camera import Camera


class ClosestHits:
    """Renders depth images of a scene through any walker over it, with buffers allocated here and never again.

    The images are those of the camera's own grid (``camera_grid/primary.py``), bit for bit. Triangles are numbered as
    the scene has them on the device: if it is ordered, through the meshes in their order.

    Args:
        scene: the world on the device, which others may use, too.
        bounds: capacities.
    """

    def __init__(self, scene: SceneBuffers, bounds: Bounds) -> None:
        self._scene, device = scene, scene.device
        self._view = CameraView(scene, bounds)
        self._image = make_image(bounds.max_rays, device)
        self._slack = wp.zeros(1, dtype=wp.float64, device=device)
        self._nodes = wp.zeros(ROWS, dtype=wp.int64, device=device)
        self._counters = make_counters(device)

    def render(self, walker: Walker, camera: Camera) -> Seen:
        """The closest triangle of every pixel, of the scene as it was synchronised last; the image fits the bounds."""
        count, pixels, device = self._scene.triangle_count, camera.width * camera.height, self._scene.device
        if count == 0:
            return seen_nothing(pixels, {})
        walker.follow()
        self._view.look_from(camera)
        self._view.set_up()
        for sums in (self._slack, self._nodes, self._counters):
            sums.zero_()
        asked = Closest()
        asked.rays, asked.seen, asked.count, asked.image = self._view.rays, self._view.seen(), count, self._image
        asked.slack, asked.nodes, asked.counters = self._slack, self._nodes, self._counters
        wp.launch(measure_slack, dim=count, inputs=[asked.rays, asked.seen, self._slack], device=device)
        walker.build.walk.launch(CLOSEST, pixels, walker.structure(), asked, device)
        nodes = int(self._nodes.numpy().sum())
        return seen_on(self._image, pixels, {**counted(self._counters), "nodes": nodes})

    def slack(self) -> float:
        """By how much computed depths of the last image may be too small [m]."""
        return float(self._slack.numpy()[0])
