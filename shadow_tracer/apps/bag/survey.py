# SPDX-License-Identifier: Apache-2.0
"""What a planner knows of a bag after one pass, so that any stretch of it can be played alone.

It holds what stands anywhere in the bag and counts everywhere (transforms, poses of the camera, camera_info), where the
depth images and meshes stand, and the small things that are in force until they are replaced (static transforms, poses
of lights). Meshes stay in the bag. Whoever plays a stretch needs no look at what is before it but for meshes.
"""

from __future__ import annotations

import io
import json
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from shadow_tracer.apps.bag.files import BagError
from shadow_tracer.apps.bag.heads import HeadsError, header_of
from shadow_tracer.apps.bag.marker_ledger import MarkerLedger, MarkerLives
from shadow_tracer.apps.bag.reader import (
    BACKGROUND,
    MESHES,
    Background,
    BackgroundReader,
    Message,
    Recording,
)
from shadow_tracer.apps.bag.types import USUAL
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.wire.messages import MessageError, pose_matrix
from shadow_tracer.ros.world.lighting import LightPose
from shadow_tracer.ros.world.transform_tree import TransformTree

REPLACING = ("mesh", "mesh_cloud")  # of these topics each message replaces the one before
_HEADERS = ("depth", "mesh", "mesh_cloud", "grid_map")  # of these no more is looked at
_LEAST = 12  # bytes of a message for each triangle: three numbers of a corner, or of its indices
_KINDS = {
    "info": "sensor_msgs/msg/CameraInfo",
    "pose": "geometry_msgs/msg/PoseStamped",
    "tf_static": "tf2_msgs/msg/TFMessage",
}


@dataclass
class Survey:
    """One bag, by what is needed to start anywhere in it. Times are those of the log [ns], in order.

    Attributes:
        frames: (N, 3) time, stamp and number of the frame name of each depth image.
        frame_names: names of the frames.
        logged: time and plain CDR of each camera_info, pose of the camera, static transform and good pose of a light,
            by input.
        meshes: times of messages, by topic.
        markers: which of them are in force when.
        largest_replacing: triangles that the largest messages of :data:`REPLACING` could have, together.
        whole: why the bag cannot be cut, a sentence each.
        refused: how many messages cannot be used, and the last reason, by input.
        transforms: all that have a stamp, and of static ones the first of each frame.
    """

    frames: Any = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    frame_names: list[str] = field(default_factory=list)
    logged: dict[str, list[tuple[int, bytes]]] = field(default_factory=dict)
    meshes: dict[str, list[int]] = field(default_factory=dict)
    markers: MarkerLives = field(default_factory=MarkerLives)
    largest_replacing: int = 0
    whole: list[str] = field(default_factory=list)
    refused: dict[str, tuple[int, str]] = field(default_factory=dict)
    transforms: TransformTree = field(default_factory=TransformTree)
    _kept: Background | None = None

    def frames_before(self, time: int) -> list[tuple[int, int, str]]:
        """Time, stamp [ns] and frame of the depth images before a time."""
        rows = self.frames[: np.searchsorted(self.frames[:, 0], time)]
        return [(when, stamp, self.frame_names[name]) for when, stamp, name in rows.tolist()]

    def info_before(self, time: int) -> Any:
        """The last camera_info before a time; None if there is none."""
        return next(iter([*self._before("info", time)][-1:]), None)

    def static_before(self, time: int) -> Iterator[Any]:
        """Static transforms before a time, messages in order."""
        return self._before("tf_static", time)

    def lights_before(self, time: int) -> dict[str, LightPose]:
        """The last pose of each light before a time."""
        found = {}
        for name in self.logged:
            if name.startswith("light "):
                rows = self.logged[name]
                place = bisect_left(rows, time, key=lambda row: row[0])
                if place:
                    content: Any = USUAL.deserialize_cdr(rows[place - 1][1], _KINDS["pose"])
                    found[name.removeprefix("light ")] = light_pose(content)
        return found

    def last_mesh(self, name: str, time: int) -> int | None:
        """When the last message of a topic before a time came; None if there is none."""
        times = self.meshes.get(name, [])
        place = bisect_left(times, time)
        return times[place - 1] if place else None

    def background(self, settings: Settings) -> Background:
        """Transforms, poses of the camera and camera_info, with nothing refused; the caller may change the tree."""
        if self._kept is None:
            reader = BackgroundReader(settings)
            for name in ("info", "pose"):
                for _, data in self.logged.get(name, []):
                    reader.take(name, USUAL.deserialize_cdr(data, _KINDS[name]))
            self._kept = reader.finish()
        kept = self._kept
        return Background(self.transforms.copy(), kept.poses, kept.infos, kept.first_info)

    def _before(self, name: str, time: int) -> Iterator[Any]:
        for when, data in self.logged.get(name, []):
            if when >= time:
                return
            yield USUAL.deserialize_cdr(data, _KINDS[name])

    def save(self, path: Path) -> None:
        """Write it to a file.npz."""
        names = sorted(self.logged)
        rows = [(kind, when, len(data)) for kind, name in enumerate(names) for when, data in self.logged[name]]
        blob = b"".join(data for name in names for _, data in self.logged[name])
        texts = {
            "frame_names": self.frame_names, "logged": names, "meshes": self.meshes, "whole": self.whole,
            "refused": self.refused, "largest_replacing": self.largest_replacing, "keys": self.markers.keys,
            "most": self.markers.most,
        }  # fmt: skip
        arrays: dict[str, Any] = {f"tree_{name}": array for name, array in self.transforms.rows().items()}
        with path.open("wb") as file:
            np.savez_compressed(
                file,
                frames=self.frames,
                markers=self.markers.rows,
                rows=np.array(rows, np.int64).reshape(-1, 3),
                blob=np.frombuffer(blob, np.uint8),
                texts=np.frombuffer(json.dumps(texts).encode(), np.uint8),
                **arrays,
            )

    @staticmethod
    def load(path: Path) -> Survey:
        """Read what :meth:`save` wrote. Raises BagError."""
        try:
            with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
                texts = json.loads(file["texts"].tobytes())
                blob, place = file["blob"].tobytes(), 0
                logged: dict[str, list[tuple[int, bytes]]] = {name: [] for name in texts["logged"]}
                for kind, when, size in file["rows"].tolist():
                    logged[texts["logged"][kind]].append((when, blob[place : place + size]))
                    place += size
                tree = {name.removeprefix("tree_"): file[name] for name in file.files if name.startswith("tree_")}
                refused = {name: (count, text) for name, (count, text) in texts["refused"].items()}
                markers = MarkerLives(file["markers"], texts["keys"], texts["most"])
                return Survey(
                    file["frames"], texts["frame_names"], logged, texts["meshes"], markers, texts["largest_replacing"],
                    texts["whole"], refused, TransformTree.of_rows(tree),
                )  # fmt: skip
        except (OSError, ValueError, KeyError, EOFError) as error:
            raise BagError(f"{path}: what was planned cannot be read: {error}; plan again") from error


