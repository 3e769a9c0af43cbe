# SPDX-License-Identifier: Apache-2.0
"""What a tracer says about cones: what certainly is free, what certainly is hidden, and what is in them."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from shadow_tracer.scene.checks import FloatArray, truth
from shadow_tracer.scene.cone_checks import check_after, check_axes, check_budget, check_cones, check_count
from shadow_tracer.scene.lights import Light
from shadow_tracer.scene.mesh import Scene
from shadow_tracer.scene.some import Numbering

if TYPE_CHECKING:
    from shadow_tracer.gpu.engine.engine import Engine

Numbers = npt.NDArray[np.int32]


class Outcome(IntEnum):
    """What is certain of a cone."""

    FREE = 0
    """No triangle meets it: every ray from the apex reaches every point of the end."""
    PARTLY = 1
    """Neither is certain."""
    BLOCKED = 2
    """Every ray from the apex to the end is hidden by a triangle."""


class ConeAnswers:
    """The part of :class:`ShadowTracer` that is asked about cones.

    A cone has an apex and an axis; one with an end is cut off across the axis there. All triangles count of the meshes
    that cast shadows, from both sides, whatever ``front_face_culling`` is, but for those of meshes that the light
    ignores of cones to one. Those without area, or with a corner that is not finite, do not. Cones go through the
    structure of the pipeline if that is ``bvh/sah``, ``kd_tree`` or ``brute_force``, otherwise through that of
    ``bvh/sah``, with the same answers; what is not there for frames, and the buffers, are made when a cone is first
    asked about, and count in ``device_bytes``.
    """

    scene: Scene
    _engine: Engine

    def cones(
        self,
        apex: Any,
        target: Any,
        radius: Any = None,
        *,
        half_angle: Any = None,
        length: Any = None,
        first: bool = False,
        budget: int | None = None,
    ) -> npt.NDArray[np.uint8] | tuple[npt.NDArray[np.uint8], Numbers, FloatArray]:
        """What is certain of cones, of all points that they are made of: FREE and BLOCKED are never wrong.

        The cone is closed: it is not FREE if a triangle touches it, or its apex lies on one. PARTLY is also the answer
        where the budget was too small, where something is within roundings (1e-13 of the distances, times 1 + the
        tangent of the half angle) of making a difference, and where several triangles hide the cone that do not join
        edge to edge. Of half angle or radius 0 it is BLOCKED if the end is hidden from the apex as
        :meth:`ShadowTracer.occluded` says, and FREE if not.

        Args:
            apex: (..., 3) positions in the world [m], finite.
            target: (..., 3) where the axis ends [m], or leads if ``length`` is given. Or a light: the axis ends in its
                middle; to one at infinity it has no end unless there is a ``length``, and takes a ``half_angle``.
                Meshes that the light ignores do not count. Its range, and where it shines, play no part.
            radius: (...) of the end [m], at most 14 times the length; or
            half_angle: (...) between axis and mantle [rad], at most 1.5.
            length: (...) of the axis [m]; None: to the target. The end is then rounded to float64.
            first: also find the triangle of each cone that is nearest to the apex, as :meth:`cone_hits` does.
            budget: nodes and triangles that may be looked at for each cone; None is as many as it takes. It does not
                hold for ``first``.

        Leading shapes are broadcast.

        Returns:
            (...) uint8 array of :class:`Outcome` values; with ``first`` also the numbers (...) of triangles, -1 where
            there is none, and distances (...) [m], infinite there.

        Raises:
            ValueError: an argument is malformed; the message names it.
        """
        asked, most = check_cones(apex, target, radius, half_angle, length), check_budget(budget)
        ignored = tuple(target.ignore) if isinstance(target, Light) else ()
        if not truth(first, "first"):
            return self._engine.ask_cones(
                self.scene, lambda cones: cones.outcomes(asked.apices, asked.ends, asked.slopes, most), ignored
            ).reshape(asked.shape)
        outcomes, (numbers, distances) = self._engine.ask_cones(
            self.scene,
            lambda cones: (
                cones.outcomes(asked.apices, asked.ends, asked.slopes, most),
                cones.hits(asked.apices, asked.ends, asked.slopes, 1, None),
            ),
            ignored,
        )
        numbers = Numbering(self.scene).of_scene(numbers)
        return outcomes.reshape(asked.shape), numbers.reshape(asked.shape), distances.reshape(asked.shape)

    def cone_hits(
        self, apex: Any, axis: Any, half_angle: Any, n: int = 8, after: Any = None
    ) -> tuple[Numbers, FloatArray]:
        """The ``n`` triangles of each cone that are nearest to its apex, by distance and then by number.

        The distance of a triangle is how far along the axis its first point inside the cone is. It is rounded, as is
        what is inside: by about 1e-15 of the numbers, and 1e-8 where an edge only just touches the cone. Of half angle
        0 triangles are those that hide a light in the direction of the axis, exactly.

        Args:
            apex: (..., 3) positions in the world [m], finite.
            axis: (..., 3) directions, of any length.
            half_angle: (...) between axis and mantle [rad], at most 1.5.
            n: of each list, at most 4096.
            after: distances (...) and numbers (...) of the last triangles that are not asked for: with those that end
                a list, the next list goes on behind it, and leaves out or repeats none as long as the scene stays.
                Leading shapes are broadcast.

        Returns:
            Numbers (..., n) of triangles, counted through the meshes of the scene in their order, -1 where there are
            no more; and distances (..., n) [m], infinite there.

        Raises:
            ValueError: an argument is malformed; the message names it.
        """
        asked, most = check_axes(apex, axis, half_angle), check_count(n)
        last, numbering = check_after(after, asked.shape), Numbering(self.scene)
        if last is not None:
            last = last[0], numbering.of_occluders(last[1])
        numbers, distances = self._engine.ask_cones(
            self.scene, lambda cones: cones.hits(asked.apices, asked.ends, asked.slopes, most, last)
        )
        numbers = numbering.of_scene(numbers)
        return numbers.reshape(*asked.shape, most), distances.reshape(*asked.shape, most)
