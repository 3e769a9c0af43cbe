# SPDX-License-Identifier: Apache-2.0
"""The files that a recording consists of, each as one that rosbags opens: told apart by how they begin, unpacked, and
mended where they were cut off."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any

import yaml

from shadow_tracer.apps.bag.salvage import mcap_ends, mend_mcap, mend_sqlite, sqlite_is_whole, unpack
from shadow_tracer.apps.bag.salvage_ros1 import mend_ros1, ros1_is_whole

_KINDS = {b"\x89MCAP0\r\n": ".mcap", b"SQLite format 3\0": ".db3", b"#ROSBAG V": ".bag"}
ZSTD = b"\x28\xb5\x2f\xfd"
_EXPECTED = "expected an mcap, db3 or ROS 1 bag file, alone or compressed by zstd"
# What splitting adds to the name of a recording, and what the kind of file adds.
_PART = re.compile(r"(_?\d{4}(-\d\d){5})?_(\d+)$")
_ENDING = re.compile(r"\.(mcap|db3|bag)(\.active)?(\.zstd)?$")
# By kind: whether a file is whole, how it is mended, and what else may help.
_MENDING: dict[str, tuple[Callable[[Path], bool], Callable[[Path, Path], int], str]] = {
    ".mcap": (mcap_ends, mend_mcap, "mcap recover {file} -o mended.mcap"),
    ".db3": (sqlite_is_whole, mend_sqlite, "sqlite3 {file} .recover | sqlite3 mended.db3"),
    ".bag": (ros1_is_whole, mend_ros1, "rosbag reindex {file}, a program of ROS 1"),
}


class BagError(Exception):
    """The bag cannot be used, or not be written; the text says why and what helps."""


class BagFiles:
    """The files of a recording, ready to be opened. Close it when they are no longer read.

    Args:
        path: one file, or the folder of a bag, with its metadata.yaml or without.

    Attributes:
        paths: mcap, db3 and bag files, in the order of the recording.
        warnings: what is missing of the recording, a sentence each.

    Raises:
        BagError: no recording, or nothing of it can be read.
        OSError: a file cannot be read, or there is no room to unpack or mend it.
    """

    def __init__(self, path: Path) -> None:
        self.paths: list[Path] = []
        self.warnings: list[str] = []
        self._room = TemporaryDirectory(prefix="shadow_tracer_bag_")
        try:
            for number, file in enumerate(self._listed(path)):
                self.paths.append(self._ready(file, Path(self._room.name) / str(number)))
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Remove what was unpacked or mended."""
        self._room.cleanup()

    def _listed(self, path: Path) -> list[Path]:
        if not path.exists():
            raise BagError(f"{path}: expected an mcap, db3 or ROS 1 bag file or the folder of a bag, found none")
        if not path.is_dir():
            return [path]
        names = self._named_by_metadata(path)
        if names is None:
            return self._found(path)
        files = [path / name for name in names]
        if absent := [file.name for file in files if not file.exists()]:
            raise BagError(
                f"{path}: metadata.yaml names {', '.join(absent)}, not in the folder; copy the whole bag, or give the "
                "files that are there one by one"
            )
        return files

    def _named_by_metadata(self, folder: Path) -> list[str] | None:
        """Names of the files; None if there is no metadata.yaml, or none that was written to its end."""
        try:
            content: Any = yaml.safe_load((folder / "metadata.yaml").read_text(encoding="utf-8"))
            names = content["rosbag2_bagfile_information"]["relative_file_paths"]
            return [PurePath(str(name)).name for name in names] or None
        except FileNotFoundError:
            return None
        except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError) as error:
            self.warnings.append(f"{folder}: metadata.yaml is damaged ({type(error).__name__}); the files are read")
            return None

    def _found(self, folder: Path) -> list[Path]:
        """Files of the one recording in a folder without metadata.yaml."""
        recordings: dict[tuple[str, str], dict[int, Path]] = {}
        # compressed ones last, so that they count only where the recorder left no other
        for file in sorted(folder.iterdir(), key=lambda file: (file.suffix == ".zstd", file.name)):
            if file.is_file() and (kind := _kind(file)):
                name, unpacked = _ENDING.sub("", file.name), file.name.removesuffix(".zstd")
                part = _PART.search(name)
                ending = kind if kind != ".zstd" else PurePath(unpacked).suffix
                parts = recordings.setdefault((name[: part.start()] if part else name, ending), {})
                number = int(part[3]) if part else -1
                if number in parts and kind != ".zstd":  # the same part of another recording
                    recordings[file.name, ending] = {number: file}
                parts.setdefault(number, file)
        if not recordings:
            raise BagError(f"{folder}: {_EXPECTED} or the folder of a bag, found none in this folder")
        if len(recordings) > 1:
            names = ", ".join(sorted(file.name for parts in recordings.values() for file in parts.values()))
            raise BagError(f"{folder}: has no metadata.yaml and more than one recording; give one of {names}")
        (parts,) = recordings.values()
        return [parts[number] for number in sorted(parts)]

    def _ready(self, file: Path, target: Path) -> Path:
        source, kind = file, _kind(file)
        if kind == ".zstd":
            source = target.with_suffix(".unpacked")
            whole, kind = unpack(file, source), _kind(source)
            if not whole:
                self.warnings.append(f"{file}: the compressed file is cut off or damaged; it is read as far as it goes")
        if kind not in _MENDING:
            raise BagError(f"{file}: {_EXPECTED}; this is {_described(file)}")
        target = target.with_suffix(kind)
        if not _MENDING[kind][0](source):
            self._mend(file, source, target)
        elif source.suffix != kind:
            target.symlink_to(source.absolute())
        else:
            return source
        return target

    def _mend(self, file: Path, source: Path, target: Path) -> None:
        _, mend, cure = _MENDING[target.suffix]
        cure = f"try: {cure.format(file=shlex.quote(str(file)))}"
        try:
            count = mend(source, target)
        except OSError:
            raise
        except Exception as error:  # of the library: whatever damaged bytes lead it to
            text = f"{file}: the recording is cut off and cannot be read: {error}; {cure}"
            raise BagError(text) from error
        if not count:
            raise BagError(f"{file}: the recording is cut off before its first whole message; {cure}")
        self.warnings.append(f"{file}: the recording is cut off; its {count} whole messages are read")


def _kind(file: Path) -> str:
    """``.mcap``, ``.db3``, ``.bag`` or ``.zstd`` by the first bytes of a file; "" for any other."""
    with file.open("rb") as stream:
        begin = stream.read(16)
    if begin.startswith(ZSTD):
        return ".zstd"
    return next((kind for magic, kind in _KINDS.items() if begin.startswith(magic)), "")


def _described(file: Path) -> str:
    if not file.stat().st_size:
        return "an empty file"
    if file.suffix in (".lz4", ".gz", ".bz2", ".xz", ".zip", ".tar", ".tgz"):
        return f"a {file.suffix} file; unpack it"
    return "none of these"
