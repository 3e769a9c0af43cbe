# SPDX-License-Identifier: Apache-2.0
"""What can be asked about rays that walk through a structure.

A query is a C++ header whose struct ``Query`` takes some rays, is shown triangles, and notes the answers; and the type
of what it needs for that, a struct of Warp named for it. Walks know neither.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import warp as wp

from shadow_tracer.gpu.exact.faces import Occluders
from shadow_tracer.gpu.visibility.answers import Answers


@dataclass(frozen=True)
class Query:
    """One of the questions.

    Attributes:
        header: its C++ header.
        asked: the type of what it needs.
    """

    header: str
    asked: Any

    @property
    def name(self) -> str:
        """The header's, without folder and ending."""
        return PurePath(self.header).stem


@wp.struct
class AnyHit:
    """Whether anything hides the rays of one light: in the frame of that light, with the triangles as it sees them."""

    rays: wp.array(dtype=wp.vec4)
    occluders: Occluders
    answers: Answers


ANY_HIT = Query("visibility/any_hit.h", AnyHit)
ALL = (ANY_HIT,)
