# SPDX-License-Identifier: Apache-2.0
"""Folders of recorded frames: what is read, and what is said when something is wrong."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("PIL")
from PIL import Image

from shadow_tracer import DirectionalLight, PointLight, ShadowTracer, SpotLight
from shadow_tracer.apps.demo import recorded
from shadow_tracer.apps.demo.recorded import FolderSequence

ROOT = Path(__file__).resolve().parents[3]
DATA = Path(os.environ.get("SHADOW_TRACER_DATA", ROOT.parent / "shared" / "data")) / "rgbd"
W, H = 64, 48


def write_mesh(path: Path) -> None:
    """A wall at z = 3 and a pillar in front of it, seen from the origin; down is +y."""
    wall = [[-9, -9, 3], [9, -9, 3], [9, 9, 3], [-9, 9, 3]]
    pillar = [[-0.2, -9, 2], [0.2, -9, 2], [0.2, 9, 2], [-0.2, 9, 2]]
    triangles = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]
    np.savez(path, vertices=np.array(wall + pillar, np.float32), triangles=np.array(triangles, np.int32))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two frames of the wall and the pillar."""
    folder = tmp_path / "rgbd" / "room"
    folder.mkdir(parents=True)
    np.savetxt(folder / "intrinsics.txt", [[40, 0, 31.5], [0, 40, 23.5], [0, 0, 1]])
    depth = np.full((H, W), 3000, np.uint16)
    depth[:, 28:36] = 2000
    depth[0, :2] = 0, 65535
    for name in ("000000", "000010"):
        Image.fromarray(depth).save(folder / f"{name}.depth.png")
        np.savetxt(folder / f"{name}.pose.txt", np.eye(4))
    Image.fromarray(np.full((H, W, 3), (200, 100, 50), np.uint8)).save(folder / "000000.color.jpg")
    write_mesh(folder / "mesh.npz")
    return folder


def test_frames_are_read(folder: Path) -> None:
    sequence = FolderSequence(folder)
    assert (len(sequence), sequence.title, sequence.down) == (2, "room", (0, 1, 0))
    first, second = sequence.view(0), sequence.view(1)
    assert first.depth.dtype == np.uint16
    assert first.depth[0, :3].tolist() == [0, 0, 3000]
    assert (first.camera.width, first.camera.height, first.camera.fx, first.camera.cy) == (W, H, 40, 23.5)
    assert np.abs(first.colour.astype(int) - (200, 100, 50)).max() < 8
    assert (second.colour == recorded.GREY).all()
    assert first.vertices is not None
    assert len(first.vertices) == 8
    assert second.vertices is None  # the mesh is sent once
    assert sequence.bias == (0.01, 0.0)


def test_frames_can_be_limited(folder: Path) -> None:
    assert len(FolderSequence(folder, frames=1)) == 1


def test_mesh_is_found_beside_the_folder(folder: Path) -> None:
    (folder / "mesh.npz").unlink()
    beside = folder.parent.parent / "meshes"
    beside.mkdir()
    write_mesh(beside / "rgbd_room_fused.npz")
    assert len(FolderSequence(folder).triangles) == 4


def test_mesh_files_are_read_as_by_the_node(folder: Path) -> None:
    vertices, triangles = recorded.load_mesh(folder / "mesh.npz")
    lines = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in triangles + 1]
    (folder.parent / "room.obj").write_text("\n".join(lines))
    again, same = recorded.load_mesh(folder.parent / "room.obj")
    assert np.array_equal(again[same], vertices[triangles])
    (folder.parent / "room.obj").write_text("\n".join(lines[:-1]) + "\nf 1 2 99\n")
    with pytest.raises(ValueError, match="^mesh: cannot read .*room.obj: it has vertex indices"):
        recorded.load_mesh(folder.parent / "room.obj")


def without(name: str):  # type: ignore[no-untyped-def]
    return lambda folder: (folder / name).unlink()


def with_text(name: str, text: str):  # type: ignore[no-untyped-def]
    return lambda folder: (folder / name).write_text(text)


