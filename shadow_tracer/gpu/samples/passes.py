# SPDX-License-Identifier: Apache-2.0
"""What an accelerator is asked to do at a time."""

from __future__ import annotations

from dataclasses import dataclass

from shadow_tracer.gpu.exact.light_frame import LightFrame


@dataclass(frozen=True)
class Pass:
    """Some consecutive lights of the frame, traced together: their rays and triangle records lie one after the other.
    Ray number i belongs to light i // count of the pass and to sample i % count, count being the number of samples.

    Attributes:
        lights: at most ``Traits.lights_at_once`` of them.
        keep: what is made of the rays may be asked for ``again``.
        again: rays and states are what they were when the pass was traced last, with ``keep``, and nothing but the
            scene has changed. Both are only asked of an accelerator that ``keeps_rays``.
    """

    lights: tuple[LightFrame, ...]
    keep: bool = False
    again: bool = False

    @property
    def light(self) -> LightFrame:
        """The first light; the only one of accelerators that take them one by one."""
        return self.lights[0]

    @property
    def first(self) -> int:
        """Number of the first light."""
        return int(self.lights[0].number)
