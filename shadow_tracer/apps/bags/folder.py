# SPDX-License-Identifier: Apache-2.0
"""The output of a plan: parts with their records, and ``metadata.yaml``, which is written last and makes them a bag."""

from __future__ import annotations

import re
import shutil
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from mcap.exceptions import McapError
from mcap.reader import make_reader

from shadow_tracer.apps.bag.files import BagError
from shadow_tracer.apps.bags.jobs import RECORD, Job, Report
from shadow_tracer.apps.bags.plan import HIDDEN, Entry, Plan
from shadow_tracer.apps.fleet.files import whole

_INFORMATION = "rosbag2_bagfile_information"
_LEFT = re.compile(r"\..*\.\d+-[0-9a-f]{8}\.part")  # what a run that was killed leaves of a file
PLAN, LOCK = "plan.json", "lock"


def report_of(job: Job) -> Report | None:
    """The report of a job that is done; None if its part is not there, is damaged, or answers something else."""
    found = _read(Path(job.part))
    return found[0] if found is not None and found[0].key == job.key else None


def _read(part: Path) -> tuple[Report, dict[str, Any]] | None:
    """Record and metadata of a part, of which as many messages are there as the record says; else None."""
    try:
        with part.open("rb") as stream:
            reader = make_reader(stream)
            summary = reader.get_summary()
            texts = [each.metadata for each in reader.iter_metadata() if each.name == "rosbag2"]
        metadata: Any = yaml.load(texts[-1]["serialized_metadata"], getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        report = Report.of_record(metadata["custom_data"][RECORD])
        there = summary.statistics.message_count if summary is not None and summary.statistics is not None else 0
        return (report, metadata) if there == sum(report.counts.values()) else None
    except (OSError, McapError, ValueError, KeyError, IndexError, TypeError, yaml.YAMLError):
        return None


def committed(plan: Plan, entry: Entry) -> bool:
    """Whether the output of a bag is whole and of this plan."""
    try:
        content: Any = yaml.safe_load((_folder(plan, entry) / "metadata.yaml").read_text(encoding="utf-8"))
        return bool(content[_INFORMATION]["custom_data"][RECORD] == entry.key)
    except (OSError, KeyError, TypeError, yaml.YAMLError, UnicodeDecodeError):
        return False


def commit(plan: Plan, entry: Entry) -> list[Report]:
    """Make a bag of the parts.

    Returns:
        Their reports, in order.

    Raises:
        BagError: a part is missing, is of another plan, or the images in them are not those of the plan.
        OSError: the file cannot be written.
    """
    reports, texts = [], []
    for job in plan.jobs_of(entry):
        found = _read(Path(job.part))
        if found is None or found[0].key != job.key:
            raise BagError(f"{job.part}: is not there or damaged; run the plan again")
        reports.append(found[0])
        texts.append(found[1])
    images = sum(report.images for report in reports)
    if images != entry.frames:
        raise BagError(f"{entry.bag}: the parts have {images} depth images, the plan {entry.frames}; plan again")
    folder = _folder(plan, entry)
    with whole(folder / "metadata.yaml") as new:
        new.write_text(yaml.safe_dump({_INFORMATION: _joined(entry, texts)}, sort_keys=False), encoding="utf-8")
    for path in folder.iterdir():
        if _LEFT.fullmatch(path.name):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    return reports


def _joined(entry: Entry, texts: list[dict[str, Any]]) -> dict[str, Any]:
    names = [f"{entry.name}_{number:04d}.mcap" for number in range(len(texts))]
    topics: dict[str, dict[str, Any]] = {}
    for text in texts:
        for each in text["topics_with_message_count"]:
            name = each["topic_metadata"]["name"]
            known = topics.setdefault(name, {**each, "message_count": 0})
            known["message_count"] += each["message_count"]
    files = [{**text["files"][0], "path": name} for name, text in zip(names, texts, strict=True)]
    full = [file for file in files if file["message_count"]]
    begin = min((_begin(file) for file in full), default=0)
    end = max((_begin(file) + file["duration"]["nanoseconds"] for file in full), default=0)
    for file in files:
        if not file["message_count"]:
            file["starting_time"] = {"nanoseconds_since_epoch": begin}
    return {
        **texts[0],
        "relative_file_paths": names,
        "duration": {"nanoseconds": end - begin},
        "starting_time": {"nanoseconds_since_epoch": begin},
        "message_count": sum(file["message_count"] for file in files),
        "topics_with_message_count": list(topics.values()),
        "files": files,
        "custom_data": {RECORD: entry.key},
    }


def _begin(file: dict[str, Any]) -> int:
    return int(file["starting_time"]["nanoseconds_since_epoch"])


def _folder(plan: Plan, entry: Entry) -> Path:
    return Path(plan.out) / entry.folder


def open_output(out: Path, restart: bool) -> Plan | None:
    """The plan that is in a folder, if there is one; with ``restart`` what it has made is removed, and it is None.

    Raises:
        BagError: the folder holds something else.
    """
    if not out.exists():
        return None
    if not out.is_dir():
        raise BagError(f"{out}: is a file; the output of several processes is a folder")
    if not (out / PLAN).exists():
        if any(path.name != HIDDEN and not _LEFT.fullmatch(path.name) for path in out.iterdir()):
            raise BagError(f"{out}: holds something that no plan has made; choose another folder")
        return None
    if not restart:
        return Plan.load(out / PLAN)
    shutil.rmtree(out / HIDDEN, ignore_errors=True)
    for part in _made(out):
        part.unlink(missing_ok=True)
    (out / PLAN).unlink()
    return None


def _made(out: Path) -> Iterator[Path]:
    """Files of the plan in a folder, whichever version made it."""
    for path in [*out.glob("*"), *out.glob("*/*")]:
        if path.name == "metadata.yaml" or re.fullmatch(r".*_\d{4,}\.mcap", path.name):
            yield path


def merged(entry: Entry, reports: list[Report]) -> Report:
    """What the windows of a bag say together."""
    total = Report(entry.key)
    counts: Counter[str] = Counter()
    warnings: Counter[str] = Counter()
    total.refused = {name: list(pair) for name, pair in entry.refused.items()}
    for each in reports:
        for name in ("frames", "traced", "images", "verified", "differing"):
            setattr(total, name, getattr(total, name) + getattr(each, name))
        total.passes += each.passes - 1
        counts.update(each.counts)
        warnings.update(each.warnings)
        for name, (text, count) in each.reasons.items():
            first, before = total.reasons.get(name, (text, 0))
            total.reasons[name] = [first, before + count]
        for name, (count, text) in each.refused.items():
            total.refused[name] = [total.refused.get(name, (0, ""))[0] + count, text]
        total.parts = list(dict.fromkeys([*total.parts, *each.parts]))
    total.counts, total.warnings = dict(sorted(counts.items())), dict(warnings)
    return total
