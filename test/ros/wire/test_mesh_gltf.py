# SPDX-License-Identifier: Apache-2.0
"""glTF: accessors of every kind, what extensions ask for, and scenes; what is not read is refused by name."""

from __future__ import annotations

import base64
import json
import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mesh_figures import SQUARE, TWO, Gltf, Mesh, area, check, read

from shadow_tracer.ros.wire.parts import PartError

ONE = (2, (0, 0, 0), (1, 1, 0), 1.0)
INDEX = np.ravel(TWO)
INSTANCING = "EXT_mesh_gpu_instancing"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.glb"


def refused(gltf: Gltf, path: Path, text: str) -> None:
    with pytest.raises(PartError, match=f"^mesh.files: cannot read .*a.glb: .*{text}"):
        read(gltf.write(path))


def up(mesh: Mesh) -> bool:
    """Whether all triangles face +z."""
    sides = (mesh[0][mesh[1][:, k]] - mesh[0][mesh[1][:, 0]] for k in (1, 2))
    return bool((np.cross(*sides)[:, 2] > 0.0).all())


# Accessors


@pytest.mark.parametrize("dtype", ["i1", "u1", "i2", "u2", "f4"])
@pytest.mark.parametrize("normalized", [False, True])
@pytest.mark.parametrize("stride", [0, 16])
def test_positions_of_every_type(path: Path, dtype: str, normalized: bool, stride: int) -> None:
    """Integers as they are, or as shares of the largest; the lowest one counts as -1."""
    if dtype == "f4" and normalized:
        return
    largest = 1.0 if dtype == "f4" else float(np.iinfo(dtype).max)
    wanted = np.array(SQUARE) * (1.0 if normalized else 3.0) - (1.0 if dtype[0] in "if" else 0.0)
    stored = wanted * largest if normalized else wanted
    if normalized and dtype[0] == "i":
        stored[stored < 0] -= 1.0
    rows = np.array(stored, f"<{dtype}")
    padded = np.full((4, (stride or rows[:1].nbytes) // rows.itemsize), 77, rows.dtype)
    padded[:, :3] = rows
    gltf = Gltf()
    gltf.require("KHR_mesh_quantization")
    view = gltf.view(b"\7" * 8 + padded.tobytes(), **({"byteStride": stride} if stride else {}))
    more = {"normalized": True} if normalized else {}
    position = gltf.accessor(rows, f"<{dtype}", view, byteOffset=8, **more)
    gltf.mesh({"attributes": {"POSITION": position}, "indices": gltf.accessor(INDEX, "<u1")})
    mesh, _ = read(gltf.write(path))
    np.testing.assert_allclose(mesh[0], wanted, rtol=0, atol=1e-12)


@pytest.mark.parametrize("over", ["zeros", "a view"])
@pytest.mark.parametrize("indices", ["u1", "u2", "u4"])
@pytest.mark.parametrize("values", ["f4", "i2"])
def test_sparse_positions(path: Path, over: str, indices: str, values: str) -> None:
    gltf = Gltf()
    start = np.zeros((4, 3)) if over == "zeros" else np.full((4, 3), 5)
    rows = [1, 2, 3] if over == "zeros" else [0, 1, 2, 3]
    position = gltf.accessor(start, f"<{values}")
    if over == "zeros":
        del gltf.root["accessors"][position]["bufferView"]
    gltf.root["accessors"][position]["sparse"] = {
        "count": len(rows),
        "indices": {
            "bufferView": gltf.view(b"xx" * 4 + np.array(rows, f"<{indices}").tobytes()),
            "byteOffset": 8,
            "componentType": {"u1": 5121, "u2": 5123, "u4": 5125}[indices],
        },
        "values": {"bufferView": gltf.view(np.array(SQUARE, f"<{values}")[rows].tobytes())},
    }
    gltf.mesh({"attributes": {"POSITION": position}, "indices": gltf.accessor(INDEX, "<u2")})
    check(read(gltf.write(path))[0], *ONE)


def test_sparse_indices_of_triangles(path: Path) -> None:
    gltf = Gltf()
    primitive = gltf.square()
    gltf.root["accessors"][primitive["indices"]]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": gltf.view(b"\5"), "componentType": 5121},
        "values": {"bufferView": gltf.view(struct.pack("<H", 0))},
    }
    gltf.mesh(primitive)
    assert read(gltf.write(path))[0][1].tolist() == [[0, 1, 2], [2, 1, 0]]


@pytest.mark.parametrize("uri", ["base64", "percent", "beside", "folder"])
def test_buffers_of_gltf(tmp_path: Path, uri: str) -> None:
    gltf = Gltf()
    gltf.mesh(gltf.square())
    name = {"beside": "a b%.bin", "folder": "sub/a.bin"}.get(uri)
    if name:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(gltf.blob)
        text = name.replace("%", "%25").replace(" ", "%20")
    elif uri == "base64":
        text = "data:application/octet-stream;base64," + base64.b64encode(gltf.blob).decode()
    else:
        text = "data:application/octet-stream," + "".join(f"%{byte:02x}" for byte in gltf.blob)
    gltf.root["buffers"] = [{"byteLength": len(gltf.blob), "uri": text}]
    file = tmp_path / "a.gltf"
    file.write_text(json.dumps(gltf.root))
    check(read(file)[0], *ONE)
    gltf.root["buffers"][0]["uri"] = "https://example.org/nowhere.bin" if uri == "base64" else "nowhere.bin"
    file.write_text(json.dumps(gltf.root))
    with pytest.raises(PartError, match=r"its buffer '.*nowhere.bin' is not there; put the file beside it"):
        read(file)


# Primitives


@pytest.mark.parametrize(
    ("mode", "corners", "wanted"),
    [
        (4, [0, 1, 2, 2, 1, 3], [[0, 1, 2], [2, 1, 3]]),
        (5, [0, 1, 2, 3], [[0, 1, 2], [2, 1, 3]]),
        (6, [0, 1, 3, 2], [[0, 1, 3], [0, 3, 2]]),
        (5, None, [[0, 1, 2], [2, 1, 3]]),
        (6, None, [[0, 1, 2], [0, 2, 3]]),
    ],
)
def test_modes(path: Path, mode: int, corners: list[int] | None, wanted: list[list[int]]) -> None:
    gltf = Gltf()
    primitive = gltf.square(mode=mode)
    del primitive["indices"]
    if corners is not None:
        primitive["indices"] = gltf.accessor(corners, "<u1")
    gltf.mesh(primitive)
    assert read(gltf.write(path))[0][1].tolist() == wanted


def test_modes_beside_each_other(path: Path) -> None:
    gltf = Gltf()
    fan, lines, points = gltf.square(2.0, mode=6), gltf.square(3.0, mode=3), gltf.square(4.0, mode=0)
    fan["indices"] = gltf.accessor([0, 1, 3, 2], "<u2")
    gltf.mesh(lines, gltf.square(), fan, points, points)
    gltf.root["animations"] = [{"channels": [], "samplers": []}]
    mesh, left_out = read(gltf.write(path))
    check(mesh, 4, (0, 0, 0), (1, 1, 2), 2)
    assert left_out == "lines (1), points (2), animations (1)"


def test_nothing_but_lines(path: Path) -> None:
    gltf = Gltf()
    gltf.mesh(gltf.square(mode=1))
    with pytest.raises(PartError, match=r"a.glb has no triangles, only lines \(1\)$"):
        read(gltf.write(path))


@pytest.mark.parametrize("where", ["mesh", "node", "both"])
def test_morph_weights(path: Path, where: str) -> None:
    """Those of the node count more than those of the mesh; targets without positions move nothing."""
    gltf = Gltf()
    targets = [
        {"POSITION": gltf.accessor([(0, 0, 2)] * 4, "<f4")},
        {},
        {"POSITION": gltf.accessor([(1, 0, 0)] * 4, "<f4")},
    ]
    weights, other = [0.5, 0.25, 3.0], [9.0, 9.0, 9.0]
    gltf.mesh(
        gltf.square(targets=targets), **{} if where == "node" else {"weights": weights if where == "mesh" else other}
    )
    gltf.root["nodes"] = [{"mesh": 0} if where == "mesh" else {"mesh": 0, "weights": weights}]
    check(read(gltf.write(path))[0], 2, (3, 0, 1), (4, 1, 1), 1)
    gltf.root["nodes"][0]["weights"] = [1.0]
    refused(gltf, path, "has 3 morph targets, but 1 weights")


def test_the_same_mesh_with_other_weights(path: Path) -> None:
    gltf = Gltf()
    gltf.mesh(gltf.square(targets=[{"POSITION": gltf.accessor([(0, 0, 2)] * 4, "<f4")}]))
    gltf.root["nodes"] = [{"mesh": 0}, {"mesh": 0, "weights": [1]}]
    gltf.root["scenes"] = [{"nodes": [0, 1]}]
    check(read(gltf.write(path))[0], 4, (0, 0, 0), (1, 1, 2), 2)


@pytest.mark.parametrize("dtype", ["f4", "u1", "u2"])
def test_skins_stand_as_their_joints_do(path: Path, dtype: str) -> None:
    """The place of the node with the mesh has no effect; the joints and their inverse matrices have."""
    gltf = Gltf()
    largest = 1.0 if dtype == "f4" else float(np.iinfo(dtype).max)
    weights = np.array([(1, 0, 0, 0), (0, 1, 0, 0), (1, 0, 0, 0), (0.5, 0.5, 0, 0)]) * largest
    more = {} if dtype == "f4" else {"normalized": True}
    primitive = gltf.square()
    primitive["attributes"]["JOINTS_0"] = gltf.accessor([(0, 1, 0, 0)] * 4, "<u1")
    primitive["attributes"]["WEIGHTS_0"] = gltf.accessor(
        weights if dtype == "f4" else np.rint(weights), f"<{dtype}", **more
    )
    gltf.mesh(primitive)
    inverse = np.stack([np.eye(4), np.eye(4)])
    inverse[1, :3, 3] = -1.0, 0.0, 0.0  # the second joint was at x = 1
    matrices = gltf.accessor(inverse.transpose(0, 2, 1).reshape(2, 16), "<f4")
    gltf.root["skins"] = [{"joints": [2, 3], "inverseBindMatrices": matrices}]
    gltf.root["nodes"] = [
        {"mesh": 0, "skin": 0, "translation": [50, 50, 50]},
        {"children": [2], "translation": [0, 0, 10]},
        {"children": [3]},
        {"translation": [5, 0, 0], "scale": [1, 1, 2]},
    ]
    gltf.root["scenes"] = [{"nodes": [0, 1]}]
    mesh, _ = read(gltf.write(path))
    np.testing.assert_allclose(mesh[0], [(0, 0, 10), (5, 0, 10), (0, 1, 10), (3, 1, 10)], rtol=0, atol=0.01)


# Nodes


def test_places_of_nodes(path: Path) -> None:
    gltf = Gltf()
    gltf.mesh(gltf.square())
    half = np.sqrt(0.5)
    turned = [0, 0, 0, 0] + [0, 0, 0, 0] + [0, 0, 0, 0] + [0, 0, 0, 1]
    turned[1], turned[4], turned[10], turned[12:15] = 1.0, -1.0, 1.0, [0.0, 0.0, 7.0]  # columns: a quarter about z
    gltf.root["nodes"] = [
        {"children": [1, 2], "translation": [10, 0, 0], "scale": [2, 3, 4]},
        {"mesh": 0, "rotation": [0, 0, half, half], "translation": [0, 0, 1]},
        {"children": [3], "matrix": turned},
        {"mesh": 0},
    ]
    mesh, _ = read(gltf.write(path))
    for k, z in ((0, 4.0), (1, 28.0)):
        check((mesh[0], mesh[1][2 * k : 2 * k + 2]), 2, (8, 0, z), (10, 3, z), 6)


def test_mirrored_nodes_are_not_inside_out(path: Path) -> None:
    gltf = Gltf()
    gltf.mesh(gltf.square())
    gltf.root["nodes"] = [{"mesh": 0, "scale": [-1, 1, 1]}, {"mesh": 0, "scale": [-1, -1, 1]}]
    gltf.root["scenes"] = [{"nodes": [0, 1]}]
    mesh, _ = read(gltf.write(path))
    check(mesh, 4, (-1, -1, 0), (0, 1, 0), 2)
    assert up(mesh)


@pytest.mark.parametrize("required", [False, True])
@pytest.mark.parametrize(("rotation", "largest"), [("f4", 1), ("i1", 127), ("i2", 32767)])
def test_instancing(path: Path, required: bool, rotation: str, largest: int) -> None:
    gltf = Gltf()
    if required:
        gltf.require(INSTANCING)
    gltf.mesh(gltf.square())
    quaternions = np.array([(0, 0, 0, 1), (0, 0, 1, 0)]) * largest
    more = {} if rotation == "f4" else {"normalized": True}
    attributes = {
        "TRANSLATION": gltf.accessor([(0, 0, 0), (0, 0, 5)], "<f4"),
        "ROTATION": gltf.accessor(quaternions, f"<{rotation}", **more),
        "SCALE": gltf.accessor([(1, 1, 1), (2, 2, 2)], "<f4"),
        "_COLOUR": gltf.accessor([(1, 1, 1)], "<f4"),
    }
    gltf.root["nodes"] = [{"mesh": 0, "scale": [1, 1, 2], "extensions": {INSTANCING: {"attributes": attributes}}}]
    mesh, _ = read(gltf.write(path))
    check(mesh, 4, (-2, -2, 0), (1, 1, 10), 5)
    attributes["SCALE"] = gltf.accessor([(1, 1, 1)], "<f4")
    refused(gltf, path, "as many translations as rotations and scales")


def test_only_the_scene_is_read(path: Path) -> None:
    gltf = Gltf()
    gltf.mesh(gltf.square())
    gltf.root["nodes"] = [{"mesh": 0}, {"mesh": 0, "translation": [0, 0, 1]}, {"mesh": 0, "translation": [0, 0, 2]}]
    gltf.root |= {"scenes": [{"nodes": [0]}, {"nodes": [1]}], "scene": 1}
    mesh, left_out = read(gltf.write(path))
    check(mesh, 2, (0, 0, 1), (1, 1, 1), 1)
    assert left_out == "nodes with meshes outside the scene (2)"
    del gltf.root["scene"]
    check(read(gltf.write(path))[0], *ONE)
    del gltf.root["scenes"]  # then every root
    check(read(gltf.write(path))[0], 6, (0, 0, 0), (1, 1, 2), 3)


def test_hidden_nodes(path: Path) -> None:
    gltf = Gltf()
    gltf.require("KHR_node_visibility")
    gltf.mesh(gltf.square())
    hidden = {"extensions": {"KHR_node_visibility": {"visible": False}}}
    gltf.root["nodes"] = [{"mesh": 0, "children": [1]}, {"children": [2], **hidden}, {"mesh": 0}]
    mesh, left_out = read(gltf.write(path))
    check(mesh, *ONE)
    assert left_out == "hidden nodes (1), nodes with meshes that are hidden (1)"


# Extensions


@pytest.mark.parametrize(
    "name",
    [
        "KHR_texture_transform",
        "KHR_materials_unlit",
        "KHR_texture_basisu",
        "EXT_texture_webp",
        "KHR_lights_punctual",
        "KHR_mesh_quantization",
    ],
)
def test_required_extensions_that_move_nothing(path: Path, name: str) -> None:
    gltf = Gltf()
    gltf.require(name)
    gltf.mesh(gltf.square())
    check(read(gltf.write(path))[0], *ONE)


@pytest.mark.parametrize(
    ("name", "cure"),
    [
        ("EXT_meshopt_compression", "write it without compression .*gltf-transform"),
        ("KHR_meshopt_compression", "write it without compression .*gltf-transform"),
        ("ACME_bends_space", "export it without"),
    ],
)
def test_required_extensions_that_are_not_known(path: Path, name: str, cure: str) -> None:
    gltf = Gltf()
    gltf.require("KHR_mesh_quantization", name)
    gltf.mesh(gltf.square())
    refused(gltf, path, f"extensionsRequired has {name}, which is not read; {cure}")


def test_what_moves_though_it_is_not_required(path: Path) -> None:
    gltf = Gltf()
    gltf.root["extensionsUsed"] = ["CESIUM_RTC"]
    gltf.mesh(gltf.square())
    refused(gltf, path, "CESIUM_RTC")


def draco(required: bool = True) -> Gltf:
    """A square that is nothing but a Draco stream."""
    decoder = pytest.importorskip("DracoPy", reason="needs DracoPy: pip install DracoPy")
    stream = decoder.encode(np.array(SQUARE, np.float32), np.array(TWO, np.uint32), quantization_bits=14)
    gltf = Gltf()
    if required:
        gltf.require("KHR_draco_mesh_compression")
    primitive = gltf.square()
    for number in (primitive["attributes"]["POSITION"], primitive["indices"]):
        del gltf.root["accessors"][number]["bufferView"]
    extension = {"bufferView": gltf.view(stream), "attributes": {"POSITION": 0}}
    gltf.mesh({**primitive, "extensions": {"KHR_draco_mesh_compression": extension}})
    return gltf


def test_draco(path: Path) -> None:
    gltf = draco()
    check(read(gltf.write(path))[0], *ONE)
    gltf.root["accessors"][0]["count"] = 5
    refused(gltf, path, "should have 5 vertices; its Draco stream has 4")


def test_draco_without_a_decoder(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gltf = draco()
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    refused(gltf, path, "KHR_draco_mesh_compression.*pip install DracoPy; or write it without compression")


@pytest.mark.parametrize("required", [False, True])
def test_draco_that_is_broken(path: Path, required: bool) -> None:
    gltf = draco(required)
    view = gltf.root["bufferViews"][
        gltf.root["meshes"][0]["primitives"][0]["extensions"]["KHR_draco_mesh_compression"]["bufferView"]
    ]
    start, size = view["byteOffset"], view["byteLength"]
    gltf.blob = gltf.blob[:start] + b"\1" * size
    refused(gltf, path, "DracoPy cannot decode it")


def test_draco_with_a_fallback_needs_no_decoder(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    gltf = Gltf()
    gltf.root["extensionsUsed"] = ["KHR_draco_mesh_compression"]
    extension = {"bufferView": gltf.view(b"\0" * 8), "attributes": {"POSITION": 0}}
    gltf.mesh(gltf.square(extensions={"KHR_draco_mesh_compression": extension}))
    check(read(gltf.write(path))[0], *ONE)


def test_a_mesh_without_data_is_not_a_point(path: Path) -> None:
    """An accessor without a view is all zeros; all corners at the origin are no mesh."""
    gltf = Gltf()
    gltf.mesh(gltf.square())
    del gltf.root["accessors"][0]["bufferView"]
    with pytest.raises(PartError, match="every triangle of .*a.glb has zero area"):
        read(gltf.write(path))


# What does not fit together


def change(path: str, value: Any) -> Any:
    """A change of the JSON: the place, as "meshes.0.primitives", and the new value; ... removes it."""

    def apply(gltf: Gltf) -> None:
        *above, last = (int(word) if word.isdecimal() else word for word in path.split("."))
        item: Any = gltf.root
        for word in above:
            item = item[word]
        if value is ...:
            del item[last]
        else:
            item[last] = value

    return apply


@pytest.mark.parametrize(
    ("where", "value", "reason"),
    [
        ("asset.version", "1.0", "it is glTF 1.0; expected 2.0"),
        ("meshes.0.primitives.0.mode", 7, r"primitives\[0\].mode: expected 0 to 6, got 7"),
        ("meshes.0.primitives.0.attributes.POSITION", ..., "has no POSITION"),
        ("meshes.0.primitives.0.attributes.POSITION", 9, "number 9 of 2 accessors"),
        ("meshes.0.primitives.0.attributes.POSITION", -1, "number -1 of 2 accessors"),
        ("meshes.0.primitives.0.attributes.POSITION", 1, r"accessors\[1\]: expected VEC3"),
        ("accessors.0.type", "VEC4", r"accessors\[0\]: expected VEC3 .*got VEC4"),
        ("accessors.0.componentType", 5124, r"accessors\[0\]: .*got VEC3 of component type 5124"),
        ("accessors.0.count", 3, "vertex indices from 0 to 3, counted from 0, but 3 vertices"),
        ("accessors.0.count", 5, r"accessors\[0\] needs 60 bytes of a buffer view of 48"),
        ("accessors.0.count", -1, r"accessors\[0\].count: expected a whole number, got -1"),
        ("accessors.0.byteOffset", 4, r"accessors\[0\] needs 52 bytes"),
        ("accessors.0.normalized", True, "normalized is for integers"),
        ("accessors.1.count", 5, "has 5 corners, which make no whole triangles"),
        ("accessors.1.bufferView", ..., "indices has no data"),
        ("accessors.1.componentType", 5122, "indices: expected unsigned integers"),
        ("bufferViews.0.byteStride", 8, r"accessors\[0\] needs"),
        ("bufferViews.0.byteLength", 1000, r"bufferViews\[0\] needs 1000 bytes of a buffer"),
        ("bufferViews.0.buffer", 1, "number 1 of 1 buffers"),
        ("nodes.0.mesh", 3, "number 3 of 1 meshes"),
        ("nodes.0.rotation", [0, 0, 0, 0], "expected a unit quaternion"),
        ("nodes.0.scale", [1, 1], "nodes.*scale: expected 3 finite numbers"),
        ("nodes.0.matrix", [1.0] * 16, "matrix: expected the last row"),
        ("nodes.0.children", [0], r"nodes\[0\] is found twice"),
        ("nodes.0.children", [4], "number 4 of 1 nodes"),
        ("nodes.0.skin", 0, "number 0 of 0 skins"),
        ("scenes.0.nodes", [], "no node of its scene places them"),
        ("scene", 2, "number 2 of 1 scenes"),
        ("scenes", [], None),
        ("nodes", [], "number 0 of 0 nodes"),
    ],
)
def test_what_does_not_fit(path: Path, where: str, value: Any, reason: str | None) -> None:
    gltf = Gltf()
    gltf.mesh(gltf.square())
    change(where, value)(gltf)
    if reason is None:
        check(read(gltf.write(path))[0], *ONE)
    else:
        refused(gltf, path, reason)


def test_strips_that_begin_again_are_refused(path: Path) -> None:
    gltf = Gltf()
    primitive = gltf.square(mode=5)
    primitive["indices"] = gltf.accessor([0, 1, 2, 255, 2, 1, 3], "<u1")
    gltf.mesh(primitive)
    refused(gltf, path, "uses index 255 to begin a strip again")


def test_nodes_that_have_two_parents_are_refused(path: Path) -> None:
    gltf = Gltf()
    gltf.mesh(gltf.square())
    gltf.root["nodes"] = [{"children": [1, 2]}, {"children": [2]}, {"mesh": 0}]
    refused(gltf, path, r"nodes\[2\] is the child of two nodes")


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9, 0.999])
def test_files_that_are_cut_short(path: Path, share: float) -> None:
    gltf = Gltf()
    gltf.mesh(gltf.square())
    data = gltf.write(path).read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(PartError, match="it is cut short or broken"):
        read(path)


def test_many_instances_cost_one_reading(path: Path) -> None:
    gltf = Gltf()
    gltf.mesh(gltf.square())
    gltf.root["nodes"] = [{"mesh": 0, "translation": [0, 0, k]} for k in range(200)]
    gltf.root["scenes"] = [{"nodes": list(range(200))}]
    assert area(read(gltf.write(path))[0]) == pytest.approx(200.0)
