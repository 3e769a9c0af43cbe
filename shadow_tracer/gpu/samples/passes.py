# SPDX-License-Identifier: Apache-2.0
"""What a pipeline is asked to do at a time."""

from __future__ import annotations

from dataclasses import dataclass

from shadow_tracer.gpu.exact.light_frame import LightFrame


@dataclass(frozen=True)
class Pass:
    """Some consecutive lights of the frame, traced together: their rays and triangle records lie one after the other.
    Ray number i belongs to light i // count of the pass and to sample i % count, count being the number of samples.

    Attributes:
        lights: at most ``Pipeline.lights_together`` of them.
        attempt: 0 looks at every ray; 1 and higher at those left PENDING by a full queue, see
            ``accelerators/participants.py``.
        part: 0 unless a list of the pipeline's own could not hold all of the attempt's work. Then the pipeline has told
            ``FrameBuffers.parts`` how many parts there are, and is asked for the others in turn, with nothing in
            between but the decision of queued pairs.
        keep: what is made of the rays may be asked for ``again``.
        again: rays and states are what they were when the pass was traced last, with ``keep``, and nothing but the
            scene has changed. Both are only asked of a ``Pipeline`` that ``keeps_rays``.
    """

    lights: tuple[LightFrame, ...]
    attempt: int = 0
    part: int = 0
    keep: bool = False
    again: bool = False

    @property
    def light(self) -> LightFrame:
        """The first light; the only one of pipelines that take them one by one."""
        return self.lights[0]

    @property
    def first(self) -> int:
        """Number of the first light."""
        return int(self.lights[0].number)
