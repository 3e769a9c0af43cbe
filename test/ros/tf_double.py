# SPDX-License-Identifier: Apache-2.0
"""A stand-in for the module tf2_ros, which the wheels do not have. It follows tf2's own buffer and listener: which
exception comes when and in what words, what is interpolated, what is forgotten. Waiting, callbacks and services are not
there. No ROS is needed: its messages have the fields of TransformStamped, and it takes anything that has."""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

SECOND = 1_000_000_000
_DEEPEST = 1000

Storage = tuple[int, str, np.ndarray, np.ndarray]  # stamp, parent, quaternion x y z w, translation


class TransformException(Exception):
    """Base of what a lookup raises, as in tf2_ros."""


class LookupException(TransformException):
    """A frame does not exist, or the tree has a loop."""


class ConnectivityException(TransformException):
    """Both frames exist, in trees that are not connected."""


class ExtrapolationException(TransformException):
    """The stamp is outside of what is known."""


class InvalidArgumentException(TransformException):
    """The name of a frame cannot be one."""


class _TimeCache:
    """Transforms of one frame to its parents, newest first."""

    def __init__(self, cache_time: int) -> None:
        self.storage: list[Storage] = []
        self.cache_time = cache_time

    def insert(self, new: Storage) -> bool:
        if self.storage and new[0] + self.cache_time < self.storage[0][0]:
            return False
        place = next((i for i, old in enumerate(self.storage) if old[0] <= new[0]), len(self.storage))
        self.storage.insert(place, new)
        while self.storage[-1][0] + self.cache_time < self.storage[0][0]:
            self.storage.pop()
        return True

    def clear(self) -> None:
        self.storage.clear()

    def latest(self) -> tuple[int, str]:
        return self.storage[0][:2] if self.storage else (0, "")

    def data(self, time: int) -> Storage:
        """Raises _Gap."""
        if not self.storage:
            raise _Gap("")
        newest, oldest = self.storage[0], self.storage[-1]
        if time in (0, newest[0]):
            return newest
        if len(self.storage) == 1:
            raise _Gap(
                f"Lookup would require extrapolation at time {_show(time)}, but only time {_show(newest[0])} is in "
                "the buffer"
            )
        if time == oldest[0]:
            return oldest
        if time > newest[0]:
            raise _Gap(
                f"Lookup would require extrapolation into the future.  Requested time {_show(time)} but the latest "
                f"data is at time {_show(newest[0])}"
            )
        if time < oldest[0]:
            raise _Gap(
                f"Lookup would require extrapolation into the past.  Requested time {_show(time)} but the earliest "
                f"data is at time {_show(oldest[0])}"
            )
        place = next(i for i, old in enumerate(self.storage) if old[0] <= time)
        older, newer = self.storage[place], self.storage[place - 1]
        if older[1] != newer[1]:
            return older
        ratio = (time - older[0]) / (newer[0] - older[0])
        return older[0], older[1], _slerp(older[2], newer[2], ratio), older[3] + ratio * (newer[3] - older[3])


class _StaticCache:
    """The one transform of a frame that holds at all times. Clearing leaves it."""

    def __init__(self, cache_time: int) -> None:
        self.storage: Storage

    def insert(self, new: Storage) -> bool:
        self.storage = new
        return True

    def clear(self) -> None:
        return None

    def latest(self) -> tuple[int, str]:
        return 0, self.storage[1]

    def data(self, time: int) -> Storage:
        return (time, *self.storage[1:])


class _Gap(Exception):
    """A cache has nothing at that time; the text is what tf2 says."""


