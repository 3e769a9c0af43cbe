# SPDX-License-Identifier: Apache-2.0
"""The launch file, with a stand-in for launch: its arguments, and what it would start."""

from __future__ import annotations

import ast
import runpy
import signal
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import launch_double
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
FILE = ROOT / "launch" / "shadow_tracer.launch.py"
CONFIG = ROOT / "config"
CONFIGS = sorted(path.name for path in CONFIG.glob("*.yaml"))


@pytest.fixture
def description(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The launch description, made as `ros2 launch` makes it."""
    for name, module in launch_double.modules().items():
        monkeypatch.setitem(sys.modules, name, module)
    return runpy.run_path(str(FILE))["generate_launch_description"]()


def test_the_arguments_and_what_is_said_of_them(description: Any) -> None:
    arguments = [entity for entity in description.entities if isinstance(entity, launch_double.DeclareLaunchArgument)]
    assert [argument.name for argument in arguments] == [
        "params_file",
        "namespace",
        "name",
        "depth_image",
        "camera_info",
        "mesh",
        "large_images",
        "lifecycle",
        "autostart",
        "rviz",
        "rviz_frame",
        "log_level",
        "use_sim_time",
    ]
    assert all(argument.default_value is not None and argument.description for argument in arguments)


def test_without_arguments_it_starts_the_node_as_it_is(description: Any) -> None:
    (node,) = launch_double.run(description)
    assert (node.package, node.executable) == ("shadow_tracer", "shadow_node")
    assert node.command_line() == ["--ros-args", "--log-level", "info", "-r", "__node:=shadow_tracer"]
    assert node.additional_env == {}


def test_everything_reaches_the_command_line(description: Any) -> None:
    (node,) = launch_double.run(
        description,
        params_file="rover_sun.yaml",
        namespace="front",
        name="shadows",
        depth_image="/camera/depth/image_rect",
        mesh="/terrain",
        log_level="debug",
        use_sim_time="true",
    )
    assert node.command_line() == [
        *("--ros-args", "--log-level", "debug", "-r", "__node:=shadows", "-r", "__ns:=/front"),
        *("--params-file", str(CONFIG / "rover_sun.yaml"), "-p", "use_sim_time:=true"),
        *("-r", "depth/image_rect:=/camera/depth/image_rect", "-r", "depth/camera_info:=/camera/depth/camera_info"),
        *("-r", "mesh:=/terrain"),
    ]


@pytest.mark.parametrize(
    ("image", "info", "expected"),
    [
        ("depth/image_rect", "", ()),
        ("depth/image_raw", "", (("depth/image_rect", "depth/image_raw"),)),
        ("image", "", (("depth/image_rect", "image"), ("depth/camera_info", "camera_info"))),
        ("/image", "", (("depth/image_rect", "/image"), ("depth/camera_info", "/camera_info"))),
        ("a/b/c", "", (("depth/image_rect", "a/b/c"), ("depth/camera_info", "a/b/camera_info"))),
        ("depth/image_rect", "/info", (("depth/camera_info", "/info"),)),
    ],
)
def test_camera_info_is_beside_the_image_unless_it_is_named(
    description: Any, image: str, info: str, expected: tuple[tuple[str, str], ...]
) -> None:
    (node,) = launch_double.run(description, depth_image=image, camera_info=info)
    assert tuple(node.remappings) == expected


@pytest.mark.parametrize("name", CONFIGS)
def test_parameter_files_by_name_and_by_path(description: Any, name: str, tmp_path: Path) -> None:
    for wanted in (name, name.removesuffix(".yaml"), str(CONFIG / name)):
        (node,) = launch_double.run(description, params_file=wanted)
        assert node.parameters == [str(CONFIG / name)]
    own = tmp_path / "own.yaml"
    own.write_text("/**: {ros__parameters: {}}\n")
    assert launch_double.run(description, params_file=str(own))[0].parameters == [str(own)]


def test_a_parameter_file_that_is_not_there(description: Any) -> None:
    with pytest.raises(FileNotFoundError, match=r"^params_file: expected .* default\.yaml, .* got 'moon\.yaml'"):
        launch_double.run(description, params_file="moon.yaml")


def test_large_images_names_a_file_that_is_there(description: Any) -> None:
    (node,) = launch_double.run(description, large_images="true")
    profile = Path(node.additional_env["FASTRTPS_DEFAULT_PROFILES_FILE"])
    assert profile == CONFIG / "fastdds_large_images.xml" and profile.is_file()


@pytest.mark.parametrize("autostart", [True, False])
def test_the_managed_node(description: Any, autostart: bool) -> None:
    (node,) = launch_double.run(description, lifecycle="true", autostart=str(autostart).lower(), namespace="front")
    assert isinstance(node, launch_double.LifecycleNode)
    assert (node.executable, node.name, node.namespace) == ("shadow_lifecycle_node", "shadow_tracer", "front")
    assert node.autostart == autostart


@pytest.mark.parametrize("autostart", [True, False])
def test_the_managed_node_with_an_older_launch_ros(monkeypatch: pytest.MonkeyPatch, autostart: bool) -> None:
    """Before 0.26.7: configured once its process is started, activated when it is inactive."""
    for name, module in launch_double.modules(old=True).items():
        monkeypatch.setitem(sys.modules, name, module)
    description = runpy.run_path(str(FILE))["generate_launch_description"]()
    done = launch_double.actions(description, lifecycle="true", autostart=str(autostart).lower())
    done = [a for a in done if not isinstance(a, (launch_double.DeclareLaunchArgument, launch_double.OpaqueFunction))]
    if not autostart:
        assert [type(action) for action in done] == [launch_double.OldLifecycleNode]
        return
    handler, node, configure = done
    assert isinstance(handler, launch_double.RegisterEventHandler) and isinstance(node, launch_double.OldLifecycleNode)
    assert isinstance(configure, launch_double.EmitEvent) and node.executable == "shadow_lifecycle_node"
    assert configure.event.transition_id == 1 and configure.event.lifecycle_node_matcher(node)
    waits = handler.event_handler
    assert waits.target_lifecycle_node is node and (waits.start_state, waits.goal_state) == ("configuring", "inactive")
    (activate,) = waits.entities
    assert isinstance(activate, launch_double.EmitEvent)
    assert activate.event.transition_id == 3 and activate.event.lifecycle_node_matcher(node)


def test_without_rviz_nothing_is_started(description: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A launch that fails at its second process would leave the first one."""
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    started = []
    monkeypatch.setattr(launch_double.Node, "execute", lambda self, _context: started.append(self))
    with pytest.raises(RuntimeError, match=r"^rviz:=true: the package rviz2 is not installed: `sudo apt install"):
        launch_double.run(description, rviz="true")
    assert not started
    launch_double.run(description)
    assert len(started) == 1


@pytest.mark.parametrize(
    ("argument", "value"),
    [("rviz", "yes"), ("large_images", "1"), ("lifecycle", ""), ("log_level", "loud"), ("use_sim_time", "True")],
)
def test_bad_values_are_refused(description: Any, argument: str, value: str) -> None:
    with pytest.raises(RuntimeError, match=f'Argument "{argument}" provided value "{value}" is not valid'):
        launch_double.run(description, **{argument: value})


def test_the_executables_are_among_our_scripts(description: Any) -> None:
    scripts = {path.name for path in (ROOT / "scripts").iterdir()}
    for lifecycle in ("true", "false"):
        assert launch_double.run(description, lifecycle=lifecycle)[0].executable in scripts


@pytest.fixture
def rviz2(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The index of an installation with RViz."""
    index = tmp_path / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "rviz2").touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))


@pytest.mark.usefixtures("rviz2")
def test_rviz_shows_the_topics_of_this_node(description: Any) -> None:
    arguments = {"namespace": "front", "name": "shadows", "depth_image": "/camera/depth/image", "rviz_frame": "odom"}
    _, rviz = launch_double.run(description, rviz="true", use_sim_time="true", **arguments)
    assert (rviz.package, rviz.executable) == ("rviz2", "rviz2")
    assert rviz.arguments == ["-d", str(CONFIG / "shadow_tracer.rviz"), "-f", "odom"]
    line = rviz.command_line()
    assert "__ns:=/front" in line and "use_sim_time:=true" in line
    rules = dict(rviz.remappings)
    assert rules["depth/image_rect"] == "/camera/depth/image" and rules["shadow_tracer/mask"] == "shadows/mask"
    # Every rule whose topic RViz listens to matches it, so all its topics are in the namespace or remapped.
    assert topics_of_rviz() >= set(rules) - {"mesh", "shadow_tracer/camera_info"}


@pytest.mark.usefixtures("rviz2")
def test_rviz_needs_no_rule_for_the_names_of_the_node(description: Any) -> None:
    _, rviz = launch_double.run(description, rviz="true")
    assert rviz.remappings == []


def topics_of_rviz() -> set[str]:
    """Topics of all displays of the RViz configuration."""
    displays = yaml.safe_load((CONFIG / "shadow_tracer.rviz").read_text())["Visualization Manager"]["Displays"]
    named = [value for display in displays for key, value in display.items() if key.endswith(" Topic")]
    return {display["Topic"]["Value"] for display in displays if "Topic" in display} | set(named)


def test_the_configuration_of_rviz() -> None:
    content = yaml.safe_load((CONFIG / "shadow_tracer.rviz").read_text())
    assert {panel["Class"] for panel in content["Panels"]} <= {
        f"rviz_common/{name}" for name in ("Displays", "Views", "Time", "Selection", "Tool Properties")
    }
    manager = content["Visualization Manager"]
    displays = {display["Name"]: display for display in manager["Displays"]}
    kinds = sorted(display["Class"].removeprefix("rviz_default_plugins/") for display in displays.values())
    assert kinds == ["DepthCloud", "Grid", "Image", "Image", "MarkerArray", "MarkerArray", "TF"]
    assert all(display["Enabled"] is display["Value"] is True for display in displays.values())
    assert topics_of_rviz() == {
        *("depth/image_rect", "depth/camera_info"),
        *(f"shadow_tracer/{name}" for name in ("mask", "overlay", "scene_markers", "light_markers")),
    }
    # Windows of displays are found by name.
    for display in displays.values():
        if display["Class"].endswith("/Image"):
            assert content["Window Geometry"][display["Name"]] == {"collapsed": False}
            assert display["Topic"]["Reliability Policy"] == "Reliable"
        if display["Class"].endswith("/MarkerArray"):  # the node keeps its last message
            assert display["Topic"]["Durability Policy"] == "Transient Local"
    assert content["Panels"][-1]["SyncSource"] in displays


def test_the_launch_file_uses_nothing_that_the_stand_in_hides() -> None:
    """Every name it takes from launch is one of the public ones that Jazzy has."""
    public = {name: set(vars(module)) for name, module in launch_double.modules().items()}
    for node in ast.walk(ast.parse(FILE.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("launch"):
            assert {alias.name for alias in node.names} <= public[node.module or ""]


def test_the_profile_of_fast_dds() -> None:
    """Shared memory of 64 MB and UDP in place of the built-in transports, for every participant."""
    space = "{http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles}"
    root = ElementTree.parse(CONFIG / "fastdds_large_images.xml").getroot()
    assert root.tag == f"{space}dds"
    transports = {
        transport.findtext(f"{space}transport_id"): transport for transport in root.iter(f"{space}transport_descriptor")
    }
    kinds = {name: transport.findtext(f"{space}type") for name, transport in transports.items()}
    assert sorted(kinds.values(), key=str) == ["SHM", "UDPv4"]
    shared = next(transport for name, transport in transports.items() if kinds[name] == "SHM")
    assert int(shared.findtext(f"{space}segment_size") or 0) == 64 * 2**20
    (participant,) = root.iter(f"{space}participant")
    assert participant.get("is_default_profile") == "true"
    used = [entry.text for entry in participant.iterfind(f".//{space}userTransports/{space}transport_id")]
    assert sorted(used, key=str) == sorted(kinds, key=str)
    assert participant.findtext(f".//{space}useBuiltinTransports") == "false"


@pytest.mark.slow
def test_the_node_starts_with_what_the_launch_file_gives_it(description: Any) -> None:
    """Its command line and environment, in a process; the log shows name and namespace."""
    pytest.importorskip("rclpy", reason="needs rclpy: pip install 'shadow_tracer[ros]'")
    from node_process import NodeProcess

    (node,) = launch_double.run(
        description, params_file="indoor_lights", namespace="front", name="shadows", large_images="true"
    )
    with NodeProcess(arguments=node.command_line(), environment=node.additional_env) as process:
        process.wait_for("Ready")
        assert any("[front.shadows]" in line for line in process.out)
        assert process.stop(signal.SIGINT) == (0, "")
