# SPDX-License-Identifier: Apache-2.0
"""The converters on the pages docs/integration.md and docs/slam.md do what the pages say they do."""

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

from shadow_tracer.ros.wire.cdr_markers import parse_markers
from shadow_tracer.ros.wire.clouds import cloud_points, visibility_cloud
from shadow_tracer.ros.wire.markers import marker_changes

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = (DOCS / "integration.md", DOCS / "slam.md")


@pytest.fixture(autouse=True)
def context() -> Iterator[None]:
    """rclpy's default context, in which the page makes its nodes."""
    rclpy.init()
    yield
    rclpy.try_shutdown()


def block_with(word: str) -> str:
    """The only block of Python on the pages that contains a word."""
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    blocks = re.findall(r"^```python ros\n((?:.*\n)*?)```$", text, re.MULTILINE)
    (found,) = [block for block in blocks if word in block]
    return found


def node_of(name: str) -> tuple[Any, list[Any]]:
    """A node that the page defines, and the list of what it publishes."""
    names: dict[str, Any] = {"__name__": "page"}
    exec(compile(block_with(f"class {name}("), "integration.md", "exec"), names)
    node, sent = names[name](), []
    for attribute in ("cloud", "out", "ask", "blank"):
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


@pytest.mark.parametrize(("encoding", "channels"), [("mono8", 1), ("rgb8", 3)])
def test_what_is_above_127_is_left_out_and_blanked(encoding: str, channels: int) -> None:
    node, sent = node_of("LeaveOut")
    header = Header(frame_id="camera")
    header.stamp.sec = 7
    values = np.array([[0, 1, 127, 128, 255]] * 2, np.uint8)
    mask = Image(header=header, height=2, width=5, encoding="mono8", step=5)
    mask.data.frombytes(values.tobytes())
    node.on_mask(mask)
    out = sent.pop()
    assert not sent, "no image has come with this stamp"
    assert (out.header, out.encoding, out.step, out.height, out.width) == (header, "mono8", 5, 2, 5)
    left_out = np.frombuffer(out.data, np.uint8).reshape(2, 5)
    np.testing.assert_array_equal(left_out, np.where(values > 127, 255, 0))
    pixels = np.random.default_rng(0).integers(0, 256, (2, 5, channels)).astype(np.uint8)
    image = Image(header=header, height=2, width=5, encoding=encoding, step=5 * channels + 2)  # rows with a gap
    image.data.frombytes(np.pad(pixels.reshape(2, -1), ((0, 0), (0, 2))).tobytes())
    node.on_image(image)
    node.on_mask(mask)
    blanked = sent.pop()
    assert (blanked.header, blanked.encoding, blanked.step) == (header, encoding, 5 * channels)
    expected = pixels.copy()
    expected[:, 3:] = pixels[:, :3].reshape(-1, channels).mean(axis=0).round()
    np.testing.assert_array_equal(np.frombuffer(blanked.data, np.uint8).reshape(2, 5, channels), expected)
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
