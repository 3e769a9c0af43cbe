# SPDX-License-Identifier: Apache-2.0
"""Where to stand, and for how long, so that a surface receives a dose."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import Any

import numpy as np

from shadow_tracer.dose import DoseMap
from shadow_tracer.scene.checks import FloatArray, finite, real, reals
from shadow_tracer.scene.dose_colors import check_dose
from shadow_tracer.scene.lights import Light

METHODS = ("greedy", "highs")
_ROUNDING = 1e-9  # relative, by which times are longer than computed, so that sums of products reach the target


@dataclass(frozen=True, eq=False)
class Stop:
    """A place to stand: the lights as they are there, and the poses of meshes that move along, such as the robot.

    Args:
        lights: lights with a strength, at least one.
        poses: (4, 4) rigid pose in the world of each mesh that stands elsewhere than now, by its name.
    """

    lights: Sequence[Light]
    poses: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Plan:
    """What to do.

    Attributes:
        stops: numbers of the candidates to stand at: greedy's in the order in which they were chosen, of HiGHS
            ascending.
        seconds: how long at each [s].
        coverage: share of the area, 0 to 1, that has the target after each of them.
        dose: (N,) dose of each texel at the end, what the map held before included [J/m2].
        reachable: share of the area that some candidate reaches, or that has the target already: no plan covers more.
    """

    stops: tuple[int, ...]
    seconds: tuple[float, ...]
    coverage: tuple[float, ...]
    dose: FloatArray
    reachable: float

    @property
    def total(self) -> float:
        """Time of exposure in all [s]."""
        return float(sum(self.seconds))


def irradiance_matrix(dose_map: DoseMap, candidates: Iterable[Stop | Iterable[Light]]) -> FloatArray:
    """(K, N) irradiance of each texel from each candidate [W/m2]; unknown is 0, which never counts as dose.

    The scene is as it was afterwards, and the map too.

    Args:
        dose_map: with a tracer.
        candidates: at least one :class:`Stop`, or lights alone.

    Raises:
        ValueError: an argument is malformed; the message names it.
        BoundsError: more lights than declared.
    """
    listed = _listed(candidates)
    stops = [each if isinstance(each, Stop) else Stop(_lights(each, k)) for k, each in enumerate(listed)]
    rows = np.empty((len(stops), len(dose_map)))
    for number, stop in enumerate(stops):
        try:
            with _standing(dose_map, stop.poses):
                found = dose_map.irradiance_by(stop.lights)
        except ValueError as error:
            raise type(error)(f"candidates[{number}].{error}") from error
        rows[number] = np.nan_to_num(found, nan=0.0)
    return rows


@contextmanager
def _standing(dose_map: DoseMap, poses: Mapping[str, Any]) -> Iterator[None]:
    """Meshes in other poses for a while."""
    if not poses:
        yield
        return
    if dose_map.tracer is None:
        raise ValueError("tracer: this map was loaded without one")
    scene = dose_map.tracer.scene
    if not isinstance(poses, Mapping):
        raise ValueError(f"poses: expected poses by names of meshes, got {type(poses).__name__}")
    before = {name: scene[name].pose for name in poses}
    try:
        for name, pose in poses.items():
            scene.move(name, pose)
        yield
    finally:
        for name, pose in before.items():
            scene.move(name, pose)


def _listed(candidates: Any) -> list[Any]:
    """At least one. Raises ValueError."""
    if not isinstance(candidates, Iterable):
        raise ValueError(f"candidates: expected an iterable of places to stand, got {type(candidates).__name__}")
    listed = list(candidates)
    if not listed:
        raise ValueError("candidates: expected at least one place to stand, got none")
    return listed


def _lights(value: Any, number: int) -> Sequence[Light]:
    if not isinstance(value, Iterable):
        raise ValueError(f"candidates[{number}]: expected a Stop or lights, got {type(value).__name__}")
    return tuple(value)


def plan_positions(
    dose_map: DoseMap,
    candidates: Iterable[Stop | Iterable[Light]],
    target: float,
    coverage: float = 1.0,
    travel: float = 10.0,
    method: str = "greedy",
    time_limit: float = 60.0,
    matrix: Any = None,
) -> Plan:
    """Choose where to stand and for how long, so that a share of what can be reached receives the target.

    ``greedy`` takes again and again the place and time that bring the most new area to the target per second, with the
    way there counted in. ``highs`` then finds the least seconds of standing and travelling together that bring the
    target to all that greedy's plan does, by mixed-integer linear programming with the solver HiGHS of scipy (extra
    ``dose``).

    Args:
        dose_map: what has been received already counts.
        candidates: at least one place to stand.
        target: dose that is wanted [J/m2], positive.
        coverage: share of the reachable area that shall have it, above 0 and at most 1.
        travel: what it costs to go to another place [s], 0 or more.
        method: "greedy" or "highs".
        time_limit: how long HiGHS may look for something better [s], positive; then the best plan there is counts,
            which may be greedy's.
        matrix: what :func:`irradiance_matrix` returned for these candidates, if it is at hand; None: it is computed.

    Returns:
        A :class:`Plan`, without stops if nothing is left to do or nothing can be reached. Its doses are those of
        irradiance times seconds with everything as in the candidates.

    Raises:
        ValueError: an argument is malformed; the message names it.
        ImportError: scipy is not installed; the message says how to install it.
    """
    wanted = check_dose(target, "target")
    share, way, limit = real(coverage), finite(travel, "travel"), real(time_limit)
    if not 0.0 < share <= 1.0:
        raise ValueError(f"coverage: expected a share above 0 and at most 1, got {coverage!r}")
    if way < 0.0:
        raise ValueError(f"travel: expected a time in seconds of 0 or more, got {travel!r}")
    if not limit > 0.0:
        raise ValueError(f"time_limit: expected a positive time in seconds, got {time_limit!r}")
    if method not in METHODS:
        raise ValueError(f"method: expected one of {', '.join(map(repr, METHODS))}, got {method!r}")
    listed = _listed(candidates)
    rows = irradiance_matrix(dose_map, listed) if matrix is None else _matrix(matrix, len(listed), len(dose_map))
    missing = np.maximum(wanted - dose_map.dose, 0.0)
    reachable = (missing == 0.0) | (rows.max(axis=0) > 0.0)
    goal = share * float(dose_map.area[reachable].sum())
    if method == "greedy":
        chosen = _greedy(rows, missing, dose_map.area, goal, way)
    else:
        chosen = _highs(rows, missing, dose_map.area, goal, way, limit)
    return _plan(dose_map, rows, wanted, chosen, reachable)


def _matrix(value: Any, stops: int, texels: int) -> FloatArray:
    rows = reals(value, "matrix", f"finite irradiances of 0 or more, of shape {(stops, texels)}")
    if rows.shape != (stops, texels) or not (rows >= 0.0).all() or not np.isfinite(rows).all():
        raise ValueError(
            f"matrix: expected finite irradiances of 0 or more, of shape {(stops, texels)}, got shape {rows.shape}"
        )
    return rows


def _plan(
    dose_map: DoseMap, rows: FloatArray, target: float, chosen: dict[int, float], reachable: np.ndarray[Any, Any]
) -> Plan:
    area, dose = dose_map.area, dose_map.dose.copy()
    covered = []
    chosen = {stop: seconds * (1.0 + _ROUNDING) for stop, seconds in chosen.items()}
    for stop, seconds in chosen.items():
        dose += rows[stop] * seconds
        covered.append(float(area[dose >= target].sum() / area.sum()))
    whole = float(area[reachable].sum() / area.sum())
    return Plan(tuple(chosen), tuple(chosen.values()), tuple(covered), dose, whole)


def _greedy(rows: FloatArray, missing: FloatArray, area: FloatArray, goal: float, travel: float) -> dict[int, float]:
    """Seconds by candidate."""
    missing, enough = missing.copy(), 0.5 * _ROUNDING * missing  # of each so little that longer times bring it, too
    chosen: dict[int, float] = {}
    while (done := float(area[missing <= enough].sum())) < goal * (1.0 - 1e-12):
        left, still = np.flatnonzero(missing > enough), goal - done
        best = (0.0, -1, 0.0)
        for number, row in enumerate(rows):
            some = left[row[left] > 0.0]
            if not len(some):
                continue
            times = missing[some] / row[some]
            order = np.argsort(times, kind="stable")
            times, gained = times[order], np.minimum(np.cumsum(area[some[order]]), still)
            rate = gained / (times + (0.0 if number in chosen else travel) + 1e-12)
            top = int(rate.argmax())
            if rate[top] > best[0]:
                best = float(rate[top]), number, float(times[top])
        _, stop, seconds = best
        if stop < 0:
            break
        chosen[stop] = chosen.get(stop, 0.0) + seconds
        missing = np.maximum(missing - rows[stop] * seconds, 0.0)
    return chosen


def _highs(
    rows: FloatArray, missing: FloatArray, area: FloatArray, goal: float, travel: float, limit: float
) -> dict[int, float]:
    """Seconds by candidate, by the solver."""
    if find_spec("scipy") is None:
        raise ImportError("method 'highs' needs scipy: pip install 'shadow_tracer[dose]'")
    dose = np.zeros(len(missing))
    greedy = _greedy(rows, missing, area, goal, travel)
    for stop, seconds in greedy.items():
        dose += rows[stop] * seconds
    order = np.flatnonzero((missing > 0.0) & (dose >= missing * (1.0 - _ROUNDING)))
    if not len(order):
        return {}
    best = rows.max(axis=0)
    # In units of the time that the worst of them needs from its best place, so that numbers are near 1.
    unit = float((missing[order] / best[order]).max())
    doses = (rows[:, order] / missing[order]).T * unit
    times = _solve(doses, travel / unit, limit)
    if times is None:
        return greedy
    if travel:  # what slips through the solver's tolerances, below places that are not chosen, is shared out
        some = np.flatnonzero(times > 0.0)
        shared = _solve(doses[:, some], 0.0, limit)
        times[some] = times[some] if shared is None else shared
    times /= min(1.0, float((doses @ times).min()))
    found = {number: float(times[number] * unit) for number in range(len(rows)) if times[number] > 0.0}
    costs = [sum(each.values()) + travel * len(each) for each in (greedy, found)]
    return greedy if costs[0] <= costs[1] else found


def _solve(doses: FloatArray, travel: float, limit: float) -> FloatArray | None:
    """(K,) times that make the least sum of times, and of travels to where time is spent, for (M, K) doses per time in
    units of what is missing. With travels, every sample gets its dose within one unit somewhere.
    None: nothing was found within the limit [s].
    """
    from scipy.optimize import Bounds, LinearConstraint, milp
    from scipy.sparse import csr_array, eye_array, hstack

    rows, count = doses.shape
    costs, kinds, most = np.ones(count), np.zeros(count), np.full(count, np.inf)
    constraints = [LinearConstraint(csr_array(doses), 1.0, np.inf)]
    if travel:
        # Standing everywhere for one unit is enough; standing longer than that and its travels is no better.
        longest = count * (1.0 + travel)
        costs, kinds = np.append(costs, np.full(count, travel)), np.append(kinds, np.ones(count))
        most = np.append(most, np.ones(count))
        uses = hstack([eye_array(count), -longest * eye_array(count)])
        constraints = [
            LinearConstraint(hstack([csr_array(doses), csr_array((rows, count))]).tocsr(), 1.0, np.inf),
            LinearConstraint(uses.tocsr(), -np.inf, 0.0),
        ]
    found = milp(
        costs, integrality=kinds, bounds=Bounds(0.0, most), constraints=constraints, options={"time_limit": limit}
    )
    if found.x is None:
        return None
    times = np.maximum(found.x[:count], 0.0)
    if travel:
        gone = np.where(found.x[count:] > 0.5, times, 0.0)
        times = gone if (doses @ gone).all() else times
    return times
