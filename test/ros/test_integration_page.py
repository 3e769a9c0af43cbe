# SPDX-License-Identifier: Apache-2.0
"""The converters on the page docs/integration.md do what the page says they do."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
from sensor_msgs.msg import Image, PointCloud2
from shape_msgs.msg import Mesh
from std_msgs.msg import Header

from shadow_tracer.ros.cdr_markers import parse_markers
from shadow_tracer.ros.clouds import cloud_points, visibility_cloud
from shadow_tracer.ros.markers import marker_changes

PAGE = Path(__file__).resolve().parents[2] / "docs" / "integration.md"


@pytest.fixture(autouse=True)
def context() -> Iterator[None]:
    """rclpy's default context, in which the page makes its nodes."""
    rclpy.init()
    yield
    rclpy.try_shutdown()


def block_with(word: str) -> str:
    """The only block of Python on the page that contains a word."""
    blocks = re.findall(r"^```python ros\n((?:.*\n)*?)```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    (found,) = [block for block in blocks if word in block]
    return found


def node_of(name: str) -> tuple[Any, list[Any]]:
    """A node that the page defines, and the list of what it publishes."""
    names: dict[str, Any] = {"__name__": "page"}
    exec(compile(block_with(f"class {name}("), "integration.md", "exec"), names)
    node, sent = names[name](), []
    for attribute in ("cloud", "out", "ask"):
        if hasattr(node, attribute):
            setattr(node, attribute, SimpleNamespace(publish=sent.append))
    return node, sent


def nvblox(clear: bool, blocks: dict[int, list[tuple[float, float, float]]]) -> Any:
    """What nvblox_msgs/Mesh holds: a block for each number, its corners in the order of its triangles."""
    return SimpleNamespace(
        header=Header(frame_id="odom"),
        clear=clear,
        block_indices=[SimpleNamespace(x=number, y=0, z=0) for number in blocks],
        blocks=[
            SimpleNamespace(
                vertices=[SimpleNamespace(x=x, y=y, z=z) for x, y, z in reversed(corners)],
                triangles=list(reversed(range(len(corners)))),
            )
            for corners in blocks.values()
        ],
    )


def test_blocks_of_nvblox_become_one_cloud(monkeypatch: pytest.MonkeyPatch) -> None:
    package, messages = ModuleType("nvblox_msgs"), ModuleType("nvblox_msgs.msg")
    messages.Mesh = Mesh  # type: ignore[attr-defined]  # any type that there is, for the subscription
    monkeypatch.setitem(sys.modules, "nvblox_msgs", package)
    monkeypatch.setitem(sys.modules, "nvblox_msgs.msg", messages)
    node, sent = node_of("NvbloxMesh")
    one, two = [(0.0, 0.0, 1.0), (1.0, 0.0, 1.0), (0.0, 1.0, 1.0)], [(0.0, 0.0, 2.0), (1.0, 0.0, 2.0), (0.0, 1.0, 2.0)]
    for message, expected in (
        (nvblox(False, {1: one}), one),
        (nvblox(False, {2: two}), one + two),
        (nvblox(False, {1: []}), two),
        (nvblox(True, {3: one + two}), one + two),
        (nvblox(True, {}), []),
    ):
        node.on_mesh(message)
        assert sent[-1].header.frame_id == "odom"
        assert cloud_points(sent[-1]).tolist() == [list(point) for point in expected]
    node.destroy_node()


def test_links_of_a_robot_become_markers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("trimesh", reason="needs trimesh: pip install 'shadow_tracer[mesh]'").creation.box().export(
        tmp_path / "arm.stl"
    )
    code = block_with("robot_meshes").replace("package://my_robot/meshes/upper_arm.stl", str(tmp_path / "arm.stl"))
    sent: list[bytes] = []
    monkeypatch.setattr(rclpy, "init", lambda: None)
    monkeypatch.setattr(rclpy, "spin", lambda node: node.destroy_node())
    monkeypatch.setattr("rclpy.publisher.Publisher.publish", lambda _publisher, data: sent.append(data))
    exec(compile(code, "integration.md", "exec"), {"__name__": "page"})
    (part,) = marker_changes(parse_markers(sent[-1], 100), {}, 0, "mesh_markers").put
    assert (len(part.triangles), part.frame, part.locked) == (12, "upper_arm_link", True)


@pytest.mark.parametrize(("encoding", "kind", "nothing"), [("16UC1", np.uint16, 0), ("32FC1", np.float32, np.nan)])
def test_depth_in_shadow_is_kept(encoding: str, kind: type, nothing: float) -> None:
    node, sent = node_of("ShadowedDepth")
    header = Header(frame_id="camera")
    header.stamp.sec = 7
    depth = np.arange(1, 13, dtype=kind).reshape(3, 4)
    image = Image(header=header, height=3, width=4, encoding=encoding, step=4 * depth.itemsize)
    image.data.frombytes(depth.tobytes())
    mask = np.array([[0, 255, 128, 0]] * 3, np.uint8)
    answer = Image(header=header, height=3, width=4, encoding="mono8", step=4)
    answer.data.frombytes(mask.tobytes())
    node.on_mask(answer)
    assert not sent, "no depth image has come with this stamp"
    node.on_depth(image)
    node.on_mask(answer)
    kept = np.frombuffer(sent[-1].data, kind).reshape(3, 4)
    np.testing.assert_array_equal(kept, np.where(mask == 0, depth, np.array(nothing, kind)))
    assert (sent[-1].header, sent[-1].encoding, sent[-1].step) == (header, encoding, image.step)
    node.destroy_node()


def test_shadow_on_the_ground_becomes_a_grid() -> None:
    node, sent = node_of("ShadowMap")
    node.on_timer()
    asked: PointCloud2 = sent.pop()
    points = cloud_points(asked)
    assert asked.header.frame_id == "map" and len(points) == asked.height * asked.width
    lit = np.where(points[:, 0] > 0.0, np.uint32(4), np.uint32(0))
    known = points[:, 1] > -9.0
    node.on_answer(visibility_cloud(asked, points, lit, known))
    grid = sent.pop()
    cells = np.array(grid.data).reshape(grid.info.height, grid.info.width)
    for row, column in ((5, 5), (50, 20), (50, 150)):
        x = grid.info.origin.position.x + (column + 0.5) * grid.info.resolution
        y = grid.info.origin.position.y + (row + 0.5) * grid.info.resolution
        assert cells[row, column] == (-1 if y < -9.0 else 0 if x > 0.0 else 60)
    node.destroy_node()
