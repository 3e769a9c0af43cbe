# SPDX-License-Identifier: Apache-2.0
"""The profile config/fastdds_large_images.xml, tried: images that stock Fast DDS loses arrive."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.utilities import get_rmw_implementation_identifier
from sensor_msgs.msg import Image

PROFILE = Path(__file__).resolve().parents[3] / "config" / "fastdds_large_images.xml"
COUNT = 40  # times 1.2 MB are less than the 64 MB of the segment, so that a subscriber that is late loses nothing

# A camera: 640 x 480 float32, best effort, 20 Hz, as soon as somebody listens. It lives until its stdin is closed.
CAMERA = f"""
import sys, time
import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image

rclpy.init()
node = rclpy.create_node("camera")
publisher = node.create_publisher(Image, "image", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
image = Image(height=480, width=640, step=2560, encoding="32FC1")
image.data.frombytes(bytes(480 * 2560))
deadline = time.monotonic() + 60.0
while not publisher.get_subscription_count() and time.monotonic() < deadline:
    rclpy.spin_once(node, timeout_sec=0.02)
for number in range({COUNT}):
    image.header.stamp.sec = number
    publisher.publish(image)
    time.sleep(0.05)
print("sent", flush=True)
sys.stdin.read()
node.destroy_node()
rclpy.shutdown()
"""


@pytest.fixture
def listener() -> Iterator[tuple[SingleThreadedExecutor, list[int], Node]]:
    """A subscriber in a context of its own, with the stock settings: only the publisher's matter."""
    context = Context()
    rclpy.init(context=context, args=[])
    node, executor = Node("listener", context=context), SingleThreadedExecutor(context=context)
    executor.add_node(node)
    stamps: list[int] = []
    qos = QoSProfile(depth=COUNT, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(Image, "image", lambda msg: stamps.append(msg.header.stamp.sec), qos)
    yield executor, stamps, node
    executor.shutdown(timeout_sec=0.0)
    node.destroy_node()
    rclpy.try_shutdown(context=context)


@pytest.mark.slow
@pytest.mark.skipif(
    get_rmw_implementation_identifier() != "rmw_fastrtps_cpp", reason="the profile is for Fast DDS, this is another RMW"
)
@pytest.mark.skipif(
    os.statvfs("/dev/shm").f_bavail * os.statvfs("/dev/shm").f_frsize < 80 * 2**20,
    reason="needs 80 MB of free shared memory in /dev/shm",
)
def test_with_the_profile_large_best_effort_images_arrive(
    listener: tuple[SingleThreadedExecutor, list[int], Node],
) -> None:
    executor, stamps, _ = listener
    camera = subprocess.Popen(
        [sys.executable, "-c", CAMERA],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "FASTRTPS_DEFAULT_PROFILES_FILE": str(PROFILE)},
    )
    assert camera.stdin is not None and camera.stdout is not None
    try:
        deadline = time.monotonic() + 90.0
        while len(stamps) < COUNT and time.monotonic() < deadline and camera.poll() is None:
            executor.spin_once(timeout_sec=0.02)
            if stamps and time.monotonic() + 20.0 < deadline:
                deadline = time.monotonic() + 20.0  # two seconds of images, on a machine that is busy
        assert len(set(stamps)) == len(stamps) and stamps == sorted(stamps)
        assert len(stamps) >= 0.9 * COUNT, f"{len(stamps)} of {COUNT} images arrived"
        assert camera.stdout.readline() == "sent\n"
        camera.stdin.close()
        assert camera.wait(30.0) == 0
    finally:
        if camera.poll() is None:
            camera.kill()
            camera.wait(10.0)
        camera.stdout.close()
