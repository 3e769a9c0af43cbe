# SPDX-License-Identifier: Apache-2.0
"""A simulated depth camera: depth images of a scene, and which triangle each pixel sees."""

from __future__ import annotations

import os
import threading
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.scene.bounds import Bounds
from shadow_tracer.scene.camera import Camera
from shadow_tracer.scene.checks import BoundsError
from shadow_tracer.scene.mesh import Scene

if TYPE_CHECKING:
    from shadow_tracer.gpu.accelerators.camera_grid.primary import PrimaryRays
    from shadow_tracer.gpu.visibility.depth_image import Seen

DepthAndTriangle = tuple[npt.NDArray[np.float32], npt.NDArray[np.int32]]


class DepthCamera:
    """Renders depth images of scenes on one device. Not thread-safe: one depth camera, one thread.

    A pixel sees the closest triangle that its ray meets, edges and corners included, from either side and at any
    distance in front of the optical centre. Rays are those of a pinhole or of the camera's table. Whether a ray meets a
    triangle is decided exactly, so there are no holes between triangles that share an edge or a corner, and the image
    is the same on every device. Triangles that have no area, are seen exactly edge-on, or have a corner that is not
    finite are not seen.

    Args:
        device: "cpu", "cuda:0", ...; None is the best there is.
        bounds: capacities of all buffers, which are allocated here and never grow: ``max_triangles``, ``max_rays``
            (pixels) and ``grid_entries``; with fewer entries than a scene needs an image takes more passes and is
            the same.

    Raises:
        ValueError: no such device; the message lists those there are.
        ImportError: Warp is not installed; the message says how to install it.
    """

    def __init__(self, device: str | None = None, bounds: Bounds | None = None) -> None:
        self._bounds = bounds or Bounds()
        try:
            from shadow_tracer.gpu.accelerators.camera_grid.primary import PrimaryRays
            from shadow_tracer.gpu.device import devices, seats
        except ModuleNotFoundError as error:
            if error.name != "warp":
                raise
            raise ImportError("shadow_tracer needs NVIDIA Warp to render: pip install 'warp-lang>=1.19'") from error
        self._device = devices.pick_device(device)
        self._make = PrimaryRays
        self._rays: PrimaryRays | None = None
        self._seat = seats.Seat(self._device, records=False)
        self._device_bytes = self._seat.run(self._found).nbytes()
        self.counters: dict[str, int] = {}
        """What the last image took: ``rays`` and ``triangles`` there were, ``degenerate`` triangles among them that
        cannot be seen, (tile, triangle) ``entries`` and the ``largest_tile`` of them, ``passes`` through the tiles,
        ray/triangle ``tests`` in float32, ``retested`` ones that it could not decide, ``exact`` determinants that
        needed expansion arithmetic, and pairs of hits ``compared`` in float64 to find the closer one."""

    @property
    def device(self) -> str:
        """Name of the device in use."""
        return str(self._device)

    @property
    def bounds(self) -> Bounds:
        """Declared capacities."""
        return self._bounds

    @property
    def device_bytes(self) -> int:
        """Bytes reserved on the device."""
        return self._device_bytes

    def render(self, scene: Scene, camera: Camera) -> DepthAndTriangle:
        """What ``camera`` sees of ``scene``. Of the scene, only what changed since the last call is uploaded.

        Returns:
            depth (H, W) float32, metres along the optical axis, positive; NaN where nothing is hit or a pixel has no
            ray. And triangle (H, W) int32: number of the triangle that is seen, counted through the meshes of the scene
            in their order; -1 where nothing is hit. Of triangles at the same depth the first one is seen.

        Raises:
            ValueError: not a scene or a camera.
            BoundsError: the scene or the image exceeds the declared bounds; the message names the bound.
        """
        _check(scene, camera)
        limits = (
            ("max_triangles", scene.triangle_count, self._bounds.max_triangles, "triangles"),
            ("max_triangles", scene.vertex_count, 3 * self._bounds.max_triangles, "vertices"),
            ("max_rays", camera.width * camera.height, self._bounds.max_rays, "pixels"),
        )
        for name, count, limit, what in limits:
            if count > limit:
                raise BoundsError(
                    f"bounds.{name}: expected at most {limit} {what} of a depth camera with this bound, got {count}"
                )
        needs = [("depth camera", scene.triangle_count > 0)]
        seen = self._seat.run(lambda: self._look(scene, camera), needs)
        self._seat.loaded.update(needs)
        self.counters = seen.counters
        shape = (camera.height, camera.width)
        return seen.depth.reshape(shape), seen.triangle.reshape(shape)

    def _look(self, scene: Scene, camera: Camera) -> Seen:
        # Whatever ends an image half way, Ctrl-C for instance, its buffers are allocated again for the next one.
        rays = self._found()
        self._rays = None
        seen = rays.render(scene, camera)
        self._rays = rays
        return seen

    def _found(self) -> PrimaryRays:
        if self._rays is None:
            self._rays = self._make(self._device, self._bounds)
        return self._rays


_cameras: dict[str, DepthCamera] = {}
_devices: dict[str | None, str] = {}  # what a name, or None, turned out to be
_one_at_a_time = threading.RLock()


def _after_fork() -> None:
    """In a child process nobody would release what another thread of the parent held."""
    global _one_at_a_time
    _one_at_a_time = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def render_depth(scene: Scene, camera: Camera, device: str | None = None) -> DepthAndTriangle:
    """What ``camera`` sees of ``scene``: :meth:`DepthCamera.render` by a depth camera that is kept from call to call.

    There is one for each device. It is as large as the largest scene and image so far, rounded up to a power of two.
    May be called from several threads, which wait for each other.

    Args:
        scene: the world.
        camera: intrinsics and pose.
        device: "cpu", "cuda:0", ...; None is the best there is.

    Returns:
        (H, W) float32 depth [m], NaN where nothing is hit; (H, W) int32 triangle, -1 there.

    Raises:
        ValueError: not a scene or a camera, or no such device.
        ImportError: Warp is not installed.
    """
    _check(scene, camera)
    with _one_at_a_time:
        triangles = max(scene.triangle_count, -(-scene.vertex_count // 3))
        kept = _cameras.get(_devices.get(device, ""))
        if kept is None or triangles > kept.bounds.max_triangles or camera.width * camera.height > kept.bounds.max_rays:
            kept = DepthCamera(device, _bounds_for(triangles, camera, kept))
            _devices[device] = _devices[kept.device] = kept.device
            _cameras[kept.device] = kept
        return kept.render(scene, camera)


def _bounds_for(triangles: int, camera: Camera, kept: DepthCamera | None) -> Bounds:
    rays = camera.width * camera.height
    if kept is not None:
        triangles, rays = max(triangles, kept.bounds.max_triangles), max(rays, kept.bounds.max_rays)
    triangles, rays = _power_of_two(triangles, 1 << 14), _power_of_two(rays, 1 << 16)
    # Triangles of real meshes are in two tiles on average, and every tile sees a few large ones.
    entries = 2 * triangles + rays // 4
    return Bounds(max_triangles=triangles, max_rays=rays, grid_entries=entries)


def _power_of_two(value: int, least: int) -> int:
    return max(least, 1 << (value - 1).bit_length()) if value > 1 else least


def _check(scene: Any, camera: Any) -> None:
    if not isinstance(scene, Scene):
        raise ValueError(f"scene: expected a Scene, got {type(scene).__name__}")
    if not isinstance(camera, Camera):
        raise ValueError(f"camera: expected a Camera, got {type(camera).__name__}")
