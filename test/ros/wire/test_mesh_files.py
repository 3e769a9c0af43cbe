# SPDX-License-Identifier: Apache-2.0
"""Meshes from files: found as URDF names them, read whatever wrote them, in metres, and read again only if changed.

What stands in the formats has tests beside this one: test_mesh_formats, test_mesh_gltf, test_mesh_collada."""

from __future__ import annotations

import os
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shadow_tracer import Scene
from shadow_tracer.ros.wire.mesh_files import file_parts, load_mesh_file, loading, locate
from shadow_tracer.ros.wire.parts import Changes, Part, PartError
from shadow_tracer.ros.world.mesh_sources import MeshSources
from shadow_tracer.ros.world.mesh_store import MeshStore

trimesh = pytest.importorskip("trimesh", reason="needs trimesh: pip install 'shadow_tracer[mesh]'")

_TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def box() -> Any:
    """A box that no rotation or mirroring leaves as it is."""
    mesh = trimesh.creation.box((1.0, 2.0, 3.0))
    mesh.apply_translation((5.0, 0.25, -1.0))
    return mesh


def corners(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(T, 9) corners in space in an order of their own: equal for meshes of the same triangles, wound alike."""
    space = vertices[triangles]
    first = np.lexsort(space.transpose(2, 0, 1)[::-1], axis=-1)[:, 0]
    turned = np.stack([np.roll(corner, -k, axis=0) for corner, k in zip(space, first, strict=True)]).reshape(-1, 9)
    return turned[np.lexsort(turned.T)]


def check(found: tuple[np.ndarray, np.ndarray], vertices: np.ndarray, triangles: np.ndarray) -> None:
    np.testing.assert_allclose(corners(*found), corners(vertices, triangles), rtol=0, atol=1e-6)
    for array, dtype in zip(found, (np.float64, np.int32), strict=True):
        assert array.dtype == dtype and array.flags.owndata and array.flags.c_contiguous and not array.flags.writeable
    mesh = Scene().put("mesh", *found)
    assert mesh.vertices is found[0] and mesh.triangles is found[1]


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "ply", "obj", "off", "glb"])
def test_formats(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"box.{kind.partition('_')[0]}"
    box().export(path, file_type=kind)
    check(load_mesh_file(str(path), 0.0), box().vertices, box().faces)
    check(load_mesh_file(str(path), 0.001), box().vertices * 0.001, box().faces)


def test_a_file_that_refers_to_others(tmp_path: Path) -> None:
    for name, data in box().export(file_type="gltf").items():
        (tmp_path / name).write_bytes(data)
    check(load_mesh_file(str(tmp_path / "model.gltf"), 0.0), box().vertices, box().faces)


def test_polygons_become_triangles_and_lines_nothing(tmp_path: Path) -> None:
    path = tmp_path / "mixed.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nf 1 2 3 4\nl 1 5\nusemtl other\nf -1 -4 -5\n")
    with pytest.warns(UserWarning, match=r"mixed.obj: left out, as it casts no shadow: lines \(1\)$"):
        vertices, triangles = load_mesh_file(str(path), 0.0)
    space = vertices[triangles]
    areas = np.linalg.norm(np.cross(space[:, 1] - space[:, 0], space[:, 2] - space[:, 0]), axis=1) / 2
    np.testing.assert_allclose(areas, 0.5)
    assert len(triangles) == 3


def placed() -> list[np.ndarray]:
    """Turned and moved, scaled unevenly, mirrored."""
    turned = trimesh.transformations.rotation_matrix(0.7, (1.0, 2.0, 3.0), (0.5, 0.0, 0.0))
    scaled = np.diag([2.0, 0.5, 1.5, 1.0])
    scaled[:3, 3] = 10.0, 20.0, 30.0
    mirrored = np.diag([1.0, -1.0, 1.0, 1.0])
    return [turned, scaled, mirrored, turned @ mirrored @ scaled]


def test_a_scene_is_flattened_by_its_transforms(tmp_path: Path) -> None:
    """Instances, a node within a node, and a mirrored one that stays the right way out."""
    scene = trimesh.Scene()
    parent = placed()[0]
    scene.graph.update("arm", scene.graph.base_frame, matrix=parent)
    scene.add_geometry(box(), geom_name="box", node_name="plain")
    wanted = [np.eye(4)]
    for number, transform in enumerate(placed()):
        scene.graph.update(f"top{number}", scene.graph.base_frame, matrix=transform, geometry="box")
        scene.graph.update(f"held{number}", "arm", matrix=transform, geometry="box")
        wanted += [transform, parent @ transform]
    scene.export(tmp_path / "scene.glb")
    vertices, triangles, first = [], [], 0
    for transform in wanted:
        mesh = box().apply_transform(transform)  # trimesh turns the triangles of a mirrored mesh, too
        assert mesh.volume > 0.0
        vertices.append(mesh.vertices)
        triangles.append(mesh.faces + first)
        first += len(mesh.vertices)
    check(load_mesh_file(str(tmp_path / "scene.glb"), 0.0), np.concatenate(vertices), np.concatenate(triangles))
    check(load_mesh_file(str(tmp_path / "scene.glb"), 0.01), np.concatenate(vertices) * 0.01, np.concatenate(triangles))


def test_units_of_the_file_are_taken_unless_a_scale_is_given(tmp_path: Path) -> None:
    mesh = box()
    for units, factor in (("mm", 0.001), ("inches", 0.0254), ("meters", 1.0), ("0.5 * meters", 0.5)):
        mesh.units = units
        path = tmp_path / "units.glb"
        trimesh.Scene(mesh).export(path)
        check(load_mesh_file(str(path), 0.0), mesh.vertices * factor, mesh.faces)
        check(load_mesh_file(str(path), 0.25), mesh.vertices * 0.25, mesh.faces)


@pytest.mark.parametrize("units", [("cubits",), ("mm", "inches")])
def test_units_that_are_unknown_or_mixed_ask_for_a_scale(tmp_path: Path, units: tuple[str, ...]) -> None:
    scene = trimesh.Scene()
    for number, name in enumerate(units):
        mesh = box()
        mesh.units = name
        scene.add_geometry(mesh, geom_name=f"box{number}")
    path = tmp_path / "units.glb"
    scene.export(path)
    with pytest.raises(PartError, match=rf"^mesh.files: the units of .*{units[0]}.*set mesh.files_scale"):
        load_mesh_file(str(path), 0.0)
    assert len(load_mesh_file(str(path), 1.0)[1]) == 12 * len(units)


def test_two_names_of_one_unit_are_one(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    for number, name in enumerate(("mm", "millimeters")):
        mesh = box()
        mesh.units = name
        scene.add_geometry(mesh, geom_name=f"box{number}")
    scene.export(tmp_path / "units.glb")
    assert load_mesh_file(str(tmp_path / "units.glb"), 0.0)[0].max() == pytest.approx(0.0055)


@pytest.mark.parametrize("scale", [-1.0, float("nan"), float("inf")])
def test_a_scale_is_a_length(tmp_path: Path, scale: float) -> None:
    path = tmp_path / "box.obj"
    path.write_text(_TRIANGLE)
    with pytest.raises(PartError, match="^mesh.files_scale: expected metres per unit"):
        load_mesh_file(str(path), scale)


# Names.


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A workspace with a package robot_description of one file; returns that file."""
    prefix = tmp_path / "install"
    index = prefix / "share/ament_index/resource_index/packages"
    index.mkdir(parents=True)
    (index / "robot_description").touch()
    file = prefix / "share/robot_description/meshes/the arm.obj"
    file.parent.mkdir(parents=True)
    file.write_text(_TRIANGLE)
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join([str(tmp_path / "other"), str(prefix)]))
    return file