def light_pose(content: Any) -> LightPose:
    """Where a PoseStamped puts a light. Raises MessageError."""
    return LightPose(content.header.frame_id, pose_matrix(content.pose, "pose"))


def survey(recording: Recording, settings: Settings) -> Survey:
    """Read a bag once, and of images and meshes no more than their headers where it has an index. Raises BagError."""
    try:
        return _Surveyor(recording, settings).read(lambda names: recording.heads(names, _HEADERS))
    except HeadsError:  # whoever reads all of it finds out what is wrong, or that nothing is
        return _Surveyor(recording, settings).read(recording.messages)


class _Surveyor:
    def __init__(self, recording: Recording, settings: Settings) -> None:
        self._recording = recording
        self._settings = settings
        self._reader = BackgroundReader(settings)
        self._made = Survey()
        self._frames: list[tuple[int, int, int]] = []
        self._names: dict[str, int] = {}
        self._largest = dict.fromkeys(REPLACING, 0)
        self._ledger = MarkerLedger(settings.max_triangles)
        self._wandering = self._unstamped = False  # parts that stay where a moving frame was
        self._static: dict[str, bytes] = {}
        self._static_changes = False

    def read(self, messages: Callable[[Iterable[str]], Iterable[Message]]) -> Survey:
        lights = [f"light {light.name}" for light in self._settings.lights]
        made = self._made
        for message in messages(("depth", *BACKGROUND, *MESHES, *lights)):
            try:
                if message.name == "depth":
                    stamp, frame = header_of(message.data)
                    self._frames.append((message.time, stamp, self._names.setdefault(frame, len(self._names))))
                elif message.name in MESHES:
                    self._mesh(message.name, message)
                else:
                    self._small(message)
            except MessageError as error:
                if message.name in BACKGROUND:
                    self._reader.found.refuse(message.name, error)
        made.frames = np.array(self._frames, np.int64).reshape(-1, 3)
        made.frame_names = list(self._names)
        made.markers = self._ledger.finish()
        made.largest_replacing = sum(self._largest.values()) // _LEAST
        background = self._reader.finish()
        made.transforms = background.tree
        made.refused = {name: (len(texts), texts[-1]) for name, texts in background.refused.items()}
        made.whole = self._reasons()
        return made

    def _small(self, message: Any) -> None:
        name, content = message.name, self._recording.decode(message)
        if name.startswith("light "):
            light_pose(content)
        else:
            self._reader.take(name, content)
        if name == "tf_static":
            for transform in content.transforms:
                data = bytes(USUAL.serialize_cdr(transform.transform, transform.transform.__msgtype__))
                data += transform.header.frame_id.encode()
                self._static_changes |= self._static.setdefault(transform.child_frame_id, data) != data
        if name != "tf":
            self._made.logged.setdefault(name, []).append((message.time, message.data))

    def _mesh(self, name: str, message: Message) -> None:
        self._made.meshes.setdefault(name, []).append(message.time)
        if name in REPLACING:
            self._largest[name] = max(self._largest[name], message.size)
        if name in ("mesh_cloud", "grid_map"):
            self._stays(*header_of(message.data)[::-1])
        elif name != "mesh":
            for each in self._ledger.take(name, message.data, message.time):
                if not each.frame_locked:
                    self._stays(each.frame, each.stamp)

    def _stays(self, frame: str, stamp: int) -> None:
        if (frame.lstrip("/") or self._settings.mesh_frame) not in ("", self._settings.fixed_frame):
            self._wandering = True
            self._unstamped |= stamp == 0

    def _reasons(self) -> list[str]:
        reasons, settings = [], self._settings
        if settings.dose_parts:
            reasons.append("dose.parts sums up from the first image to the last")
        if settings.uses_depth and self._recording.count("query", "grid_map"):
            reasons.append("queries and grid maps see the surface of the image before them")
        if self._unstamped:
            reasons.append("a mesh without stamp stays where its frame is at the first image that can be answered")
        if self._wandering and self._static_changes:
            reasons.append("static transforms change, and a mesh stays where its frame was")
        return reasons
