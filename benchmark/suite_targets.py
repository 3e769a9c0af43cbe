# SPDX-License-Identifier: Apache-2.0
"""What the figures of a run come to: each target that they say something about, and whether it is met."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

Rows = list[dict[str, Any]]
_BUILT = ("Embree", "wp.Mesh build")
_ALL = (*_BUILT, "wp.Mesh", "Open3D")
_REAL = ("BART robots", "Sponza", "Sibenik", "conference")


def targets(sections: dict[str, Rows]) -> Rows:
    """Rows of target, worst case found, limit, and met or not; nothing about what was not measured."""
    return [
        *_speed(sections.get("scenes", [])),
        *_choice([row for rows in sections.values() for row in rows if row.get("dynamic ms")]),
        *_growth(sections),
        *_lights(sections.get("lights", [])),
    ]


def _row(what: str, where: str, measured: float, limit: float | None, least: bool) -> dict[str, Any]:
    """Without a ``limit`` it is a figure to know, not a target."""
    row = {"target": what, "limit": "-", "worst": measured, "where": where, "met": "-"}
    if limit is not None:
        met = measured >= limit if least else measured <= limit
        row |= {"limit": f"{'>=' if least else '<='} {limit:g}", "met": "yes" if met else "no"}
    return row


def _by_view(rows: Rows) -> dict[str, Rows]:
    found: dict[str, Rows] = {}
    for row in rows:
        found.setdefault(row["view"], []).append(row)
    return found


def _leader(rows: Rows, ratio: str) -> dict[str, Any] | None:
    """Our row that counts: auto's where there is one, else the best."""
    ours = [row for row in rows if row.get(ratio)]
    auto = [row for row in ours if row["method"].startswith("auto/")]
    return max(auto or ours, key=lambda row: row[ratio], default=None)


def _speed(rows: Rows) -> Iterator[dict[str, Any]]:
    views = {view: found for view, found in _by_view(rows).items() if view in _REAL}
    questions: tuple[tuple[str, str, tuple[str, ...], float | None], ...] = (
        (
            "mesh new in every frame: times faster than the better of Embree and wp.Mesh, both built",
            "dynamic",
            _BUILT,
            3,
        ),
        ("mesh new in every frame: times faster than Open3D, built", "dynamic", ("Open3D",), None),
        ("mesh and light as before: times faster than the better peer's query alone", "static", _ALL, 1),
    )
    for what, motion, names, limit in questions:
        found = []
        for view, mine in views.items():
            leader = _leader(mine, f"{motion} ratio")
            peers = [row[f"{motion} ms"] for row in mine if row["method"].startswith(names) and row.get(f"{motion} ms")]
            if leader and peers:
                found.append((min(peers) / leader[f"{motion} ms"], f"{view}, {leader['method']}"))
        if found:
            yield _row(what, min(found)[1], min(found)[0], limit, least=True)


def _choice(rows: Rows) -> Iterator[dict[str, Any]]:
    """auto beside the best single pipeline of the same contest."""
    contests: dict[tuple[Any, ...], Rows] = {}
    for row in rows:
        if row.get("ours") and not row["method"].startswith("brute_force"):
            contests.setdefault((row["view"], row["triangles"], row["rays"], row["lights"]), []).append(row)
    worst: tuple[float, str] | None = None
    for motion in ("dynamic ms", "static ms"):
        for (view, triangles, rays, lights), found in contests.items():
            auto = [row[motion] for row in found if row["method"].startswith("auto/") and row.get(motion)]
            single = [row[motion] for row in found if not row["method"].startswith("auto/") and row.get(motion)]
            if auto and single:
                where = f"{view}, {triangles:,} triangles, {rays:,} rays, {lights} light(s), {motion[:-3]}"
                worst = max(worst or (0.0, ""), (auto[0] / min(single), where))
    if worst:
        yield _row("auto: its time in parts of the best single pipeline's", worst[1], worst[0], 1.3, least=False)


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
    found = []
    for view, mine in _by_view(rows).items():
        leaders = {n: _leader([row for row in mine if row["lights"] == n], "dynamic ratio") for n in (1, 16)}
        one, many = leaders[1], leaders[16]
        if one and many:
            found.append((many["dynamic ms"] / one["dynamic ms"], f"{view}, {one['method']} and {many['method']}"))
    if found:
        worst = max(found)
        yield _row("16 lights: their time in parts of that of one", worst[1], worst[0], 10.0, least=False)