@pytest.fixture(params=["with ament_index_python", "without"])
def ament(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if request.param == "without":
        monkeypatch.setitem(sys.modules, "ament_index_python.packages", None)
    else:
        pytest.importorskip("ament_index_python")


@pytest.mark.usefixtures("ament")
def test_package_names(package: Path) -> None:
    assert locate("package://robot_description/meshes/the arm.obj") == package
    assert locate("package://robot_description/meshes/the%20arm.obj") == package
    assert len(load_mesh_file("package://robot_description/meshes/the arm.obj", 0.0)[1]) == 1
    with pytest.raises(PartError, match="^mesh.files: cannot find .*robot_description/meshes/leg.obj.*No such file"):
        locate("package://robot_description/meshes/leg.obj")


@pytest.mark.usefixtures("ament", "package")
@pytest.mark.parametrize("name", ["other_robot", "robot_descriptio", "..", "a b", "robot_description\x00"])
def test_a_package_that_is_not_there(name: str) -> None:
    with pytest.raises(PartError, match="^mesh.files: there is no package .* in AMENT_PREFIX_PATH, .*source the setup"):
        locate(f"package://{name}/mesh.stl")


@pytest.mark.usefixtures("ament")
def test_packages_without_a_workspace(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    with pytest.raises(PartError, match="in AMENT_PREFIX_PATH, which is ''; source"):
        locate("package://robot_description/mesh.stl")


def test_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "a b%20c.obj"
    file.write_text(_TRIANGLE)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    for name in (
        str(file),
        "a b%20c.obj",
        "./a b%20c.obj",
        "~/a b%20c.obj",
        f"file://{tmp_path}/a b%2520c.obj",
        f"file://localhost{tmp_path}/a%20b%2520c.obj",
    ):
        assert locate(name) == file, name


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("https://example.org/mesh.stl", "expected a path, file:///... or package://..., got 'https"),
        ("model://mesh.stl", "expected a path, file:///... or package://"),
        ("file://elsewhere/mesh.stl", "expected a path, file:///... or package://"),
        ("package://", "expected package://<package>/<path>, got 'package://'"),
        ("package://robot", "expected package://<package>/<path>"),
        ("package://robot/", "expected package://<package>/<path>"),
        ("package:///mesh.stl", "expected package://<package>/<path>"),
        ("/nowhere/mesh.stl", "cannot find '/nowhere/mesh.stl': No such file"),
        ("/", "/ is not a file"),
        ("/dev/null", "/dev/null is not a file"),
        ("a\x00b.stl", "cannot find .*null"),
        ("x" * 5000, "cannot find .*: File name too long"),
        ("~nobody_of_that_name/mesh.stl", "cannot find"),
    ],
)
def test_names_that_lead_nowhere(name: str, text: str) -> None:
    for use in (locate, lambda where: load_mesh_file(where, 0.0), lambda where: file_parts([where], 0.0)):
        with pytest.raises(PartError, match=f"^mesh.files: {text}"):
            use(name)


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "mesh.stl")
    with pytest.raises(PartError, match="is not a file"):
        load_mesh_file(str(tmp_path / "mesh.stl"), 0.0)


