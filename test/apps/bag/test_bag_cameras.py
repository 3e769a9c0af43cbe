# SPDX-License-Identifier: Apache-2.0
"""A recording of several cameras, with the parameters of the node that answers all of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bag_journey import FOCAL, MESH, SECOND, corners, log_of
from bag_maker import BagMaker, image, info, transform
from bags_runs import PARAMETERS, given

from shadow_tracer.apps import cli
from shadow_tracer.ros.wire.cdr import encode_mesh

W, H = 10, 8
CAMERAS = PARAMETERS | {
    "camera_names": ["front", "rear"], "cameras.rear.depth_topic": "/back/depth/image_rect",
    "cameras.rear.bias.constant": 0.25, "cameras.rear.frame": "rear",
}  # fmt: skip


def recording(path: Path) -> Path:
    made = BagMaker()
    for name, x in (("front", 0.0), ("rear", 0.1)):
        made.add("/tf_static", transform("odom", name, 0, (x, 0.0, 0.0)))
    made.raw("/mesh", MESH, encode_mesh(corners(0.1) + (0.0, -0.3, 0.0), [(0, 1, 2)]))
    for k in range(4):
        for name, topic in (("front", "front"), ("rear", "back")):
            stamp = 100 * SECOND + k * SECOND // 8 + (name == "rear")
            made.add(f"/{topic}/depth/camera_info", info(W, H, stamp, FOCAL / 4, name))
            depth = np.random.default_rng(k).integers(1900, 2100, (H, W)).astype(np.uint16)
            made.add(f"/{topic}/depth/image_rect", image(depth, stamp, name))
    return made.write(path)


@pytest.mark.parametrize(("camera", "topic", "bias"), [("front", "front", 0.0), ("rear", "back", 0.25)])
def test_one_of_several_cameras_is_answered_as_if_it_were_alone(
    tmp_path: Path, camera: str, topic: str, bias: float
) -> None:
    """What differs is where its answers stand."""
    bag, options = recording(tmp_path / "in"), ["--no-timing", "--overlay", "--visibility"]
    alone = PARAMETERS | {"bias.constant": bias} if bias else PARAMETERS
    remaps = [word for name in ("image_rect", "camera_info")
              for word in ("--remap", f"depth/{name}:=/{topic}/depth/{name}")]  # fmt: skip
    one, other, jobs = tmp_path / "one", tmp_path / "other.mcap", tmp_path / "jobs"
    assert cli.main(["bag", str(bag), str(one), *options, *given(CAMERAS), "--camera", camera]) == 0
    assert cli.main(["bag", str(bag), str(other), *options, *given(alone), *remaps]) == 0
    found = log_of(one)
    expected = [(name.replace("/shadow_tracer/", f"/shadow_tracer/{camera}/"), *rest) for name, *rest in log_of(other)]
    assert found == expected and {name for name, *_ in found} >= {
        f"/shadow_tracer/{camera}/{name}" for name in ("mask", "mask/lamp", "visibility/spot", "camera_info", "overlay")
    }
    assert cli.main(["bags", "plan", str(bag), str(jobs), *options, *given(CAMERAS), "--camera", camera]) == 0
    assert cli.main(["bags", "status", str(jobs)]) == 3


@pytest.mark.parametrize(
    ("parameters", "camera", "message"),
    [
        (CAMERAS, [], "--camera: expected one of front, rear, cameras of the parameters, got ''"),
        (CAMERAS, ["--camera", "left"], "--camera: expected one of front, rear, cameras of the parameters, got 'left'"),
        (PARAMETERS, ["--camera", "left"], "--camera: expected none, the parameters have no camera_names, got 'left'"),
        (CAMERAS | {"cameras.rear.depth_topic": "/up/depth"}, ["--camera", "rear"],
         "no sensor_msgs/msg/Image on /up/depth; use --remap /up/depth:=... with one of /back/depth/image_rect, "),
    ],
    ids=["none", "another", "nobody", "topic"],
)  # fmt: skip
def test_which_camera_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], parameters: dict, camera: list[str], message: str
) -> None:
    bag, out = recording(tmp_path / "in"), tmp_path / "out"
    assert cli.main(["bag", str(bag), str(out), *given(parameters), *camera]) == 1
    assert message in capsys.readouterr().err and not out.exists()
