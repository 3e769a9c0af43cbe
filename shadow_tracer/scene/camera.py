# SPDX-License-Identifier: Apache-2.0
"""Camera: intrinsics and pose of the optical frame; the rays of its pixels are those of a pinhole, or a table."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.scene.checks import FloatArray, finite, refuse_mask, rigid_pose, unmasked_depth
from shadow_tracer.scene.distortion import undistorted_rays


class RayTable:
    """A ray for each pixel of an image: the point (x, y, 1) of the optical frame that it goes through.

    Compared and hashed by value.

    Args:
        xy: (height, width, 2) real numbers, which are rounded to float32; NaN for both where a pixel has no ray.

    Raises:
        ValueError: another shape, infinite values, or NaN for one of x and y alone; the message starts with ``rays``.
    """

    def __init__(self, xy: Any) -> None:
        refuse_mask(xy, "rays")
        try:
            given = np.asarray(xy)
        except ValueError as error:
            raise ValueError(f"rays: expected shape (height, width, 2), got {type(xy).__name__}") from error
        if given.ndim != 3 or given.shape[2] != 2 or given.size == 0 or given.dtype.kind not in "fiu":
            raise ValueError(
                f"rays: expected real numbers of shape (height, width, 2), got shape {given.shape} of {given.dtype}"
            )
        with np.errstate(over="ignore"):
            self.xy: npt.NDArray[np.float32] = np.array(given, dtype=np.float32, order="C")
        missing = np.isnan(self.xy)
        wrong = np.isinf(self.xy).any(axis=2) | (missing[..., 0] != missing[..., 1])
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            raise ValueError(
                "rays: expected finite float32 numbers, or NaN for both where a pixel has no ray, got "
                f"{given[row, column].tolist()} in row {row}, column {column}"
            )
        self.xy[missing] = np.nan  # all of the same bits
        self.xy.setflags(write=False)
        self.known: npt.NDArray[np.bool_] = ~missing[..., 0]
        """(height, width), whether a pixel has a ray."""
        self.known.setflags(write=False)
        self._key = self.xy.shape, hashlib.blake2b(self.xy, digest_size=32).digest()

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, RayTable) and self._key == other._key)

    def __hash__(self) -> int:
        return hash(self._key)

    def __repr__(self) -> str:
        return f"RayTable({self.xy.shape[1]} x {self.xy.shape[0]} pixels)"


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera and its pose. Compared and hashed by value.

    The optical frame has x to the right, y down and z forward (REP-103). Pixel centres lie at integer coordinates, so a
    depth ``z`` at column u and row v is the point ``((u - cx) / fx * z, (v - cy) / fy * z, z)``; with ``rays`` it is
    ``(x * z, y * z, z)`` with x and y of the pixel.

    Args:
        width: image width [px], at least 1.
        height: image height [px], at least 1.
        fx: focal length along x [px], positive.
        fy: focal length along y [px], positive.
        cx: principal point, column [px].
        cy: principal point, row [px].
        camera_to_world: (4, 4) rigid transform from the optical frame to the world [m], float64.
        rays: the ray of each pixel where it is not that of a pinhole, (height, width, 2): x and y at z = 1, rounded to
            float32 and taken as exact from then on, NaN where a pixel has none; or a :class:`RayTable`, which is not
            copied. ``fx``, ``fy``, ``cx`` and ``cy`` then say nothing of samples. None: a pinhole.

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
    rays: Any = None

    @classmethod
    def distorted(
        cls,
        width: int,
        height: int,
        fx: float,
        fy: float,
        cx: float,
        cy: float,
        distortion_model: str,
        d: Any,
        camera_to_world: Any = None,
    ) -> Camera:
        """A camera whose image is distorted, as ``camera_info`` of ROS describes one: fx, fy, cx and cy of K.

        The rays are computed in float64 and rounded to float32. That takes a while: for another pose use
        ``dataclasses.replace(camera, camera_to_world=pose)``.

        Args:
            width, height, fx, fy, cx, cy: as above.
            distortion_model: ``plumb_bob``, ``rational_polynomial`` or ``equidistant``.
            d: its coefficients in the order of OpenCV: 4 or 5; 8, 12 or 14, of which the last two must be 0; 4. With
                zeros alone the first two models are those of a pinhole, and so is the camera.
            camera_to_world: as above; None is the identity.

        Raises:
            ValueError: a value is out of range, or the model has no inverse in the image; the message names it.
        """
        pose = np.eye(4) if camera_to_world is None else camera_to_world
        pinhole = cls(width, height, fx, fy, cx, cy, pose)
        size, focal, centre = (pinhole.width, pinhole.height), (pinhole.fx, pinhole.fy), (pinhole.cx, pinhole.cy)
        rays = undistorted_rays(distortion_model, d, size, focal, centre)
        return cls(width, height, fx, fy, cx, cy, pose, rays)

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
        if self.rays is not None:
            table = self.rays if isinstance(self.rays, RayTable) else RayTable(self.rays)
            if table.xy.shape[:2] != (self.height, self.width):
                expected = (self.height, self.width, 2)
                raise ValueError(f"rays: expected shape {expected} as the camera has, got {table.xy.shape}")
            object.__setattr__(self, "rays", table)

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, Camera) and self._key() == other._key())

    def __hash__(self) -> int:
        return hash(self._key())

    def _key(self) -> tuple[Any, ...]:
        pose = (self.camera_to_world + 0.0).tobytes()  # -0.0 equals 0.0
        return self.width, self.height, self.fx, self.fy, self.cx, self.cy, pose, self.rays

    @property
    def position(self) -> FloatArray:
        """Centre of projection in the world, shape (3,) [m]."""
        position: FloatArray = self.camera_to_world[:3, 3]
        return position

    def pixel_rays(self) -> FloatArray:
        """Directions of all pixels in the optical frame with z = 1, shape (height, width, 3); NaN where there is
        none."""
        rays = np.ones((self.height, self.width, 3))
        rays[..., 0], rays[..., 1] = self.ways(*np.ogrid[: self.height, : self.width])
        return rays

    def ways(self, rows: Any, columns: Any) -> tuple[FloatArray, FloatArray]:
        """x and y at z = 1 of the rays of some pixels, given by arrays of integers that broadcast together; so do
        those returned."""
        if self.rays is None:
            return (columns - self.cx) / self.fx, (rows - self.cy) / self.fy
        picked = self.rays.xy[rows, columns].astype(np.float64)
        return picked[..., 0], picked[..., 1]

    def unproject(self, depth: Any) -> FloatArray:
        """Points in the world of a depth image in metres along z, shape (height, width, 3) [m].

        Computed in the same order of operations as on the device, so the values are the samples that are traced.
        Invalid depths give meaningless points, NaN where ``depth`` is a masked array of floats and masked, or where a
        pixel has no ray.
        """
        z = unmasked_depth(depth).astype(np.float64)
        if z.shape != (self.height, self.width):
            raise ValueError(f"depth: expected shape {(self.height, self.width)}, got {z.shape}")
        across, down = self.ways(*np.ogrid[: self.height, : self.width])
        x, y = across * z, down * z
        pose, points = self.camera_to_world, np.empty((*z.shape, 3))
        for i in range(3):
            points[..., i] = ((pose[i, 0] * x + pose[i, 1] * y) + pose[i, 2] * z) + pose[i, 3]
        return points