# What cannot be read.


def ply(vertices: str, faces: str) -> str:
    head = f"ply\nformat ascii 1.0\nelement vertex {len(vertices.splitlines())}\n"
    head += "".join(f"property float {name}\n" for name in "xyz")
    return f"{head}element face 1\nproperty list uchar int vertex_indices\nend_header\n{vertices}\n{faces}\n"


@pytest.mark.parametrize(
    ("name", "content", "text"),
    [
        ("empty.stl", "", "cannot read .*empty.stl: it is neither text .* nor binary: it has 0 bytes"),
        ("empty.obj", "", "empty.obj has no triangles$"),
        ("empty.ply", "", "cannot read .*empty.ply: it does not begin with a line 'ply'"),
        ("empty.off", "", "cannot read .*empty.off: it does not begin with OFF"),
        ("empty.glb", "", "cannot read .*empty.glb: it is no glTF"),
        ("empty.dae", "", "cannot read .*empty.dae: it is no XML"),
        ("empty.3mf", "", "cannot read .*empty.3mf: it is no 3MF"),
        ("points.xyz", "1 2 3\n4 5 6\n", r"points.xyz has no triangles, only PointCloud \(1\)$"),
        ("points.obj", "v 1 2 3\nv 4 5 6\n", "points.obj has no triangles$"),
        ("mesh.blend", "BLENDER", "cannot read .*mesh.blend: trimesh cannot read it: .*blend'? not supported"),
        ("mesh", "solid", "cannot read .*: trimesh cannot read it"),
        ("mesh.glb", b"\xff" * 300, "cannot read .*mesh.glb: it is no glTF"),
        ("mesh.zip", b"PK\x03\x04" + bytes(100), "cannot read .*mesh.zip: it is an archive; unpack it"),
        ("mesh.dae.gz", b"\x1f\x8b", "cannot read .*mesh.dae.gz: it is an archive; unpack it"),
        (
            "mesh.obj",
            "v 0 0 0\nv 1 0 0\nf 1 2 3\n",
            "cannot read .*mesh.obj: it has vertex indices from 0 to 2, counted from 0, but 2 vertices",
        ),
        (
            "nan.obj",
            "v 0 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n",
            r"vertex 1 of .* is \[1.0, nan, 0.0\] m; expected",
        ),
        ("huge.obj", "v 0 0 0\nv 1 0 0\nv 0 1e51 0\nf 1 2 3\n", r"vertex 2 of .* at most 1e\+50 m"),
        ("index.ply", ply("0 0 0\n1 0 0\n0 1 0", "3 0 1 7"), "it has vertex indices from 0 to 7, .* but 3 vertices"),
        ("index.ply", ply("0 0 0\n1 0 0\n0 1 0", "3 0 1 -1"), "it has vertex indices from -1 to 1,"),
        ("flat.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\nf 1 1 2\n", r"every triangle of .* zero area \(2 of them\)"),
    ],
)
def test_files_that_are_no_mesh(tmp_path: Path, name: str, content: str | bytes, text: str) -> None:
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(PartError, match=f"^mesh.files: .*{text}"):
        load_mesh_file(str(path), 0.0)


