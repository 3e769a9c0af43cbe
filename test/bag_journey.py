# SPDX-License-Identifier: Apache-2.0
"""A short recording with every kind of input, for tests of what recordings are kept in."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from bag_maker import BagMaker, cloud, image, info, pixels, pose, read, transform
from rosbags.rosbag2 import StoragePlugin

from shadow_tracer.apps import cli
from shadow_tracer.ros.wire.cdr import encode_mesh
from shadow_tracer.ros.wire.cdr_markers import MarkerMessage, encode_marker, encode_markers

W, H, FOCAL = 48, 36, 45.0
SECOND = 10**9
DEPTH, INFO, MESH = "/depth/image_rect", "/depth/camera_info", "shape_msgs/msg/Mesh"
MARKER, MARKERS = "visualization_msgs/msg/Marker", "visualization_msgs/msg/MarkerArray"
IMAGE = "sensor_msgs/msg/Image"
FRAMES = 4
FORWARD = (0.0, -(0.5**0.5), 0.0, 0.5**0.5)
OPTIONS = [
    *("--no-timing", "--param", "device:=cpu", "--param", "fixed_frame:=odom", "--param", "lights.spot.type:=spot"),
    *("--param", "bounds.max_triangles:=4096", "--param", "bounds.max_rays:=4096"),
    *("--param", "light_names:=[lamp, spot]"),
    *("--param", "lights.lamp.position:=[0.4, -0.7, 0.3]", "--param", "lights.spot.outer_angle:=0.3"),
]
MCAP, SQLITE = StoragePlugin.MCAP, StoragePlugin.SQLITE3


def depth_at(k: int) -> np.ndarray:
    """(H, W) millimetres."""
    return np.random.default_rng(k).integers(1900, 2100, (H, W)).astype(np.uint16)


def corners(x: float) -> np.ndarray:
    return np.array([(x, -0.2, 0.8), (x + 0.3, 0.2, 0.8), (x - 0.3, 0.2, 0.8)])


def journey(depth: Callable[[BagMaker, int], None] | None = None) -> BagMaker:
    """Every kind of input. A frame takes seven messages, of which the depth image is the last."""
    made = BagMaker()
    made.add("/tf_static", transform("base", "camera", 0, (0.0, 0.125, 0.0)))
    made.add("/tf", transform("odom", "base", 0, (-0.5, 0.0, 0.0)))
    for k in range(FRAMES):
        stamp = 100 * SECOND + k * SECOND // 8
        made.add("/tf", transform("odom", "base", stamp, (0.03 * k, 0.0, 0.0)))
        made.raw("/mesh", MESH, encode_mesh(corners(0.1 * k), [(0, 1, 2)]))
        lower, higher = (corners(-0.1 * k) + (0.0, shift, 0.1) for shift in (0.3, -0.3))
        made.raw("/mesh_marker", MARKER, encode_marker(MarkerMessage(ns="one", frame="odom", points=lower)))
        several = [MarkerMessage(ns="two", id=n, frame="odom", points=higher + 0.02 * n) for n in range(2)]
        made.raw("/mesh_markers", MARKERS, encode_markers(several))
        made.add("/mesh_cloud", cloud(np.float32(corners(0.6)), stamp, "odom"))
        made.add("/shadow_tracer/lights/spot/pose", pose(stamp, "camera", (0.3, 0.0, 0.0), FORWARD))
        made.add(INFO, info(W, H, stamp, FOCAL))
        if depth:
            depth(made, k)
        else:
            made.add(DEPTH, image(depth_at(k), stamp))
    return made


def run(bag: Path, output: Path, *options: str, expect: int = 0) -> list[np.ndarray]:
    """Masks of both lights, frame by frame, of the program on a bag."""
    assert cli.main(["bag", str(bag), str(output), *OPTIONS, *options]) == expect
    found = read(output) if expect != 1 else {}
    return [pixels(m) for name in ("lamp", "spot") for m in found.get(f"/shadow_tracer/mask/{name}", [])]


def same(masks: list[np.ndarray], expected: list[np.ndarray]) -> bool:
    return len(masks) == len(expected) and all(map(np.array_equal, masks, expected))


def log_of(file: Path) -> list[tuple[str, int, bytes]]:
    """Topic, time and bytes of all messages."""
    from rosbags.highlevel import AnyReader

    with AnyReader([file]) as reader:
        return [(connection.topic, time, bytes(data)) for connection, time, data in reader.messages()]
