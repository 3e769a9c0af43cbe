# SPDX-License-Identifier: Apache-2.0
"""What a run of the suite is to measure, and how its sections keep to their time."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field
from typing import Any

from contest import Effort

from shadow_tracer import available_pipelines

# What is measured when nothing is asked for; those that need the data folder are left out without it.
VIEWS = (
    "robots/corridor/inside",
    "BART robots",
    "Sponza",
    "Sibenik",
    "conference",
    "museum/room/inside",
    "stadium/pot/inside",
    "livingroom1",
    "redkitchen",
    "workshop",
    "robots/corridor/sun",
    "museum/room/far",
)
QUICK_VIEWS = ("robots/corridor/inside", "stadium/pot/inside", "Sponza", "livingroom1")
SECTIONS = ("scenes", "points", "variants", "rays", "triangles", "lights", "maps", "memory")

# Those that one may choose for their speed on meshes; "variants" has the others.
_FAST = ("light_grid/packed", "cone_hierarchy/linear", "mesh_bvh/refit", "bvh/sah", "auto/measured")

# Scalar code of the papers, and brute force in float64, there to be compared with: last, and not in quick runs.
_SLOW = (
    "cone_hierarchy/precise_sea",
    "cone_hierarchy/precise_seatp",
    "cone_hierarchy/precise_sorted",
    "cone_hierarchy/spheres_sorted",
    "brute_force/float64",
    "cone_hierarchy/precise_eatp",
    "cone_hierarchy/spheres",
    "cone_hierarchy/precise",
)

# Seconds after which a section begins nothing new. What it leaves over the next ones have.
_BUDGET = {
    "scenes": 200,
    "points": 60,
    "variants": 60,
    "rays": 40,
    "triangles": 65,
    "lights": 60,
    "maps": 35,
    "memory": 25,
}
_QUICK_BUDGET = {
    "scenes": 14,
    "points": 6,
    "variants": 8,
    "rays": 5,
    "triangles": 6,
    "lights": 7,
    "maps": 3,
    "memory": 7,
}


@dataclass(frozen=True)
class Settings:
    """A run.

    Attributes:
        size: image width and height [px].
        views: names of scenes.views.
        effort: frames and seconds per figure.
        pipelines: (pipeline, variant) of all sections but "variants" and brute force's rows.
        every: (pipeline, variant) of "variants".
        held: (pipeline, variant) of "memory", beside ``pipelines``.
        sizes, triangles, lights, maps: what the sections of scaling and of shadow maps go through, ascending.
        asked: (triangles, points) of "points" beside the views.
        views_few: the views of "variants" and "maps"; "rays", "lights" and "memory" take the first.
        variants_size: image width and height of "variants", whose slowest takes minutes otherwise.
        budget: seconds per section.
    """

    size: int
    views: tuple[str, ...]
    effort: Effort
    pipelines: tuple[tuple[str, str], ...]
    every: tuple[tuple[str, str], ...]
    held: tuple[tuple[str, str], ...]
    sizes: tuple[int, ...]
    triangles: tuple[int, ...]
    lights: tuple[int, ...]
    maps: tuple[int, ...]
    asked: tuple[tuple[int, int], ...]
    views_few: tuple[str, ...]
    variants_size: int
    budget: dict[str, float] = field(default_factory=dict)


def fast() -> tuple[tuple[str, str], ...]:
    """The pipelines that are measured beside the peers, each in its default variant."""
    return choose(list(_FAST))


def every_variant() -> tuple[tuple[str, str], ...]:
    """All there are, the slow ones last."""
    pairs = [(name, variant) for name, variants in available_pipelines().items() for variant in variants]
    return tuple(sorted(pairs, key=lambda pair: _SLOW.index("/".join(pair)) if is_slow(pair) else -1))


def is_slow(pair: tuple[str, str]) -> bool:
    """Whether quick runs leave a (pipeline, variant) out."""
    return "/".join(pair) in _SLOW


def full(factor: float = 1.0) -> Settings:
    """Some minutes."""
    return Settings(
        size=512,
        views=VIEWS,
        effort=Effort(5, 0.7),
        pipelines=fast(),
        every=every_variant(),
        held=tuple(pair for pair in every_variant() if not is_slow(pair)),
        sizes=(128, 256, 512, 1024, 2048),
        triangles=(1_000, 4_000, 16_000, 64_000, 256_000, 1_000_000),
        lights=(1, 2, 4, 8, 16, 32),
        maps=(256, 512, 1024, 2048, 4096),
        asked=tuple((triangles, points) for triangles in (36, 1_000, 30_000, 1_000_000) for points in (1_000, 100_000)),
        views_few=("robots/corridor/inside", "BART robots", "museum/room/inside"),
        variants_size=256,
        budget={name: factor * seconds for name, seconds in _BUDGET.items()},
    )


def quick(factor: float = 1.0) -> Settings:
    """Under a minute with a warm kernel cache."""
    return Settings(
        size=256,
        views=QUICK_VIEWS,
        effort=Effort(3, 0.25),
        pipelines=fast(),
        every=tuple(pair for pair in every_variant() if not is_slow(pair)),
        held=(),
        sizes=(128, 256, 512),
        triangles=(1_000, 16_000, 128_000),
        lights=(1, 4, 16),
        maps=(256, 512, 1024),
        asked=((36, 1_000), (1_000, 10_000), (128_000, 1_000)),
        views_few=("robots/corridor/inside",),
        variants_size=128,
        budget={name: factor * seconds for name, seconds in _QUICK_BUDGET.items()},
    )


def choose(wanted: list[str]) -> tuple[tuple[str, str], ...]:
    """(pipeline, variant) pairs of names such as ``cone_hierarchy`` and ``mesh_bvh/refit``.

    Raises:
        ValueError: an unknown name; the message lists the known ones.
    """
    known = every_variant()
    pairs: list[tuple[str, str]] = []
    for name in wanted:
        found = [pair for pair in known if name in (pair[0], "/".join(pair))]
        if not found:
            raise ValueError(f"pipelines: expected names among {', '.join('/'.join(p) for p in known)}, got {name!r}")
        pairs += [pair for pair in found if pair not in pairs]
    return tuple(pairs)


class Clock:
    """A section's time. What does not fit any more is left out, and noted."""

    def __init__(self, section: str, seconds: float, quiet: bool = False) -> None:
        self.section, self.seconds, self._quiet = section, seconds, quiet
        self._begin = time.perf_counter()
        self.left_out: list[str] = []

    @property
    def spent(self) -> float:
        """Seconds since the section began."""
        return time.perf_counter() - self._begin

    def allows(self, what: str, expected: float = 0.0) -> bool:
        """Whether there is time for something that is expected to take so many seconds; says so on standard error."""
        fits = self.spent + expected <= self.seconds
        if not fits:
            self.left_out.append(what)
        if not self._quiet:
            doing = what if fits else f"{what}: left out, no time"
            print(f"[{self.section} {self.spent:5.1f} of {self.seconds:.0f} s] {doing}", file=sys.stderr, flush=True)
        return fits


Rows = list[dict[str, Any]]
