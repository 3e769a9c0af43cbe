# SPDX-License-Identifier: Apache-2.0
"""Cones beside rays: answers that are wrong, of which there must be none, and what they take.

    python benchmark/cones.py --cones 1000000       # random cones in real scenes against 64 rays each
    python benchmark/cones.py --time                # cones from a view's pixels beside 16 and 64 rays of the peers'
    python benchmark/cones.py --kd-tree             # random cones through bvh/sah and kd_tree

A FREE cone is wrong if one of 64 rays is hidden, or if a vertex of the scene, or a point of an edge, is inside of it; a
BLOCKED one if one of 64 rays reaches, or one of those that pass a 1e-9th beside such vertices and points. Rays are
decided exactly. The latter is looked at for some cones of each apex. Times are processor time of one thread.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
import numpy.typing as npt
from area_lights import installed
from case import FrameRays, shots
from report import header, table, write_json
from rivals import missing
from scenes import View, views

from shadow_tracer import Bounds, Outcome, PointLight, ShadowTracer

Floats = npt.NDArray[np.float64]
_SCENES = ("BART robots", "Sponza", "Sibenik", "conference")
_AT_ONCE, _RAYS, _CLOSE, _BESIDE = 1000, 64, 8, 40


def ends_of_rays(apex: Floats, ends: Floats, radii: Floats, count: int = _RAYS) -> Floats:
    """(N, count, 3) points of the ends of cones from (N, 3) or one apex, half of them at the rim."""
    axis = ends - apex
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    right = np.cross(axis, np.where(np.abs(axis[:, :1]) < 0.6, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]))
    right /= np.linalg.norm(right, axis=1)[:, None]
    up, number = np.cross(axis, right), np.arange(count)
    share = np.where(number < count // 2, np.sqrt((number + 0.5) / count), 1.0) * (1.0 - 1e-9)
    turn = 2.399963 * number
    across = (share * np.cos(turn))[:, None] * right[:, None] + (share * np.sin(turn))[:, None] * up[:, None]
    found: Floats = ends[:, None] + radii[:, None, None] * across
    return found


class _Scene:
    """A view's scene, and how wrong cones in it are."""

    def __init__(self, view: View, pipeline: str = "bvh") -> None:
        self.vertices, self.triangles = view.positions[0], view.triangles
        count = len(view.triangles)
        bounds = Bounds(max_triangles=count, max_rays=_RAYS * _AT_ONCE, max_lights=1, grid_entries=8 * count)
        self.tracer = ShadowTracer(pipeline, device="cpu", bounds=bounds, threads=1)
        self.tracer.scene.put("mesh", self.vertices, self.triangles)
        self.low, self.high = self.vertices.min(axis=0), self.vertices.max(axis=0)

    def ask(self, rng: np.random.Generator) -> tuple[npt.NDArray[np.int64], int]:
        """How often random cones from a place have each outcome, and how often that is wrong."""
        apex = rng.uniform(self.low, self.high)
        ends = rng.uniform(self.low, self.high, (_AT_ONCE, 3))
        radii = np.linalg.norm(ends - apex, axis=1) * 10.0 ** rng.uniform(-4.0, 0.0, _AT_ONCE)
        outcomes = self.tracer.cones(apex, ends, radii)
        lamp = PointLight("apex", apex)
        hidden = self.tracer.occluded(ends_of_rays(apex, ends, radii), lamp)
        wrong = (hidden.any(axis=1) & (outcomes == Outcome.FREE)) | (
            ~hidden.all(axis=1) & (outcomes == Outcome.BLOCKED)
        )
        for outcome in (Outcome.FREE, Outcome.BLOCKED):
            for k in np.flatnonzero(outcomes == outcome)[:_CLOSE]:
                wrong[k] |= self._wrong_beside_edges(lamp, ends[k], radii[k], outcome, rng)
        return np.bincount(outcomes, minlength=3), int(wrong.sum())

    def _wrong_beside_edges(
        self, lamp: PointLight, end: Floats, radius: float, outcome: Outcome, rng: np.random.Generator
    ) -> bool:
        some = self.triangles[rng.integers(0, len(self.triangles), 20_000)]
        share = rng.uniform(0.0, 1.0, (len(some), 1))
        points = np.concatenate(
            [self.vertices, (1 - share) * self.vertices[some[:, 0]] + share * self.vertices[some[:, 1]]]
        )
        apex = np.asarray(lamp.position)
        length = np.linalg.norm(end - apex)
        axis, from_apex = (end - apex) / length, points - apex
        along = from_apex @ axis
        beside = np.linalg.norm(from_apex - along[:, None] * axis, axis=1)
        inside = (beside < (1.0 - 1e-6) * radius / length * along) & (along < (1.0 - 1e-9) * length)
        if outcome == Outcome.FREE:
            used = np.zeros(len(self.vertices), bool)
            used[self.triangles] = True
            return bool(inside[: len(used)][used].any() or inside[len(used) :].any())
        passed = rng.permutation(np.flatnonzero(inside))[:_BESIDE]
        if not len(passed):
            return False
        through = apex + from_apex[passed] * (length / along[passed])[:, None]
        nearby = through[:, None] + 1e-9 * length * rng.uniform(-1.0, 1.0, (len(passed), 8, 3))
        nearby -= (((nearby - end) @ axis)[..., None]) * axis  # in the end's plane
        return not self.tracer.occluded(nearby - 1e-12 * length * axis, lamp).all()


