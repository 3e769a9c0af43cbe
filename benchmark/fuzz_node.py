# SPDX-License-Identifier: Apache-2.0
"""Throws messages at every input of the node that no honest publisher sends, and looks at what is left of it.

Messages go straight into the callbacks that the node gave to rclpy, and its work step follows each. For every message:
nothing is raised or warned of, no fault is counted, what must be refused is refused with a text that starts with a
field, and what is in force then can be drawn as markers. Every few hundred a good frame is sent over real topics: its
mask has the very bits it had before. At the end ``/diagnostics`` has counted as many refusals as there were, and
resident memory has not grown.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from harness import SMALL, Rig, plate, wall
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from benchmark.fuzz_messages import INPUTS, Input, Message, cloud_msg, small_frame
from shadow_tracer.ros.diagnostics import PROCESSING, Complaint, Missing
from shadow_tracer.ros.world.marker_feed import Markers

FIELD = re.compile(r"[a-z][a-z0-9_.\[\]]*.*: \S.{4,}", re.DOTALL)  # "step: expected at least ..."
LONGEST_TEXT = 1000
SLOPE_LIMIT = 20.0  # bytes per message: less than the smallest object one could forget to let go of
PEAK_LIMIT = 256.0  # MiB above the state after the first messages: 8 images may wait, of up to 16 MiB and as bytes
SLOWEST_LIMIT = 2.0  # s of processor time
WARM_UP = 0.25


def resident() -> int:
    """Resident memory of this process [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def robust_slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Median of the slopes through all pairs of points (Theil and Sen): a few outliers do not move it."""
    a, b = np.asarray(x, float), np.asarray(y, float)
    i, j = np.triu_indices(len(a), 1)
    return float(np.median((b[j] - b[i]) / (a[j] - a[i]))) if len(i) else 0.0


class Ears:
    """Hears every refusal, and every reason why a mask says unknown, as they are noted."""

    def __init__(self) -> None:
        self.refusals: list[str] = []
        self.missing: list[str] = []

    @contextmanager
    def listening(self) -> Iterator[Ears]:
        """Until the end of the block."""
        add, init = Complaint.add, Missing.__init__

        def heard_add(complaint: Complaint, text: str, now: float) -> None:
            add(complaint, text, now)
            self.refusals.append(complaint.text)

        def heard_init(missing: Missing, status: str, text: str, *rest: Any, **named: Any) -> None:
            init(missing, status, text, *rest, **named)
            self.missing.append(missing.text)

        Complaint.add, Missing.__init__ = heard_add, heard_init  # type: ignore[method-assign]
        try:
            yield self
        finally:
            Complaint.add, Missing.__init__ = add, init  # type: ignore[method-assign]


@contextmanager
def quiet() -> Iterator[None]:
    """Fast CDR writes its own opinion of bad bytes to stderr, past Python; nothing else of the node does."""
    sys.stderr.flush()
    saved, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(nowhere)


class Doors:
    """The callbacks of a node, called as rclpy would. Made anew whenever subscriptions may have been."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._number = 0
        self._by_topic = {subscription.topic_name: subscription for subscription in node.subscriptions}
        self._guards = [guard.callback for guard in node.guards]

    def __contains__(self, topic: str) -> bool:
        return self._node.resolve_topic_name(topic) in self._by_topic

    def knock(self, topic: str, payload: Any) -> None:
        """Give a message to the subscription of a topic, and let the node do what work there is."""
        subscription = self._by_topic[self._node.resolve_topic_name(topic)]
        if not subscription.raw:
            raise TypeError(f"{topic}: expected a raw subscription")
        payload = payload if isinstance(payload, bytes) else bytes(serialize_message(payload))
        self._number += 1
        if subscription._callback_type is Subscription.CallbackType.WithMessageInfo:
            now = time.time_ns()
            info = {"source_timestamp": now, "received_timestamp": now}
            info |= {"publication_sequence_number": self._number, "reception_sequence_number": self._number}
            subscription.callback(payload, info)
        else:
            subscription.callback(payload)
        for work in self._guards:
            work()


class Viewer:
    """Somebody who always looks, to whom ROS reads what comes."""

    def get_subscription_count(self) -> int:
        """One."""
        return 1

    def publish(self, data: bytes) -> None:
        """Read it, and see that every marker has a frame."""
        for marker in deserialize_message(data, MarkerArray).markers[1:]:
            if not marker.header.frame_id or not marker.ns:
                raise ValueError(f"a marker without a name or a frame: {marker}")


@dataclass
class Result:
    """What came of the messages for one input; ``wrong`` holds what should not have happened, the first few of each."""

    name: str
    messages: int = 0
    refused: int = 0
    accepted: int = 0
    checks: int = 0
    slowest: float = 0.0
    slope: float = 0.0
    peak: float = 0.0
    seconds: float = 0.0
    wrong: list[str] = field(default_factory=list)

    def complain(self, what: str) -> None:
        """Note something that should not have happened."""
        if len(self.wrong) < 10:
            self.wrong.append(what)

    def row(self) -> dict[str, Any]:
        """A line of the table."""
        return {
            "input": self.name,
            "messages": self.messages,
            "refused": self.refused,
            "taken": self.accepted,
            "good frames": self.checks,
            "slowest [ms]": self.slowest * 1e3,
            "memory [B/message]": self.slope,
            "peak [MiB]": self.peak,
            "seconds": self.seconds,
            "wrong": len(self.wrong),
        }


class Session:
    """A node, and everything needed to fuzz one of its inputs."""

    def __init__(self, rig: Rig, tried: Input, ears: Ears, seed: int) -> None:
        self.rig = rig
        self.tried = tried
        self.ears = ears
        self.rng = random.Random(f"{tried.name} {seed}")
        self.result = Result(tried.name)
        self.doors = Doors(rig.node)
        self.answers: list[PointCloud2] = []
        self.warned: list[warnings.WarningMessage] = []
        self._memory: list[tuple[int, int]] = []
        core, viewer = rig.core, Viewer()
        self._markers = Markers(viewer, viewer, core.inputs.meshes.store, core.inputs.lighting, lambda _: None)
        self._looks = 0
        if tried.topic == "query":
            rig.listen(PointCloud2, "shadow_tracer/query/visibility", self.answers)

    def prepare(self) -> bool:
        """Bring the node into the good state and remember its mask. False if it has no such input."""
        if self.tried.topic not in self.doors:
            self.result.complain(f"the node does not subscribe to {self.tried.topic}")
            return False
        if "mesh" not in self.tried.topic:
            self.rig.send_mesh(*plate())
        self.restore()
        self.good_mask = self.mask()
        self.good_answer = self.answer()
        if int((self.good_mask == 0).sum()) < 50:
            self.result.complain("the good frame has no shadow")
        return True

    def restore(self) -> None:
        """Send the good messages of this input, straight."""
        for payload in self.tried.good(self.rig.stamp):
            self.doors.knock(self.tried.topic, payload)

    def mask(self) -> np.ndarray:
        """The mask of a good frame, over real topics."""
        if self.tried.topic.startswith("depth/image_rect"):
            self.rig.trace(wall())  # strange stamps are behind us with this one: a jump in time forgets camera_info
        stamp = self.rig.next_stamp()
        if self.tried.with_frame:
            for payload in self.tried.good(stamp):
                self.doors.knock(self.tried.topic, payload)
        mask = self.rig.trace(wall(), stamp=stamp).copy()
        for heard in (*self.rig.masks.values(), self.rig.timings, self.rig.infos):
            heard.clear()
        del self.rig.reports[:-1]
        return mask

    def answer(self) -> bytes:
        """The answer to a good query; nothing for other inputs."""
        if self.tried.topic != "query":
            return b""
        self.answers.clear()
        points = np.linspace((-1.0, -0.2, 2.0), (1.0, 0.2, 2.0), 40)
        self.doors.knock("query", cloud_msg(points, self.rig.stamp))
        self.rig.until(lambda: any(len(cloud.data) == 40 * 20 for cloud in self.answers), what="a query is answered")
        found = next(bytes(cloud.data) for cloud in self.answers if len(cloud.data) == 40 * 20)
        self.answers.clear()
        return found

    def attempt(self, number: int) -> None:
        """One message."""
        message = self.tried.make(self.rng, number)
        self.result.messages += 1
        self.ears.refusals.clear()
        self.ears.missing.clear()
        start = time.thread_time()
        try:
            self.doors.knock(self.tried.topic, message.payload)
            if self.tried.with_image:
                self.doors.knock("depth/image_rect", small_frame(number))
        except Exception as error:
            self.result.complain(f"message {number}: a callback raised {type(error).__name__}: {error}")
        self.result.slowest = max(self.result.slowest, time.thread_time() - start)
        self._draw(number)
        self._judge(message, number)

    def _draw(self, number: int) -> None:
        """What is in force, as markers."""
        inputs, settings = self.rig.core.inputs, self.rig.core.settings
        self._looks += 2  # seconds: nobody may look more often
        now_ns = self.rig.core.now_ns()
        try:
            while self._markers.step(settings, inputs.camera_frame, inputs.last_stamp, self._looks, now_ns):
                pass
        except Exception as error:
            self.result.complain(f"message {number}: markers raised {type(error).__name__}: {error}")

    def _judge(self, message: Message, number: int) -> None:
        texts = self.ears.refusals
        if self.tried.with_image:
            texts = texts + [text for text in self.ears.missing if text.startswith("camera_info")][:1]
        if not texts and message.bad:
            self.result.complain(f"message {number} was taken: {str(message.payload)[:300]}")
        if self.warned:  # Python would write it to stderr
            self.result.complain(f"message {number}: {self.warned[0].message} ({self.warned[0].filename})")
            self.warned.clear()
        if len(texts) > 1:
            self.result.complain(f"message {number} was refused more than once: {texts}")
        for text in texts:
            if not FIELD.fullmatch(text) or len(text) > LONGEST_TEXT:
                self.result.complain(f"message {number} was refused without naming a field: {text[:300]!r}")
        if texts:
            self.result.refused += 1
        else:
            self.result.accepted += 1
            if not self.tried.with_image and not self.tried.with_frame:
                self.restore()

    def check(self, number: int) -> None:
        """The good frame, over real topics, and what memory is held now."""
        self.result.checks += 1
        mask = self.mask()
        if not np.array_equal(mask, self.good_mask):
            differing = int((mask != self.good_mask).sum())
            self.result.complain(f"before message {number}: the good frame differs in {differing} pixels")
        if self.answer() != self.good_answer:
            self.result.complain(f"before message {number}: the good query gets another answer")
        faults = self.rig.value(PROCESSING, "faults")
        if faults not in ("0", ""):
            fault = self.rig.value(PROCESSING, "last fault")
            self.result.complain(f"before message {number}: {faults} faults, the last {fault}")
        self.doors = Doors(self.rig.node)
        self._memory.append((number, resident()))

    def counted(self) -> int:
        """Refusals that /diagnostics counts, of all inputs."""
        before = len(self.rig.reports)
        self.rig.until(lambda: len(self.rig.reports) >= before + 2, what="/diagnostics")
        pairs = [pair for status in self.rig.reports[-1].status for pair in status.values]
        return sum(int(pair.value) for pair in pairs if "refused" in pair.key and pair.value.isdigit())

    def finish(self, judge_memory: bool) -> Result:
        """Take stock."""
        self.rig.until(lambda: self.rig.value(PROCESSING, "faults") == "0", 3.0, "faults is 0")
        late = [entry for entry in self._memory if entry[0] >= WARM_UP * self.result.messages]
        numbers, sizes = zip(*late, strict=True)
        self.result.slope = robust_slope(numbers, sizes)
        self.result.peak = (max(sizes) - sizes[0]) / 2**20
        if judge_memory and (self.result.slope > SLOPE_LIMIT or self.result.peak > PEAK_LIMIT):
            self.result.complain(f"memory grows by {self.result.slope:.1f} bytes per message")
        if self.result.slowest > SLOWEST_LIMIT:
            self.result.complain(f"a message took {self.result.slowest:.2f} s")
        return self.result


def fuzz(tried: Input, messages: int, seed: int = 1, every: int = 500, judge_memory: bool = True) -> Result:
    """Throw ``messages`` messages at one input of a node made for it.

    Args:
        every: messages between two good frames.
        judge_memory: growth of memory counts as wrong; only for some ten thousand messages and more.
    """
    set_logger_level("shadow_tracer", LoggingSeverity.FATAL)
    ears = Ears()
    begin = time.perf_counter()
    with (
        Rig({**SMALL, "mask.unknown_value": 77, **tried.parameters}, codec=tried.codec) as rig,
        ears.listening(),
        warnings.catch_warnings(record=True) as warned,
    ):
        warnings.simplefilter("always")
        session = Session(rig, tried, ears, seed)
        session.warned = warned
        if not session.prepare():
            return session.result
        before = session.counted()
        with quiet():
            for number in range(messages):
                if number % every == 0:
                    session.check(number)
                session.attempt(number)
        session.check(messages)
        expected, counted = session.result.refused, session.counted() - before
        if not tried.with_image and counted != expected:
            session.result.complain(f"/diagnostics counts {counted} refusals, there were {expected}")
        result = session.finish(judge_memory)
    result.seconds = time.perf_counter() - begin
    return result


def main() -> int:
    """Fuzz, print a table, and say by the exit code whether all was right."""
    from benchmark.report import finish

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--messages", type=int, default=100_000, help="per input")
    parser.add_argument("--inputs", nargs="*", default=[tried.name for tried in INPUTS], help="names as in the table")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", help="file to write")
    options = parser.parse_args()
    results = []
    for tried in INPUTS:
        if tried.name in options.inputs:
            results.append(fuzz(tried, options.messages, options.seed, judge_memory=options.messages >= 20_000))
            print(f"{tried.name}: {results[-1].seconds:.0f} s", flush=True)
    finish("Messages that no honest publisher sends", [result.row() for result in results], options.json)
    for result in results:
        for text in result.wrong:
            print(f"WRONG {result.name}: {text[:300]}")
    return int(any(result.wrong for result in results))


if __name__ == "__main__":
    sys.exit(main())
