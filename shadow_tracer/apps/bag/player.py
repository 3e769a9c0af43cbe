# SPDX-License-Identifier: Apache-2.0
"""Plays a bag through the code of the node, frame by frame, without a clock: the same bag gives the same masks.

What is in force at a frame: transforms, poses of the camera and camera_info of its stamp, wherever they stand in the
bag; meshes, poses of lights and later static transforms as far as they stand before it in the log.
"""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from heapq import merge
from typing import Any

import numpy as np

from shadow_tracer import ShadowTracer
from shadow_tracer.apps.bag.dose import TOPICS, BagDose
from shadow_tracer.apps.bag.ground import BagGround
from shadow_tracer.apps.bag.heads import header_of
from shadow_tracer.apps.bag.marker_ledger import is_marker, runs
from shadow_tracer.apps.bag.names import Names
from shadow_tracer.apps.bag.reader import MESHES, Background, Message, Recording, add_transforms
from shadow_tracer.apps.bag.survey import REPLACING, Survey
from shadow_tracer.apps.bag.writer import Output
from shadow_tracer.ros import diagnostics
from shadow_tracer.ros.cameras.frame_queue import FrameQueue, WaitingFrame
from shadow_tracer.ros.cameras.overlay import overlay
from shadow_tracer.ros.node.answer import MOST_BITS, Answer, published_mask
from shadow_tracer.ros.node.processing import Processor
from shadow_tracer.ros.node.queries import Queries
from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.wire.grid_map import KEY as GRID_KEY
from shadow_tracer.ros.wire.messages import MessageError, decode_depth, pose_matrix
from shadow_tracer.ros.wire.parts import Changes
from shadow_tracer.ros.world.frames import Frames
from shadow_tracer.ros.world.lighting import Lighting, LightPose
from shadow_tracer.ros.world.mesh_sources import MeshSources

_MARKERS = ("mesh_markers", "mesh_marker")
_NOW = 0.0  # steady time: nothing waits here
_BY_LIGHT = ("mask", "visibility", "irradiance")  # topics of which each light has one
_LATER = 1e9  # by then everything has waited long enough
_BACKWARD_STAMPS = 1_000_000_000  # as in the node: images this much older than the last one mean another pass


@dataclass(frozen=True)
class Wish:
    """What is written beside masks, light_bits and camera_info."""

    timing: bool = True
    overlay: bool = False
    copy: bool = False
    visibility: bool = False
    irradiance: bool = False
    sun_map: bool = False


@dataclass
class Result:
    """What happened.

    Attributes:
        frames: depth images that were answered.
        traced: those of them of which something is known.
        reasons: why nothing is known of the others: text with numbers left out -> first such text, count.
        refused: what could not be used by input: count, last reason.
        warnings: what is doubtful though it was used.
        passes: how often the images start again at an earlier time.
        differing: pixels on which a second pipeline did not agree (``verify_every``).
        verified: frames that a second pipeline traced as well.
        parts: those that were there with any image, in order.
    """

    frames: int = 0
    traced: int = 0
    reasons: dict[str, tuple[str, int]] = field(default_factory=dict)
    refused: dict[str, tuple[int, str]] = field(default_factory=dict)
    warnings: Counter[str] = field(default_factory=Counter)
    passes: int = 1
    differing: int = 0
    verified: int = 0
    parts: dict[str, None] = field(default_factory=dict)

    def refuse(self, name: str, text: str, count: int = 1) -> None:
        """Count what could not be used."""
        self.refused[name] = (self.refused.get(name, (0, ""))[0] + count, text)


