# SPDX-License-Identifier: Apache-2.0
"""ROS tests stay on this machine, in a domain of their own, and write no log into the home directory."""

from __future__ import annotations

import atexit
import importlib.util
import os
import shutil
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import NoReturn

import pytest

HERE = Path(__file__).parent
WITHOUT_ROS = {
    "test_camera_infos.py",
    "test_cdr.py",
    "test_cdr_markers.py",
    "test_clouds.py",
    "test_compressed_depth.py",
    "test_cure_first.py",
    "test_frame_queue.py",
    "test_grid_map.py",
    "test_installed.py",
    "test_health_inputs.py",
    "test_launch.py",
    "test_mask_shape.py",
    "test_marker_feed.py",
    "test_markers.py",
    "test_mesh_collada.py",
    "test_mesh_damage.py",
    "test_mesh_file_data.py",
    "test_mesh_files.py",
    "test_mesh_formats.py",
    "test_mesh_gltf.py",
    "test_mesh_polygons.py",
    "test_mesh_store.py",
    "test_overlay.py",
    "test_parameters.py",
    "test_sun.py",
    "test_transform_tree.py",
    "test_transport.py",
    "test_turns_and_rates.py",
}
HAS_ROS = all(importlib.util.find_spec(name) for name in ("rclpy", "sensor_msgs", "shape_msgs", "diagnostic_msgs"))

sys.path[:0] = [str(HERE), str(HERE / "node"), str(HERE / "parameters")]  # for tf_double, and what tests share

# All this is read when a context is made, and must be there before rclpy is first imported. Nodes of
# shadow_tracer.testing, and so of Rig, have a domain that no other process holds.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 101)
os.environ["ROS_LOG_DIR"] = tempfile.mkdtemp(prefix="shadow_tracer_ros_log_")
atexit.register(shutil.rmtree, os.environ["ROS_LOG_DIR"], ignore_errors=True)
os.environ.pop("FASTRTPS_DEFAULT_PROFILES_FILE", None)


class NeedsRos(pytest.Module):
    """A module that is not imported, because there is no ROS here."""

    def collect(self) -> NoReturn:
        pytest.skip("needs rclpy and the ROS messages: pip install 'shadow_tracer[ros]'", allow_module_level=True)


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Module | None:
    if HAS_ROS or module_path.name in WITHOUT_ROS:
        return None
    return NeedsRos.from_parent(parent, path=module_path)


def pytest_collection_modifyitems(items: Iterable[pytest.Item]) -> None:
    for item in items:
        if HERE in item.path.parents and item.path.name not in WITHOUT_ROS:
            item.add_marker("ros")
