# SPDX-License-Identifier: Apache-2.0
"""What parts of the scene receive while the node runs: a dose map of each part that is named. No ROS here.

Time is that of the node's clock between two images of which everything is known. An interval counts in the lights of
the image at its end; one longer than a second is a pause, and so is one in which the clock jumps, or that an image
begins or ends of which nothing is known: these never count. Exposures are added once a second, with everything where it
is then, and at once when a light changes; of what waits when a pause begins, up to a second, nothing is added.

With several cameras the images of all count, and one of which nothing is known begins no pause while everything is
known of another camera's.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from urllib.parse import quote

from shadow_tracer import DoseMap, IntensityTable, ShadowTracer
from shadow_tracer.ros.settings import Settings
from shadow_tracer.scene.lights import Light
from shadow_tracer.scene.strength import QUANTITIES

LONGEST = 1.0  # between two images [s]
PERIOD = 1.0  # of exposures [s]


class Exposure:
    """Dose maps by part.

    Attributes:
        maps: those of the parts that have been there.
        trouble: why a part that is named has no map, or has lost what it had received; "" if all is well.
    """

    def __init__(self) -> None:
        self.maps: dict[str, DoseMap] = {}
        self.trouble = ""
        self._last: int | None = None
        self._waiting = 0.0
        self._lights: tuple[Light, ...] = ()

    def configure(self, old: Settings, new: Settings) -> None:
        """Forget the maps of parts that are no longer named, and all where texels are other ones now. What a part
        receives counts from the next image on."""
        same = (old.dose_max_edge, old.dose_side) == (new.dose_max_edge, new.dose_side)
        if not same or old.dose_parts != new.dose_parts:
            self.pause()
        self.maps = {part: self.maps[part] for part in new.dose_parts if same and part in self.maps}
        self.trouble = ""

    def pause(self) -> None:
        """Until the next image, time does not count."""
        self._last, self._waiting = None, 0.0

    def note(self, settings: Settings, tracer: ShadowTracer, lights: Iterable[Light], now_ns: int) -> bool:
        """An image was traced just now.

        Args:
            lights: those that shine; others than those with a strength do not count.
            now_ns: time of the node's clock [ns].

        Returns:
            Whether an exposure was added.
        """
        if not settings.dose_parts:
            self.pause()
            return False
        strong = tuple(light for light in lights if light.strength is not None)
        seconds = 0.0 if self._last is None else (now_ns - self._last) * 1e-9
        if not 0.0 <= seconds <= LONGEST:
            self.pause()
            seconds = 0.0
        self._last = now_ns
        added = _kinds(strong) != _kinds(self._lights) and self._flush(settings, tracer)
        self._lights = strong
        if strong:
            self._waiting += seconds
        return (self._waiting >= PERIOD and self._flush(settings, tracer)) or added

    def _flush(self, settings: Settings, tracer: ShadowTracer) -> bool:
        """Add what waits. False if there is nothing."""
        seconds, self._waiting = self._waiting, 0.0
        if not self._lights or seconds <= 0.0:
            return False
        troubles = [self._expose(settings, tracer, part, seconds) for part in settings.dose_parts]
        self.trouble = "; ".join(text for text in troubles if text)
        return True

    def _expose(self, settings: Settings, tracer: ShadowTracer, part: str, seconds: float) -> str:
        """Add to one part; why that is not all that is wanted, or ""."""
        if part not in tracer.scene:
            some = ", ".join(tracer.scene.names[:8]) or "none"
            return f"dose.parts names {part!r}, but the parts are {some}; correct the name, or publish the part"
        trouble = ""
        try:
            if part in self.maps:
                try:
                    self.maps[part].attach(tracer)
                except ValueError:
                    del self.maps[part]
                    trouble = f"part {part!r} has another mesh than before: its dose began again"
            if part not in self.maps:
                self.maps[part] = DoseMap(
                    tracer, part, settings.dose_max_edge, side=settings.dose_side, samples=settings.samples
                )
            self.maps[part].add(self._lights, seconds)
        except ValueError as error:
            return f"dose of {part!r}: {error}"
        return trouble

    def coverage(self, target: float) -> float:
        """Share of the area of all maps that has the target [J/m2], 0 to 1; NaN where there is none."""
        area = sum(float(each.area.sum()) for each in self.maps.values())
        done = sum(each.coverage(target) * float(each.area.sum()) for each in self.maps.values())
        return done / area if area else float("nan")

    def done(self, settings: Settings) -> bool:
        """Whether all named parts have a map, and together the coverage that is wanted."""
        return set(self.maps) == set(settings.dose_parts) and self.coverage(settings.dose_target) >= settings.dose_goal

    def shown(self) -> dict[str, DoseMap]:
        """The maps whose parts are in the scene now, as they were."""
        found = {}
        for part, each in self.maps.items():
            try:
                if each.tracer is not None:
                    each.attach(each.tracer)
                    found[part] = each
            except ValueError:  # it has gone, or is another one: the next exposure says so
                continue
        return found

    def release(self) -> None:
        """The tracer will be freed; what was received stays, for the next one."""
        self.pause()
        self._lights = ()
        for each in self.maps.values():
            each.tracer = None

    def reset(self) -> int:
        """No dose anywhere, nor from the time before; how many maps there were."""
        self.pause()
        for each in self.maps.values():
            each.reset()
        return len(self.maps)

    def save(self, settings: Settings) -> int:
        """Write each map to a file in ``dose.folder``; how many there were.

        Raises:
            ValueError: there is no folder, or no map.
            OSError: a file cannot be written.
        """
        folder = folder_of(settings)
        if not self.maps:
            raise ValueError("there is no dose map to save: no part of dose.parts has been exposed yet")
        for part, each in self.maps.items():
            each.save(_path(folder, part))
        return len(self.maps)

    def load(self, settings: Settings, tracer: ShadowTracer) -> int:
        """Go on with the maps in ``dose.folder``, of each part in ``dose.parts``; all of them or none.

        Raises:
            ValueError: there is no folder, no part is named, a file is missing, broken or of another part, or the
                part's mesh is another one now.
        """
        folder = folder_of(settings)
        if not settings.dose_parts:
            raise ValueError("dose.parts: expected names of the parts whose dose maps are loaded, got none")
        maps = {part: DoseMap.load(_path(folder, part), samples=settings.samples) for part in settings.dose_parts}
        for part, each in maps.items():
            if each.part != part:
                raise ValueError(f"part: expected {part!r} in {str(_path(folder, part))!r}, got {each.part!r}")
            each.attach(tracer)
            if (each.max_edge, each.side) != (settings.dose_max_edge, settings.dose_side):
                raise ValueError(
                    f"dose.max_edge, dose.side: expected {each.max_edge:g} and {each.side} as in the file of {part!r}"
                )
        self.maps = maps
        self.pause()
        return len(maps)


def _kinds(lights: Iterable[Light]) -> list[tuple[object, ...]]:
    """What of lights makes an exposure end when it changes: not where they are, nor how their tables hang."""
    kinds: list[tuple[object, ...]] = []
    for light in lights:
        strength = light.strength
        assert strength is not None
        model = strength.model
        kind = id(model.values) if isinstance(model, IntensityTable) else model  # of lights that are kept
        kinds.append((light.name, *(getattr(strength, name) for name in QUANTITIES), strength.output, kind))
    return kinds


def folder_of(settings: Settings) -> Path:
    """``dose.folder``. Raises ValueError if there is none."""
    if not settings.dose_folder:
        raise ValueError("dose.folder: expected a folder for dose maps, got none")
    folder = Path(settings.dose_folder)
    if not folder.is_dir():
        raise ValueError(f"dose.folder: expected a folder, got {settings.dose_folder!r}")
    return folder


def _path(folder: Path, part: str) -> Path:
    return folder / f"{quote(part, safe='')}.dose.npz"