class Player:
    """Answers every depth image of a bag.

    Args:
        recording: the bag.
        background: what was read of it before.
        settings: as the node has them; ``process`` is always ``every``.
        tracer: a tracer with an empty scene.
        output: where the answers go.
        names: how topics are called.
        wish: what is written.

    Raises:
        ValueError: a mesh file cannot be used.
    """

    def __init__(
        self, recording: Recording, background: Background, settings: Settings, tracer: ShadowTracer, output: Output,
        names: Names, wish: Wish,
    ) -> None:  # fmt: skip
        self.result = Result()
        self.meshes = MeshSources(settings.max_triangles, settings.grid_map_layer)
        self._recording = recording
        self._background = background
        self._settings = settings
        self._tracer = tracer
        self._output = output
        self._names = names
        self._wish = wish
        self._queue = FrameQueue(settings.camera)
        self._queue.every = True
        # Static transforms are those of the moment in the log, not of a second of waiting: none is kept.
        self._frames = Frames(lambda: background.tree, static_period=0.0)
        self._frames.poses_of[settings.camera] = background.poses
        self._frames.configure(settings)
        self._lighting = Lighting()
        self._processor = Processor(self._queue, self._frames, self.meshes.store, self._lighting)
        self._queries = Queries(self._frames, self.meshes.store, self._lighting)
        self.dose = BagDose(settings, tracer, output, names)
        self._ground = BagGround(self._frames, self.meshes.store, self._lighting, output, names, wish.sun_map)
        self._camera_frame = ""
        self._last_stamp = 0
        self._info_stamps = sorted(background.infos)
        self._next_info = 0
        self._start: int | None = None
        self._before: dict[str, int] = {}  # refused meshes, by topic
        self._received_before = 0
        self._mine = {names.topic(f"~/{name}") for name in ("mask", "light_bits", "camera_info", "timing")}
        self._mine |= {names.topic(f"~/{name}") for name in ("overlay", "irradiance")}
        self._mine |= {names.topic(topic) for topic in ("~/query/visibility", "~/shadow_grid", "~/sun_map", *TOPICS)}
        self._mine |= {names.topic(f"~/{kind}/{light.name}") for light in settings.lights for kind in _BY_LIGHT}
        if settings.camera_info_policy == "latest":
            self._queue.put_info(background.first_info)
        self.meshes.load_files(settings, 0)
        if self.meshes.files:
            raise ValueError(self.meshes.files)

    @property
    def received(self) -> int:
        """Mesh messages since the beginning, or since what was sought."""
        return self.meshes.received - self._received_before

    def play(self, progress: Callable[[], None], stop: int | None = None) -> Result:
        """Go through the bag, from where :meth:`seek` went or its beginning, to before ``stop`` [ns] or its end;
        ``progress`` is called after each depth image. Raises BagError."""
        lights = [f"light {light.name}" for light in self._settings.lights]
        inputs = ["depth", "info", "query", "tf_static", *MESHES, *lights]
        for message in self._recording.messages(None if self._wish.copy else inputs, self._start, stop):
            try:
                if self._wish.copy and message.topic not in self._mine:
                    self._copy(message)
                if message.name in inputs:
                    self._take(message)
            except MessageError as error:
                self.result.refuse(message.name or message.topic, str(error))
            if message.name == "depth":
                progress()
        self.dose.finish()
        self._sum_up()
        return self.result

    def seek(self, survey: Survey, start: int) -> None:
        """Bring everything to where it is when all messages before ``start`` [ns] have been played, of a bag that
        :attr:`Survey.whole` allows to be cut. Images before it are neither traced nor written, and nothing before it
        is counted. To be called once, before :meth:`play`. Raises BagError."""
        self._start = start
        frames = survey.frames_before(start)
        for _, stamp, frame in frames:
            self._arrive(stamp, frame)
            self._queue.note_image(stamp)
        self._processor.skip(len(frames))
        if self._settings.camera_info_policy == "latest" and (info := survey.info_before(start)) is not None:
            self._queue.put_info(info)
        for name, pose in survey.lights_before(start).items():
            self._lighting.move(name, pose)
        for transforms in survey.static_before(start):
            add_transforms(self._background, transforms, True)
        self._background.refused.clear()
        self._seek_meshes(survey, start, [time for time, _, _ in frames])
        self.result.passes = 1
        self._before = {name: source.refused.count for name, source in self.meshes.sources.items()}
        self._received_before = self.meshes.received

    def _seek_meshes(self, survey: Survey, start: int, frames: list[int]) -> None:
        """Of topics whose messages replace each other the last will do, and of markers those that brought one that is
        in force; unless something was refused for lack of room, or might have been: then all messages are taken."""
        store, files = self.meshes.store, self.meshes.store.triangle_count
        keys, times = survey.markers.at(start)
        last = [self._recording.messages(("grid_map",), None, start), self._markers_at(survey, times, start)]
        for name in REPLACING:
            if (time := survey.last_mesh(name, start)) is not None:
                last.append(self._recording.messages((name,), time, start))
        ground = self._receive_all(merge(*last, key=lambda message: message.time), frames)
        # What came together with one in force and has gone.
        store.commit(Changes(remove=tuple(key for key in store.parts if is_marker(key) and key not in keys)), start)
        refused = sum(self.meshes.sources[name].refused.count for name in (*REPLACING, "grid_map"))
        most = files + ground + survey.markers.most + survey.largest_replacing
        if refused or most > self._settings.max_triangles:
            self.meshes.clear(0)
            self._ground.restart()
            self._receive_all(self._recording.messages(MESHES, None, start), frames)

    def _markers_at(self, survey: Survey, times: set[int], start: int) -> Iterator[Message]:
        """Messages with markers at some times [ns], and the last one before ``start``, by which is known whether a mesh
        is lacking."""
        every = np.sort(np.concatenate([np.array(survey.meshes.get(name, []), np.int64) for name in _MARKERS]))
        wanted = times | set(every[: np.searchsorted(every, start)][-1:].tolist())
        for first, last in runs(every, wanted):
            for message in self._recording.messages(_MARKERS, first, last + 1):
                if message.time in wanted:
                    yield message

    def _receive_all(self, messages: Iterable[Message], frames: list[int]) -> int:
        """Take meshes at the times of the log, with images in between. Returns the most triangles that the ground
        had."""
        most = waiting = 0
        for message in messages:
            while waiting < len(frames) and frames[waiting] <= message.time:
                self._ground.skip(self._settings, frames[waiting])
                waiting += 1
            with suppress(MessageError):  # it was counted when it was played
                self._mesh(message)
                if message.name == "grid_map":
                    self._ground.skip(self._settings, message.time)
            if (ground := self.meshes.store.parts.get(GRID_KEY)) is not None:
                most = max(most, len(ground.triangles))
        for time_ns in frames[waiting:]:
            self._ground.skip(self._settings, time_ns)
        return most

    def _copy(self, message: Message) -> None:
        data, types = self._recording.copier(message)
        qos = getattr(message.connection.ext, "offered_qos_profiles", [])  # ROS 1 has none
        self._output.copy(message.topic, message.time, message.kind, data, types, qos)

    def _take(self, message: Message) -> None:
        name = message.name
        if name == "depth":
            self._depth(message)
            return
        if name in MESHES:
            self._mesh(message)
            if name == "grid_map":
                self._look_at_ground(message.time)
            return
        content = self._recording.decode(message)
        if name == "info":
            if self._settings.camera_info_policy == "latest":
                self._queue.put_info(content)
        elif name == "tf_static":
            add_transforms(self._background, content, True)
        elif name == "query":
            self._query(content, message.time)
        else:
            pose = LightPose(content.header.frame_id, pose_matrix(content.pose, "pose"))
            self._lighting.move(name.removeprefix("light "), pose)

    def _mesh(self, message: Message) -> None:
        # What is over makes room first, so that whether a mesh fits does not depend on which images came in between.
        self.meshes.store.expire(message.time)
        content = self._recording.decode(message) if message.name == "mesh_cloud" else message.data
        self.meshes.receive(message.name, content, _NOW, message.time)

    def _depth(self, message: Message) -> None:
        try:
            stamp, frame = header_of(message.data)
        except MessageError:
            self._recording.decode(message)  # which says what it is not
            raise
        self._arrive(stamp, frame)
        try:
            self._answer(message, stamp)
        except MessageError:
            self._queue.note_image(stamp)  # it came, and so counts for the camera_info of others
            self._look_at_ground(message.time)
            raise

    def _arrive(self, stamp: int, frame: str) -> None:
        """An image has come, whether or not it is of any use."""
        if stamp < self._last_stamp - _BACKWARD_STAMPS:
            self.result.passes += 1
            self._next_info = 0
            if self._settings.camera_info_policy != "latest":
                self._queue.clear()
        self._last_stamp = stamp
        self._camera_frame = self._settings.camera_frame or frame
        if self._settings.camera_info_policy != "latest":
            self._offer_infos(stamp)

    def _answer(self, message: Message, stamp: int) -> None:
        start, now_ns, topic = time.perf_counter(), message.time, message.topic
        image = self._recording.decode(message)
        depth = decode_depth(image, self._settings.depth_unit)
        decoding = (time.perf_counter() - start) * 1e3
        self._queue.put(WaitingFrame(image, depth, stamp, _NOW, decoding, topic=topic))
        answer = self._processor.step(self._settings, self._tracer, _NOW, now_ns, patient=False)
        if answer is None:
            raise RuntimeError("a frame waits though nothing can come")
        self._note(answer)
        self._publish(answer, now_ns, start)
        self.dose.note(answer, now_ns, self._camera_frame)
        self._look_at_ground(now_ns)

    def _look_at_ground(self, now_ns: int) -> None:
        seen = self._camera_frame, self._last_stamp, now_ns
        if missing := self._ground.look(self._settings, self._tracer, *seen):
            self._give_reason(f"shadow_grid: {missing}")

    def _offer_infos(self, stamp: int) -> None:
        """Give the queue every camera_info up to the stamp of an image [ns], and the one after it."""
        while self._next_info < len(self._info_stamps):
            offered = self._info_stamps[self._next_info]
            self._queue.put_info(self._background.infos[offered])
            self._next_info += 1
            if offered > stamp:
                break

    def _query(self, cloud: Any, now_ns: int) -> None:
        self._queries.put(cloud, self._settings.max_rays, _NOW)
        topic = self._names.topic("~/query/visibility")
        self._queries.step(
            self._settings, self._tracer, self._camera_frame, _LATER, now_ns,
            lambda reply: self._output.message(topic, now_ns, reply),
        )  # fmt: skip
        if self._queries.missing is not None:
            self._give_reason(f"query: {self._queries.missing.text}")

    def _note(self, answer: Answer) -> None:
        result = self.result
        result.frames += 1
        result.traced += answer.missing is None
        result.parts |= dict.fromkeys(self.meshes.store.parts)
        if answer.warning:
            result.warnings[answer.warning] += 1
        if answer.missing is not None:
            self._give_reason(answer.missing.text)

    def _give_reason(self, text: str) -> None:
        key = re.sub(r"[-+]?\d[\d.]*", "#", text)
        first, count = self.result.reasons.get(key, (text, 0))
        self.result.reasons[key] = (first, count + 1)

    def _publish(self, answer: Answer, now_ns: int, start: float) -> None:
        header, topic = answer.frame.image.header, self._names.topic
        made = time.perf_counter()
        for light in answer.enabled:
            mask = published_mask(answer, light, self._settings)
            self._output.image(topic(f"~/mask/{light}"), now_ns, mask, "mono8", header)
            if self._wish.visibility:
                share = answer.visibility(light)
                self._output.image(topic(f"~/visibility/{light}"), now_ns, share, "32FC1", header)
            if self._wish.irradiance:
                self._output.image(topic(f"~/irradiance/{light}"), now_ns, answer.irradiance(light), "32FC1", header)
        if self._wish.irradiance:
            self._output.image(topic("~/irradiance"), now_ns, answer.irradiance(), "32FC1", header)
        self._output.image(topic("~/mask"), now_ns, published_mask(answer, None, self._settings), "mono8", header)
        if len(answer.names) <= MOST_BITS:
            bits = answer.bits()
            encoding = "mono8" if bits.dtype == np.uint8 else "16UC1"
            self._output.image(topic("~/light_bits"), now_ns, bits, encoding, header)
        if self._wish.overlay and answer.optics is not None:
            optics = answer.optics
            picture = overlay(answer.frame.depth, answer.mask(), optics.fx, optics.fy, optics.cx, optics.cy)
            self._output.image(topic("~/overlay"), now_ns, picture, "rgb8", header)
        if answer.mask_info is not None:
            self._output.message(topic("~/camera_info"), now_ns, answer.mask_info)
        end = time.perf_counter()
        if self._wish.timing:
            self._timing(answer, now_ns, {"write": (end - made) * 1e3, "total": (end - start) * 1e3})

    def _timing(self, answer: Answer, now_ns: int, further: dict[str, float]) -> None:
        image = answer.frame.image
        stages = {name: value for name, value in answer.stages.items() if name != "wait"} | further
        numbers = {"width": image.width, "height": image.height} | answer.numbers
        name = f"{self._names.node.lstrip('/')}: timing"
        values = diagnostics.timing_values(stages, numbers)
        level, text = diagnostics.outcome(answer.missing)
        topic = self._names.topic("~/timing")
        self._output.timing(topic, now_ns, image.header, name, level, text, self._tracer.device, values)

    def _sum_up(self) -> None:
        result = self.result
        result.verified, result.differing = self._processor.verified, self._processor.differing
        for name, errors in self._background.refused.items():
            result.refuse(name, errors[-1], len(errors))
        for name, source in self.meshes.sources.items():
            if count := source.refused.count - self._before.get(name, 0):
                result.refuse(name, source.refused.text, count)
        if self._queries.refused.count:
            result.refuse("query", self._queries.refused.text, self._queries.refused.count)
