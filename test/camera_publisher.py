# SPDX-License-Identifier: Apache-2.0
"""A camera as a program: publishes a wall on the topics of its name until it is killed."""

from __future__ import annotations

import sys
import time

import rclpy
from sensor_msgs.msg import CameraInfo, Image

from shadow_tracer.testing import image_msg, info_msg, reliable, wall

RATE = 20.0  # Hz


def main(name: str) -> None:
    """Publish for ever."""
    rclpy.init(args=[])
    node = rclpy.create_node(f"camera_{name}")
    depth = node.create_publisher(Image, f"/{name}/depth/image_rect", reliable())
    info = node.create_publisher(CameraInfo, f"/{name}/depth/camera_info", reliable())
    image = wall()
    while True:
        stamp = time.time_ns()
        info.publish(info_msg(image.shape[1], image.shape[0], stamp))
        depth.publish(image_msg(image, stamp))
        time.sleep(1.0 / RATE)


if __name__ == "__main__":
    main(sys.argv[1])
