# SPDX-License-Identifier: Apache-2.0
"""The program as a process: how it starts, answers over real topics, and ends."""

from __future__ import annotations

import gc
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from harness import NodeProcess, Rig, plate, wall
from node_world import BIAS
from rcl_interfaces.msg import Parameter as ParameterMsg
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import SetParameters
from sensor_msgs.msg import Image

from shadow_tracer import Bounds, Camera, PointLight, ShadowTracer
from shadow_tracer.ros.diagnostics import DEVICE, ERROR, OK, PROCESSING, WARN
from shadow_tracer.ros.node.node import spin

ROOT = Path(__file__).parents[3]
pytestmark = pytest.mark.slow
SIGNALS = pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda s: s.name)


def test_what_is_there_when_frames_begin_is_not_searched_for_garbage() -> None:
    """It would hold up frames; what comes later still is collected."""
    before = gc.get_freeze_count()
    try:
        with Rig(start=False) as rig:
            rig.start(wait=False)
            node = rig.node
            assert node is not None and not node.ready
            rig.executor.remove_node(node)
            assert spin(node, lambda: gc.get_freeze_count() > before) == 0
            assert node.ready and gc.isenabled()
    finally:
        gc.unfreeze()


@SIGNALS
def test_signals_end_it_cleanly(number: signal.Signals) -> None:
    with NodeProcess() as process:
        process.wait_for("Ready: light_grid/packed on cpu")
        assert process.stop(number) == (0, "")


@SIGNALS
def test_signals_during_warm_up_end_it_cleanly_and_soon(number: signal.Signals, tmp_path: Path) -> None:
    """An empty kernel cache: the compiler runs, and cannot be stopped."""
    with NodeProcess(environment={"WARP_CACHE_PATH": str(tmp_path)}) as process, Rig(start=False) as rig:
        status = rig.wait_status(DEVICE, OK, "starting up")
        assert status.name == "shadow_tracer: device"
        rig.wait_status(PROCESSING, OK, "starting up: frames wait")
        assert process.stop(number, timeout=5.0) == (0, "")
        assert not any("Ready" in line for line in process.out)


def test_impatience_changes_nothing() -> None:
    """Signal upon signal, until the process is gone."""
    with NodeProcess() as process:
        process.wait_for("Ready")
        while process.running:
            process.send(signal.SIGINT)
            process.send(signal.SIGTERM)
            time.sleep(0.002)
        assert process.wait() == (0, "")


@SIGNALS
def test_a_signal_before_the_node_is_made_is_not_lost(number: signal.Signals) -> None:
    with NodeProcess() as process:
        status = Path(f"/proc/{process.pid}/status")
        caught = 0
        while not caught & 1 << (number - 1):
            line = next(line for line in status.read_text().splitlines() if line.startswith("SigCgt"))
            caught = int(line.split()[1], 16) if number == signal.SIGTERM else _python_handles(line)
        assert process.stop(number) == (0, "")


def _python_handles(line: str) -> int:
    """SIGINT is caught by Python from the start; ours is in place when SIGTERM is caught as well."""
    mask = int(line.split()[1], 16)
    return mask if mask & 1 << (signal.SIGTERM - 1) else 0


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"device": "cuda:63"}, "the tracer cannot be made: device"),
        ({"bias.constant": -1, "pose_source": "gps"}, "pose_source: expected string (tf, topic, parameter), got 'gps'"),
        ({"qos_overrides./mesh.subscription.reliability": "sometimes"}, "Unexpected QoS override"),
    ],
    ids=["device", "parameters", "qos"],
)
def test_what_cannot_start_says_so_and_exits_with_1(parameters: dict[str, object], message: str) -> None:
    with NodeProcess(parameters) as process:
        code, errors = process.wait()
        text = "".join(process.out) + errors
        assert code == 1 and message in text and "[ERROR]" in text
        assert "Traceback" not in text


def test_a_missing_warp_is_explained(tmp_path: Path) -> None:
    (tmp_path / "warp.py").write_text("raise ModuleNotFoundError(\"No module named 'warp'\", name='warp')\n")
    path = os.pathsep.join(filter(None, (str(tmp_path), os.environ.get("PYTHONPATH", ""))))
    with NodeProcess(environment={"PYTHONPATH": f"{path}{os.pathsep}{ROOT}"}) as process:
        code, errors = process.wait()
        text = "".join(process.out) + errors
        assert code == 1 and "pip install 'warp-lang" in text and "Traceback" not in text


def test_a_damaged_kernel_cache_is_mended_and_logged(tmp_path: Path) -> None:
    """In the log of the node, not by Python on stderr, where LLVM alone says that it could not read the file."""
    import warp as wp

    ShadowTracer(device="cpu", bounds=Bounds(max_triangles=10, max_rays=10)).warm_up()
    shutil.copytree(wp.config.kernel_cache_dir, tmp_path / wp.__version__)
    files = list(tmp_path.glob("*/wp_shadow_tracer.gpu.accelerators.light_grid.pack_pieces_*/*.o"))
    assert files
    for file in files:
        os.truncate(file, 1000)
    with NodeProcess(environment={"WARP_CACHE_PATH": str(tmp_path)}) as process:
        process.wait_for("Ready: light_grid/packed on cpu")
        code, errors = process.stop(signal.SIGTERM)
    assert code == 0 and "kernel cache" not in errors
    (said,) = [line for line in process.out if "kernel cache: " in line]
    # Other versions of the package may have left modules of the same name in the cache.
    assert "[WARN]" in said and any(f"{file.parent.name} was damaged and has been removed" in said for file in files)


