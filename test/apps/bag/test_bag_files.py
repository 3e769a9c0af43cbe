# SPDX-License-Identifier: Apache-2.0
"""Whatever a recording is kept in, its masks are the same."""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")
pytest.importorskip("mcap")
pytest.importorskip("rich")
pytest.importorskip("scipy")
pytest.importorskip("yaml")

import zstandard
from bag_journey import DEPTH, FOCAL, FRAMES, IMAGE, INFO, MCAP, SECOND, SQLITE, depth_at, journey, run, same
from bag_maker import TYPES, BagMaker, image, make, read, ros1_types
from bag_maker import header as stamped
from compressed_images import compressed
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from shadow_tracer.apps.bag.types import Types
from shadow_tracer.ros.wire.grid_map import DEFINITIONS, GRID_MAP, GRID_MAP_INFO


def lone(folder: Path, name: str) -> Path:
    """The one file of a bag under another name, alone in a folder."""
    (file,) = (path for path in folder.iterdir() if path.name != "metadata.yaml")
    target = folder.parent / "alone" / name
    target.parent.mkdir()
    return file.rename(target)


@pytest.mark.parametrize("storage", [MCAP, SQLITE], ids=["mcap", "db3"])
@pytest.mark.parametrize("mode", [None, *CompressionMode], ids=str)
@pytest.mark.parametrize("kept", ["folder", "no metadata", "file", "renamed"])
@pytest.mark.slow
def test_every_storage_and_compression(
    storage: StoragePlugin, mode: Any, kept: str, tmp_path: Path, expected: list[np.ndarray],
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    if storage is SQLITE and mode is CompressionMode.STORAGE:
        return  # sqlite3 has none
    bag = journey().write(tmp_path / "in", storage, mode)
    ending = ".zstd" if mode is CompressionMode.FILE else ""
    if kept == "no metadata":
        (bag / "metadata.yaml").unlink()
    elif kept != "folder":
        bag = lone(bag, f"a b.{'mcap' if storage is MCAP else 'db3'}{ending}" if kept == "file" else "a.recording")
    capsys.readouterr()
    assert same(run(bag, tmp_path / "out.mcap"), expected)
    err = capsys.readouterr().err
    assert "warning" not in err and "note" not in err


@pytest.mark.slow
def test_parts_without_metadata_are_read_in_order(tmp_path: Path, expected: list[np.ndarray]) -> None:
    whole = tmp_path / "run"
    whole.mkdir()
    for number, start in enumerate(range(0, 40, 3)):
        part = journey().write(tmp_path / str(number), SQLITE, part=slice(start, start + 3))
        if number % 2:  # the recorder compresses a part when the next one has begun
            unpacked = (part / f"{number}.db3").read_bytes()
            (whole / f"run_{number}.db3.zstd").write_bytes(zstandard.compress(unpacked))
        if number % 2 == 0 or number == 13:  # killed while it did
            shutil.copy(part / f"{number}.db3", whole / f"run_{number}.db3")
    (whole / "run_13.db3.zstd").write_bytes(zstandard.compress(unpacked)[:100])
    (whole / "notes.txt").write_text("not a part")
    assert same(run(whole, tmp_path / "out.mcap"), expected)


@pytest.mark.parametrize("compressed_too", [False, True])
def test_names_of_parts_may_have_dots(compressed_too: bool, tmp_path: Path, expected: list[np.ndarray]) -> None:
    whole = tmp_path / "run"
    whole.mkdir()
    for number, part in enumerate((slice(0, 17), slice(17, None))):
        data = (journey().write(tmp_path / str(number), part=part) / f"{number}.mcap").read_bytes()
        if compressed_too:
            (whole / f"run.v1.5_{number}.mcap.zstd").write_bytes(zstandard.compress(data))
        else:
            (whole / f"run.v1.5_{number}.mcap").write_bytes(data)
    assert same(run(whole, tmp_path / "out.mcap"), expected)


def test_metadata_that_was_not_written_to_its_end(
    tmp_path: Path, expected: list[np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    bag = journey().write(tmp_path / "in")
    text = (bag / "metadata.yaml").read_text()
    (bag / "metadata.yaml").write_text(text[: len(text) // 2] + "\n  {")
    assert same(run(bag, tmp_path / "out.mcap"), expected)
    assert "metadata.yaml is damaged (" in capsys.readouterr().err


@pytest.mark.parametrize("tf", ["tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"])
def test_ros1(tf: str, tmp_path: Path, expected: list[np.ndarray]) -> None:
    bag = journey().write_ros1(tmp_path / "in.bag", renamed={"tf2_msgs/msg/TFMessage": tf})
    assert same(run(bag, tmp_path / "out.mcap"), expected)


def test_ros1_in_parts_compressed_and_with_old_names(tmp_path: Path, expected: list[np.ndarray]) -> None:
    """rosbag record --split puts the time into each name; old recordings have topics without a slash."""
    from rosbags.highlevel import AnyReader
    from rosbags.rosbag1 import Writer

    whole = journey().write_ros1(tmp_path / "in.bag")
    parts = tmp_path / "parts"
    parts.mkdir()
    types = ros1_types()
    with AnyReader([whole]) as reader:
        messages = [(c.topic, c.msgtype, time, data) for c, time, data in reader.messages()]
    for number, start in enumerate(range(0, len(messages), 17)):
        writer = Writer(parts / f"drive_2019-03-0{number + 1}-10-20-30_{number}.bag")
        writer.set_compression(Writer.CompressionFormat.LZ4 if number else Writer.CompressionFormat.BZ2)
        with writer:
            connections: dict[str, Any] = {}
            for topic, kind, time, data in messages[start : start + 17]:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic.lstrip("/"), kind, typestore=types)
                writer.write(connections[topic], time, data)
    assert same(run(parts, tmp_path / "out.mcap"), expected)


def test_a_copy_of_ros1_is_one_of_ros2(tmp_path: Path, expected: list[np.ndarray]) -> None:
    types = ros1_types()
    types.register(get_types_from_msg("std_msgs/Header header\ntime when\nfloat32[] charge", "robot/msg/Battery"))
    own = get_typestore(Stores.ROS2_JAZZY)
    own.register(get_types_from_msg("std_msgs/Header header\nbuiltin_interfaces/Time when\nfloat32[] charge",
                                    "robot/msg/Battery"))  # fmt: skip
    TYPES.register({"robot/msg/Battery": own.fielddefs["robot/msg/Battery"]})
    made = journey()
    when = make("builtin_interfaces/Time", sec=7, nanosec=8)
    charge = np.array([0.5, 0.25], np.float32)
    made.add("/battery", make("robot/Battery", header=stamped(SECOND, "b"), when=when, charge=charge))
    bag = made.write_ros1(tmp_path / "in.bag", types)
    assert same(run(bag, tmp_path / "out.mcap", "--copy"), expected)
    copied = read(tmp_path / "out.mcap")
    (battery,) = copied["/battery"]
    assert (battery.header.stamp.sec, battery.when.sec, battery.charge.tolist()) == (1, 7, [0.5, 0.25])
    assert copied["/mesh_marker"][1].points[0].x == -0.1 and copied[INFO][0].k[0] == FOCAL
    assert same(run(tmp_path / "out.mcap", tmp_path / "again.mcap"), expected)


def test_a_copy_of_a_lone_file_keeps_its_own_types(tmp_path: Path) -> None:
    types = get_typestore(Stores.ROS2_JAZZY)
    types.register(get_types_from_msg("uint8 level", "robot/msg/Level"))
    made = journey()
    made.raw("/level", "robot/msg/Level", b"\x00\x01\x00\x00\x2a")
    file = lone(made.write(tmp_path / "in", types=types), "a.mcap")
    run(file, tmp_path / "out.mcap", "--copy")
    assert [message.level for message in read(tmp_path / "out.mcap")["/level"]] == [42]


def test_markers_of_older_versions_of_ros2(tmp_path: Path, expected: list[np.ndarray]) -> None:
    bag = journey().write(tmp_path / "in", types=get_typestore(Stores.ROS2_FOXY))
    assert same(run(bag, tmp_path / "out.mcap"), expected)


@pytest.mark.parametrize("ros1", [False, True])
def test_a_type_that_is_another_names_a_command_that_works(
    ros1: bool, tmp_path: Path, expected: list[np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    types = ros1_types() if ros1 else get_typestore(Stores.ROS2_JAZZY)
    fields = "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\n"
    del types.fielddefs[IMAGE]
    types.register(get_types_from_msg(f"{fields}uint8[] data\nfloat32 exposure", IMAGE))
    made = journey()
    bag = made.write_ros1(tmp_path / "a bag.bag", types) if ros1 else made.write(tmp_path / "a bag", types=types)
    run(bag, tmp_path / "out.mcap", expect=1)
    said = capsys.readouterr().err
    assert f"{DEPTH}: {IMAGE} is defined differently in this bag than in ROS 2 Jazzy; convert it with: " in said
    command = shlex.split(said.split("convert it with: ")[1])
    program = Path(sys.executable).with_name(command[0])
    done = subprocess.run([program, *command[1:]], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert same(run(Path(command[command.index("--dst") + 1]), tmp_path / "out.mcap"), expected)


def damaged_message(made: BagMaker, k: int) -> None:
    made.raw(DEPTH, IMAGE, zstandard.compress(bytes(TYPES.serialize_cdr(image(depth_at(k), k), IMAGE)))[:-9])


def test_a_damaged_compressed_message_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """All depth images are lost: nothing is known, and the exit code says so."""
    bag = journey(damaged_message).write(tmp_path / "in")
    assert run(bag, tmp_path / "out.mcap", expect=3) == []
    why = f"message: not a {IMAGE}: the zstd data is cut off"
    assert f"depth: {FRAMES} messages were refused, the last one because of {why}" in capsys.readouterr().err


def depth_compressed(codec: str, topic: str = f"{DEPTH}/compressedDepth") -> Callable[[BagMaker, int], None]:
    def add(made: BagMaker, k: int) -> None:
        form, data = compressed(depth_at(k), codec)
        header = stamped(100 * SECOND + k * SECOND // 8, "camera")
        content = np.frombuffer(data, np.uint8)
        made.add(topic, make("sensor_msgs/CompressedImage", header=header, format=form, data=content))

    return add


NOTE = f"note: {DEPTH} is not in the bag; {DEPTH}/compressedDepth is used\n"


@pytest.mark.parametrize("ros1", [False, True])
@pytest.mark.parametrize("codec", ["png", "rvl"])
def test_compressed_depth_is_found(
    codec: str, ros1: bool, tmp_path: Path, expected: list[np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    made = journey(depth_compressed(codec))
    bag = made.write_ros1(tmp_path / "in.bag") if ros1 else made.write(tmp_path / "in")
    assert same(run(bag, tmp_path / "out.mcap"), expected)
    assert NOTE in capsys.readouterr().err


def test_raw_depth_comes_first(tmp_path: Path, expected: list[np.ndarray], capsys: pytest.CaptureFixture[str]) -> None:
    def both(made: BagMaker, k: int) -> None:
        header, data = stamped(k, "camera"), np.zeros(1, np.uint8)
        damaged = make("sensor_msgs/CompressedImage", header=header, format="16UC1; compressedDepth png", data=data)
        made.add(f"{DEPTH}/compressedDepth", damaged)
        made.add(DEPTH, image(depth_at(k), 100 * SECOND + k * SECOND // 8))

    assert same(run(journey(both).write(tmp_path / "in"), tmp_path / "out.mcap"), expected)
    err = capsys.readouterr().err
    assert "note" not in err and "refused" not in err


def test_compressed_depth_of_other_names(
    tmp_path: Path, expected: list[np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    bag = journey(depth_compressed("rvl", "/cam/depth/compressedDepth")).write(tmp_path / "in")
    run(bag, tmp_path / "out.mcap", expect=1)
    assert (
        f"no {IMAGE} on {DEPTH}; use --remap depth/image_rect:=... with one of /cam/depth\n" in capsys.readouterr().err
    )
    for topic in ("/cam/depth", "/cam/depth/compressedDepth"):
        found = run(bag, tmp_path / "out.mcap", "--overwrite", "--remap", f"depth/image_rect:={topic}")
        assert same(found, expected)


def test_damaged_compressed_depth_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def damaged(made: BagMaker, k: int) -> None:
        data = np.frombuffer(compressed(depth_at(k), "png")[1][:-30] if k else b"", np.uint8)
        header = stamped(100 * SECOND + k, "camera")
        made.add(f"{DEPTH}/compressedDepth", make("sensor_msgs/CompressedImage", header=header, data=data,
                                                  format="16UC1; compressedDepth png"))  # fmt: skip

    run(journey(damaged).write(tmp_path / "in"), tmp_path / "out.mcap", expect=3)
    assert f"depth: {FRAMES} messages were refused, the last one because of data: the PNG" in capsys.readouterr().err


def test_large_compressed_depth_is_refused_before_it_is_unpacked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def large(made: BagMaker, k: int) -> None:
        form, data = compressed(np.full((99, 99), 2000, np.uint16), "png")
        content = np.frombuffer(data[:50], np.uint8)  # nothing but its size
        header = stamped(100 * SECOND + k, "camera")
        made.add(
            f"{DEPTH}/compressedDepth", make("sensor_msgs/CompressedImage", header=header, format=form, data=content)
        )

    run(journey(large).write(tmp_path / "in"), tmp_path / "out.mcap", expect=3)
    assert "data: expected at most bounds.max_rays = 4096 pixels, got 99 x 99" in capsys.readouterr().err


@pytest.mark.parametrize("change", ["", "another header", "no pose", "float64 data"])
def test_grid_maps_of_ros1_are_those_of_the_definition_or_refused(change: str) -> None:
    info, grid_map = "std_msgs/Header header\n" + DEFINITIONS[GRID_MAP_INFO], DEFINITIONS[GRID_MAP]
    grid_map = grid_map.removeprefix("" if change == "another header" else "std_msgs/Header header\n")
    if change == "no pose":
        info = info.replace("geometry_msgs/Pose pose\n", "")
    if change == "float64 data":
        grid_map = grid_map.replace("Float32", "Float64")
    types = get_typestore(Stores.ROS1_NOETIC)
    types.register(get_types_from_msg(info, GRID_MAP_INFO) | get_types_from_msg(grid_map, GRID_MAP))
    assert (Types(types, is2=False).converter(GRID_MAP) is None) == bool(change)
