# SPDX-License-Identifier: Apache-2.0
"""A small scene, and the messages that carry it: a wall before the camera, and a plate that casts a shadow on it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image

from shadow_tracer.scene.camera import Camera

WIDTH, HEIGHT, FOCAL = 64, 48, 60.0
CAMERA_FRAME = "camera"


def reliable(depth: int = 10, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE) -> QoSProfile:
    """A reliable profile that keeps the last ``depth`` messages."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.RELIABLE, durability=durability
    )


def time_msg(nanoseconds: int) -> Time:
    """A stamp as a message."""
    return Time(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)


def nanoseconds(stamp: Time) -> int:
    """A stamp as one number."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def wall(width: int = WIDTH, height: int = HEIGHT, distance: float = 2.0) -> npt.NDArray[np.float32]:
    """Depth of a wall across the optical axis, (H, W) float32 metres, with one invalid pixel in the corner."""
    depth = np.full((height, width), distance, np.float32)
    depth[0, 0] = np.nan
    return depth


def plate(
    distance: float = 1.0, half: float = 0.25, x: float = 0.0
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """A square plate across the optical axis [m]: (4, 3) vertices in the camera's frame and (2, 3) triangles."""
    corners = [(x - half, -half), (x + half, -half), (x + half, half), (x - half, half)]
    return np.array([(u, v, distance) for u, v in corners]), np.array([(0, 1, 2), (0, 2, 3)])


def image_msg(
    depth: npt.NDArray[np.float32] | npt.NDArray[np.uint16],
    stamp: int,
    frame: str = CAMERA_FRAME,
    encoding: str = "",
) -> Image:
    """A depth image message.

    Args:
        depth: (H, W) float32 metres or uint16 millimetres.
        stamp: nanoseconds.
        encoding: instead of 32FC1 or 16UC1.

    Raises:
        ValueError: another array.
    """
    kinds = {"float32": "32FC1", "uint16": "16UC1"}
    if not isinstance(depth, np.ndarray) or depth.ndim != 2 or depth.dtype.name not in kinds:
        got = f"{depth.dtype} of shape {depth.shape}" if isinstance(depth, np.ndarray) else type(depth).__name__
        raise ValueError(f"depth: expected a (H, W) array of float32 metres or uint16 millimetres, got {got}")
    msg = Image(height=depth.shape[0], width=depth.shape[1], step=depth.shape[1] * depth.itemsize)
    msg.encoding = encoding or kinds[depth.dtype.name]
    msg.header.stamp, msg.header.frame_id = time_msg(stamp), frame
    msg.data.frombytes(np.ascontiguousarray(depth).tobytes())
    return msg


def camera_info_msg(camera: Camera, stamp: int, frame: str = CAMERA_FRAME) -> CameraInfo:
    """A camera_info message of a rectified camera; its pose is not in it. ``stamp`` in nanoseconds."""
    msg = info_msg(camera.width, camera.height, stamp, frame=frame)
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    msg.k = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    msg.p = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    return msg


def info_msg(width: int, height: int, stamp: int, focal: float = FOCAL, frame: str = CAMERA_FRAME) -> CameraInfo:
    """A camera_info message of an ideal camera: ``focal`` in pixels, the principal point in the middle."""
    msg = CameraInfo(width=width, height=height, distortion_model="plumb_bob", d=[0.0] * 5)
    cx, cy = (width - 1) / 2, (height - 1) / 2
    msg.k = [focal, 0.0, cx, 0.0, focal, cy, 0.0, 0.0, 1.0]
    msg.p = [focal, 0.0, cx, 0.0, 0.0, focal, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    msg.header.stamp, msg.header.frame_id = time_msg(stamp), frame
    return msg


def pose_msg(
    position: Sequence[float], rotation: Sequence[float] = (0.0, 0.0, 0.0, 1.0), frame: str = "", stamp: int = 0
) -> PoseStamped:
    """A pose: position [m], quaternion x y z w; ``stamp`` in nanoseconds."""
    msg = PoseStamped()
    msg.header.stamp, msg.header.frame_id = time_msg(stamp), frame
    p, q = msg.pose.position, msg.pose.orientation
    p.x, p.y, p.z = (float(value) for value in position)
    q.x, q.y, q.z, q.w = (float(value) for value in rotation)
    return msg
