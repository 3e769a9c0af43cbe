# SPDX-License-Identifier: Apache-2.0
"""Pinhole camera: intrinsics and pose of the optical frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from shadow_tracer.scene.checks import FloatArray, finite, rigid_pose, unmasked_depth


@dataclass(frozen=True)
class Camera:
    """An undistorted pinhole camera.

    The optical frame has x to the right, y down and z forward (REP-103). Pixel centres lie at integer coordinates, so a
    depth ``z`` at column u and row v is the point ``((u - cx) / fx * z, (v - cy) / fy * z, z)``.

    Args:
        width: image width [px], at least 1.
        height: image height [px], at least 1.
        fx: focal length along x [px], positive.
        fy: focal length along y [px], positive.
        cx: principal point, column [px].
        cy: principal point, row [px].
        camera_to_world: (4, 4) rigid transform from the optical frame to the world [m], float64.

    Raises:
        ValueError: a value is out of range; the message names it.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    camera_to_world: Any = field(default_factory=lambda: np.eye(4))

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            value: Any = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 1:
                raise ValueError(f"{name}: expected an integer of at least 1, got {value!r}")
            object.__setattr__(self, name, int(value))
        for name in ("fx", "fy"):
            focal = finite(getattr(self, name), name)
            if focal <= 0.0:
                raise ValueError(f"{name}: expected a positive focal length in pixels, got {focal!r}")
            object.__setattr__(self, name, focal)
        for name in ("cx", "cy"):
            object.__setattr__(self, name, finite(getattr(self, name), name))
        pose = rigid_pose(self.camera_to_world, "camera_to_world")
        pose.setflags(write=False)
        object.__setattr__(self, "camera_to_world", pose)

    @property
    def position(self) -> FloatArray:
        """Centre of projection in the world, shape (3,) [m]."""
        position: FloatArray = self.camera_to_world[:3, 3]
        return position

    def pixel_rays(self) -> FloatArray:
        """Directions of all pixels in the optical frame with z = 1, shape (height, width, 3)."""
        u = (np.arange(self.width, dtype=np.float64) - self.cx) / self.fx
        v = (np.arange(self.height, dtype=np.float64) - self.cy) / self.fy
        rays = np.ones((self.height, self.width, 3))
        rays[..., 0] = u[None, :]
        rays[..., 1] = v[:, None]
        return rays

    def unproject(self, depth: Any) -> FloatArray:
        """Points in the world of a depth image in metres along z, shape (height, width, 3) [m].

        Computed in the same order of operations as on the device, so the values are the samples that are traced.
        Invalid depths give meaningless points, NaN where ``depth`` is a masked array of floats and masked.
        """
        z = unmasked_depth(depth).astype(np.float64)
        if z.shape != (self.height, self.width):
            raise ValueError(f"depth: expected shape {(self.height, self.width)}, got {z.shape}")
        rays = self.pixel_rays()
        x, y = rays[..., 0] * z, rays[..., 1] * z
        pose = self.camera_to_world
        return np.stack([((pose[i, 0] * x + pose[i, 1] * y) + pose[i, 2] * z) + pose[i, 3] for i in range(3)], axis=-1)
