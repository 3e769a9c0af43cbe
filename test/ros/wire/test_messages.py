# SPDX-License-Identifier: Apache-2.0
"""Messages to numpy and back: every encoding and byte order, and every way an image or a camera_info can be wrong."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Point, Pose, PoseStamped
from harness import image_msg, info_msg, plate
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CameraInfo, Image
from shape_msgs.msg import Mesh, MeshTriangle

from shadow_tracer import Camera
from shadow_tracer.ros.diagnostics import READ_FIRST
from shadow_tracer.ros.wire.cdr import encode_mesh, parse_mesh
from shadow_tracer.ros.wire.messages import (
    MessageError,
    camera_pose,
    decode_depth,
    image_message,
    info_content,
    intrinsics,
    is_raw,
    mask_image,
    pose_matrix,
    rigid,
)

MILLIMETRES = np.array([[0, 1, 700], [1500, 40000, 65535]], np.uint16)
METRES = np.array([[0.0, np.nan, 0.7], [1.5, -np.inf, 1e-3]], np.float32)


def depth_msg(values: np.ndarray, encoding: str, big: bool, padding: int) -> Image:
    rows, columns = values.shape
    step = columns * values.itemsize + padding
    msg = Image(height=rows, width=columns, encoding=encoding, is_bigendian=int(big), step=step)
    for row in values.astype(values.dtype.newbyteorder(">" if big else "<")):
        msg.data.frombytes(row.tobytes() + b"\xab" * padding)
    return msg


@pytest.mark.parametrize("big", [False, True], ids=["little", "big"])
@pytest.mark.parametrize("padding", [0, 1, 8])
@pytest.mark.parametrize(
    ("encoding", "values"),
    [("16UC1", MILLIMETRES), ("mono16", MILLIMETRES), ("32FC1", METRES)],
    ids=lambda v: str(v)[:6],
)
def test_depth_is_decoded(encoding: str, values: np.ndarray, padding: int, big: bool) -> None:
    depth = decode_depth(depth_msg(values, encoding, big, padding))
    assert depth.dtype == values.dtype and depth.dtype.isnative and depth.flags.c_contiguous
    np.testing.assert_array_equal(depth, values)


@pytest.mark.parametrize("unit", [1e-6, 0.0001, 0.0002, 0.25, 1.0])
def test_a_step_of_another_length(unit: float) -> None:
    """The product in float64, rounded once; 0 stays no measurement, and metres are metres."""
    steps = np.arange(2**16, dtype=np.uint16).reshape(256, 256)
    found = decode_depth(depth_msg(steps, "16UC1", True, 3), unit)
    assert found.dtype == np.float32 and found.flags.c_contiguous and found[0, 0] == 0.0
    assert found.ravel()[1:].tolist() == [float(np.float32(step * unit)) for step in range(1, 2**16)]
    np.testing.assert_array_equal(decode_depth(depth_msg(METRES, "32FC1", False, 0), unit), METRES)
    assert decode_depth(depth_msg(steps, "16UC1", False, 0), 0.001).dtype == np.uint16


def test_plain_depth_is_not_copied() -> None:
    msg = depth_msg(MILLIMETRES, "16UC1", False, 0)
    assert np.shares_memory(decode_depth(msg), np.frombuffer(msg.data, np.uint8))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"encoding": "rgb8"}, "encoding: expected one of 16UC1, mono16, 32FC1, got 'rgb8'"),
        ({"encoding": ""}, "encoding: expected one of"),
        ({"encoding": "32FC1"}, "step: expected at least 12 bytes for 3 pixels, got 6"),
        ({"height": 0}, "width, height: expected 1 to 65536 pixels each, got 3 x 0"),
        ({"width": 0}, "width, height: expected 1"),
        ({"width": 2**32 - 1, "step": 2**32 - 1}, "width, height: expected 1"),
        ({"step": 5}, "step: expected at least 6 bytes"),
        ({"step": 0}, "step: expected at least 6 bytes"),
        ({"step": 2**31}, "data: expected step * height"),
        ({"height": 3}, "data: expected step * height = 18 bytes, got 12"),
        ({"height": 65536}, "data: expected step * height"),
    ],
    ids=lambda value: str(value)[:40],
)
def test_bad_images_are_refused(change: dict[str, Any], message: str) -> None:
    msg = depth_msg(MILLIMETRES, "16UC1", False, 0)
    for name, value in change.items():
        setattr(msg, name, value)
    with pytest.raises(MessageError) as caught:
        decode_depth(msg)
    assert message in str(caught.value)


def test_intrinsics_come_from_p_even_without_a_k() -> None:
    """Some drivers (depthai-ros) leave K all zero."""
    info = info_msg(64, 48, 0)
    info.k = [0.0] * 9
    assert intrinsics(info, 64, 48) == intrinsics(info_msg(64, 48, 0), 64, 48)


def test_intrinsics_come_from_p_or_else_from_k() -> None:
    info = info_msg(64, 48, 0)
    info.p[0], info.p[2] = 70.0, 30.0
    optics = intrinsics(info, 64, 48)
    assert (optics.fx, optics.fy, optics.cx, optics.cy, optics.warning) == (70.0, 60.0, 30.0, 23.5, "")
    info.p = [0.0] * 12
    assert intrinsics(info, 64, 48).fx == 60.0
    camera = optics.camera(np.eye(4))
    assert (camera.width, camera.height, camera.fx) == (64, 48, 70.0)


BARREL = [-0.2, 0.05, 0.01, -0.002, 0.003]


def distorted_info(d: Any = BARREL, model: str = "plumb_bob") -> CameraInfo:
    """camera_info of 64 x 48 pixels with a distortion, and a P that is not K."""
    info = info_msg(64, 48, 0)
    info.d, info.distortion_model = d, model
    info.p[0], info.p[2] = 70.0, 30.0
    return info


@pytest.mark.parametrize(
    ("topic", "rectified"),
    [
        ("/camera/depth/image_rect", True),
        ("/camera/depth/image_rect_raw", True),
        ("/camera/depth/image_rectified/compressedDepth", True),
        ("/depth_registered/image_rect/compressedDepth", True),
        ("/camera/depth/image_raw", False),
        ("/camera/depth/image_raw/compressedDepth", False),
        ("/camera/rectangle/image", False),
        ("/camera/image_direct", False),
        ("", False),
    ],
)
def test_a_topic_says_whether_its_image_is_rectified(topic: str, rectified: bool) -> None:
    assert is_raw(distorted_info(), topic, "auto") == (not rectified)
    for d in ([], [0.0] * 5, [0.0, -0.0]):
        assert not is_raw(distorted_info(d), topic, "auto")
        assert is_raw(distorted_info(d), topic, "apply")
    assert is_raw(distorted_info([float("nan")]), topic, "auto") == (not rectified)
    assert is_raw(distorted_info(), topic, "apply") and not is_raw(distorted_info(), topic, "ignore")


@pytest.mark.parametrize(
    ("model", "d"),
    [
        ("plumb_bob", BARREL),
        ("plumb_bob", BARREL[:4]),
        ("rational_polynomial", [5.7, 3.6, 1e-4, -5e-5, 0.19, 6.0, 5.4, 1.0]),
        ("equidistant", [-0.0037, 0.0388, -0.0368, 0.0062]),
        ("equidistant", [0.0] * 4),
    ],
)
def test_a_raw_image_has_the_rays_of_k_and_d(model: str, d: list[float]) -> None:
    info = distorted_info(d, model)
    optics = intrinsics(info, 64, 48, raw=True)
    assert (optics.fx, optics.cx, optics.warning, optics.model) == (60.0, 31.5, "", model)
    assert optics.camera(np.eye(4)) == Camera.distorted(64, 48, 60.0, 60.0, 31.5, 23.5, model, d)
    assert intrinsics(info, 64, 48, raw=True).rays is optics.rays, "made once"
    rectified = intrinsics(info, 64, 48)
    assert (rectified.fx, rectified.cx, rectified.rays, rectified.model, rectified.warning) == (
        70.0,
        30.0,
        None,
        "",
        "",
    )


@pytest.mark.parametrize(
    ("model", "d"), [("plumb_bob", []), ("", []), ("", [0.0] * 5), ("rational_polynomial", [0.0] * 8)]
)
def test_a_raw_image_without_distortion_is_that_of_a_pinhole(model: str, d: list[float]) -> None:
    optics = intrinsics(distorted_info(d, model), 64, 48, raw=True)
    assert (optics.fx, optics.rays, optics.model, optics.warning) == (60.0, None, "", "")


@pytest.mark.parametrize(
    ("model", "d", "message"),
    [
        (
            "fisheye",
            BARREL,
            "camera_info.distortion_model: expected one of plumb_bob, rational_polynomial, equidistant,",
        ),
        ("", BARREL, "camera_info.distortion_model: expected one of"),
        ("plumb_bob", BARREL[:3], "camera_info.d: expected 4 or 5 coefficients of plumb_bob, got 3"),
        ("plumb_bob", [float("nan")] * 5, "camera_info.d: expected finite numbers of at most 1e+09, got"),
        ("plumb_bob", [-3.0, 0.0, 0.0, 0.0], "camera_info.d: expected coefficients of plumb_bob that give every pixel"),
        ("rational_polynomial", [0.1] * 14, "camera_info.d: expected no tilt of the sensor"),
    ],
)
def test_distortion_that_cannot_be_undone_is_refused(model: str, d: list[float], message: str) -> None:
    for _ in range(2):  # the second time it is known
        with pytest.raises(MessageError) as caught:
            intrinsics(distorted_info(d, model), 64, 48, raw=True)
        assert str(caught.value).startswith(message)
        cure = str(caught.value).rpartition("; ")[2]
        assert "rectif" in cure and len(cure) <= READ_FIRST
    assert intrinsics(distorted_info(d, model), 64, 48).rays is None


def test_a_raw_image_needs_k() -> None:
    info = distorted_info()
    info.k = [0.0] * 9
    with pytest.raises(
        MessageError, match=r"^camera_info\.k: K\[0\] is 0, and a raw image needs K; set distortion to "
    ):
        intrinsics(info, 64, 48, raw=True)
    info.k = [60.0, 0.0, float("nan"), 0.0, 60.0, 23.5, 0.0, 0.0, 1.0]
    with pytest.raises(MessageError, match=r"^camera_info\.k: expected fx, fy from"):
        intrinsics(info, 64, 48, raw=True)


@pytest.mark.parametrize(
    ("offset", "window", "binning"), [((8, 4), (32, 24), (0, 0)), ((0, 0), (0, 0), (2, 2)), ((8, 4), (32, 24), (2, 4))]
)
def test_rays_of_a_cut_or_binned_image_are_those_of_the_full_one(offset: Any, window: Any, binning: Any) -> None:
    info = reduced_info(offset, window, binning)
    info.d, info.k[4] = BARREL, 61.0
    x, y = (max(1, step) for step in binning)
    width, height = (window[0] or 64) // x, (window[1] or 48) // y
    rays = intrinsics(info, width, height, raw=True).rays
    full = Camera.distorted(64, 48, 60.0, 61.0, 31.5, 23.5, "plumb_bob", BARREL).rays
    assert rays is not None
    cut = full.xy[offset[1] : offset[1] + height * y : y, offset[0] : offset[0] + width * x : x]
    np.testing.assert_allclose(rays.xy, cut, rtol=0.0, atol=1e-7)


def reduced_info(offset: tuple[int, int], window: tuple[int, int], binning: tuple[int, int]) -> CameraInfo:
    """camera_info of 64 x 48 pixels with fx 60, fy 61, cx 31.5, cy 23.5, a region of interest and binning."""
    info = info_msg(64, 48, 0)
    info.p[5] = 61.0
    info.roi.x_offset, info.roi.y_offset = offset
    info.roi.width, info.roi.height = window
    info.binning_x, info.binning_y = binning
    return info


@pytest.mark.parametrize("source", "pk")
@pytest.mark.parametrize(
    ("offset", "window", "binning", "size", "values"),
    [
        ((0, 0), (0, 0), (0, 0), (64, 48), (60.0, 61.0, 31.5, 23.5)),
        ((0, 0), (64, 48), (1, 1), (64, 48), (60.0, 61.0, 31.5, 23.5)),
        ((0, 0), (63, 47), (1, 1), (64, 48), (60.0, 61.0, 31.5, 23.5)),  # an Ensenso: the window moves nothing
        ((0, 0), (0, 0), (2, 2), (32, 24), (30.0, 30.5, 15.75, 11.75)),
        ((0, 0), (0, 0), (1, 3), (64, 16), (60.0, 61.0 / 3, 31.5, 23.5 / 3)),
        ((8, 4), (32, 24), (0, 0), (32, 24), (60.0, 61.0, 23.5, 19.5)),
        ((8, 4), (32, 24), (2, 4), (16, 6), (30.0, 15.25, 11.75, 4.875)),
        ((0, 0), (33, 25), (2, 2), (16, 12), (30.0, 30.5, 15.75, 11.75)),  # a rest of the division is cut off
    ],
)
def test_region_of_interest_and_binning(
    offset: Any, window: Any, binning: Any, size: tuple[int, int], values: Any, source: str
) -> None:
    """As image_geometry: the offset first, then the division."""
    info = reduced_info(offset, window, binning)
    if source == "k":
        info.k[4] = 61.0
        info.p = [0.0] * 12
    optics = intrinsics(info, *size)
    assert (optics.width, optics.height) == size and optics.warning == ""
    assert (optics.fx, optics.fy, optics.cx, optics.cy) == values


@pytest.mark.parametrize(
    ("offset", "window", "binning", "values"),
    [
        ((0, 0), (0, 0), (2, 2), (30.0, 30.5, 15.75, 11.75)),
        ((8, 4), (32, 24), (0, 0), (60.0, 61.0, 23.5, 19.5)),
        ((8, 4), (64, 48), (0, 0), (60.0, 61.0, 23.5, 19.5)),  # the size of the image given as the full one
        ((8, 4), (0, 0), (1, 1), (60.0, 61.0, 23.5, 19.5)),
    ],
)
def test_where_drivers_disagree_a_warning_says_so(offset: Any, window: Any, binning: Any, values: Any) -> None:
    info = reduced_info(offset, window, binning)
    info.d = [0.1]
    optics = intrinsics(info, 64, 48)
    assert (optics.fx, optics.fy, optics.cx, optics.cy) == values
    assert optics.warning.startswith("camera_info.roi, binning: the image has the full 64 x 48 pixels though")


@pytest.mark.parametrize(
    ("offset", "window", "binning", "size"),
    [
        ((0, 0), (0, 0), (2, 2), (64, 24)),
        ((8, 4), (32, 24), (2, 2), (32, 24)),  # binning was not done
        ((8, 4), (32, 24), (2, 2), (32, 12)),
        ((0, 0), (32, 24), (2, 2), (32, 24)),
        ((60, 4), (32, 24), (1, 1), (32, 24)),  # beyond the sensor
        ((8, 4), (0, 24), (1, 1), (64, 24)),
        ((0, 0), (0, 0), (100, 100), (1, 1)),
    ],
)
def test_sizes_that_do_not_fit_are_refused(offset: Any, window: Any, binning: Any, size: tuple[int, int]) -> None:
    with pytest.raises(MessageError, match=r"^camera_info\.width, height: the image has .* camera_info says 64 x 48"):
        intrinsics(reduced_info(offset, window, binning), *size)


def test_an_offset_far_away_is_refused() -> None:
    with pytest.raises(MessageError, match=r"^camera_info\.p: expected fx, fy"):
        intrinsics(reduced_info((2**32 - 1, 0), (64, 48), (1, 1)), 64, 48)


def test_content_of_camera_info_is_all_but_its_stamp() -> None:
    first = info_msg(64, 48, 1)
    assert info_content(first) == info_content(info_msg(64, 48, 2))
    first.d[0] = first.p[3] = float("nan")
    again = info_msg(64, 48, 2)
    again.d[0] = again.p[3] = float("nan")
    assert info_content(first) == info_content(again)
    for name, value in {
        "width": 65, "height": 47, "distortion_model": "x", "d": [0.0], "k": [1.0] * 9, "r": [1.0] * 9,
        "p": [1.0] * 12, "binning_x": 1, "binning_y": 1,
    }.items():  # fmt: skip
        other = info_msg(64, 48, 1)
        setattr(other, name, value)
        assert info_content(other) != info_content(info_msg(64, 48, 1)), name
    for name in ("x_offset", "y_offset", "width", "height", "do_rectify"):
        other = info_msg(64, 48, 1)
        setattr(other.roi, name, True if name == "do_rectify" else 1)
        assert info_content(other) != info_content(info_msg(64, 48, 1)), name
    assert info_content(info_msg(64, 48, 1, frame="b")) != info_content(info_msg(64, 48, 1, frame="c"))


@pytest.mark.parametrize("frame", ["map", "/map"])
def test_a_leading_slash_of_a_pose(frame: str) -> None:
    msg = PoseStamped()
    msg.header.frame_id = frame
    assert camera_pose(msg, "map")[0] == 0


def test_without_p_and_k_the_camera_is_uncalibrated() -> None:
    info = info_msg(64, 48, 0)
    info.k[0] = info.p[0] = 0.0
    with pytest.raises(MessageError, match=r"^camera_info\.p, k: P\[0\] and K\[0\] are 0, the camera is uncalibrated"):
        intrinsics(info, 64, 48)


@pytest.mark.parametrize(
    ("field", "values", "message"),
    [
        ("p", {0: float("nan")}, "camera_info.p: expected fx, fy from 0.001"),
        ("p", {5: 0.0}, "camera_info.p: expected fx, fy from 0.001"),
        ("p", {0: -60.0}, "camera_info.p"),
        ("p", {2: float("inf")}, "camera_info.p"),
    ],
)
def test_bad_camera_info_is_refused(field: str, values: dict[int, float], message: str) -> None:
    info = info_msg(64, 48, 0)
    matrix = getattr(info, field).copy()
    for index, value in values.items():
        matrix[index] = value
    setattr(info, field, matrix)
    with pytest.raises(MessageError, match=message):
        intrinsics(info, 64, 48)


def test_camera_info_of_another_size_is_refused() -> None:
    with pytest.raises(MessageError, match="the image has 32 x 48 pixels, camera_info says 64 x 48"):
        intrinsics(info_msg(64, 48, 0), 32, 48)


def test_rigid_is_a_rotation() -> None:
    half = np.sqrt(0.5)
    turned = rigid((1, 2, 3), (0, 0, half, half), "pose")
    np.testing.assert_allclose(turned @ [1, 0, 0, 1], [1, 3, 3, 1], atol=1e-15)
    loose = rigid((0, 0, 0), 0.995 * np.array([0.1, -0.5, 0.5, 0.7]), "pose")
    np.testing.assert_allclose(loose[:3, :3] @ loose[:3, :3].T, np.eye(3), atol=1e-14)
    np.testing.assert_array_equal(rigid((0, 0, 0), (0, 0, 0, 1), "pose"), np.eye(4))


@pytest.mark.parametrize("quaternion", [(0, 0, 0, 0), (0, 0, 0, 2), (0, 0, np.nan, 1), (1, 1, 1, 1)])
def test_no_unit_quaternion_is_refused(quaternion: tuple[float, ...]) -> None:
    pose = Pose()
    pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w = (float(v) for v in quaternion)
    with pytest.raises(MessageError, match="^pose: expected"):
        pose_matrix(pose, "pose")


def test_mask_image_keeps_the_header() -> None:
    depth = image_msg(np.ones((3, 5), np.float32), 12_345_678_901, "optical")
    mask = np.arange(30, dtype=np.uint8).reshape(3, 10)[:, ::2]
    msg = mask_image(mask, depth)
    assert msg.header == depth.header
    assert (msg.encoding, msg.height, msg.width, msg.step, msg.is_bigendian) == ("mono8", 3, 5, 5, 0)
    assert bytes(msg.data) == mask.tobytes()


@pytest.mark.parametrize(
    ("encoding", "pixels", "step"),
    [("rgb8", np.arange(36, dtype=np.uint8).reshape(3, 4, 3), 12), ("16UC1", np.full((2, 5), 0x0102, np.uint16), 10)],
)
def test_images_of_other_encodings(encoding: str, pixels: np.ndarray, step: int) -> None:
    msg = image_message(pixels, encoding, image_msg(np.ones((9, 9), np.float32), 1))
    again = deserialize_message(serialize_message(msg), Image)
    assert again == msg and (again.encoding, again.step) == (encoding, step)
    assert (again.height, again.width) == pixels.shape[:2] and again.is_bigendian == (sys.byteorder == "big")
    assert bytes(again.data) == pixels.tobytes()


def test_camera_pose_must_be_in_the_fixed_frame() -> None:
    msg = PoseStamped()
    msg.header.frame_id, msg.header.stamp.sec, msg.pose.position.x = "map", 2, 3.0
    for fixed in ("map", ""):
        stamp, pose = camera_pose(msg, fixed)
        assert stamp == 2_000_000_000 and pose[:3, 3].tolist() == [3.0, 0.0, 0.0]
    with pytest.raises(MessageError, match="header.frame_id: expected fixed_frame 'odom', got 'map'"):
        camera_pose(msg, "odom")
    msg.header.frame_id = ""
    assert camera_pose(msg, "odom")[0] == 2_000_000_000


@pytest.mark.parametrize("triangles", [0, 1, 2, 3])
def test_raw_mesh_agrees_with_the_message_of_ros(triangles: int) -> None:
    vertices, corners = plate()[0], np.array([(0, 1, 2), (0, 2, 3), (3, 2, 1)])[:triangles]
    msg = Mesh()
    msg.vertices = [Point(x=float(x), y=float(y), z=float(z)) for x, y, z in vertices]
    msg.triangles = [MeshTriangle(vertex_indices=row.astype(np.uint32)) for row in corners]
    parsed = parse_mesh(serialize_message(msg), 10)
    np.testing.assert_array_equal(parsed.vertices, vertices)
    np.testing.assert_array_equal(parsed.triangles, corners)
    assert deserialize_message(encode_mesh(vertices, corners), Mesh) == msg
