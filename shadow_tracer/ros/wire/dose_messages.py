# SPDX-License-Identifier: Apache-2.0
"""Dose maps as messages: the fields of a sensor_msgs/PointCloud2, and coloured lists of triangles. No ROS here."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from shadow_tracer import DoseMap
from shadow_tracer.ros.settings import FloatArray
from shadow_tracer.ros.wire.cdr_markers import MarkerMessage
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


def cloud_rows(dose_map: DoseMap, target: float) -> npt.NDArray[Any]:
    """(N,) a row of ``FIELDS`` for each texel: where it is in the world [m], W/m2, J/m2, colour."""
    names, offsets, _, formats = zip(*FIELDS, strict=True)
    layout: Any = {"names": names, "offsets": offsets, "formats": formats, "itemsize": STEP}
    rows: Any = np.zeros(len(dose_map), np.dtype(layout))
    with np.errstate(over="ignore"):  # beyond float32 is infinity
        for name, values in zip("xyz", dose_map.positions().T, strict=True):
            rows[name] = values
        rows["irradiance"], rows["dose"] = dose_map.irradiance, dose_map.dose
    red, green, blue = colors_of(dose_map.dose, target).astype(np.uint32).T
    rows["rgb"] = red << 16 | green << 8 | blue
    return rows


def colored_chunks(
    part: str, dose_map: DoseMap, target: float, world: str, corners: FloatArray, sent: dict[tuple[str, int], bytes]
) -> Iterator[MarkerMessage]:
    """Markers of some thousand texels each, of those whose colours are not those in ``sent``, which follows.

    Args:
        part: name of the part, of which the markers' ``ns`` is made.
        corners: (N, 3, 3) of the texels in the world [m].
        sent: colours and places by part and number of the chunk, as they were last sent.
    """
    colors = colors_of(dose_map.dose, target)
    for number, begin in enumerate(range(0, len(colors), CHUNK)):
        some = colors[begin : begin + CHUNK]
        points = corners[begin : begin + CHUNK].reshape(-1, 3)
        key = some.tobytes() + points[:1].tobytes() + points[-1:].tobytes()
        if sent.get((part, number)) == key:
            continue
        sent[part, number] = key
        shades = np.ones((len(points), 4), np.float32)
        shades[:, :3] = np.repeat(some, 3, axis=0) / np.float32(255.0)
        yield MarkerMessage(f"dose/{part}", number, frame=world, points=points, colors=shades)
