# SPDX-License-Identifier: Apache-2.0
"""When markers are sent: to somebody, after a change, at most once a second, and drawn in turns. No ROS here.

Every message is all there is to see. It begins with DELETEALL, so the last one alone, which is kept for late joiners,
is right for whoever missed those before.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from typing import Any, Protocol

from shadow_tracer.ros.settings import Settings
from shadow_tracer.ros.wire.cdr_markers import MarkerMessage, encode_markers
from shadow_tracer.ros.world.light_markers import light_markers
from shadow_tracer.ros.world.lighting import Lighting
from shadow_tracer.ros.world.mesh_store import MeshStore
from shadow_tracer.ros.world.scene_markers import ShownPart, draw_parts, shown_parts, world_name

PERIOD = 1.0  # least time between two looks [s]
NAMELESS = (
    "scene_markers and light_markers leave out what is in a world without a name; set fixed_frame, which gives it one"
)


class Sink(Protocol):
    """What is needed of a publisher."""

    def get_subscription_count(self) -> int:
        """How many listen."""

    def publish(self, data: bytes) -> None:
        """Send a serialised message."""


class MarkerFeed:
    """One topic.

    Args:
        sink: where it goes.
        draw: makes a message of what there is to see, and yields between pieces of that work.
        same: whether two things that were seen look the same.
    """

    def __init__(
        self, sink: Sink, draw: Callable[[Any], Generator[None, None, bytes]], same: Callable[[Any, Any], bool]
    ) -> None:
        self._sink = sink
        self._draw = draw
        self._same = same
        self._listeners = 0
        self._looked = float("-inf")
        self._seen: Any = None
        self._work: Generator[None, None, bytes] | None = None

    def step(self, now: float, look: Callable[[], Any]) -> bool:
        """One turn. True if there is another one to be had at once.

        Args:
            now: steady time [s].
            look: called for what there is to see, if somebody listens and the last look was long enough ago.
        """
        listeners = self._sink.get_subscription_count()
        if not listeners:
            self._listeners, self._seen, self._work = 0, None, None
            return False
        if self._work is None:
            if now - self._looked < PERIOD:
                return False
            self._looked = now
            seen = look()
            came = listeners > self._listeners  # whose durability may be volatile
            self._listeners = listeners
            if not came and self._same(seen, self._seen):
                self._seen = seen  # so that what it was is not kept
                return False
            self._seen, self._work = seen, self._draw(seen)
        work, self._work = self._work, None  # one that raises is not asked again
        try:
            next(work)
        except StopIteration as done:
            self._looked = now
            self._sink.publish(done.value)
            return False
        self._work = work
        return True


class Markers:
    """Both topics.

    Args:
        scene, lights: where they go.
        store: the parts.
        lighting: poses of lights that topics gave.
        warn: called with a sentence about what cannot be shown.
    """

    def __init__(
        self, scene: Sink, lights: Sink, store: MeshStore, lighting: Lighting, warn: Callable[[str], None]
    ) -> None:
        self._scene = MarkerFeed(scene, draw_parts, _same_parts)
        self._lights = MarkerFeed(lights, _draw_lights, _same_lights)
        self._store = store
        self._lighting = lighting
        self._warn = warn

    def step(self, settings: Settings, camera_frame: str, stamp: int, now: float, now_ns: int) -> bool:
        """One turn of each. True if one of them has another one at once.

        Args:
            camera_frame: optical frame of the last depth image, "" before there is one.
            stamp: that of the last depth image [ns], 0 before there is one.
            now: steady time [s].
            now_ns: time of the node's clock [ns], on which parts expire.
        """
        world = world_name(settings, camera_frame)

        def parts() -> list[ShownPart]:
            self._store.expire(now_ns)
            return self._named(settings, shown_parts(self._store, settings, world))

        def lights() -> list[MarkerMessage]:
            return self._named(settings, light_markers(settings, self._lighting, world, stamp))

        more = self._scene.step(now, parts)
        return self._lights.step(now, lights) or more

    def _named(self, settings: Settings, found: tuple[list[Any], int]) -> list[Any]:
        shown, nameless = found
        if nameless and settings.pose_source != "tf":  # with tf the first image brings the name
            self._warn(NAMELESS)
        return shown


def _same_parts(one: Sequence[ShownPart], other: Sequence[ShownPart] | None) -> bool:
    return other is not None and len(one) == len(other) and all(a.same(b) for a, b in zip(one, other, strict=True))


def _draw_lights(markers: Sequence[MarkerMessage]) -> Generator[None, None, bytes]:
    yield from ()
    return encode_markers(markers)


def _same_lights(one: Sequence[MarkerMessage], other: Sequence[MarkerMessage] | None) -> bool:
    return other is not None and encode_markers(one) == encode_markers(other)
