# SPDX-License-Identifier: Apache-2.0
"""Points of lights with size that are traced one by one, by another pipeline where that costs less."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from shadow_tracer.gpu.accelerators.registry import apart
from shadow_tracer.gpu.device import forms
from shadow_tracer.gpu.engine.band import Band
from shadow_tracer.gpu.engine.gather import Traced
from shadow_tracer.gpu.occluders.seen import TriangleRecords


class Apart:
    """Bands of the same samples as those of a pipeline that asks about all points of a light together, for lights of
    which it does not. They are made when the first light with size comes.

    Args:
        device: on which; on a GPU, and where frames are ``recorded``, there are none.
    """

    def __init__(self, device: Any, recorded: bool) -> None:
        self._possible = forms.wide(device) and not recorded
        self._beside: dict[Band, Band] = {}

    def bands(self) -> list[Band]:
        """All that have been made."""
        return list(self._beside.values())

    def of(self, working: list[Band]) -> list[Band]:
        """Those with the samples of ``working``; these themselves if there are no others."""
        names = apart(*working[0].names)
        if names is None or not self._possible:
            return working
        for band in working:
            if band not in self._beside:
                self._beside[band] = Band(band.context, *names)
        return [self._beside[band] for band in working]


def trace_beside(
    beside: Sequence[Band], working: Sequence[Band], records: TriangleRecords, trace: Callable[[], Traced]
) -> Traced:
    """``trace`` by bands ``beside`` those that are ``working``. Each pipeline makes its own of a light, and tells by
    the records whether it has it."""
    for band in beside:
        band.follow()
    records.forget()
    traced = trace()
    records.forget()
    for band, own in zip(beside, working, strict=True):
        own.busy, band.busy = own.busy + band.busy, 0.0
    return traced
