# SPDX-License-Identifier: Apache-2.0
"""`shadow_tracer demo --uv`: the room, the way through it, and the animation."""

from __future__ import annotations

from pathlib import Path

import geometry
import numpy as np
import pytest

from shadow_tracer.apps.demo import demo, hospital
from shadow_tracer.apps.demo.route import drive
from shadow_tracer.scene.mesh import Scene
from shadow_tracer.scene.texels import cut


def pieces(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    texels = cut(Scene().put("room", vertices, triangles), 0.15)
    return texels.centres, texels.normals


def test_the_room_is_closed_and_seen_from_within() -> None:
    """The area that looks up is that which looks down, and so on; the shell is in front of its middle."""
    made = hospital.room()
    a, b, c = (made.vertices[made.triangles[:, k]] for k in range(3))
    across = 0.5 * np.cross(b - a, c - a)
    assert np.abs(across.sum(axis=0)).max() < 1e-9
    middle = np.array([0.0, 0.0, 0.5 * hospital.HIGH])
    assert (((middle - a) * across).sum(axis=1)[:12] > 0.0).all()
    volume = (a * across).sum(axis=1)[12:].sum() / 3.0
    assert 2.0 < volume < 12.0, "furniture is seen from without"


def test_the_way_keeps_off_what_stands_there_and_comes_by_everywhere() -> None:
    made = hospital.room()
    centres, normals = pieces(made.vertices, made.triangles)
    way = drive(centres, normals, 0.32, 1.3)
    assert (np.abs(way[:, 2]) < 1e-9).all() and np.linalg.norm(np.diff(way, axis=0), axis=1).max() < 0.6
    high = centres[(centres[:, 2] > 0.2) & (centres[:, 2] < 1.6)]
    gaps = np.sqrt(((way[:, None, :2] - high[None, :, :2]) ** 2).sum(axis=2).min(axis=1))
    assert gaps.min() > hospital.RADIUS - 0.15  # by cells of 0.2 m whose corners are cut off
    assert np.ptp(way[:, 0]) > 4.0 and np.ptp(way[:, 1]) > 2.5


def test_of_two_rooms_without_a_door_the_larger_one_is_driven_through() -> None:
    parts = [geometry.square(2, 0.0, 2.0), geometry.square(2, 0.0, 3.0, (9.0, 0.0))]
    vertices = np.concatenate([np.asarray(part[0], float) for part in parts])
    triangles = np.concatenate([np.asarray(parts[0][1]), np.asarray(parts[1][1]) + len(parts[0][0])])
    assert drive(*pieces(vertices, triangles), 0.3, 1.5)[:, 0].min() > 5.0


def test_places_without_a_floor_or_without_room() -> None:
    with pytest.raises(ValueError, match="data: there is no floor in the mesh"):
        drive(np.zeros((3, 3)), np.tile([1.0, 0.0, 0.0], (3, 1)), 0.3, 1.0)
    slit = geometry.box((0.0, 0.0, 0.0), (0.5, 0.5, 2.0))
    with pytest.raises(ValueError, match="data: no room for a robot 2 m across on the floor at z = 0.00 m"):
        drive(*pieces(slit[0], np.asarray(slit[1])[:, ::-1]), 1.0, 1.0)


@pytest.mark.slow
def test_the_animation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of a mesh in a file: it begins grey, and what has been reached is coloured."""
    for name in demo.NEEDED:
        pytest.importorskip(name)
    from PIL import Image

    vertices, triangles = geometry.box((-1.5, -1.0, 0.0), (1.5, 1.0, 2.2))
    np.savez(tmp_path / "cell.npz", vertices=vertices, triangles=np.asarray(triangles)[:, ::-1])
    options = ["--uv", "--data", str(tmp_path / "cell.npz"), "--frames", "3", "--animation-height", "90"]
    assert demo.main([*options, "--device", "cpu", "--output", str(tmp_path / "out")]) == 0
    assert "cell: 12 triangles" in capsys.readouterr().out
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["uv.gif"]
    with Image.open(tmp_path / "out" / "uv.gif") as gif:
        assert gif.n_frames == 4 and gif.height > 90
        coloured = []
        for number in range(4):
            gif.seek(number)
            red, green, blue = np.moveaxis(np.asarray(gif.convert("RGB"))[:90].astype(int), -1, 0)
            coloured.append(int((np.abs(red - green) + np.abs(green - blue) > 60).sum()))
        assert coloured[0] < 400 < 2000 < min(coloured[1:]), "at first only the robot is"


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--node"], "--node does not go with --uv"),
        (["--size", "64x48"], "--size does not go with --uv"),
        (["--budget", "3"], "--budget does not go with --uv"),
        (["--mesh", "room.obj"], "--mesh does not go with --uv"),
        (["--frames", "1"], "frames: must be 2 or more, got 1"),
        (["--data", "/nowhere.npz"], "data: expected a file with a mesh, got /nowhere.npz"),
    ],
)
def test_options_that_do_not_go_with_it(options: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    for name in demo.NEEDED:
        pytest.importorskip(name)
    try:
        code: object = demo.main(["--uv", "--device", "cpu", *options])
    except SystemExit as error:
        code = error.code
    assert code == 2 and says in capsys.readouterr().err
