# SPDX-License-Identifier: Apache-2.0
"""Transforms without ROS, for recordings: all of tf is known from the start, and nothing is forgotten by age.

It answers as tf2 does, interpolation and refusals included; only products of rotations are rounded differently.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.ros.diagnostics import TRANSFORMS, Missing
from shadow_tracer.ros.settings import FloatArray
from shadow_tracer.ros.wire.messages import MessageError, frame_name, rigid

Vector = tuple[float, ...]


@dataclass
class _Edge:
    """From one frame to its parent: by stamp, or static."""

    static: tuple[str, FloatArray] | None = None
    known: dict[int, tuple[str, Vector, Vector]] = field(default_factory=dict)  # stamp -> parent, position, quaternion
    stamps: list[int] = field(default_factory=list)

    def at(self, stamp: int) -> tuple[str, FloatArray]:
        """Parent and (4, 4) transform to it. Raises _Unknown."""
        if self.static is not None:
            return self.static
        if len(self.stamps) != len(self.known):
            self.stamps = sorted(self.known)
        if not self.stamps:
            raise _Unknown("Lookup would require extrapolation: all data was cleared")
        place = bisect_left(self.stamps, stamp)
        if place < len(self.stamps) and self.stamps[place] == stamp:
            parent, position, quaternion = self.known[stamp]
            return parent, rigid(position, quaternion, "transform")
        if place in (0, len(self.stamps)):
            raise _Unknown(_extrapolation(stamp, self.stamps))
        return _between(stamp, self.stamps[place - 1], self.stamps[place], self.known)


class _Unknown(Exception):
    pass


class TransformTree:
    """Transforms by child frame, from a bag or a program; use it as the ``open_tf`` of :class:`frames.Frames`."""

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}
        self._names: set[str] = set()

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of all frames, sorted."""
        return tuple(sorted(self._names))

    def add(self, child: str, parent: str, stamp: int, translation: Vector, quaternion: Vector, static: bool) -> None:
        """Add a transform, one of a /tf or /tf_static message.

        Args:
            child: frame whose coordinates it takes.
            parent: frame whose coordinates it gives.
            stamp: when it holds [ns]; of no meaning if ``static``.
            translation: x y z [m].
            quaternion: x y z w, unit.
            static: holds at all times, until another one for the same child is added.

        Raises:
            MessageError: not finite, not a unit quaternion, a frame without name, or child and parent are the same.
        """
        child, parent = (frame_name(name) for name in (child, parent))
        if not child or not parent or child == parent:
            raise MessageError(f"child_frame_id: expected two different frames, got {child!r} in {parent!r}")
        matrix = rigid(translation, quaternion, f"transform from {child} to {parent}")
        edge = self._edges.setdefault(child, _Edge())
        self._names |= {child, parent}
        if static:
            edge.static = (parent, matrix)
        else:
            edge.static = None  # as in tf2, what came last says what the frame is
            edge.known[stamp] = (parent, tuple(translation), tuple(quaternion))

    def copy(self) -> TransformTree:
        """Another one with the same transforms. To add static ones to it leaves this one as it is."""
        other = TransformTree()
        other._names = set(self._names)
        other._edges = {child: replace(edge) for child, edge in self._edges.items()}
        return other

    def rows(self) -> dict[str, npt.NDArray[Any]]:
        """Everything in arrays, which :meth:`of_rows` takes: names, static transforms, and those with a stamp."""
        names = list(self.frames)
        number = {name: place for place, name in enumerate(names)}
        moving, still = [], []
        values, matrices = [], []
        for child, edge in self._edges.items():
            for stamp, (parent, position, quaternion) in edge.known.items():
                moving.append((number[child], number[parent], stamp))
                values.append((*position, *quaternion))
            if edge.static is not None:
                still.append((number[child], number[edge.static[0]]))
                matrices.append(edge.static[1])
        return {
            "names": np.array(names, np.str_),
            "moving": np.array(moving, np.int64).reshape(-1, 3),
            "values": np.array(values, np.float64).reshape(-1, 7),
            "still": np.array(still, np.int64).reshape(-1, 2),
            "matrices": np.array(matrices, np.float64).reshape(-1, 4, 4),
        }

    @staticmethod
    def of_rows(rows: Mapping[str, npt.NDArray[Any]]) -> TransformTree:
        """The tree whose :meth:`rows` these are."""
        made, names = TransformTree(), [str(name) for name in rows["names"]]
        made._names = set(names)
        for (child, parent, stamp), numbers in zip(rows["moving"].tolist(), rows["values"].tolist(), strict=True):
            edge = made._edges.setdefault(names[child], _Edge())
            edge.known[stamp] = (names[parent], tuple(numbers[:3]), tuple(numbers[3:]))
        for (child, parent), matrix in zip(rows["still"].tolist(), rows["matrices"], strict=True):
            made._edges.setdefault(names[child], _Edge()).static = (names[parent], matrix)
        return made

    def lookup(self, target: str, source: str, stamp: int, purpose: str) -> FloatArray:
        """(4, 4) transform from ``source`` to ``target`` at a stamp [ns]. Raises Missing; no waiting helps."""
        try:
            return self._find(target, source, stamp)
        except _Unknown as unknown:
            raise Missing(
                TRANSFORMS,
                f"no transform from {source!r} to {target!r} {purpose}: {unknown}; record /tf and /tf_static as well, "
                "from before the first image until after the last",
                wait=False,
            ) from unknown

    def is_static(self, target: str, source: str) -> bool:
        """True if every transform between the two is static."""
        return bool(set(self._static_ancestors(source)) & set(self._static_ancestors(target)))

    def clear(self) -> None:
        """Forget everything with a stamp. Static transforms stay."""
        for edge in self._edges.values():
            edge.known.clear()
            edge.stamps.clear()

    def close(self) -> None:
        """Nothing is listened to."""

    def _static_ancestors(self, frame: str) -> list[str]:
        chain = [frame]
        while (edge := self._edges.get(chain[-1])) is not None and edge.static is not None:
            if edge.static[0] in chain:
                break
            chain.append(edge.static[0])
        return chain

    def _find(self, target: str, source: str, stamp: int) -> FloatArray:
        for name, role in ((target, "target"), (source, "source")):
            if name not in self._names:
                raise _Unknown(f'"{name}" passed to lookupTransform argument {role}_frame does not exist')
        from_source, source_gap = self._climb(source, stamp)
        from_target, target_gap = self._climb(target, stamp)
        common = next((frame for frame in from_target if frame in from_source), None)
        if common is not None:
            return _inverse(from_target[common]) @ from_source[common]
        gap = target_gap or source_gap
        if gap:
            raise _Unknown(f"{gap}, when looking up transform from frame [{source}] to frame [{target}]")
        raise _Unknown(
            f"Could not find a connection between '{target}' and '{source}' because they are not part of the same "
            "tree.Tf has two or more unconnected trees"
        )

    def _climb(self, frame: str, stamp: int) -> tuple[dict[str, FloatArray], str]:
        """Transforms to a frame and all above it as far as they are known, and what ended the way; "" at the top."""
        found, gap = {frame: np.eye(4)}, ""
        while (edge := self._edges.get(frame)) is not None:
            try:
                parent, matrix = edge.at(stamp)
            except _Unknown as unknown:
                gap = str(unknown)
                break
            if parent in found:
                raise _Unknown(f"The tf tree is invalid because it contains a loop: {' '.join([*found, parent])}")
            found[parent] = matrix @ found[frame]
            frame = parent
        return found, gap