def test_a_point_cloud_in_a_mesh_format(tmp_path: Path) -> None:
    trimesh.PointCloud(np.eye(3)).export(tmp_path / "points.ply")
    with pytest.raises(PartError, match="points.ply has no triangles$"):
        load_mesh_file(str(tmp_path / "points.ply"), 0.0)


@pytest.mark.parametrize("kind", ["stl", "ply", "obj", "off", "glb"])
def test_damaged_files(tmp_path: Path, kind: str) -> None:
    """Cut and changed anywhere: a mesh that the scene takes, or a refusal that names the file."""
    rng = np.random.default_rng(20261122)
    path = tmp_path / f"box.{kind}"
    box().export(path)
    whole, refused = path.read_bytes(), 0
    for _ in range(60):
        data = bytearray(whole[: rng.integers(0, len(whole) + 1)] if rng.random() < 0.5 else whole)
        for _ in range(rng.integers(0, 6)):
            data[rng.integers(0, len(data) or 1) : rng.integers(0, len(data) + 1)] = rng.bytes(rng.integers(0, 8))
        path.write_bytes(data[: 2 * len(whole)])
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)
                Scene().put("mesh", *load_mesh_file(str(path), 0.0))
        except PartError as error:
            refused += 1
            assert str(error).startswith("mesh.files: ") and path.name in str(error)
    assert refused > 10


@pytest.mark.parametrize("kind", ["stl", "ply", "glb"])
def test_files_that_are_cut_short(tmp_path: Path, kind: str) -> None:
    """Every beginning of a file with counts is refused, never taken for a smaller mesh."""
    path = tmp_path / f"box.{kind}"
    box().export(path)
    whole = path.read_bytes()
    for length in range(0, len(whole), 7):
        path.write_bytes(whole[:length])
        with pytest.raises(PartError, match="^mesh.files: cannot read"):
            load_mesh_file(str(path), 0.0)


def test_vertices_that_no_triangle_uses_may_be_anything(tmp_path: Path) -> None:
    path = tmp_path / "loose.obj"
    path.write_text("v nan 0 0\n" + _TRIANGLE.replace("f 1 2 3", "v 0 0 -inf\nv 1e60 0 0\nf 2 3 4"))
    vertices, triangles = load_mesh_file(str(path), 0.0)
    assert triangles.tolist() == [[1, 2, 3]] and len(vertices) == 6
    store = MeshStore(10)
    store.commit(Changes(file_parts([str(path)], 0.0)), 1)
    assert len(Scene().put("mesh", vertices, triangles).triangles) == 1


def test_what_trimesh_is_needed_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "box.obj").write_text(_TRIANGLE)
    (tmp_path / "box.xyz").write_text("0 0 0\n")
    box().export(tmp_path / "plain.glb")
    mesh = box()
    mesh.units = "mm"
    mesh.export(tmp_path / "units.glb")
    monkeypatch.setitem(sys.modules, "trimesh", None)
    monkeypatch.setitem(sys.modules, "trimesh.units", None)
    with pytest.raises(PartError, match=r"^mesh.files: .*needs trimesh: pip install 'shadow_tracer\[mesh\]'"):
        load_mesh_file(str(tmp_path / "box.xyz"), 0.0)
    with pytest.raises(
        PartError, match=r"^mesh.files: .*states its units as \['mm'\], which needs trimesh: pip install"
    ):
        load_mesh_file(str(tmp_path / "units.glb"), 0.0)
    assert len(load_mesh_file(str(tmp_path / "units.glb"), 0.001)[1]) == 12
    assert len(load_mesh_file(str(tmp_path / "plain.glb"), 0.0)[1]) == 12
    assert len(load_mesh_file(str(tmp_path / "box.obj"), 0.0)[1]) == 1