FAULTS = {
    "no folder": (lambda f: f.rename(f.parent / "gone"), "data: must be a folder"),
    "no depth": (lambda f: [p.unlink() for p in f.glob("*.depth.png")], "holds no NNNNNN.depth.png"),
    "no pose": (without("000010.pose.txt"), "000010.pose.txt is missing"),
    "no intrinsics": (without("intrinsics.txt"), "intrinsics.txt is missing"),
    "no mesh": (without("mesh.npz"), "mesh: none in .* give one with --mesh"),
    "two meshes": (lambda f: write_mesh(f / "other.npz"), "mesh: .* holds several, choose one"),
    "words for a pose": (with_text("000000.pose.txt", "hello"), "000000.pose.txt must hold a 4x4 matrix"),
    "short pose": (
        with_text("000000.pose.txt", "1 0 0\n0 1 0\n0 0 1"),
        r"4x4 matrix of finite numbers, got shape \(3, 3\)",
    ),
    "scaled pose": (with_text("000000.pose.txt", "2 0 0 0\n0 2 0 0\n0 0 2 0\n0 0 0 1"), "must hold a rigid"),
    "not a number": (with_text("intrinsics.txt", "nan 0 0\n0 1 0\n0 0 1"), "3x3 matrix of finite numbers"),
    "focal length": (with_text("intrinsics.txt", "0 0 0\n0 1 0\n0 0 1"), "camera of frame 000000 .* fx: "),
    "not a picture": (with_text("000000.depth.png", "hello"), "000000.depth.png is not a readable picture"),
    "colour as depth": (
        lambda f: Image.fromarray(np.zeros((H, W, 3), np.uint8)).save(f / "000000.depth.png"),
        "must be a 16-bit grey PNG",
    ),
    "mesh elsewhere": (
        lambda f: np.savez(f / "mesh.npz", vertices=np.eye(3) - 50, triangles=np.array([[0, 1, 2]])),
        "mesh: the frames see next to nothing of it",
    ),
    "other arrays": (lambda f: np.savez(f / "mesh.npz", points=np.eye(3)), r"must hold the arrays .* got \['points'\]"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_named(folder: Path, fault: str) -> None:
    spoil, text = FAULTS[fault]
    spoil(folder)
    with pytest.raises(ValueError, match=text):
        FolderSequence(folder)


def test_missing_mesh_file_and_frame_number_are_refused(folder: Path) -> None:
    with pytest.raises(ValueError, match="mesh: .* is not a file"):
        FolderSequence(folder, folder / "none.ply")
    with pytest.raises(ValueError, match="frames: must be 1 or more"):
        FolderSequence(folder, frames=0)
    with pytest.raises(ValueError, match="index: must be 0..1"):
        FolderSequence(folder).view(2)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["livingroom1", "redkitchen"])
def test_lights_for_real_places_make_shadows(name: str) -> None:
    """Each light reaches a good part of what it shines at, but not all, in the eyes of the library itself."""
    if not (DATA / name).is_dir():
        pytest.skip(f"needs {DATA / name} (set SHADOW_TRACER_DATA)")
    sequence = FolderSequence(DATA / name)
    assert sequence.down == (0, 1, 0)
    assert {light.name: type(light.light) for light in sequence.lights} == {
        "lamp": PointLight,
        "spotlight": SpotLight,
        "sun": DirectionalLight,
    }
    view = sequence.view(0)
    points = view.camera.unproject(view.depth / 1000)[::8, ::8][view.depth[::8, ::8] > 0]
    assert view.vertices is not None
    tracer = ShadowTracer(device="cpu")
    tracer.scene.put("place", view.vertices, sequence.triangles)
    for light in sequence.lights:
        way = light.light.homogeneous[:3] - points * light.light.homogeneous[3]
        axis, cosine = light.light.cone
        inside = -(way / np.linalg.norm(way, axis=1, keepdims=True)) @ axis >= cosine
        hidden = tracer.occluded(points[inside], light.light, bias=sequence.bias[0])
        assert inside.mean() > 0.1
        assert 0.1 < hidden.mean() < 0.7, light.name
