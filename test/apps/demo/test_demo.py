# SPDX-License-Identifier: Apache-2.0
"""The demo as a program: parameters, messages, processes, and a short run end to end."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from shadow_tracer import Bias, Camera, ShadowTracer
from shadow_tracer.apps.demo import demo, workshop
from shadow_tracer.apps.demo.parameter_file import parameters, yaml
from shadow_tracer.apps.demo.processes import Processes
from shadow_tracer.apps.demo.publisher import Renderer, quaternion, size
from shadow_tracer.apps.demo.sequence import View, WorkshopSequence
from shadow_tracer.ros.parameters.parameters import names_for, problems_in
from shadow_tracer.ros.wire.cdr import parse_mesh

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def child_environment() -> dict[str, str]:
    """For a child that finds this package and, as every ROS process here, talks to this machine only."""
    path = os.pathsep.join(p for p in (str(ROOT), os.environ.get("PYTHONPATH", "")) if p)
    return {**os.environ, "PYTHONPATH": path, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def descendants(pid: int) -> set[int]:
    """Ids of all living processes below this one, from /proc."""
    parents = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if fields[0] != "Z":
                parents[int(entry.name)] = int(fields[1])
    found: set[int] = set()
    while more := {child for child, parent in parents.items() if parent in found | {pid}} - found:
        found |= more
    return found


def test_node_knows_every_parameter_of_the_demo() -> None:
    sequence = WorkshopSequence(2, (64, 48))
    values = parameters(sequence, "mesh_bvh", "", "auto")
    own = {name: value for name, value in values.items() if not name.startswith("qos_overrides.")}
    assert problems_in(own) == []
    assert set(own) <= set(names_for(values["light_names"]))


def test_parameter_file_is_yaml_of_the_same_values() -> None:
    reader = pytest.importorskip("yaml")
    values = parameters(WorkshopSequence(2, (64, 48)), "mesh_bvh", "refit", "cpu")
    read = reader.safe_load(yaml(values))["/shadow_tracer"]["ros__parameters"]
    assert read.keys() == values.keys()
    for name, value in values.items():
        assert read[name] == value  # every bit, so that node and library trace the same lights
        assert type(read[name]) is type(value)


@pytest.mark.parametrize("text", ["640", "640x", "axb", "8x8", "5000x5000", ""])
def test_wrong_sizes_are_refused(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        demo.main(["--size", text])
    assert ended.value.code == 2
    assert "size: must be" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["59", "1081", "-270", "270.5", "tall", ""])
def test_wrong_heights_are_refused(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        demo.main([f"--animation-height={text}"])
    assert ended.value.code == 2
    assert "animation-height: expected 60 to 1080 pixels" in capsys.readouterr().err


@pytest.mark.parametrize("text", ["-1", "nan", "inf", "soon", ""])
def test_wrong_budgets_are_refused(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        demo.main([f"--budget={text}"])
    assert ended.value.code == 2
    assert "budget: expected 0 to 86400 seconds" in " ".join(capsys.readouterr().err.split())


def test_size() -> None:
    assert size("640x480") == (640, 480)


def test_wrong_folder_is_an_error_in_words(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in demo.NEEDED:
        pytest.importorskip(name)
    assert demo.main(["--data", str(tmp_path / "none"), "--output", str(tmp_path / "out")]) == 2
    assert "data: must be a folder" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_missing_packages_are_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(demo.importlib.util, "find_spec", lambda name: None if name in ("rclpy", "rich") else object())
    assert demo.main(["--node"]) == 2
    assert "needs rclpy, rich: pip install 'shadow_tracer[demo,ros]'" in capsys.readouterr().err
    assert demo.main([]) == 2
    assert "needs rich: pip install 'shadow_tracer[demo]'" in capsys.readouterr().err


def test_quaternion_gives_the_rotation_back() -> None:
    messages = pytest.importorskip("shadow_tracer.ros.wire.messages", exc_type=ImportError)
    rng = np.random.default_rng(5)
    rotations = [np.linalg.qr(rng.standard_normal((3, 3)))[0] for _ in range(50)]
    rotations = [q * np.sign(np.linalg.det(q)) for q in rotations]
    rotations += [np.eye(3), np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1])]
    for rotation in rotations:
        back = messages.rigid((0, 0, 0), quaternion(rotation), "pose")[:3, :3]
        assert back == pytest.approx(rotation, abs=1e-12)


class Counting:
    """A sequence of tiny views that remembers which were made, and fails at one of them."""

    triangles = np.array([[0, 1, 2]], np.int32)

    def __init__(self, fails_at: int = 99) -> None:
        self.made: list[int] = []
        self._fails_at = fails_at

    def __len__(self) -> int:
        return 100

    def view(self, index: int) -> View:
        if index == self._fails_at:
            raise ValueError("no such view")
        self.made.append(index)
        camera = Camera(1, 1, 1, 1, 0, 0)
        return View(camera, np.full((1, 1), index, np.float32), np.zeros((1, 1, 3), np.uint8), np.eye(3) * index)


def test_renderer_makes_views_in_order_and_skips_what_is_not_wanted() -> None:
    sequence = Counting()
    renderer = Renderer(sequence)  # type: ignore[arg-type]
    try:
        for index in (0, 1, 90, 91):
            parcel = renderer.get(index)
            assert parcel.view.depth[0, 0] == index
            mesh = parse_mesh(parcel.mesh or b"", 10)
            assert np.array_equal(mesh.vertices, np.eye(3) * index)
    finally:
        renderer.stop()
    assert len(sequence.made) < 70  # no more than it looks ahead, and not what lies between


def test_renderer_hands_on_what_went_wrong() -> None:
    renderer = Renderer(Counting(fails_at=2))  # type: ignore[arg-type]
    try:
        with pytest.raises(ValueError, match="no such view"):
            renderer.get(2)
    finally:
        renderer.stop()


@pytest.mark.ros
def test_messages_carry_camera_and_pixels() -> None:
    pytest.importorskip("rclpy")
    from builtin_interfaces.msg import Time

    from shadow_tracer.apps.demo import collector, publisher
    from shadow_tracer.ros.wire.messages import decode_depth, intrinsics, pose_matrix

    camera = Camera(6, 4, 5.5, 5.25, 2.5, 1.5, workshop.camera_to_world(0.3))
    stamp = Time(sec=12, nanosec=34)
    pose, info = publisher.pose_message(camera, stamp), publisher.info_message(camera, stamp)
    assert intrinsics(info, 6, 4).camera(camera.camera_to_world).cy == 1.5
    assert pose_matrix(pose.pose, "pose") == pytest.approx(camera.camera_to_world, abs=1e-12)
    assert collector.camera_of(info, pose.pose).camera_to_world == pytest.approx(camera.camera_to_world, abs=1e-12)
    metres = np.arange(24, dtype=np.float32).reshape(4, 6)
    for values, encoding in ((metres, "32FC1"), (metres.astype(np.uint16), "16UC1")):
        message = publisher.image_message(values, encoding, stamp)
        assert np.array_equal(decode_depth(message), values)
        assert np.array_equal(collector.pixels(message), values)
        assert publisher.stamp_ns(message.header.stamp) == 12_000_000_034
    read = collector.metres(np.array([[0, 1500]], np.uint16))
    assert np.isnan(read[0, 0])
    assert read[0, 1] == 1.5


def test_stubborn_children_are_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, child_environment: dict[str, str]
) -> None:
    (tmp_path / "stubborn.py").write_text(
        "import signal, time\nsignal.signal(signal.SIGINT, signal.SIG_IGN)\nprint('up', flush=True)\ntime.sleep(600)\n"
    )
    for name in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOG_DIR", "FASTRTPS_DEFAULT_PROFILES_FILE"):
        monkeypatch.setenv(name, os.environ.get(name, ""))  # restored afterwards: Processes sets them
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    heard: list[str] = []
    processes = Processes()
    with pytest.raises(RuntimeError, match="trouble"), processes:
        processes.start("child", "stubborn", on_line=heard.append)
        end = time.monotonic() + 20
        while not heard and time.monotonic() < end:
            time.sleep(0.02)
        assert heard == ["up"]
        assert processes.exit_code("child") is None
        processes.stop(patience=0.2)
        assert processes.exit_code("child") == -signal.SIGKILL
        raise RuntimeError("trouble")
    assert not processes.folder.exists()


SHORT = ["--frames", "3", "--budget", "0", "--size", "96x72", "--animation-height", "90", "--device", "cpu"]


def check_files(folder: Path) -> None:
    """All that a run of SHORT leaves, and nothing else."""
    from PIL import Image

    names = {"contact_sheet.png", "all_lights.png", "depth.png", "shadows.gif", "stage_times.md", "stage_times.json"}
    names |= {f"{light}_{kind}.png" for light in ("lamp", "spotlight", "sun") for kind in ("mask", "shaded")}
    assert {path.name for path in folder.iterdir()} == names
    with Image.open(folder / "shadows.gif") as gif:
        assert gif.n_frames == 3 and gif.height == 90


@pytest.mark.slow
def test_demo_by_the_library_alone(tmp_path: Path, child_environment: dict[str, str]) -> None:
    """In an environment without ROS: the same files, and a figure for each light."""
    for name in demo.NEEDED:
        pytest.importorskip(name)
    code = (
        "import sys\n"
        "sys.modules.update(dict.fromkeys(('rclpy', 'sensor_msgs', 'geometry_msgs', 'builtin_interfaces')))\n"
        "from shadow_tracer.apps.cli import main\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )
    command = [sys.executable, "-c", code, "demo", *SHORT, "--output", str(tmp_path / "out")]
    done = subprocess.run(command, env=child_environment, capture_output=True, text=True, timeout=400, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    check_files(tmp_path / "out")
    assert all(f"{light} " in done.stdout.partition("are lit:")[2] for light in ("lamp", "spotlight", "sun"))


@pytest.mark.slow
def test_an_interrupt_ends_the_demo_without_the_node(tmp_path: Path, child_environment: dict[str, str]) -> None:
    for name in demo.NEEDED:
        pytest.importorskip(name)
    command = [sys.executable, "-m", "shadow_tracer.apps.demo.demo", "--frames", "2000", "--size", "64x48", "--output"]
    with (tmp_path / "log").open("wb") as log:
        child = subprocess.Popen([*command, str(tmp_path / "out")], env=child_environment, stdout=log, stderr=log)
        try:
            end = time.monotonic() + 120
            while not (tmp_path / "out").is_dir() and time.monotonic() < end:
                time.sleep(0.02)
            child.send_signal(signal.SIGINT)
            code = child.wait(timeout=60)
        finally:
            child.kill()
            child.wait()
    said = (tmp_path / "log").read_text()
    # Where the signal comes within an exec() of a string, as dataclasses are made by, Python ends itself by it later,
    # though it was caught: 130 for a shell, too.
    assert code in (130, -signal.SIGINT), said
    assert "demo: interrupted" in said and "Traceback" not in said


def test_a_mesh_at_rest_is_the_one_of_the_view_before() -> None:
    pytest.importorskip("rich"), pytest.importorskip("PIL")
    from shadow_tracer.apps.demo.library_run import LibraryRun

    sequence = WorkshopSequence(2, (48, 36))
    run = LibraryRun(sequence, "mesh_bvh", "", "cpu")
    view = sequence.view(1)
    first = run.shot(view)
    again = run.shot(View(view.camera, view.depth, view.colour, None))
    other = run.shot(View(view.camera, view.depth, view.colour, sequence.view(0).vertices))
    assert all(np.array_equal(first.masks[name], again.masks[name]) for name in first.masks)
    assert any(not np.array_equal(first.masks[name], other.masks[name]) for name in first.masks)
    assert {"trace", "total"} <= first.stages.keys()


def test_a_device_that_is_not_there_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("rich"), pytest.importorskip("PIL")
    assert demo.main(["--device", "cuda:77", "--frames", "1", "--size", "16x16", "--output", str(tmp_path)]) == 1
    assert "demo: device" in capsys.readouterr().err


@pytest.mark.ros
@pytest.mark.slow
def test_demo_end_to_end(tmp_path: Path, child_environment: dict[str, str]) -> None:
    """Three frames through node and publisher; the masks of the still are those the library gives, bit by bit."""
    for name in demo.NEEDED_BY_NODE:
        pytest.importorskip(name)
    from builtin_interfaces.msg import Time
    from PIL import Image

    from shadow_tracer.apps.demo import publisher
    from shadow_tracer.apps.demo.library_run import LibraryRun
    from shadow_tracer.ros.wire.messages import pose_matrix

    options = [*SHORT, "--node", "--output", str(tmp_path / "out")]
    command = [sys.executable, "-m", "shadow_tracer.apps.demo.demo", *options]
    done = subprocess.run(command, env=child_environment, capture_output=True, text=True, timeout=400, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "not answered" not in done.stdout
    sequence = WorkshopSequence(3, (96, 72))
    check_files(tmp_path / "out")
    stages = json.loads((tmp_path / "out" / "stage_times.json").read_text())["stages"]
    assert {"trace", "publish", "total"} <= stages.keys()
    assert all(0 <= times["median_ms"] <= times["p95_ms"] for times in stages.values())

    view = sequence.view(sequence.still)
    seen = pose_matrix(publisher.pose_message(view.camera, Time()).pose, "pose")  # rounded as on its way to the node
    c = view.camera
    tracer = ShadowTracer(device="cpu")
    assert view.vertices is not None
    tracer.scene.put("mesh", view.vertices, sequence.triangles)
    frame = tracer.trace(
        view.depth,
        Camera(c.width, c.height, c.fx, c.fy, c.cx, c.cy, seen),
        [light.light for light in sequence.lights],
        bias=Bias(*sequence.bias),
    )
    for light in sequence.lights:
        with Image.open(tmp_path / "out" / f"{light.name}_mask.png") as picture:
            mask = np.asarray(picture)
        assert np.array_equal(mask, frame.mask(light.name, unknown=100)), light.name
        assert {0, 100, 255} == set(np.unique(mask).tolist())
    shot = LibraryRun(sequence, "light_grid", "", "cpu").shot(view)
    assert np.array_equal(shot.camera.camera_to_world, seen) and not np.array_equal(c.camera_to_world, seen)
    for light in sequence.lights:
        assert np.array_equal(shot.masks[light.name], frame.mask(light.name, unknown=100)), light.name


@pytest.mark.ros
@pytest.mark.slow
@pytest.mark.parametrize("when", ["starting", "playing"])
def test_interrupted_demo_leaves_nothing_behind(tmp_path: Path, child_environment: dict[str, str], when: str) -> None:
    """SIGINT to the demo alone: it ends its children, in the middle of their start or of their work."""
    for name in demo.NEEDED_BY_NODE:
        pytest.importorskip(name)
    command = [
        sys.executable,
        "-m",
        "shadow_tracer.apps.demo.demo",
        "--node",
        "--frames",
        "2000",
        "--size",
        "96x72",
        "--output",
    ]
    with (tmp_path / "log").open("wb") as log:
        child = subprocess.Popen([*command, str(tmp_path / "out")], env=child_environment, stdout=log, stderr=log)
        try:
            end = time.monotonic() + 300
            wanted = 2
            while len(descendants(child.pid)) < wanted and time.monotonic() < end:
                time.sleep(0.05)
            if when == "playing":
                time.sleep(8)
            below = descendants(child.pid)
            assert len(below) >= wanted, (tmp_path / "log").read_text()
            child.send_signal(signal.SIGINT)
            assert child.wait(timeout=60) == 130, (tmp_path / "log").read_text()
            assert not {pid for pid in below if Path(f"/proc/{pid}").exists()}
        finally:
            if child.poll() is None:
                child.kill()
    assert "Traceback" not in (tmp_path / "log").read_text()


@pytest.mark.ros
@pytest.mark.slow
def test_node_that_cannot_start_is_reported(tmp_path: Path, child_environment: dict[str, str]) -> None:
    for name in demo.NEEDED:
        pytest.importorskip(name)
    command = [
        sys.executable,
        "-m",
        "shadow_tracer.apps.demo.demo",
        "--node",
        "--device",
        "cuda:77",
        "--frames",
        "2",
        "--size",
        "96x72",
    ]
    done = subprocess.run(
        [*command, "--output", str(tmp_path)],
        env=child_environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 1
    assert "the node ended with exit code 1" in done.stderr
    assert "cuda:77" in done.stderr
    assert "Traceback" not in done.stderr
