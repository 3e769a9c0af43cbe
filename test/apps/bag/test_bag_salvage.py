# SPDX-License-Identifier: Apache-2.0
"""Recordings that were cut off are read as far as they go, and what cannot be read is explained."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
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
from bag_journey import FRAMES, IMAGE, MCAP, SQLITE, depth_at, journey, log_of, run, same
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Header, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from shadow_tracer.apps.bag.salvage import MCAP_MAGIC, mend_mcap, mend_sqlite
from shadow_tracer.apps.bag.salvage_ros1 import mend_ros1, ros1_is_whole


@pytest.mark.parametrize("mode", [None, CompressionMode.STORAGE], ids=str)
@pytest.mark.slow
def test_an_mcap_file_that_was_cut_off_anywhere(mode: Any, tmp_path: Path) -> None:
    """What is read is the beginning of what was recorded, byte by byte, and all of it that is whole."""
    whole = (journey().write(tmp_path / "in", MCAP, mode) / "in.mcap").read_bytes()
    everything = log_of(tmp_path / "in" / "in.mcap")
    counts = []
    for size in [*range(100, len(whole), max(1, len(whole) // 60)), len(whole) - 8]:
        (tmp_path / "cut.mcap").write_bytes(whole[:size])
        (tmp_path / "mended.mcap").unlink(missing_ok=True)
        count = mend_mcap(tmp_path / "cut.mcap", tmp_path / "mended.mcap")
        assert count == 0 or log_of(tmp_path / "mended.mcap") == everything[:count]
        counts.append(count)
    assert counts == sorted(counts) and counts[-1] == len(everything)
    if mode is None:  # nothing has to be decompressed: only the message that the file ends in is lost
        assert len(set(counts)) > FRAMES


def test_a_damaged_chunk_ends_what_is_read(tmp_path: Path) -> None:
    """Bytes that a checksum contradicts are not used, even if they could be messages."""
    file = tmp_path / "in.mcap"
    writer = Writer(str(file), chunk_size=1000, compression=CompressionType.NONE)
    writer.start(profile="ros2")
    schema = writer.register_schema(IMAGE, "ros2msg", b"uint8 x")
    channel = writer.register_channel("/x", "cdr", schema)
    for k in range(50):
        writer.add_message(channel, k, bytes([k]) * 100, k)
    writer.finish()
    data = bytearray(file.read_bytes())
    place = data.index(bytes([25]) * 100)
    data[place + 50] ^= 1
    file.write_bytes(data[: data.rindex(bytes([49]) * 100)])
    count = mend_mcap(file, tmp_path / "mended.mcap")
    assert 10 <= count <= 25
    assert [data[0] for _, _, data in log_of(tmp_path / "mended.mcap")] == list(range(count))


def test_channels_that_a_recorder_repeats_stay_one(tmp_path: Path) -> None:
    """rosbag2 repeats them in each chunk, and a file cannot have more than 65536."""
    parts = RecordBuilder()
    Header("ros2", "a test").write(parts)
    for k in range(5):
        Schema(1, b"uint8 x", "ros2msg", IMAGE).write(parts)
        Channel(1, "/x", "cdr", {}, 1).write(parts)
        Message(1, k, bytes([k]), k, 0).write(parts)
    (tmp_path / "in.mcap").write_bytes(MCAP_MAGIC + parts.end())
    assert mend_mcap(tmp_path / "in.mcap", tmp_path / "mended.mcap") == 5
    with AnyReader([tmp_path / "mended.mcap"]) as reader:
        assert len(reader.connections) == 1
        assert [data for _, _, data in reader.messages()] == [bytes([k]) for k in range(5)]


def test_a_killed_recording(tmp_path: Path, expected: list[np.ndarray], capsys: pytest.CaptureFixture[str]) -> None:
    bag = journey().write(tmp_path / "in")
    (bag / "metadata.yaml").unlink()  # written last
    file = bag / "in.mcap"
    data = file.read_bytes()
    third = data.index(depth_at(2).tobytes())
    file.write_bytes(data[: third + 100])
    masks = run(bag, tmp_path / "out.mcap")
    assert same(masks, [*expected[:2], *expected[FRAMES : FRAMES + 2]])
    assert f"warning: {file}: the recording is cut off; its 25 whole messages are read\n" in capsys.readouterr().err
    assert file.read_bytes() == data[: third + 100]


def test_a_database_that_was_cut_off_anywhere(tmp_path: Path) -> None:
    file = journey().write(tmp_path / "in", SQLITE) / "in.db3"
    whole, everything, counts = file.read_bytes(), log_of(file), []
    for size in range(len(whole) // 3 // 512 * 512 + 77, len(whole), 4096):
        (tmp_path / "cut.db3").write_bytes(whole[:size])
        (tmp_path / "mended.db3").unlink(missing_ok=True)
        count = mend_sqlite(tmp_path / "cut.db3", tmp_path / "mended.db3")
        assert count == 0 or log_of(tmp_path / "mended.db3") == everything[:count]
        counts.append(count)
    assert counts == sorted(counts) and len(set(counts)) > 3 and counts[-1] >= len(everything) - 7


def test_a_truncated_database(tmp_path: Path, expected: list[np.ndarray], capsys: pytest.CaptureFixture[str]) -> None:
    bag = journey().write(tmp_path / "in", SQLITE)
    file = bag / "in.db3"
    data = file.read_bytes()
    file.write_bytes(data[: data.index(depth_at(3).tobytes()[:200])])
    masks = run(bag, tmp_path / "out.mcap")
    assert same(masks, [*expected[:3], *expected[FRAMES : FRAMES + 3]])
    assert "the recording is cut off; its " in capsys.readouterr().err


@pytest.mark.parametrize("journal", ["wal", "truncate"])
def test_a_journal_of_a_killed_recorder_counts(journal: str, tmp_path: Path, expected: list[np.ndarray]) -> None:
    """With a write-ahead log the last messages stand there alone; with a rollback journal half a transaction goes."""
    bag = journey().write(tmp_path / "in", SQLITE)
    file, killed = bag / "in.db3", tmp_path / "killed"
    killed.mkdir()
    with closing(sqlite3.connect(file, isolation_level=None)) as database:
        database.execute(f"PRAGMA journal_mode={journal}")
        database.execute("PRAGMA cache_size=1")  # so that pages reach the file before they are committed
        late = database.execute("SELECT * FROM messages ORDER BY id DESC LIMIT 9").fetchall()
        if journal == "wal":
            database.execute("DELETE FROM messages WHERE id >= ?", (late[-1][0],))
            database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
            database.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", late[::-1])
        else:
            database.execute("BEGIN")
            database.execute("UPDATE messages SET data = zeroblob(length(data)) WHERE topic_id > 0")
        for path in bag.glob("in.db3*"):  # as a power failure leaves it
            shutil.copy(path, killed / path.name)
    assert (killed / f"in.db3-{'wal' if journal == 'wal' else 'journal'}").stat().st_size
    kept = {path.name: path.read_bytes() for path in killed.iterdir()}
    assert same(run(killed / "in.db3", tmp_path / "out.mcap"), expected)
    assert {path.name: path.read_bytes() for path in killed.iterdir()} == kept


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
@pytest.mark.slow
def test_a_bag_of_ros1_that_was_cut_off_anywhere(compression: str, tmp_path: Path) -> None:
    file = journey().write_ros1(tmp_path / "in.bag", compression=compression)
    whole, everything, counts = file.read_bytes(), log_of(file), []
    place = whole.index(b"index_pos=") + 10
    killed = whole[:place] + bytes(8) + whole[place + 8 :]  # the recorder writes the place of the index last
    for size in [*range(4100, len(whole), len(whole) // 40), len(whole)]:
        (tmp_path / "in.bag.active").write_bytes(killed[:size])
        (tmp_path / "mended.bag").unlink(missing_ok=True)
        assert not ros1_is_whole(tmp_path / "in.bag.active")
        count = mend_ros1(tmp_path / "in.bag.active", tmp_path / "mended.bag")
        assert count == 0 or log_of(tmp_path / "mended.bag") == everything[:count]
        counts.append(count)
    assert counts == sorted(counts) and counts[-1] == len(everything)
    if compression == "none":
        assert len(set(counts)) > FRAMES


@pytest.mark.parametrize("index", [False, True])
def test_a_killed_recording_of_ros1(
    index: bool, tmp_path: Path, expected: list[np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    file = journey().write_ros1(tmp_path / "drive.bag").rename(tmp_path / "drive.bag.active")
    data = file.read_bytes()
    if index:  # it was copied, and the copy not finished
        file.write_bytes(data[:-100])
    else:
        place, cut = data.index(b"index_pos=") + 10, data.index(depth_at(2).tobytes()) + 100
        file.write_bytes(data[:place] + bytes(8) + data[place + 8 : cut])
    known = FRAMES if index else 2
    masks = run(file, tmp_path / "out.mcap")
    assert same(masks, [*expected[:known], *expected[FRAMES : FRAMES + known]])
    assert f"warning: {file}: the recording is cut off; its " in capsys.readouterr().err


@pytest.mark.parametrize("storage", [MCAP, SQLITE], ids=["mcap", "db3"])
def test_a_compressed_file_that_is_cut_off(
    storage: StoragePlugin, tmp_path: Path, expected: list[np.ndarray], capsys: pytest.CaptureFixture[str]
) -> None:
    bag = journey().write(tmp_path / "in", storage)
    (bag / "metadata.yaml").unlink()
    (file,) = bag.iterdir()
    frames = [zstandard.compress(file.read_bytes()[start : start + 5000]) for start in range(0, 10**6, 5000)]
    packed = bag / f"{file.name}.zstd"
    packed.write_bytes(b"".join(frame for frame in frames if len(frame) > 20)[:-4000])
    file.unlink()
    masks = run(packed, tmp_path / "out.mcap")
    known = len(masks) // 2
    assert 0 < known < FRAMES and same(masks, [*expected[:known], *expected[FRAMES : FRAMES + known]])
    err = capsys.readouterr().err
    assert f"warning: {packed}: the compressed file is cut off or damaged; it is read as far as it goes\n" in err
    assert f"warning: {packed}: the recording is cut off; its " in err


def unsorted(bag: Path) -> None:
    """As the preset fastwrite of rosbag2 leaves it where several threads record."""
    file = bag / "in.mcap"
    with file.open("rb") as stream:
        records = list(StreamReader(stream).records)
    file.unlink()
    writer = Writer(str(file), use_chunking=False, compression=CompressionType.NONE)
    writer.start(profile="ros2")
    schemas = {r.id: writer.register_schema(r.name, r.encoding, r.data) for r in records if isinstance(r, Schema)}
    channels = {
        r.id: writer.register_channel(r.topic, r.message_encoding, schemas[r.schema_id], r.metadata)
        for r in records
        if isinstance(r, Channel)
    }
    for r in sorted((r for r in records if isinstance(r, Message)), key=lambda r: r.log_time ^ 2**21):
        writer.add_message(channels[r.channel_id], r.log_time, r.data, r.publish_time)
    writer.finish()


def two_recordings(bag: Path) -> None:
    (bag / "metadata.yaml").unlink()
    shutil.copy(bag / "in.mcap", bag / "other.mcap")


def two_with_one_name(bag: Path) -> None:
    shutil.rmtree(bag)
    bag.mkdir()
    for day in (1, 2):
        journey().write_ros1(bag / f"drive_2019-03-0{day}-10-20-30_0.bag")


def cut_short(bag: Path) -> None:
    file = bag / "in.mcap"
    file.write_bytes(file.read_bytes()[:60])


def no_message(bag: Path) -> None:
    shutil.rmtree(bag)
    journey().write_ros1(bag)
    bag.write_bytes(bag.read_bytes()[:4200])


def lost_header(bag: Path) -> None:
    file = journey().write(bag.parent / "db", SQLITE) / "db.db3"
    (bag / "in.mcap").write_bytes(file.read_bytes()[:3000])


def other_packing(bag: Path) -> None:
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information: {relative_file_paths: [x.lz4]}")
    (bag / "x.lz4").write_bytes(b"abc")


DAMAGE: dict[str, tuple[Callable[[Path], Any], str]] = {
    "unsorted": (unsorted, "in.mcap: an mcap file without index that is not sorted; try: mcap sort "),
    "two recordings": (two_recordings, "no metadata.yaml and more than one recording; give one of in.mcap, other.mcap"),
    "two with one name": (
        two_with_one_name,
        "give one of drive_2019-03-01-10-20-30_0.bag, drive_2019-03-02-10-20-30_0",
    ),
    "cut short": (cut_short, "in.mcap: the recording is cut off before its first whole message; try: mcap recover "),
    "no message": (no_message, "cut off before its first whole message; try: rosbag reindex "),
    "half a database": (lost_header, "the recording is cut off and cannot be read: "),
    "part missing": (lambda bag: (bag / "in.mcap").unlink(), "metadata.yaml names in.mcap, not in the folder; copy "),
    "empty file": (lambda bag: (bag / "in.mcap").write_bytes(b""), "ROS 1 bag file, alone or compressed by zstd; this"),
    "other file": (lambda bag: (bag / "in.mcap").write_text("x" * 99), "in.mcap: expected an mcap, db3 or ROS 1 bag"),
    "other packing": (other_packing, "this is a .lz4 file; unpack it"),
    "nothing": (lambda bag: [path.unlink() for path in bag.iterdir()], "found none in this folder"),
}


@pytest.mark.parametrize("what", DAMAGE)
def test_what_cannot_be_read_is_explained(what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    damage, message = DAMAGE[what]
    bag = journey().write(tmp_path / "in")
    damage(bag)
    run(bag, tmp_path / "out.mcap", expect=1)
    assert message in capsys.readouterr().err and not (tmp_path / "out.mcap").exists()
