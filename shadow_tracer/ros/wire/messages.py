# SPDX-License-Identifier: Apache-2.0
"""ROS messages <-> numpy: depth images, camera_info, poses, masks. The mesh, which arrives raw, is in :mod:`cdr`.

Whatever is wrong with a message is a :class:`MessageError` that names the field. No ROS is imported here: a message is
anything with its fields, be it of rclpy or of a library that reads bags.
"""

from __future__ import annotations

import math
import sys
from array import array
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from shadow_tracer import Camera
from shadow_tracer.ros.settings import FloatArray
from shadow_tracer.scene.camera import RayTable

if TYPE_CHECKING:
    from geometry_msgs.msg import Pose, PoseStamped
    from sensor_msgs.msg import CameraInfo, Image

DEPTH_ENCODINGS = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
LARGEST_SIDE = 2**16
MILLIMETRE = 0.001  # [m], a step of 16UC1 and mono16 by REP 118
_FOCAL_RANGE = (1e-3, 1e7)  # [px]
DISTORTION = ("auto", "apply", "ignore")
_Optics = tuple[int, int, float, float, float, float]
_RECTIFIED = "set distortion to ignore if the image is rectified, else rectify it or correct its driver"


class MessageError(ValueError):
    """A message cannot be used. The text starts with the field and says what was expected and what came."""


def stamp_ns(stamp: Any) -> int:
    """Nanoseconds of a builtin_interfaces/Time."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def decode_depth(msg: Image, unit: float = MILLIMETRE) -> npt.NDArray[Any]:
    """Depth image as numpy, without a copy where byte order, ``step`` and ``unit`` allow it.

    Args:
        unit: length of a step of 16UC1 and mono16 [m].

    Returns:
        (H, W) uint16 millimetres (16UC1, mono16) or float32 metres (32FC1, or another unit than a millimetre), native
        byte order, C-contiguous.

    Raises:
        MessageError: another encoding, no pixels, ``step`` or data too short.
    """
    kind = DEPTH_ENCODINGS.get(msg.encoding)
    if kind is None:
        raise MessageError(f"encoding: expected one of {', '.join(DEPTH_ENCODINGS)}, got {msg.encoding!r}")
    height, width, step = int(msg.height), int(msg.width), int(msg.step)
    if not (1 <= height <= LARGEST_SIDE and 1 <= width <= LARGEST_SIDE):
        raise MessageError(f"width, height: expected 1 to {LARGEST_SIDE} pixels each, got {width} x {height}")
    dtype = np.dtype((">" if msg.is_bigendian else "<") + kind)
    if step < width * dtype.itemsize:
        raise MessageError(f"step: expected at least {width * dtype.itemsize} bytes for {width} pixels, got {step}")
    if len(msg.data) < step * height:
        raise MessageError(f"data: expected step * height = {step * height} bytes, got {len(msg.data)}")
    pixels: npt.NDArray[Any] = np.ndarray((height, width), dtype, msg.data, strides=(step, dtype.itemsize))
    return in_unit(np.ascontiguousarray(pixels, dtype=dtype.newbyteorder("=")), unit)


def in_unit(depth: npt.NDArray[Any], unit: float) -> npt.NDArray[Any]:
    """A depth image whose steps have a length, as the tracer takes it.

    Args:
        depth: (H, W) uint16 steps, or float32 metres, which stay as they are.
        unit: length of a step [m].

    Returns:
        uint16 as they are if a step is a millimetre; else float32 metres, step * unit computed in float64 and rounded
        once, so that the image is the one that a camera of metres would have sent. 0 stays 0, no measurement.
    """
    return _metres(unit)[depth] if depth.dtype == np.uint16 and unit != MILLIMETRE else depth


@lru_cache(maxsize=2)
def _metres(unit: float) -> npt.NDArray[np.float32]:
    return (np.arange(2**16, dtype=np.float64) * unit).astype(np.float32)


@dataclass(frozen=True)
class Intrinsics:
    """Intrinsics of an image [px]; ``warning`` tells what is doubtful about them, "" if nothing.

    ``rays`` are those of the pixels of a distorted image, None if they are those of a pinhole; ``model`` is the
    distortion model they come from, or "".
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    warning: str = ""
    rays: RayTable | None = None
    model: str = ""

    def camera(self, camera_to_world: FloatArray) -> Camera:
        """The camera at a pose, (4, 4)."""
        return Camera(self.width, self.height, self.fx, self.fy, self.cx, self.cy, camera_to_world, self.rays)


def is_raw(info: CameraInfo, topic: str, distortion: str) -> bool:
    """Whether a depth image is as the lens has distorted it, and not rectified.

    Args:
        topic: what it came on. ROS calls rectified images image_rect, image_rect_raw and the like, and sends the
            distortion of the raw image with them.
        distortion: one of ``DISTORTION``; ``auto``: if there is distortion and the topic's name does not say rect.
    """
    if distortion != "auto":
        return distortion == "apply"
    words = topic.removesuffix("/compressedDepth").rpartition("/")[2].split("_")
    return any(value != 0.0 for value in info.d) and not any(word.startswith("rect") for word in words)


