# SPDX-License-Identifier: Apache-2.0
"""What tests of the node send beside images and meshes, and the library's own answer to the same question."""

from __future__ import annotations

from typing import Any

import numpy as np
from harness import FOCAL, HEIGHT, SMALL, WIDTH, plate, time_msg
from sensor_msgs.msg import PointCloud2, PointField

from shadow_tracer import Bias, Bounds, Camera, ShadowTracer
from shadow_tracer.testing.messages import pose_msg as pose_msg  # for those who import it from here

BIAS = Bias(0.02, 0.003, 0.6)  # the node's default
UNKNOWN = 77


def library() -> ShadowTracer:
    """A tracer with the bounds of the node under test."""
    sizes = {name[len("bounds.") :]: value for name, value in SMALL.items() if name.startswith("bounds.")}
    return ShadowTracer(device="cpu", bounds=Bounds(**sizes))


def library_with_plate() -> ShadowTracer:
    """The same, with the :func:`harness.plate` that a rig sends as its mesh."""
    made = library()
    made.scene.put("mesh", *plate())
    return made


def camera(pose: np.ndarray | None = None) -> Camera:
    """The camera of :func:`harness.info_msg`, at a pose."""
    centre = (WIDTH - 1) / 2, (HEIGHT - 1) / 2
    return Camera(WIDTH, HEIGHT, FOCAL, FOCAL, *centre, np.eye(4) if pose is None else pose)


def shift(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """(4, 4) translation."""
    pose = np.eye(4)
    pose[:3, 3] = (x, y, z)
    return pose


def cloud_msg(points: Any, stamp: int = 0, frame: str = "camera", kind: str = "f4", height: int = 1) -> PointCloud2:
    """A cloud of (N, 3) points, of ``height`` rows, as float32 or float64 with an intensity behind each point."""
    points = np.asarray(points, kind)
    item = points.dtype.itemsize
    rows = np.zeros((len(points), 4), kind)
    rows[:, :3] = points
    code = {4: PointField.FLOAT32, 8: PointField.FLOAT64}[item]
    width = len(points) // height
    msg = PointCloud2(height=height, width=width, point_step=4 * item, row_step=4 * item * width)
    names = ("x", "y", "z", "intensity")
    msg.fields = [PointField(name=name, offset=k * item, datatype=code, count=1) for k, name in enumerate(names)]
    msg.header.stamp, msg.header.frame_id = time_msg(stamp), frame
    msg.data.frombytes(rows.tobytes())
    return msg


def soup(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(3 T, 3) corners of the triangles of a mesh, one after the other."""
    return np.ascontiguousarray(vertices[np.asarray(triangles).ravel()], np.float64)


def shadow_size(mask: np.ndarray) -> int:
    """Pixels in shadow."""
    return int((mask == 0).sum())


def all_unknown(mask: np.ndarray) -> bool:
    """Whether nothing is known."""
    return bool((mask == UNKNOWN).all())
