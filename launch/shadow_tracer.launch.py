# SPDX-License-Identifier: Apache-2.0
r"""Starts the node. `ros2 launch shadow_tracer shadow_tracer.launch.py --show-args` lists the arguments.

    ros2 launch shadow_tracer shadow_tracer.launch.py params_file:=rover_sun.yaml \
        depth_image:=/camera/depth/image_rect mesh:=/terrain rviz:=true
"""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import Action, LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.events import matches_action
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from lifecycle_msgs.msg import Transition

PACKAGE = "shadow_tracer"
# Beside the folder of this file, in the source tree as where it is installed.
CONFIG = Path(__file__).parents[1] / "config"
YES_NO = ["true", "false"]

ARGUMENTS = [
    DeclareLaunchArgument(
        "params_file",
        default_value="",
        description="Parameter file: a path, or a name in the package's folder config such as rover_sun.yaml. Empty: "
        "the defaults, as in default.yaml.",
    ),
    DeclareLaunchArgument("namespace", default_value="", description="Namespace of the node, and of RViz."),
    DeclareLaunchArgument("name", default_value=PACKAGE, description="Name of the node."),
    DeclareLaunchArgument("depth_image", default_value="depth/image_rect", description="Topic of the depth image."),
    DeclareLaunchArgument(
        "camera_info",
        default_value="",
        description="Topic of its camera_info. Empty: camera_info beside depth_image.",
    ),
    DeclareLaunchArgument("mesh", default_value="mesh", description="Topic of the mesh, shape_msgs/Mesh."),
    DeclareLaunchArgument(
        "large_images",
        default_value="false",
        choices=YES_NO,
        description="Give the node 64 MB of shared memory for its masks (Fast DDS). A camera driver that publishes "
        "best effort needs the same file, config/fastdds_large_images.xml, in its own environment.",
    ),
    DeclareLaunchArgument(
        "lifecycle", default_value="false", choices=YES_NO, description="Start the managed node instead."
    ),
    DeclareLaunchArgument(
        "autostart",
        default_value="true",
        choices=YES_NO,
        description="Configure and activate the managed node. false: it waits for `ros2 lifecycle set`.",
    ),
    DeclareLaunchArgument(
        "rviz", default_value="false", choices=YES_NO, description="Start RViz with config/shadow_tracer.rviz."
    ),
    DeclareLaunchArgument(
        "rviz_frame",
        default_value="map",
        description="Fixed frame of RViz: the node's fixed_frame, or the optical frame if that is empty.",
    ),
    DeclareLaunchArgument(
        "log_level",
        default_value="info",
        choices=["debug", "info", "warn", "error", "fatal"],
        description="Least severity that is logged.",
    ),
    DeclareLaunchArgument(
        "use_sim_time", default_value="false", choices=YES_NO, description="Take the time from /clock."
    ),
]


def parameter_file(wanted: str) -> str:
    """Path of a parameter file that is given by path or by a name in ``config``.

    Raises:
        FileNotFoundError: there is none.
    """
    for path in (Path(wanted).expanduser(), CONFIG / wanted, CONFIG / f"{wanted}.yaml"):
        if path.is_file():
            return str(path)
    known = ", ".join(sorted(path.name for path in CONFIG.glob("*.yaml")))
    raise FileNotFoundError(f"params_file: expected a path, or one of {known} (in {CONFIG}), got {wanted!r}")


def remappings(values: dict[str, str]) -> list[tuple[str, str]]:
    """Names in the node and the topics that take their place; only those that differ."""
    image = values["depth_image"]
    info = values["camera_info"] or "/".join([*image.split("/")[:-1], "camera_info"])
    wanted = {"depth/image_rect": image, "depth/camera_info": info, "mesh": values["mesh"]}
    return [(name, topic) for name, topic in wanted.items() if name != topic]


def check_rviz() -> None:
    """RViz is there: a launch that fails at it would leave the node that it has started before.

    Raises:
        RuntimeError: it is not installed.
    """
    try:
        get_package_prefix("rviz2")
    except PackageNotFoundError as error:
        raise RuntimeError(
            "rviz:=true: the package rviz2 is not installed: `sudo apt install ros-jazzy-rviz2`, or leave rviz out"
        ) from error


def managed_node(autostart: bool, common: dict[str, Any]) -> list[Action]:
    """The managed node and what brings it up. launch_ros before 0.26.7 (April 2025) has no keyword for that."""
    common = {**common, "executable": "shadow_lifecycle_node"}
    if not autostart:
        return [LifecycleNode(**common)]
    if "autostart" in inspect.signature(LifecycleNode.__init__).parameters:
        return [LifecycleNode(autostart=True, **common)]
    node = LifecycleNode(**common)

    def change(transition: int) -> Action:
        return EmitEvent(event=ChangeState(lifecycle_node_matcher=matches_action(node), transition_id=transition))

    activate = OnStateTransition(
        target_lifecycle_node=node,
        start_state="configuring",
        goal_state="inactive",
        entities=[change(Transition.TRANSITION_ACTIVATE)],
    )
    return [RegisterEventHandler(activate), node, change(Transition.TRANSITION_CONFIGURE)]


def start(context: LaunchContext) -> list[Action]:
    """The node and, if wanted, RViz, with the arguments as they came."""
    values = {argument.name: LaunchConfiguration(argument.name).perform(context) for argument in ARGUMENTS}
    yes = {name for name, value in values.items() if value == "true"}
    clock = [{"use_sim_time": True}] if "use_sim_time" in yes else []
    common = {
        "package": PACKAGE,
        "name": values["name"],
        "namespace": values["namespace"],
        "parameters": [*([parameter_file(values["params_file"])] if values["params_file"] else []), *clock],
        "remappings": remappings(values),
        "ros_arguments": ["--log-level", values["log_level"]],
        "output": "screen",
    }
    if "large_images" in yes:
        common["additional_env"] = {"FASTRTPS_DEFAULT_PROFILES_FILE": str(CONFIG / "fastdds_large_images.xml")}
    if "rviz" in yes:
        check_rviz()
    if "lifecycle" in yes:
        actions = managed_node("autostart" in yes, common)
    else:
        actions = [Node(executable="shadow_node", **common)]
    if "rviz" not in yes:
        return actions
    topics = ("mask", "overlay", "camera_info", "scene_markers", "light_markers")
    own = [(f"{PACKAGE}/{topic}", f"{values['name']}/{topic}") for topic in topics]
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        namespace=values["namespace"],
        arguments=["-d", str(CONFIG / "shadow_tracer.rviz"), "-f", values["rviz_frame"]],
        parameters=clock,
        remappings=[*common["remappings"], *(own if values["name"] != PACKAGE else [])],
    )
    return [*actions, rviz]


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` asks for."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=start)])