class BufferCore:
    """Transforms by frame. ``cache_time`` is a Duration, 10 s if None."""

    def __init__(self, cache_time: Any = None) -> None:
        self.cache_time = 10 * SECOND if cache_time is None else cache_time.nanoseconds
        self.caches: dict[str, _TimeCache | _StaticCache] = {}
        self.names: set[str] = set()

    def set_transform(self, transform: Any, authority: str) -> None:
        """A transform of /tf; one that cannot be is ignored."""
        self._set(transform, _TimeCache)

    def set_transform_static(self, transform: Any, authority: str) -> None:
        """A transform of /tf_static."""
        self._set(transform, _StaticCache)

    def clear(self) -> None:
        """Forget what has stamps; frames and static transforms stay."""
        for cache in self.caches.values():
            cache.clear()

    def lookup_transform_core(self, target_frame: str, source_frame: str, time: Any) -> Any:
        """The transform that takes coordinates of ``source_frame`` to ``target_frame``; time 0 is the latest common."""
        when = time.nanoseconds
        if target_frame == source_frame:
            cache = self.caches.get(target_frame)
            when = when or (cache.latest()[0] if cache else 0)
            return _message(target_frame, source_frame, when, (0.0, 0.0, 0.0, 1.0), np.zeros(3))
        self._validate("lookupTransform argument target_frame", target_frame)
        self._validate("lookupTransform argument source_frame", source_frame)
        when = when or self._latest_common_time(target_frame, source_frame)
        quaternion, vector = self._walk(target_frame, source_frame, when)
        return _message(target_frame, source_frame, when, quaternion, vector)

    def can_transform_core(self, target_frame: str, source_frame: str, time: Any) -> tuple[bool, str]:
        """Whether a lookup would answer, and why not."""
        try:
            self.lookup_transform_core(target_frame, source_frame, time)
        except TransformException as error:
            return False, str(error)
        return True, ""

    def _set(self, msg: Any, kind: type[_TimeCache | _StaticCache]) -> None:
        parent, child = msg.header.frame_id.removeprefix("/"), msg.child_frame_id.removeprefix("/")
        t, q = msg.transform.translation, msg.transform.rotation
        quaternion, vector = np.array([q.x, q.y, q.z, q.w]), np.array([t.x, t.y, t.z])
        unit = abs(float(quaternion @ quaternion) - 1.0) < 10e-3
        if child == parent or not child or not parent or not unit or np.isnan(vector).any():
            return
        if type(self.caches.get(child)) is not kind:
            self.caches[child] = kind(self.cache_time)
        stamp = msg.header.stamp.sec * SECOND + msg.header.stamp.nanosec
        if self.caches[child].insert((stamp, parent, quaternion, vector)):
            self.names |= {parent, child}

    def _validate(self, what: str, frame: str) -> None:
        for wrong, why in ((not frame, "cannot be empty"), (frame.startswith("/"), "cannot start with a '/'")):
            if wrong:
                raise InvalidArgumentException(f'Invalid argument "{frame}" passed to {what} - in tf2 frame_ids {why}')
        if frame not in self.names:
            raise LookupException(f'"{frame}" passed to {what} does not exist. ')

    def _latest_common_time(self, target: str, source: str) -> int:
        """The earliest of the latest stamps between the two; 0 if there is none but static transforms."""
        chains = []
        for frame in (source, target):
            chain: list[tuple[int, str]] = [(0, frame)]
            while (cache := self.caches.get(chain[-1][1])) is not None and cache.latest()[1]:
                chain.append(cache.latest())
                if len(chain) > _DEEPEST:
                    raise LookupException("The tf tree is invalid because it contains a loop.")
            chains.append(chain)
        names = [[name for _, name in chain] for chain in chains]
        common = next((name for name in names[1] if name in names[0]), None)
        if common is None:
            raise ConnectivityException(_unconnected(target, source))
        ways = [chain[: name.index(common) + 1] for chain, name in zip(chains, names, strict=True)]
        return min((stamp for way in ways for stamp, _ in way if stamp), default=0)

    def _walk(self, target: str, source: str, when: int) -> tuple[np.ndarray, np.ndarray]:
        up, gap = self._climb(source, when, {})
        down, late = self._climb(target, when, up)
        top = next((frame for frame in down if frame in up), None)
        if top is None:
            error = late if late is not None else gap
            if error is None:
                raise ConnectivityException(_unconnected(target, source))
            raise ExtrapolationException(
                f"{error}, when looking up transform from frame [{source}] to frame [{target}]"
            )
        (q, v), (q_target, v_target) = up[top], down[top]
        back = q_target * (-1.0, -1.0, -1.0, 1.0)
        return _multiply(back, q), _rotate(back, v - v_target)

    def _climb(self, frame: str, when: int, until: dict[str, Any]) -> tuple[dict[str, Any], str | None]:
        found = {frame: (np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3))}
        while frame not in until and (cache := self.caches.get(frame)) is not None:
            try:
                _, parent, quaternion, vector = cache.data(when)
            except _Gap as gap:
                return found, str(gap)
            if parent in found:
                raise LookupException("The tf tree is invalid because it contains a loop.")
            q, v = found[frame]
            found[parent] = (_multiply(quaternion, q), _rotate(quaternion, v) + vector)
            frame = parent
        return found, None


