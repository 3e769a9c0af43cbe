# SPDX-License-Identifier: Apache-2.0
"""The parameters of a camera, ``cameras.<name>.*``, and what of them must fit together. No ROS here."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from shadow_tracer.ros.parameters.light_parameters import FRAME, FRAME_TEXT
from shadow_tracer.ros.parameters.parameter_rows import (
    DOUBLE,
    DOUBLES,
    NAME,
    NAME_TEXT,
    STRING,
    STRINGS,
    Parameter,
    ParameterError,
    convert,
    convert_names,
)
from shadow_tracer.ros.settings import CameraSettings
from shadow_tracer.scene.bounds import LIMITS

AS_ALL = -1.0  # a bias that is that of all cameras
MOST_CAMERAS = LIMITS["max_sample_sets"]
_NO_CAMERAS = ("lights", "query", "dose")  # under these names the node has other topics
_START = "each camera has buffers and topics from the start; restart the node to change it"
_TOPIC = re.compile(r"(?!.*__)(~?/)?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*|")
_TOPIC_TEXT = 'a topic such as /front/depth/image_rect, or ""'

CAMERA_NAMES = Parameter(
    "camera_names", STRINGS, ("",),
    "Names of several cameras, each with its own group cameras.<name> and its own topics; [''] is one camera without "
    "a name, with the topics depth/image_rect and depth/camera_info.",
    pattern=NAME, pattern_text=f"{NAME_TEXT}, not {', '.join(_NO_CAMERAS)}", read_only=_START,
)  # fmt: skip

CAMERA_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("depth_topic", STRING, "",
              "Topic of its depth image; empty is <name>/depth/image_rect.",
              pattern=_TOPIC, pattern_text=_TOPIC_TEXT, read_only=_START),
    Parameter("info_topic", STRING, "",
              "Topic of its camera_info; empty is camera_info beside depth_topic.",
              pattern=_TOPIC, pattern_text=_TOPIC_TEXT, read_only=_START),
    Parameter("pose_topic", STRING, "",
              "Topic of its poses, where pose_source is topic; empty is <name>/camera_pose.",
              pattern=_TOPIC, pattern_text=_TOPIC_TEXT, read_only=_START),
    Parameter("transport", STRING, "raw",
              "As depth_image_transport, which is that of a camera without a name.",
              allowed=("raw", "compressedDepth")),
    Parameter("frame", STRING, "",
              "Its optical frame, where the header of the depth image names another one or none; empty is that of the "
              "header.", pattern=FRAME, pattern_text=FRAME_TEXT),
    Parameter("pose", DOUBLES, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
              "Pose of the optical frame, x y z [m] qx qy qz qw, used when pose_source is parameter.", length=7),
    Parameter("rate", DOUBLE, 0.0,
              "Most of its images in a second that are answered; others are left unread. 0 is all.", "Hz", 0.0, 1000.0),
    Parameter("bias.constant", DOUBLE, AS_ALL,
              "Bias of this camera; -1 is that of the parameter bias.constant.", "m", AS_ALL, 1.0),
    Parameter("bias.quadratic", DOUBLE, AS_ALL,
              "The same for bias.quadratic.", "1/m", AS_ALL, 0.1),
    Parameter("bias.normal", DOUBLE, AS_ALL,
              "The same for bias.normal.", low=AS_ALL, high=2.0),
)  # fmt: skip


def camera_names(values: Mapping[str, Any]) -> tuple[str, ...]:
    """The names in the parameter ``camera_names``; none is one camera without a name.

    Raises:
        ParameterError: not a list of valid, different names, or too long a one.
    """
    given = values.get("camera_names", CAMERA_NAMES.default)
    names = convert_names("camera_names", CAMERA_NAMES, given, _NO_CAMERAS)
    if len(names) > MOST_CAMERAS:
        raise ParameterError(f"camera_names: expected at most {MOST_CAMERAS} names, got {len(names)}")
    return names


def cameras_from(values: Mapping[str, Any], checked: Mapping[str, Any]) -> tuple[CameraSettings, ...]:
    """The cameras that have names.

    Args:
        values: full parameter name -> value.
        checked: the values of those that belong to no group.

    Raises:
        ParameterError: the first fault found.
    """
    cameras = tuple(_camera_from(name, values, checked) for name in camera_names(values))
    if len(cameras) > 1 and checked["pose_source"] == "tf" and not checked["fixed_frame"]:
        raise ParameterError(
            f"fixed_frame: expected the frame in which the cameras {', '.join(each.name for each in cameras)} and the "
            "lights are, got ''"
        )
    topics: dict[str, str] = {}
    for camera in cameras:
        other = topics.setdefault(camera.depth_topic, camera.name)
        if other != camera.name:
            raise ParameterError(
                f"cameras.{camera.name}.depth_topic: expected another topic than that of camera {other}, got "
                f"{camera.depth_topic!r}"
            )
    return cameras


def check_rotation(name: str, pose: Sequence[float]) -> None:
    """Raise ParameterError unless the last four of seven numbers are a unit quaternion."""
    length = math.sqrt(sum(value * value for value in pose[3:]))
    if not 0.99 <= length <= 1.01:
        raise ParameterError(f"{name}: expected a unit quaternion qx qy qz qw, got one of length {length:.6g}")


def _camera_from(name: str, values: Mapping[str, Any], checked: Mapping[str, Any]) -> CameraSettings:
    group = f"cameras.{name}"
    found = {}
    for row in CAMERA_PARAMETERS:
        full = f"{group}.{row.name}"
        found[row.name] = convert(full, row, values.get(full, row.default))
    for key in ("bias.constant", "bias.quadratic", "bias.normal"):
        if found[key] == AS_ALL:
            found[key] = checked[key]
        elif found[key] < 0.0:
            raise ParameterError(f"{group}.{key}: expected -1 (as {key}) or at least 0, got {found[key]:g}")
    check_rotation(f"{group}.pose", found["pose"])
    depth = found["depth_topic"] or f"{name}/depth/image_rect"
    found["depth_topic"] = depth
    found["info_topic"] = found["info_topic"] or "/".join([*depth.split("/")[:-1], "camera_info"])
    found["pose_topic"] = found["pose_topic"] or f"{name}/camera_pose"
    return CameraSettings(name=name, **{key.replace(".", "_"): value for key, value in found.items()})
