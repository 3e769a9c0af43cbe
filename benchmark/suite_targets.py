# SPDX-License-Identifier: Apache-2.0
"""What the figures of a run come to: each target that they say something about, and whether it is met."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

Rows = list[dict[str, Any]]
_BUILT = ("Embree", "wp.Mesh build", "Open3D")
_ALL = (*_BUILT, "wp.Mesh")
_SIX = ("BART robots", "Sponza", "Sibenik", "conference", "livingroom1", "redkitchen")
_CHOICE = 1.2  # what auto may take, in parts of the best single pipeline's time
_LEAST_POINTS = 1_000  # of a question about points that is to be faster than the peers'


def targets(sections: dict[str, Rows]) -> Rows:
    """Rows of target, worst case found, limit, and met or not; nothing about what was not measured."""
    points = sections.get("points", [])
    many = [row for row in points if row["rays"] >= _LEAST_POINTS * row["lights"]]
    return [
        *_speed(sections.get("scenes", [])),
        *_worst("points: times faster than the best peer, built", points, "dynamic", 3, _SIX),
        *_worst("points, at least a thousand: times faster than the best peer, built", many, "dynamic", 1),
        *_choice(list(sections.values())),
        *_growth(sections),
        *_lights(sections.get("lights", [])),
    ]


def _row(what: str, where: str, measured: float, limit: float, least: bool) -> dict[str, Any]:
    met = measured >= limit if least else measured <= limit
    bound = f"{'>=' if least else '<='} {limit:g}"
    return {"target": what, "limit": bound, "worst": measured, "where": where, "met": "yes" if met else "no"}


def _questions(rows: Rows) -> dict[tuple[Any, ...], Rows]:
    """The rows of each contest of a section; brute force, which may have been asked about some of the rays, is in no
    target."""
    found: dict[tuple[Any, ...], Rows] = {}
    for row in rows:
        if not row["method"].startswith("brute_force"):
            found.setdefault((row["view"], row["triangles"], row["rays"], row["lights"]), []).append(row)
    return found


def _leader(rows: Rows, ratio: str) -> dict[str, Any] | None:
    """Our row that counts: auto's where there is one, else the best."""
    ours = [row for row in rows if row.get(ratio)]
    auto = [row for row in ours if row["method"].startswith("auto/")]
    return max(auto or ours, key=lambda row: row[ratio], default=None)


def _speed(rows: Rows) -> Iterator[dict[str, Any]]:
    built = "mesh new in every frame: times faster than the best peer, built"
    yield from _worst(built, rows, "dynamic", 4, _SIX)
    yield from _worst(f"{built}, every view", rows, "dynamic", 3)
    alone = "mesh and light as before: times faster than the best peer's query alone"
    yield from _worst(f"{alone}, every view", rows, "static", 1)


def _worst(
    what: str, rows: Rows, motion: str, limit: float, views: tuple[str, ...] | None = None
) -> Iterator[dict[str, Any]]:
    """The question (of ``views``) in which our leader is the least ahead of the best peer."""
    names = _BUILT if motion == "dynamic" else _ALL
    found = []
    for (view, triangles, _, _), mine in _questions(rows).items():
        leader = _leader(mine, f"{motion} ratio")
        peers = [row[f"{motion} ms"] for row in mine if row["method"].startswith(names) and row.get(f"{motion} ms")]
        if leader and peers and (views is None or view in views):
            where = f"{view}, {triangles:,} triangles, {leader['rays']:,} rays, {leader['method']}"
            found.append((min(peers) / leader[f"{motion} ms"], where))
    if found:
        yield _row(what, min(found)[1], min(found)[0], limit, least=True)


def _choice(sections: list[Rows]) -> Iterator[dict[str, Any]]:
    """auto beside the best single pipeline of the same contest."""
    found = []
    for rows in sections:
        for (view, triangles, rays, lights), mine in _questions([row for row in rows if row.get("ours")]).items():
            for motion in ("dynamic", "static"):
                times = {row["method"]: row[f"{motion} ms"] for row in mine if row.get(f"{motion} ms")}
                auto = [time for name, time in times.items() if name.startswith("auto/")]
                single = [time for name, time in times.items() if not name.startswith("auto/")]
                if auto and single:
                    where = f"{view}, {triangles:,} triangles, {rays:,} rays, {lights} light(s), {motion}"
                    found.append((auto[0] / min(single), where))
    if found:
        worst = max(found)
        yield _row("auto: its time in parts of the best single pipeline's", worst[1], worst[0], _CHOICE, least=False)


def _growth(sections: dict[str, Rows]) -> Iterator[dict[str, Any]]:
    """From the smallest to the largest: single steps are at the mercy of the machine."""
    for what in ("rays", "triangles"):
        rows = [row for row in sections.get(what, []) if row.get("ours") and row.get("dynamic ms")]
        worst: tuple[float, str] | None = None
        for method in {row["method"] for row in rows if not row["method"].startswith("brute_force")}:
            line = sorted((row for row in rows if row["method"] == method), key=lambda row: row[what])
            if len(line) > 1:
                first, last = line[0], line[-1]
                growth = last["dynamic ms"] / first["dynamic ms"] / (last[what] / first[what])
                worst = max(worst or (0.0, ""), (growth, f"{method}, {first[what]:,} to {last[what]:,}"))
        if worst:
            yield _row(f"{what}: growth of the time in parts of theirs", worst[1], worst[0], 1.0, least=False)


def _lights(rows: Rows) -> Iterator[dict[str, Any]]:
    yield from _worst("any number of lights: times faster than the best peer, built once", rows, "dynamic", 1)
    many = [row for row in rows if row["lights"] == 16]
    yield from _worst("16 lights: times faster than the best peer, built once", many, "dynamic", 4)
    found = []
    for view in dict.fromkeys(row["view"] for row in rows):
        mine = [row for row in rows if row["view"] == view]
        leaders = {n: _leader([row for row in mine if row["lights"] == n], "dynamic ratio") for n in (1, 16)}
        one, many_lights = leaders[1], leaders[16]
        if one and many_lights:
            names = f"{view}, {one['method']} and {many_lights['method']}"
            found.append((many_lights["dynamic ms"] / one["dynamic ms"], names))
    if found:
        worst = max(found)
        yield _row("16 lights: their time in parts of that of one", worst[1], worst[0], 5.0, least=False)