def check(cones: int, seed: int) -> list[dict[str, Any]]:
    """A row for each scene; raises SystemExit if an answer is wrong."""
    rows, rng = [], np.random.default_rng(seed)
    for view in views(64, list(_SCENES)):
        scene, found, wrong = _Scene(view), np.zeros(3, np.int64), 0
        while found.sum() < cones / len(_SCENES):
            outcomes, more = scene.ask(rng)
            found, wrong = found + outcomes, wrong + more
        rows.append({"scene": view.name, "cones": int(found.sum()), **_shares(found), "wrong": wrong})
        print(rows[-1], flush=True)
        if wrong:
            raise SystemExit(f"{view.name}: {wrong} answers are wrong")
    return rows


def _shares(found: npt.NDArray[np.int64]) -> dict[str, float]:
    return {outcome.name: round(float(found[outcome] / found.sum()), 4) for outcome in Outcome}


def _least(call: Any, turns: int) -> tuple[float, Any]:
    """Seconds of the processor, the median of some turns, and what was found."""
    spent = []
    for _ in range(turns):
        begin = time.process_time()
        found = call()
        spent.append(time.process_time() - begin)
    return float(np.median(spent)), found


def through_both(cones: int, seed: int, turns: int) -> list[dict[str, Any]]:
    """Random cones of half angles from 1e-4 to 0.2 rad, and lists of 16 of some, through the tree of ``bvh/sah`` and
    the k-d tree; raises SystemExit if an answer differs."""
    rows, rng = [], np.random.default_rng(seed)
    for view in views(64, list(_SCENES)):
        low, high = view.positions[0].min(axis=0), view.positions[0].max(axis=0)
        apices, ends = rng.uniform(low, high, (2, cones // len(_SCENES), 3))
        angles, few = 10.0 ** rng.uniform(-4.0, -0.7, len(apices)), slice(0, len(apices) // 16)
        found, row = [], {"scene": view.name, "cones": len(apices)}
        for pipeline in ("bvh", "kd_tree"):
            tracer = _Scene(view, pipeline).tracer

            def outcomes(tracer: Any = tracer, asked: Any = (apices, ends), angles: Any = angles) -> Any:
                return tracer.cones(*asked, half_angle=angles)

            def lists(tracer: Any = tracer, asked: Any = (apices, ends - apices, angles), few: Any = few) -> Any:
                return tracer.cone_hits(*(each[few] for each in asked), 16)

            outcomes(asked=(apices[:1], ends[:1]), angles=angles[:1])
            lists(few=slice(0, 1))
            for name, call, count in (("outcome", outcomes, len(apices)), ("list", lists, few.stop)):
                seconds, answers = _least(call, turns)
                row[f"us, {name}, {pipeline}"] = round(1e6 * seconds / count, 1)
                found.append(answers)
        if not all(
            np.array_equal(one, two) for one, two in ((found[0], found[2]), *zip(found[1], found[3], strict=True))
        ):
            raise SystemExit(f"{view.name}: answers differ")
        rows.append(row)
    return rows


def measure(size: int, shares: tuple[float, ...], turns: int) -> list[dict[str, Any]]:
    """Cones from every fourth pixel's place, both ways, to a ball of so many parts of the view's diagonal around the
    light, and 16 and 64 rays of the peers' into each."""
    rows = []
    for view in views(size, list(_SCENES)):
        scene, light = _Scene(view), np.asarray(view.light.position)
        apices = FrameRays(shots(view, 1)[0], [view.light], view.bias).points[::4]
        apices = apices + view.bias * (light - apices) / np.linalg.norm(light - apices, axis=1)[:, None]
        diagonal = np.linalg.norm(apices.max(axis=0) - apices.min(axis=0))
        peers = installed(view.positions[0], view.triangles)
        for peer in peers:  # which build their trees for the first ray
            peer.hidden(apices[:1].astype(np.float32), np.ones((1, 3), np.float32))
        for share in shares:
            radii = np.full(len(apices), share * diagonal)
            ends = np.broadcast_to(light, apices.shape)
            far = np.linalg.norm(ends - apices, axis=1) > 2.0 * radii
            some, ends, radii = apices[far], ends[far], radii[far]
            scene.tracer.cones(some[:1], ends[:1], radii[:1])
            ours, outcomes = _least(lambda: scene.tracer.cones(some, ends, radii), turns)  # noqa: B023
            budget, few = _least(lambda: scene.tracer.cones(some, ends, radii, budget=200), turns)  # noqa: B023
            count = len(some) / 1e6
            row: dict[str, Any] = {
                "scene": view.name,
                "radius": share,
                "cones": len(some),
                "us": round(ours / count, 2),
            }
            row["us, budget 200"] = round(budget / count, 2)
            for rays in (16, _RAYS):
                ways = (ends_of_rays(some, ends, radii, rays) - some[:, None]).reshape(-1, 3).astype(np.float32)
                starts = np.repeat(some, rays, axis=0).astype(np.float32)
                for peer in peers:
                    spent = float(np.median([peer.hidden(starts, ways)[0] for _ in range(turns)])) / 1e3
                    row[f"us, {rays} rays of {peer.name}"] = round(spent / count, 2)
            best = min(row[f"us, {_RAYS} rays of {peer.name}"] for peer in peers)
            row["times"] = round(best * count / ours, 1)
            row |= _shares(np.bincount(outcomes, minlength=3))
            rows.append(row | {"PARTLY, budget 200": round(float((few == Outcome.PARTLY).mean()), 4)})
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cones", type=int, default=100_000, help="how many are checked")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--time", action="store_true", help="measure instead")
    parser.add_argument("--kd-tree", action="store_true", help="compare with the k-d tree instead")
    parser.add_argument("--size", type=int, default=256, help="of the view's image")
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--json", help="also write the table there")
    options = parser.parse_args()
    title = "cones beside 64 rays" if options.time else "cones against 64 rays"
    title = "cones through two trees" if options.kd_tree else title
    if options.time and "Embree" in missing():
        raise SystemExit("needs embreex: pip install embreex")
    header(title)
    if options.time:
        rows = measure(options.size, (0.01, 0.05), options.turns)
    elif options.kd_tree:
        rows = through_both(options.cones, options.seed, options.turns)
    else:
        rows = check(options.cones, options.seed)
    table(rows)
    write_json(title, rows, options.json)


if __name__ == "__main__":
    main()