def test_without_what_trimesh_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def load(*_: Any, **__: Any) -> None:
        raise ImportError("No module named 'cascadio'")

    monkeypatch.setattr(trimesh, "load", load)
    (tmp_path / "box.step").write_bytes(b"ISO-10303-21;")
    with pytest.raises(PartError, match=r"^mesh.files: .*another package: .*cascadio.*pip install 'trimesh\[easy\]'"):
        load_mesh_file(str(tmp_path / "box.step"), 0.0)


# Parts.


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of all files that are read from now on."""
    seen: list[str] = []
    original = loading._read
    monkeypatch.setattr(loading, "_read", lambda path: seen.append(path.name) or original(path))
    return seen


def test_parts_are_numbered_as_they_are_listed(tmp_path: Path) -> None:
    assert file_parts([""], 0.0) == () == file_parts([], 1.0)
    for name in ("a.obj", "b.obj"):
        (tmp_path / name).write_text(_TRIANGLE)
    parts = file_parts(["", str(tmp_path / "a.obj"), " ", str(tmp_path / "b.obj")], 2.0)
    assert [part.key for part in parts] == ["files/1", "files/3"]
    for part in parts:
        assert part.vertices.max() == 2.0 and part.frame == "" and part.locked and part.expires is None
        assert part.field == "mesh.frame" and np.array_equal(part.pose, np.eye(4))
    store = MeshStore(2)
    store.commit(Changes(parts), 1)
    assert store.triangle_count == 2


def test_only_what_changed_is_read_again(tmp_path: Path, reads: list[str]) -> None:
    names = [str(tmp_path / name) for name in ("a.obj", "b.obj")]
    for name in names:
        Path(name).write_text(_TRIANGLE)
    other = Part("mesh", np.zeros((3, 3)), np.zeros((1, 3), np.int32))
    first = file_parts(names, 1.0)
    assert reads == ["a.obj", "b.obj"]
    again = file_parts(names, 1.0, (other, *first))
    assert all(new is old for new, old in zip(again, first, strict=True)) and len(reads) == 2

    swapped = file_parts(names[::-1], 1.0, [replace(part, expires=None) for part in first])
    assert len(reads) == 2 and [part.key for part in swapped] == ["files/0", "files/1"]
    assert swapped[0].vertices is first[1].vertices and swapped[1].triangles is first[0].triangles

    then = Path(names[1]).stat().st_mtime_ns  # a copy may keep the time
    Path(names[1]).write_text(_TRIANGLE + "f 1 3 2\n")
    os.utime(names[1], ns=(then, then))
    grown = file_parts(names, 1.0, first)
    assert reads[2:] == ["b.obj"] and len(grown[1].triangles) == 2 and grown[0] is first[0]

    Path(names[0]).write_text(_TRIANGLE.replace("1", "2", 1))  # as many bytes as before
    os.utime(names[0], ns=(1, 1))
    assert file_parts(names, 1.0, grown)[0].vertices.max() == 2.0 and reads[3:] == ["a.obj"]

    assert file_parts(names, 0.5, grown)[1].vertices.max() == 0.5 and reads[4:] == ["a.obj", "b.obj"]


def test_a_file_that_is_listed_twice_is_read_once(tmp_path: Path, reads: list[str]) -> None:
    (tmp_path / "a.obj").write_text(_TRIANGLE)
    parts = file_parts([str(tmp_path / "a.obj")] * 2, 1.0)
    assert reads == ["a.obj"] and [part.key for part in parts] == ["files/0", "files/1"]
    assert parts[0].vertices is parts[1].vertices


def test_parts_say_what_their_files_hold_besides(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(_TRIANGLE + "l 1 2\n")
    (tmp_path / "b.obj").write_text(_TRIANGLE)
    names = [str(tmp_path / "a.obj"), str(tmp_path / "b.obj"), str(tmp_path / "a.obj")]
    first = file_parts(names, 1.0)
    assert [part.left_out.rpartition(": ")[2] for part in first] == ["lines (1)", "", "lines (1)"]
    assert [part.left_out for part in file_parts(names, 1.0, first)] == [part.left_out for part in first]
    sources = MeshSources(10, "elevation")
    sources.store.commit(Changes(first), 1)
    assert sources.left_out == (f"{names[0]}: left out, as it casts no shadow: lines (1)",)


def test_one_bad_file_refuses_all(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(_TRIANGLE)
    with pytest.raises(PartError, match="cannot find .*b.obj"):
        file_parts([str(tmp_path / "a.obj"), str(tmp_path / "b.obj")], 1.0)
