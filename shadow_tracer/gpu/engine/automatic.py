# SPDX-License-Identifier: Apache-2.0
"""Pipeline ``auto``: which pipeline is the fastest for the frame at hand, by what frames have cost.

Each candidate has a rough law of its cost (``costs.py``). The law is multiplied by a factor that is learned: for each
kind of frame (what has changed, and the numbers of rays, triangles and lights to a power of two) the ratio of found and
lawful cost, a running mean over the frames that the candidate traced; for a kind of which it has traced none, the
factor of the nearest kind it has. Before any, that of :meth:`Chooser.calibrated`, or 1, times what other candidates
have been found to take of this kind, in parts of what they should, to the power of 0.7: what is hard for one mostly is
for all.

On the CPU the cost of a frame is found by what it has counted, so that the same frames are always traced by the same
pipelines; of lights with a size, whose bundles count otherwise, and on CUDA, where nothing has been fitted yet, it is
what a clock says (``frame.py``).

The least expected cost wins; the current pipeline is kept until another is expected to take 15 percent less: changing
costs a frame in which things are made again. A candidate that is better than thought would never show it, so a near
second is tried now and then, for two frames.

The others are no candidates. Measured on one core of the CPU in 17 scenes with 36 to 524,288 triangles, one light, 64 x
64 to 512 x 512 rays (docs/papers.md, "Which can ever win"), in parts of the best of these three: where the scene
changes, what divides space (grids, ``octree``, ``kd_tree``, ``bsp``) takes 2 to 300 times as long, as it is built
again; at rest 1.3 to 10 times, ``uniform_grid`` up to 470 in a stadium. ``cone_hierarchy`` takes 1.1 to 7 times as
long, ``bvh`` at least 0.84, ``ray_classification`` up to a thousand times. ``light_buffer`` takes 0.46 to 3.6 times as
long with one light where all but the depth image rests, and 1.6 to 30 times elsewhere: it could win, but trying it, and
any change, makes a frame wait for 0.6 to 2.8 us for each triangle: 70 ms where the others take 7.

No Warp here.
"""

from __future__ import annotations

from shadow_tracer.gpu.engine.costs import BRUTE_FORCE, LIGHT_GRID, MESH_BVH, Names, Situation, catching_up, lawful

CANDIDATES = (LIGHT_GRID, MESH_BVH, BRUTE_FORCE)

_ADVANTAGE = 0.85  # another is taken if it is expected to take less than this share of the present one's time
_NEAR, _NEAR_AT_REST = 1.5, 2.0  # a second within this is tried
_FIRST_TRIAL, _NEXT_TRIAL = 20, 400  # frames of a kind before a second is tried, and from trial to trial
_TRIAL_AT_REST = 2  # the first, if the scene rests, where the law says least and trying costs least
_MEMORY = 0.25  # weight of the last frame in the running mean
_ALIKE = 0.7  # power of what a kind of frame takes more than the law has it, for candidates that have not traced it
_NEIGHBOUR = 3  # distance of kinds that are taken for each other