def intrinsics(info: CameraInfo, width: int, height: int, raw: bool = False) -> Intrinsics:
    """Intrinsics for a depth image of this size. Those of a rectified one come from P where P[0] is not 0, else from K;
    those of a ``raw`` one from K and D.

    P and K are of the full resolution. A region of interest shifts them and binning scales them, as the camera model of
    ``image_geometry`` does: (c - offset) / binning, f / binning.

    Raises:
        MessageError: uncalibrated, not finite, focal length not positive, another image size; a distortion that cannot
            be undone.
    """
    k = [float(value) for value in info.k]
    p = [float(value) for value in info.p]
    if raw and k[0] == 0.0 and p[0] != 0.0:
        raise MessageError(f"camera_info.k: K[0] is 0, and a raw image needs K; {_RECTIFIED}")
    if p[0] == 0.0 and k[0] == 0.0:
        raise MessageError(
            "camera_info.p, k: P[0] and K[0] are 0, the camera is uncalibrated; calibrate it, or set P or K in the "
            "driver"
        )
    of_p = p[0] != 0.0 and not raw
    fx, fy, cx, cy = [p[0], p[5], p[2], p[6]] if of_p else [k[0], k[4], k[2], k[5]]
    field = "camera_info.p" if of_p else "camera_info.k"
    (left, top), (across, down), doubt = _reduction(info, width, height)
    values = [fx / across, fy / down, (cx - left) / across, (cy - top) / down]
    fx, fy, cx, cy = values
    # Comparisons with NaN are false. Beyond these limits squares of the numbers leave float64.
    low, high = _FOCAL_RANGE
    if not (low <= fx <= high and low <= fy <= high and abs(cx) <= high and abs(cy) <= high):
        raise MessageError(
            f"{field}: expected fx, fy from {low:g} to {high:g} and cx, cy within +-{high:g} pixels, got {values}"
        )
    rays = _rays(info, (width, height, fx, fy, cx, cy)) if raw else None
    return Intrinsics(width, height, fx, fy, cx, cy, doubt, rays, info.distortion_model if rays is not None else "")


def _rays(info: CameraInfo, optics: _Optics) -> RayTable | None:
    # D is of the plane z = 1 and does not know of pixels: with the K of the cut or binned image it is right there too.
    d = tuple(float(value) for value in info.d)
    if not d or (info.distortion_model != "equidistant" and not any(d)):
        return None
    found = _ray_table(info.distortion_model, d, optics)
    if isinstance(found, str):
        raise MessageError(f"camera_info.{found}")
    return found


# Distortion that cannot be undone is kept as a text: it takes as long to find out.
@lru_cache(maxsize=4)
def _ray_table(model: str, d: tuple[float, ...], optics: _Optics) -> RayTable | str | None:
    try:
        rays: RayTable | None = Camera.distorted(*optics, model, d).rays
        return rays
    except ValueError as error:
        return str(error) if "; " in str(error) else f"{error}; {_RECTIFIED}"


