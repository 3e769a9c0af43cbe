# SPDX-License-Identifier: Apache-2.0
"""What arrives, whatever the message or file was: parts, and what is to be changed about them. No ROS here."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from shadow_tracer.ros.settings import FloatArray

FILES = "files/"  # keys of parts that come from files: they do not age


class PartError(ValueError):
    """Something that was received cannot be used; the text starts with the field. Nothing of it was kept."""


IDENTITY = np.eye(4)
IDENTITY.setflags(write=False)


def _identity() -> FloatArray:
    return IDENTITY


@dataclass(frozen=True, eq=False)
class Part:
    """One mesh as it was received.

    Attributes:
        key: unique name: "mesh", "cloud", "grid_map", "markers/<ns>/<id>", "files/<n>".
        vertices: (V, 3) float64 [m], read-only, owning; those that a triangle uses are finite.
        triangles: (T, 3) int32, read-only, owning, in range. The same object as before means the same topology.
        frame: frame of ``pose``; "" is the parameter ``mesh.frame``.
        stamp: time at which the frame is looked up [ns]; 0 is the stamp of the depth image.
        pose: (4, 4) rigid transform to ``frame``.
        locked: True: moves with its frame; False: stays where its frame was at ``stamp``.
        expires: time of the node's clock after which it is gone [ns]; None never.
        field: what messages call its frame.
    """

    key: str
    vertices: FloatArray
    triangles: npt.NDArray[np.int32]
    frame: str = ""
    stamp: int = 0
    pose: FloatArray = field(default_factory=_identity)
    locked: bool = True
    expires: int | None = None
    field: str = "mesh.frame"

    @property
    def drawn(self) -> npt.NDArray[np.int32]:
        """(T, 3) the triangles that there is something to be seen of; read-only."""
        return self.triangles


@dataclass(frozen=True)
class Changes:
    """What a message asks for, applied in this order.

    Attributes:
        clear: all parts whose key starts with this go; None is none.
        remove: the parts of these keys go; unknown ones are ignored.
        put: these come, or replace those of their keys.
    """

    put: tuple[Part, ...] = ()
    remove: tuple[str, ...] = ()
    clear: str | None = None


_soups: OrderedDict[int, npt.NDArray[np.int32]] = OrderedDict()


def soup_triangles(count: int) -> npt.NDArray[np.int32]:
    """(count, 3) int32 read-only indices 0, 1, 2, ...: every three vertices one triangle. The same object again for the
    same count, so that a soup of as many triangles counts as deformed."""
    found = _soups.pop(count, None)
    if found is None:
        found = np.empty((count, 3), np.int32)  # a reshaped view would not own its memory, and the scene would copy it
        found.reshape(-1)[:] = np.arange(3 * count, dtype=np.int32)
        found.setflags(write=False)
    _soups[count] = found
    if len(_soups) > 16:
        _soups.popitem(last=False)
    return found