class Chooser:
    """Chooses among the candidates, and learns from what they took."""

    def __init__(self, candidates: tuple[Names, ...] = CANDIDATES) -> None:
        self.candidates = candidates
        self.forced: Names | None = None
        self._chosen = candidates[0]
        self._why: tuple[str, dict[Names, float]] | None = None
        self._base: dict[Names, float] = {}
        self._factors: dict[Names, dict[tuple[int, ...], float]] = {names: {} for names in candidates}
        self._nearest: dict[tuple[Names, tuple[int, ...]], tuple[int, ...]] = {}  # looking takes as long as a launch
        self._frames: dict[tuple[int, ...], int] = {}
        self._trial: dict[tuple[int, ...], int] = {}
        self._on_trial: dict[tuple[int, ...], Names] = {}
        self._trying = False

    @property
    def chosen(self) -> Names:
        """The current pipeline."""
        return self._chosen

    @property
    def reason(self) -> str:
        """Why, in words."""
        if self._why is None:
            return "nothing has been traced yet" if self.forced is None else "asked for"
        why, costs = self._why
        others = ", ".join(f"{'/'.join(names)} {costs[names]:.3g}" for names in costs if names != self._chosen)
        return f"{'/'.join(self._chosen)}: {why} {costs[self._chosen]:.3g} ms ({others})"

    def expected(self, names: Names, frame: Situation) -> float:
        """Milliseconds that a candidate is expected to take."""
        return lawful(names, frame) * self._factor(names, frame.kind)

    def choose(self, frame: Situation) -> Names:
        """The candidate for a frame."""
        if self.forced is not None:
            self._chosen, self._why = self.forced, None
            return self._chosen
        costs = {names: self.expected(names, frame) for names in self.candidates}
        ranking = sorted(self.candidates, key=costs.__getitem__)
        best = ranking[0]
        # Who was on trial is not the present one: it may have been tried before anything was known of that.
        if not self._trying and costs[best] >= _ADVANTAGE * costs[self._chosen]:
            best = self._chosen
        number = self._frames[frame.kind] = self._frames.get(frame.kind, 0) + 1
        tried = self._second_to_try(frame, ranking, costs, best, number)
        self._chosen, self._trying = tried or best, tried is not None
        why = "tried, as it may be better than thought; expected" if tried else "expected"
        self._why = why, {names: costs[names] for names in ranking}
        return self._chosen

    def learn(self, names: Names, frame: Situation, milliseconds: float) -> None:
        """A frame has cost so much. By the clock those are not told in which a candidate had to catch up with the
        scene, or was new, or loaded kernels."""
        ratio = milliseconds / lawful(names, frame)
        known = self._factors[names]
        before = known.get(frame.kind)
        if before is None:
            self._nearest.clear()
        # The first is often slower than those that follow; and a single slow frame says little.
        known[frame.kind] = ratio if before is None else before + _MEMORY * (min(ratio, 3.0 * before) - before)
        if len(known) > 512:
            known.pop(next(iter(known)))

    def calibrated(self, names: Names, frame: Situation, milliseconds: float) -> None:
        """What a candidate takes on this device, measured on a scene of known size: holds where nothing is learned."""
        self._base[names] = milliseconds / lawful(names, frame)

    def _factor(self, names: Names, kind: tuple[int, ...]) -> float:
        found = self._learned(names, kind)
        if found is not None:
            return found
        base, known = self._base.get(names), self._factors[names]
        if base is None and known:
            return known[self._nearest_of(names, kind)]
        learned = ((one, self._learned(one, kind)) for one in self.candidates)
        harder = [factor / self._base.get(one, 1.0) for one, factor in learned if factor is not None]
        return (1.0 if base is None else base) * (min(harder) ** _ALIKE if harder else 1.0)

    def _learned(self, names: Names, kind: tuple[int, ...]) -> float | None:
        """The factor of a kind of frame, or of one that is much like it."""
        known = self._factors[names]
        if kind in known or not known:
            return known.get(kind)
        nearest = self._nearest_of(names, kind)
        return known[nearest] if _distance(nearest, kind) <= _NEIGHBOUR else None

    def _nearest_of(self, names: Names, kind: tuple[int, ...]) -> tuple[int, ...]:
        """The kind that a candidate has traced which is most like this one."""
        found = self._nearest.get((names, kind))
        if found is None:
            found = min(self._factors[names], key=lambda other: _distance(other, kind))
            if len(self._nearest) > 512:
                self._nearest.clear()
            self._nearest[names, kind] = found
        return found

    def _second_to_try(
        self, frame: Situation, ranking: list[Names], costs: dict[Names, float], best: Names, number: int
    ) -> Names | None:
        if len(ranking) < 2:
            return None
        due = self._trial.get(frame.kind)
        if due is None:
            # At rest not before as much has been spent on frames as the second takes to be made.
            made = max(catching_up(names, frame) for names in ranking if names != best) / costs[best]
            due = self._trial[frame.kind] = _FIRST_TRIAL if frame.change else max(_TRIAL_AT_REST, int(made))
        if number < due:
            return None
        if number == due:
            second = self._on_trial[frame.kind] = next(names for names in ranking if names != best)
        else:
            # A second frame: in the first it may have had to catch up, which teaches nothing.
            second = self._on_trial.pop(frame.kind, best)  # none if the first frame of the trial did not end
            self._trial[frame.kind] = due + _NEXT_TRIAL
        near = _NEAR if frame.change else _NEAR_AT_REST
        return second if second != best and costs[second] <= near * costs[best] else None


def _distance(one: tuple[int, ...], other: tuple[int, ...]) -> int:
    # What changed matters most: mesh_bvh builds or does not.
    return 8 * (one[0] != other[0]) + sum(abs(a - b) for a, b in zip(one, other, strict=True))