def test_masks_over_real_topics_and_a_malformed_request() -> None:
    with NodeProcess(arguments=["-r", "__ns:=/front"]) as process, Rig(start=False, namespace="/front") as rig:
        process.wait_for("Ready")
        rig.connected()
        vertices, triangles = plate()
        rig.send_mesh(vertices, triangles)
        rig.until(lambda: rig.value("input mesh", "triangles") == "2")
        mask = rig.trace(wall())
        tracer = ShadowTracer(device="cpu", bounds=Bounds(max_triangles=100, max_rays=5000, queue_capacity=1000))
        tracer.scene.put("mesh", vertices, triangles)
        camera = Camera(64, 48, 60.0, 60.0, 31.5, 23.5)
        frame = tracer.trace(wall(), camera, [PointLight("lamp", (0.5, -0.5, 0.0))], bias=BIAS)
        np.testing.assert_array_equal(mask, frame.mask())
        assert rig.status(DEVICE) and rig.reports[-1].status[0].name == "front/shadow_tracer: input depth"
        client = rig.client(SetParameters, "shadow_tracer/set_parameters")
        change = ParameterMsg(name="device", value=ParameterValue(type=4, string_value="cpu"))
        answer = client.call_async(SetParameters.Request(parameters=[change]))
        rig.until(answer.done)
        assert (
            answer.result().results[0].reason.startswith("device is read-only: buffers and kernels live on one device")
        )
        # A parameter of a type that does not exist raises inside rclpy's own service.
        client.call_async(
            SetParameters.Request(parameters=[ParameterMsg(name="light_names", value=ParameterValue(type=77))])
        )
        rig.wait_status(PROCESSING, ERROR, "77")
        np.testing.assert_array_equal(rig.trace(wall()), mask)
        assert process.stop(signal.SIGTERM) == (0, "")


def test_the_default_parameter_file_is_understood() -> None:
    with NodeProcess(arguments=["--params-file", str(ROOT / "config" / "default.yaml")]) as process:
        process.wait_for("Ready")
        assert process.stop(signal.SIGINT) == (0, "")
        assert not any("[WARN]" in line or "[ERROR]" in line for line in process.out)


def test_a_signal_amid_traffic_ends_it_cleanly() -> None:
    """Whatever is just being published or logged must not meet a context that is gone."""
    for number in (signal.SIGINT, signal.SIGTERM):
        with NodeProcess() as process, Rig(start=False) as rig:
            process.wait_for("Ready")
            rig.connected()
            for _ in range(40):
                rig.send_mesh(*plate())
                rig.send_frame(wall())
                rig.executor.spin_once(timeout_sec=0.0)
            process.send(number)
            for _ in range(40):
                rig.send_frame(wall())
            assert process.wait() == (0, "")


def test_the_launcher_finds_the_program_from_lib(tmp_path: Path) -> None:
    (tmp_path / "bin").mkdir()
    (tmp_path / "lib" / "shadow_tracer").mkdir(parents=True)
    program = tmp_path / "bin" / "shadow_node"
    program.write_text('#!/bin/sh\necho "started $@"\n')
    program.chmod(0o755)
    launcher = tmp_path / "lib" / "shadow_tracer" / "shadow_node"
    launcher.write_bytes((ROOT / "scripts" / "shadow_node").read_bytes())
    launcher.chmod((ROOT / "scripts" / "shadow_node").stat().st_mode)
    run = subprocess.run([launcher, "--ros-args", "a b"], capture_output=True, text=True, check=True)
    assert run.stdout == "started --ros-args a b\n"


def test_importing_the_room_needs_no_ros_and_no_warp() -> None:
    code = (
        "import sys; import shadow_tracer.ros.parameters.parameters, shadow_tracer.ros.cdr;"
        "import shadow_tracer.ros.node.process;"
        "print(sorted({'rclpy', 'warp', 'sensor_msgs'} & set(sys.modules)))"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_two_cameras_of_which_one_is_killed(tmp_path: Path) -> None:
    """As a user does it: a parameter file of config, a program for each camera. The masks of the other go on."""
    text = (ROOT / "config" / "several_cameras.yaml").read_text()
    path = tmp_path / "my.yaml"
    path.write_text(text.replace("    fixed_frame: map\n", "    fixed_frame: map\n    pose_source: parameter\n", 1))
    names = ("front", "rear")
    with Rig(start=False) as rig, NodeProcess(arguments=["--params-file", str(path)]) as process:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
        command = [sys.executable, str(ROOT / "test" / "camera_publisher.py")]
        cameras = {name: subprocess.Popen([*command, name], env=environment) for name in names}
        try:
            process.wait_for("Ready")
            masks = {name: rig.collect(Image, f"shadow_tracer/{name}/mask") for name in names}
            rig.until(lambda: all(len(masks[name]) >= 5 for name in names))
            assert rig.status("input depth front") and rig.status("input depth rear")
            cameras["rear"].kill()
            cameras["rear"].wait()
            rig.wait_status("input depth rear", WARN, "no depth image for", 30.0)
            count = {name: len(masks[name]) for name in names}
            rig.until(lambda: len(masks["front"]) >= count["front"] + 20)
            assert len(masks["rear"]) == count["rear"]
            rig.wait_status("input depth front", OK)
            cameras["rear"] = subprocess.Popen([*command, "rear"], env=environment)
            rig.until(lambda: len(masks["rear"]) > count["rear"])
            for status in ("device", "processing"):
                rig.wait_status(status, OK)
        finally:
            for camera in cameras.values():
                camera.kill()
                camera.wait()
        assert process.stop(signal.SIGINT) == (0, "")