class Buffer(BufferCore):
    """As tf2_ros.Buffer, with a way to fill it in tests."""

    def __init__(self, cache_time: Any = None, node: Any = None) -> None:
        super().__init__(cache_time)
        self.node = node
        self.cleared = 0
        self.asked = 0

    def lookup_transform(self, target_frame: str, source_frame: str, time: Any, timeout: Any = None) -> Any:
        """As tf2_ros, without waiting."""
        assert timeout is None, "the node must not wait in a callback"
        self.asked += 1
        with np.errstate(invalid="ignore"):  # infinite translations pass, as in C++
            return self.lookup_transform_core(target_frame, source_frame, time)

    def clear(self) -> None:
        """As tf2_ros; counted."""
        self.cleared += 1
        super().clear()

    def put(self, target: str, source: str, x: float, until: int, since: int | None = None) -> None:
        """A transform along x, turned by 90 degrees about z, known between two stamps [ns], a second by default."""
        turn = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
        for stamp in (max(until - SECOND, 1) if since is None else since, until):
            self.set_transform(transform(target, source, stamp, (x, 0.0, 0.0), turn), "test")


def transform(
    parent: str,
    child: str,
    stamp: int,
    translation: Sequence[float] = (0.0, 0.0, 0.0),
    rotation: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
) -> Any:
    """A message with a stamp in ns, a translation [m] and a quaternion x y z w."""
    return _message(parent, child, stamp, np.asarray(rotation), np.asarray(translation))


def module() -> tuple[ModuleType, list[Buffer]]:
    """A module to put in place of tf2_ros, and the buffers that will be made with it."""
    made: list[Buffer] = []
    double = ModuleType("tf2_ros")

    def make(*args: Any, **kwargs: Any) -> Buffer:
        made.append(Buffer(*args, **kwargs))
        return made[-1]

    class TransformListener:
        def __init__(self, buffer: Buffer, node: Any, *, spin_thread: bool = False) -> None:
            assert isinstance(buffer, Buffer) and not spin_thread
            buffer.node = node
            self.buffer = buffer

        def unregister(self) -> None:
            self.buffer.node = None

    contents = {
        "Buffer": make,
        "TransformListener": TransformListener,
        "TransformException": TransformException,
        "LookupException": LookupException,
        "ConnectivityException": ConnectivityException,
        "ExtrapolationException": ExtrapolationException,
        "InvalidArgumentException": InvalidArgumentException,
    }
    vars(double).update(contents)
    return double, made


def _message(parent: str, child: str, stamp: int, rotation: Any, translation: Any) -> Any:
    stamped = SimpleNamespace(stamp=SimpleNamespace(sec=stamp // SECOND, nanosec=stamp % SECOND), frame_id=parent)
    shift, turn = (
        SimpleNamespace(**{axis: float(value) for axis, value in zip(axes, values, strict=True)})
        for axes, values in (("xyz", translation), ("xyzw", rotation))
    )
    return SimpleNamespace(
        header=stamped, child_frame_id=child, transform=SimpleNamespace(translation=shift, rotation=turn)
    )


def _show(stamp: int) -> str:
    return f"{stamp * 1e-9:.6f}"


def _unconnected(target: str, source: str) -> str:
    return (
        f"Could not find a connection between '{target}' and '{source}' because they are not part of the same tree."
        "Tf has two or more unconnected trees."
    )


def _multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    vector = a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3])
    return np.array([*vector, a[3] * b[3] - a[:3] @ b[:3]])


def _rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    return _multiply(_multiply(q, np.array([*v, 0.0])), q * (-1.0, -1.0, -1.0, 1.0))[:3]


def _slerp(a: np.ndarray, b: np.ndarray, ratio: float) -> np.ndarray:
    cosine = float(a @ b) / math.sqrt(float(a @ a) * float(b @ b))
    sign = -1.0 if cosine < 0.0 else 1.0
    angle = math.acos(min(abs(cosine), 1.0))
    if angle == 0.0:
        return a
    return (math.sin((1.0 - ratio) * angle) * a + sign * math.sin(ratio * angle) * b) / math.sin(angle)
