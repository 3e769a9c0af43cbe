# SPDX-License-Identifier: Apache-2.0
"""Dose maps as messages: the fields of a sensor_msgs/PointCloud2, and coloured lists of triangles. No ROS here."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer import DoseMap
from shadow_tracer.ros.settings import FloatArray
from shadow_tracer.ros.wire.cdr_markers import CLEARED, MarkerMessage
from shadow_tracer.scene.dose_colors import colors_of

CHUNK = 8192  # texels of a marker
# name, offset, datatype, format; rgb is the colour's bytes in a FLOAT32, as the Point Cloud Library has it
FIELDS = (
    ("x", 0, 7, "<f4"),
    ("y", 4, 7, "<f4"),
    ("z", 8, 7, "<f4"),
    ("irradiance", 12, 7, "<f4"),
    ("dose", 16, 7, "<f4"),
    ("rgb", 20, 7, "<u4"),
)
STEP = 24
_NAMES, _OFFSETS, _, _FORMATS = zip(*FIELDS, strict=True)
_LAYOUT: Any = {"names": _NAMES, "offsets": _OFFSETS, "formats": _FORMATS, "itemsize": STEP}
_ROW = np.dtype(_LAYOUT)


def cloud_rows(shown: Mapping[str, DoseMap], target: float) -> npt.NDArray[Any]:
    """(N,) a row of ``FIELDS`` for each texel of all maps: where it is in the world [m], W/m2, J/m2, colour.

    Args:
        shown: maps by part.
        target: dose that is wanted [J/m2].
    """
    return np.concatenate([np.zeros(0, _ROW), *(_rows(each, target) for each in shown.values())])


def _rows(dose_map: DoseMap, target: float) -> npt.NDArray[Any]:
    rows: Any = np.zeros(len(dose_map), _ROW)
    with np.errstate(over="ignore"):  # beyond float32 is infinity
        for name, values in zip("xyz", dose_map.positions().T, strict=True):
            rows[name] = values
        rows["irradiance"], rows["dose"] = dose_map.irradiance, dose_map.dose
    red, green, blue = colors_of(dose_map.dose, target).astype(np.uint32).T
    rows["rgb"] = red << 16 | green << 8 | blue
    return rows


@dataclass(frozen=True, eq=False)
class _Sent:
    """Of a part, as it was last sent: frame, pose and colours, and the corners of its texels in its own frame."""

    world: str
    pose: FloatArray
    colors: npt.NDArray[np.uint8]
    corners: FloatArray


class DoseMarkers:
    """What a viewer has been sent, so that only what is new is sent again."""

    def __init__(self) -> None:
        self._sent: dict[str, _Sent] = {}

    def message(
        self, shown: Mapping[str, DoseMap], target: float, world: str, everything: bool = False
    ) -> list[MarkerMessage]:
        """Markers of some thousand texels each, of those that have another colour or place than when they were sent
        last.

        Args:
            shown: maps by part, of whose name the markers' ``ns`` is made.
            target: dose that is wanted [J/m2].
            world: name of the frame of the world.
            everything: all of them after a DELETEALL, as is done anyway at first and where a part has gone or is cut
                otherwise.

        Returns:
            Empty if nothing is new.
        """
        # The corners of a map are one array for as long as it lives.
        gone = any(part not in shown or shown[part].corners is not old.corners for part, old in self._sent.items())
        message = []
        if gone or (shown and (everything or not self._sent)):  # of another run there may be some, too
            message.append(CLEARED)
            self._sent.clear()
        for part, each in shown.items():
            message += self._new(part, each, target, world)
        return message

    def _new(self, part: str, dose_map: DoseMap, target: float, world: str) -> Iterator[MarkerMessage]:
        old, pose, colors = self._sent.get(part), dose_map.pose(), colors_of(dose_map.dose, target)
        same_place = old is not None and old.world == world and np.array_equal(old.pose, pose)
        for number, begin in enumerate(range(0, len(colors), CHUNK)):
            some = slice(begin, begin + CHUNK)
            if old is not None and same_place and np.array_equal(old.colors[some], colors[some]):
                continue
            points = (dose_map.corners[some] @ pose[:3, :3].T + pose[:3, 3]).reshape(-1, 3)
            shades = np.ones((len(points), 4), np.float32)
            shades[:, :3] = np.repeat(colors[some], 3, axis=0) / np.float32(255.0)
            yield MarkerMessage(f"dose/{part}", number, frame=world, points=points, colors=shades)
        self._sent[part] = _Sent(world, pose, colors, dose_map.corners)
