# SPDX-License-Identifier: Apache-2.0
"""Whoever starts in the middle of a bag reads the messages of the markers that are there, and has the markers that
somebody has who read all of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_journey import DEPTH, FOCAL, INFO, MARKER, MARKERS, MESH, corners
from bag_maker import BagMaker, image, info

from shadow_tracer.apps.bag import reader
from shadow_tracer.apps.bag.marker_ledger import MarkerLedger, runs
from shadow_tracer.apps.bag.names import Names
from shadow_tracer.apps.bag.player import Player, Wish
from shadow_tracer.apps.bag.reader import MESHES, Recording
from shadow_tracer.apps.bag.survey import Survey, survey
from shadow_tracer.ros.parameters.parameters import settings_from
from shadow_tracer.ros.wire.cdr import encode_mesh
from shadow_tracer.ros.wire.cdr_markers import MarkerMessage, encode_marker, encode_markers
from shadow_tracer.ros.world.mesh_store import MeshStore

MOST = 4096
_STEP = 1_000_000  # from message to message [ns]


def marker(chance: np.random.Generator, k: int) -> MarkerMessage:
    """Any action on one of six markers in two namespaces; some are refused, some are no lists of triangles."""
    action = int(chance.choice([0, 2, 3, 7], p=[0.8, 0.12, 0.06, 0.02]))
    points = corners(0.01 * k)[: int(chance.choice([3, 0, 2], p=[0.9, 0.06, 0.04]))]
    if chance.random() < 0.03:
        points = points * np.nan
    ns = str(chance.choice(["a", "b"] if action != 3 else ["a", "b", ""]))
    return MarkerMessage(
        ns=ns, id=int(chance.integers(3)), action=action, frame="odom", stamp=k + 1, points=points,
        type=int(chance.choice([11, 1], p=[0.95, 0.05])),
        lifetime=int(chance.choice([0, 5, 40])) * _STEP,
    )  # fmt: skip


def wild(seed: int, meshes: bool) -> BagMaker:
    chance, made = np.random.default_rng(seed), BagMaker()
    for k in range(120):
        one = chance.random() < 0.5
        several = [marker(chance, k) for _ in range(1 if one else chance.integers(0, 4))]
        if one:
            made.raw("/mesh_marker", MARKER, encode_marker(several[0]))
        else:
            made.raw("/mesh_markers", MARKERS, encode_markers(several))
        if chance.random() < 0.1:
            made.now -= 2 * _STEP  # several at one time, or one before others
        if chance.random() < 0.1:
            made.raw("/mesh_marker", MARKER, b"\0\1\0\0nothing")
        if meshes and chance.random() < 0.05:
            made.raw("/mesh", MESH, encode_mesh(corners(0.1 * k), [(0, 1, 2)]))
        made.add(INFO, info(10, 8, k + 1, FOCAL / 4))
        made.add(DEPTH, image(np.ones((8, 10), np.uint16), k + 1))
    return made


def player(recording: Recording, found: Survey, most: int = MOST) -> Player:
    settings = settings_from({"bounds.max_triangles": most, "fixed_frame": "odom"})
    nothing: Any = None  # no image is answered
    return Player(recording, found.background(settings), settings, nothing, nothing, Names(), Wish())


def state(store: MeshStore, now: int) -> tuple[Any, ...]:
    store.expire(now)
    parts = {key: (part.vertices.tolist(), part.frame, part.stamp, part.expires) for key, part in store.parts.items()}
    return parts, store.lacking, {key: store._received[key] for key in parts}


@pytest.mark.parametrize("most", [MOST, 2], ids=["room", "too little room"])
@pytest.mark.parametrize("seed", range(3))
def test_markers_at_any_time_are_those_of_all_messages_before(tmp_path: Path, seed: int, most: int) -> None:
    settings = settings_from({"bounds.max_triangles": most})
    with Recording(wild(seed, most == MOST).write(tmp_path / "bag"), Names(), [], 1 << 20) as recording:
        found = survey(recording, settings)
        all_of_them = player(recording, found, most)
        messages = list(recording.messages(MESHES))
        there = 0
        for start in sorted({message.time for message in messages[::4]} | set(found.frames[::9, 0].tolist())):
            one = player(recording, found, most)
            one.seek(found, start)
            while messages and messages[0].time < start:
                all_of_them._receive_all([messages.pop(0)], [])
            assert state(one.meshes.store, start) == state(all_of_them.meshes.store, start)
            there += len(one.meshes.store.parts)
        assert there > 25


def test_what_is_over_makes_room() -> None:
    ledger = MarkerLedger(MOST)
    for k in range(20):
        message = MarkerMessage(id=k, frame="odom", points=corners(0.0), lifetime=3 * _STEP)
        assert len(ledger.take("mesh_marker", encode_marker(message), 1 + k * _STEP)) == 1
    found = ledger.finish()
    assert found.most == 3 and len(found.rows) == len(found.keys) == 20
    assert (found.rows[:17, 1] - found.rows[:17, 0] == 3 * _STEP).all()


def test_what_is_in_force_is_read_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A still marker from the beginning, one that moves with each image: two messages of 200 are taken."""
    made = BagMaker()
    made.raw("/mesh_marker", MARKER, encode_marker(MarkerMessage(id=7, frame="odom", stamp=1, points=corners(0.0))))
    for k in range(200):
        made.raw("/mesh_marker", MARKER, encode_marker(MarkerMessage(frame="odom", stamp=1, points=corners(0.01 * k))))
        made.add(INFO, info(10, 8, k + 1, FOCAL / 4))
        made.add(DEPTH, image(np.ones((8, 10), np.uint16), k + 1))
    settings, read = settings_from({"bounds.max_triangles": MOST}), []
    with Recording(made.write(tmp_path / "bag"), Names(), [], 1 << 20) as recording:
        found = survey(recording, settings)
        assert found.markers.most == 2 and len(found.markers.rows) == 201
        one, taken = player(recording, found), reader.Message
        monkeypatch.setattr(reader, "Message", lambda *row: read.append(row[0]) or taken(*row))
        one.seek(found, int(found.frames[150, 0]))
        assert sorted(one.meshes.store.parts) == ["markers//0", "markers//7"] and len(read) == 2
        assert one.meshes.store.parts["markers//0"].vertices.tolist() == corners(1.5).tolist()


def test_runs() -> None:
    times = np.arange(1000) * 10
    assert runs(times, set()) == []
    assert runs(times, {50}) == [(50, 50)]
    assert runs(times, {50, 130, 500, 510}) == [(50, 130), (500, 510)]
    many = set(times[::11].tolist())
    assert len(runs(times, many)) <= 64 and runs(times, many)[-1][1] == 990 * 10
    for first, last in runs(times, many):
        many -= set(range(first, last + 1))
    assert not many
