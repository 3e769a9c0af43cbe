# SPDX-License-Identifier: Apache-2.0
"""What a planner reads by the index of a file is what is in the file."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bag_journey import DEPTH, FOCAL, INFO, SECOND, journey
from bag_maker import TYPES, BagMaker, image, info, ros1_types, transform
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from shadow_tracer.apps.bag import heads, survey
from shadow_tracer.apps.bag.files import BagError
from shadow_tracer.apps.bag.heads import Heads, HeadsError, header_of
from shadow_tracer.apps.bag.names import Names
from shadow_tracer.apps.bag.reader import INPUTS, Recording
from shadow_tracer.apps.bag.survey import Survey
from shadow_tracer.ros.parameters.parameters import settings_from

HEADERS = ("depth", "mesh", "mesh_cloud", "grid_map")
LIGHTS = ["spot"]
NAMES = [*INPUTS, "light spot"]


def opened(bag: Path) -> Recording:
    return Recording(bag, Names(), LIGHTS, 1 << 20)


def by_mcap(made: BagMaker, path: Path, compression: CompressionType, chunk: int = 4000, shuffled: int = 0) -> Path:
    """The same messages as other programs write them: with checksums, small chunks, and not in the order of time."""
    rows = list(made._log)
    if shuffled:
        order = np.argsort(np.arange(len(rows)) + np.random.default_rng(0).uniform(0, shuffled, len(rows)))
        rows = [rows[k] for k in order]
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=chunk, compression=compression)
        writer.start("ros2")
        channels: dict[str, int] = {}
        for topic, kind, time, data in rows:
            if topic not in channels:
                text, _ = TYPES.generate_msgdef(kind, ros_version=2)
                schema = writer.register_schema(kind, "ros2msg", text.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], time, data, time)
        writer.finish()
    return path


def many() -> BagMaker:
    made = journey()
    for k in range(30):
        stamp = 200 * SECOND + k * SECOND
        made.add(INFO, info(48, 36, stamp, FOCAL))
        made.add(DEPTH, image(np.random.default_rng(k).integers(1900, 2100, (36, 48)).astype(np.uint16), stamp))
        if k % 5 == 0:
            made.now -= 4_000_000  # some at one time, and some before others
    made.add(DEPTH, image(np.ones((36, 48), np.uint16), 1, "long" * 300))
    made.raw(DEPTH, "sensor_msgs/msg/Image", b"\0\1\0\0cut")
    return made


WRITTEN: dict[str, Callable[[BagMaker, Path], Path]] = {
    "mcap": lambda made, path: made.write(path),
    "zstd": lambda made, path: made.write(path, compression=CompressionMode.STORAGE),
    "zstd of messages": lambda made, path: made.write(path, StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    "sqlite3": lambda made, path: made.write(path, StoragePlugin.SQLITE3),
    "ros1": lambda made, path: made.write_ros1(path.with_suffix(".bag")),
    "plain chunks": lambda made, path: by_mcap(made, path.with_suffix(".mcap"), CompressionType.NONE, shuffled=9),
    "small chunks": lambda made, path: by_mcap(made, path.with_suffix(".mcap"), CompressionType.ZSTD, 99, shuffled=9),
    "other headers": lambda made, path: made.write(path, types=ros1_types(), part=slice(-1)),
    "lz4": lambda made, path: by_mcap(made, path.with_suffix(".mcap"), CompressionType.LZ4),
}


@pytest.mark.parametrize("written", WRITTEN)
def test_heads_are_those_of_the_messages_in_their_order(tmp_path: Path, written: str) -> None:
    bag = WRITTEN[written](many(), tmp_path / "bag")
    with opened(bag) as recording:
        whole, found = list(recording.messages(NAMES)), list(recording.heads(NAMES, HEADERS))
    assert len(whole) > 90
    assert [(m.name, m.time, m.size) for m in found] == [(m.name, m.time, len(m.raw)) for m in whole]
    for one, other in zip(found, whole, strict=True):
        if one.unread:
            assert other.raw.startswith(one.raw)
            assert one.name == "mesh" or header_of(one.data) == header_of(other.data)
        else:
            assert one.raw == other.raw
    short = sum(m.unread > 0 for m in found)
    assert short == (0 if written in ("sqlite3", "zstd of messages", "ros1", "lz4", "other headers") else 34)


def surveyed(bag: Path) -> Survey:
    with opened(bag) as recording:
        return survey.survey(recording, settings_from({"light_names": LIGHTS}))


def same(one: Survey, other: Survey, tmp_path: Path) -> bool:
    texts = []
    for number, each in enumerate((one, other)):
        each.save(tmp_path / f"{number}.npz")
        with np.load(tmp_path / f"{number}.npz") as file:
            texts.append({name: file[name].tolist() for name in file.files})
    return json.dumps(texts[0]) == json.dumps(texts[1])


def test_no_more_than_headers_is_read_of_images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = BagMaker()
    for k in range(20):
        made.add(INFO, info(640, 480, k, FOCAL))
        made.add(DEPTH, image(np.ones((480, 640), np.uint16), k))
    bag, read, count = made.write(tmp_path / "bag"), heads.os.pread, [0]

    def counted(file: int, size: int, place: int) -> bytes:
        count[0] += size
        return read(file, size, place)

    monkeypatch.setattr(heads.os, "pread", counted)
    assert len(surveyed(bag).frames) == 20
    assert 0 < count[0] < 60_000 < 2 * 480 * 640


def spoilt(bag: Path, opcode: int, place: int) -> None:
    """Change a byte of a record of the first chunk that has so many: 7 is an index, 5 a message."""
    data = bytearray(bag.read_bytes())
    with bag.open("rb") as stream:
        chunk = heads.make_reader(stream).get_summary().chunk_indexes[0]
    start = chunk.chunk_start_offset + (chunk.chunk_length if opcode == 7 else 9 + 40 + len(chunk.compression))
    data[start + place] ^= 0x40
    bag.write_bytes(data)


@pytest.mark.parametrize("place", [0, 9, 11, 15, 16, 20, 23, 25, 29])
def test_where_the_index_is_wrong_all_is_read(tmp_path: Path, place: int) -> None:
    bag = by_mcap(many(), tmp_path / "bag.mcap", CompressionType.NONE)
    good = surveyed(bag)
    spoilt(bag, 7, place)
    with opened(bag) as recording, pytest.raises(HeadsError):
        list(recording.heads(NAMES, HEADERS))
    assert same(surveyed(bag), good, tmp_path)


def test_what_nobody_will_read_again_is_checked(tmp_path: Path) -> None:
    """A chunk with nothing but transforms has a checksum."""
    made = BagMaker()
    for k in range(80):
        made.add("/tf", transform("odom", "camera", k * SECOND, (0.5, 0.0, 0.0)))
    made.add(INFO, info(10, 8, 0, FOCAL))
    made.add(DEPTH, image(np.ones((8, 10), np.uint16), 0))
    for compression in (CompressionType.NONE, CompressionType.ZSTD):
        bag = by_mcap(made, tmp_path / f"{compression.name}.mcap", compression)
        assert len(surveyed(bag).frames) == 1
        spoilt(bag, 5, 300)
        with pytest.raises(BagError, match="damaged"):
            surveyed(bag)


def test_a_file_without_index_has_no_heads(tmp_path: Path) -> None:
    for name, content in (("a", b""), ("b", b"\x89MCAP0\r\n" * 40), ("c", b"nothing" * 40)):
        (tmp_path / name).write_bytes(content)
        with pytest.raises((HeadsError, OSError)):
            Heads(tmp_path / name)