def _reduction(info: CameraInfo, width: int, height: int) -> tuple[tuple[int, int], tuple[int, int], str]:
    """Offset [px] and binning that lead from the full resolution to the image, and what is doubtful about them.

    Raises:
        MessageError: the image has not the size that camera_info gives it.
    """
    full, roi = (int(info.width), int(info.height)), info.roi
    offset = (int(roi.x_offset), int(roi.y_offset))
    binning = (max(1, int(info.binning_x)), max(1, int(info.binning_y)))
    window = (int(roi.width), int(roi.height))
    if window == (0, 0) and offset == (0, 0):
        window = full
    reduced = (window[0] // binning[0], window[1] // binning[1])
    inside = offset[0] + window[0] <= full[0] and offset[1] + window[1] <= full[1]
    if (width, height) == reduced and inside:
        return offset, binning, ""
    if (width, height) == full:
        if offset == (0, 0) and binning == (1, 1):
            return offset, binning, ""  # whatever the window is, it moves nothing
        # Drivers that crop or bin may give the size of what they send as the full one, and a K of either.
        return (
            offset,
            binning,
            (
                f"camera_info.roi, binning: the image has the full {width} x {height} pixels though there is an offset "
                f"of {offset} and a binning of {binning}; P and K are adjusted as image_geometry does, which is right "
                "if point clouds of the camera are; if not, its driver should leave both 0"
            ),
        )
    sizes = f"camera_info says {full[0]} x {full[1]}"
    if reduced != full:
        sizes += f", and {reduced[0]} x {reduced[1]} with its region of interest and binning"
    raise MessageError(
        f"camera_info.width, height: the image has {width} x {height} pixels, {sizes}; scale it with the image "
        "(image_proc ResizeNode), or set region of interest and binning to what was done to the image"
    )


def info_content(info: CameraInfo) -> tuple[Any, ...]:
    """All that a camera_info says but its stamp; equal for two of them if they agree bit for bit."""
    numbers = tuple(np.asarray(getattr(info, name), np.float64).tobytes() for name in "dkrp")
    roi = info.roi
    window = (roi.x_offset, roi.y_offset, roi.width, roi.height, bool(roi.do_rectify))
    size = (info.width, info.height, info.binning_x, info.binning_y)
    return info.header.frame_id, info.distortion_model, *numbers, *size, *window


def frame_name(name: str) -> str:
    """A frame as tf2 calls it: without the leading slash that tf of ROS 1 allowed, and some drivers still send."""
    return name[1:] if name.startswith("/") else name


def rigid(position: npt.ArrayLike, quaternion: npt.ArrayLike, field: str) -> FloatArray:
    """(4, 4) transform of a position [m] and a quaternion x y z w, which is normalised.

    Raises:
        MessageError: not finite, or not a unit quaternion within 1 percent.
    """
    values = np.concatenate([np.asarray(position, np.float64), np.asarray(quaternion, np.float64)])
    if not np.isfinite(values).all():
        raise MessageError(f"{field}: expected finite numbers, got {values.tolist()}")
    with np.errstate(over="ignore"):  # an infinite length is refused like any other
        length = float(np.linalg.norm(values[3:]))
    if not 0.99 <= length <= 1.01:
        raise MessageError(f"{field}: expected a unit quaternion, got one of length {length:.6g}")
    x, y, z, w = values[3:] / length
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = values[:3]
    return matrix


def quaternion_of(matrix: FloatArray) -> tuple[float, float, float, float]:
    """The unit quaternion x y z w of the rotation in a (4, 4) rigid transform."""
    (a, b, c), (d, e, f), (g, h, i) = matrix[:3, :3].tolist()
    # Four times the products of each of them with all; that with the largest square is far from 0.
    squares = (1 + a - e - i, 1 - a + e - i, 1 - a - e + i, 1 + a + e + i)
    rows = (
        (squares[0], d + b, c + g, h - f),
        (d + b, squares[1], h + f, c - g),
        (c + g, h + f, squares[2], d - b),
        (h - f, c - g, d - b, squares[3]),
    )
    x, y, z, w = rows[squares.index(max(squares))]
    length = math.sqrt(x * x + y * y + z * z + w * w)
    return x / length, y / length, z / length, w / length


def pose_matrix(pose: Pose, field: str) -> FloatArray:
    """(4, 4) transform of a geometry_msgs/Pose. Raises MessageError as :func:`rigid`."""
    p, q = pose.position, pose.orientation
    return rigid((p.x, p.y, p.z), (q.x, q.y, q.z, q.w), field)


def camera_pose(msg: PoseStamped, fixed_frame: str) -> tuple[int, FloatArray]:
    """Stamp [ns] and (4, 4) pose of a message of the topic ``camera_pose``.

    Raises:
        MessageError: it is in another frame than ``fixed_frame``, where both are named; or as :func:`rigid`.
    """
    frame = frame_name(msg.header.frame_id)
    if fixed_frame and frame and frame != fixed_frame:
        raise MessageError(f"header.frame_id: expected fixed_frame {fixed_frame!r}, got {frame!r}")
    return stamp_ns(msg.header.stamp), pose_matrix(msg.pose, "pose")


def image_layout(pixels: npt.NDArray[Any], encoding: str) -> dict[str, Any]:
    """The fields of an image that say how its bytes are to be read; they are those of C-contiguous ``pixels``.

    Args:
        pixels: (H, W) or (H, W, channels), uint8, uint16 or float32.
        encoding: what ROS calls that: mono8, rgb8, 16UC1, 32FC1.

    Returns:
        ``height``, ``width`` [px], ``encoding``, ``is_bigendian``, ``step`` [bytes].
    """
    height, width = pixels.shape[:2]
    return {
        "height": height,
        "width": width,
        "encoding": encoding,
        "is_bigendian": int(sys.byteorder == "big"),
        "step": pixels.nbytes // height,
    }


def image_message(pixels: npt.NDArray[Any], encoding: str, depth: Image) -> Image:
    """An image with the header of the depth image it belongs to.

    Args:
        pixels: (H, W) or (H, W, channels), uint8, uint16 or float32.
        encoding: what ROS calls that: mono8, rgb8, 16UC1, 32FC1.
        depth: the depth image; of its class the message is.
    """
    pixels = np.ascontiguousarray(pixels)
    data = array("B")
    # frombytes copies once; assigning a numpy array to .data goes element by element (25 ms at 640 x 480).
    data.frombytes(memoryview(pixels).cast("B"))
    return type(depth)(header=depth.header, data=data, **image_layout(pixels, encoding))


def mask_image(mask: npt.NDArray[np.uint8], depth: Image) -> Image:
    """A mono8 image of a mask, (H, W) uint8, with the header of the depth image it belongs to."""
    return image_message(mask, "mono8", depth)
