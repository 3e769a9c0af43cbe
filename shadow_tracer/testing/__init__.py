# SPDX-License-Identifier: Apache-2.0
"""For tests of what you build around the node: the node itself, without launch, and what talks to it.

See docs/testing.md. Needs ROS 2; pytest is not needed, and any test runner will do.
"""

try:
    import rclpy as _rclpy  # noqa: F401
except ModuleNotFoundError as error:
    if error.name != "rclpy":
        raise
    raise ImportError(
        "shadow_tracer.testing needs rclpy: pip install 'shadow_tracer[ros]', or source an installed ROS 2"
    ) from error

from shadow_tracer.testing.harness import Harness
from shadow_tracer.testing.isolation import isolated
from shadow_tracer.testing.messages import (
    camera_info_msg,
    image_msg,
    info_msg,
    nanoseconds,
    plate,
    pose_msg,
    reliable,
    time_msg,
    wall,
)
from shadow_tracer.testing.process import DEFAULTS, NodeProcess, NotInTime

__all__ = [
    "DEFAULTS",
    "Harness",
    "NodeProcess",
    "NotInTime",
    "camera_info_msg",
    "image_msg",
    "info_msg",
    "isolated",
    "nanoseconds",
    "plate",
    "pose_msg",
    "reliable",
    "time_msg",
    "wall",
]