def _between(
    stamp: int, before: int, after: int, known: dict[int, tuple[str, Vector, Vector]]
) -> tuple[str, FloatArray]:
    try:
        from scipy.spatial.transform import Rotation, Slerp
    except ImportError as error:
        raise ImportError("to interpolate transforms scipy is needed: pip install 'shadow_tracer[bag]'") from error
    (parent, start, turned), (other, end, turned_to) = known[before], known[after]
    if parent != other:
        return parent, rigid(start, turned, "transform")
    ratio = (stamp - before) / (after - before)
    rotation = Slerp([0.0, 1.0], Rotation.from_quat([turned, turned_to]))(ratio)
    position = np.asarray(start) * (1.0 - ratio) + np.asarray(end) * ratio
    return parent, rigid(position, rotation.as_quat(), "transform")


def _extrapolation(stamp: int, stamps: list[int]) -> str:
    """What tf2 says."""
    when = f"{stamp * 1e-9:.6f}"
    if len(stamps) == 1:
        return (
            f"Lookup would require extrapolation at time {when}, but only time {stamps[0] * 1e-9:.6f} is in the buffer"
        )
    direction, kind, limit = ("past", "earliest", stamps[0]) if stamp < stamps[0] else ("future", "latest", stamps[-1])
    return (
        f"Lookup would require extrapolation into the {direction}.  Requested time {when} but the {kind} data is at "
        f"time {limit * 1e-9:.6f}"
    )


def _inverse(rigid_transform: FloatArray) -> FloatArray:
    inverse = np.eye(4)
    inverse[:3, :3] = rigid_transform[:3, :3].T
    inverse[:3, 3] = -(rigid_transform[:3, :3].T @ rigid_transform[:3, 3])
    return inverse
