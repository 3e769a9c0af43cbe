# SPDX-License-Identifier: Apache-2.0
"""From a plan to bags: what is left is played by an engine, and each bag is committed once its windows are there."""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from shadow_tracer.apps.bag.files import BagError
from shadow_tracer.apps.bags.folder import LOCK, commit, committed, merged, report_of
from shadow_tracer.apps.bags.jobs import Job, Report
from shadow_tracer.apps.bags.plan import HIDDEN, Entry, Plan
from shadow_tracer.apps.fleet.engines import Engine
from shadow_tracer.apps.fleet.files import only_one

ALL, SOME, WRONG, UNFINISHED, INTERRUPTED = 0, 1, 2, 3, 130  # exit codes


def good(report: Report) -> bool:
    """Whether a job left a part."""
    return not report.error


class Log:
    """Lines on stderr for people, or JSON, an object a line, for programs.

    Args:
        as_json: which.
    """

    def __init__(self, as_json: bool) -> None:
        self._json = as_json

    def say(self, event: str, text: str, **values: Any) -> None:
        """An event, for programs with its values, for people by its text; one without text they do not see."""
        if self._json:
            print(json.dumps({"event": event, **values, **({"text": text} if text else {})}), file=sys.stderr)
        elif text:
            print(text, file=sys.stderr)

    def bar(self, total: int, before: int) -> Bar:
        """A bar for all frames."""
        return Bar(total, before, not self._json)


class Bar:
    """Frames of all bags, on stderr. Use as a context manager."""

    def __init__(self, total: int, before: int, shown: bool) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        columns = (TextColumn("frames"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        self._progress = Progress(*columns, console=Console(stderr=True), disable=not shown)
        self._task = self._progress.add_task("frames", total=total, completed=before)

    def __enter__(self) -> Bar:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def advance(self, frames: int) -> None:
        """So many more are done."""
        self._progress.advance(self._task, frames)


@dataclasses.dataclass
class Outcome:
    """What came of a run: why jobs failed, by bag."""

    failed: dict[str, str]


def run(plan: Plan, engine: Engine, log: Log, keep_going: bool, shard: tuple[int, int] | None = None) -> Outcome:
    """Play the windows that are not there yet.

    Args:
        plan: what is to be done.
        engine: who does it.
        log: where events are written.
        keep_going: after a failure do the rest as well.
        shard: (number from 0, count): only each count-th job.

    Raises:
        Busy: another run is at work on the same jobs.
    """
    hidden = Path(plan.out) / HIDDEN
    with only_one(hidden / LOCK, shared=shard is not None):
        if shard is None:
            return _run(list(plan.jobs()), engine, log, keep_going)
        number, count = shard
        with only_one(hidden / f"{LOCK}-{number}-{count}"):
            return _run(list(plan.jobs())[number::count], engine, log, keep_going)


class _Stop(Exception):
    pass


def _run(jobs: list[Job], engine: Engine, log: Log, keep_going: bool) -> Outcome:
    left = [job for job in jobs if report_of(job) is None]
    total, before = (sum(job.frames for job in some) for some in (jobs, [job for job in jobs if job not in left]))
    failed: dict[str, str] = {}
    with log.bar(total, before) as bar:

        def done(job: Job, result: Any) -> None:
            text = str(result) or type(result).__name__ if isinstance(result, BaseException) else result.error
            if text:
                failed[job.bag] = text
                log.say("failed", "", bag=job.bag, part=job.part, error=text)
                if not keep_going:
                    raise _Stop
                return
            log.say("part", "", part=job.part, frames=job.frames, seconds=result.seconds, host=result.host)
            bar.advance(job.frames)

        try:
            if left:
                engine(left, done)
        except _Stop:
            pass
    return Outcome(failed)


def states(plan: Plan) -> Iterator[tuple[Entry, int, int, bool]]:
    """Of each bag the frames that are done, the windows that are done, and whether it is committed."""
    for entry in plan.entries:
        if not entry.error and committed(plan, entry):
            yield entry, entry.frames, len(entry.windows), True
            continue
        done = [job for job in plan.jobs_of(entry) if report_of(job) is not None]
        yield entry, sum(job.frames for job in done), len(done), False


def finish(plan: Plan, outcome: Outcome, log: Log, strict: bool) -> int:
    """Commit the bags of which all windows are there, and say what came of each. Returns the exit code."""
    failed = unfinished = 0
    for entry in plan.entries:
        error = entry.error or outcome.failed.get(entry.bag, "")
        if error:
            failed += 1
            log.say("bag_failed", f"failed: {entry.bag}: {error}", bag=entry.bag, error=error)
            continue
        if any(report_of(job) is None for job in plan.jobs_of(entry)):
            unfinished += 1
            log.say("bag_unfinished", f"not finished: {entry.bag}", bag=entry.bag)
            continue
        try:
            total = merged(entry, commit(plan, entry))
        except (BagError, OSError) as fault:
            failed += 1
            log.say("bag_failed", f"failed: {entry.bag}: {fault}", bag=entry.bag, error=str(fault))
            continue
        _tell(plan, entry, total, log)
        if strict and (total.incomplete or not total.traced):
            failed += 1
            text = f"failed: {entry.bag}: nothing is known of {total.frames - total.traced} frames (--strict)"
            log.say("bag_failed", text, bag=entry.bag, error="unknown")
    return SOME if failed else UNFINISHED if unfinished else ALL


def _tell(plan: Plan, entry: Entry, total: Report, log: Log) -> None:
    numbers = {"frames": total.frames, "traced": total.traced, "windows": len(entry.windows)}
    where = Path(plan.out) / entry.folder
    text = f"{where}: {total.frames} frames, {total.traced} traced, {total.frames - total.traced} unknown"
    log.say("bag", text, bag=entry.bag, output=str(where), **numbers)
    said = [f"{what} ({count} frames)" for what, count in total.warnings.items()]
    said += [f"unknown, {count} times: {what}" for what, count in total.reasons.values()]
    said += [
        f"{name}: {count} messages were refused, the last one because of {what}"
        for name, (count, what) in sorted(total.refused.items())
    ]
    if total.passes > 1:
        said.append(f"the images start again {total.passes - 1} times at an earlier stamp; cut the bag there")
    if total.differing:
        said.append(f"{total.differing} pixels differ between two pipelines; please report this")
    for line in said:
        log.say("warning", f"warning: {entry.name}: {line}", bag=entry.bag)
