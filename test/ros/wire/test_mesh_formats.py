# SPDX-License-Identifier: Apache-2.0
"""OBJ, PLY, STL, OFF and 3MF: every way to write a mesh that these formats have gives the mesh, or is refused."""

from __future__ import annotations

import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mesh_figures import SQUARE, TWO, area, check, read

from shadow_tracer.ros.wire.parts import PartError

Write = Callable[[str, "str | bytes"], Path]
ONE = (2, (0, 0, 0), (1, 1, 0), 1.0)
V = "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in SQUARE)


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write(name: str, content: str | bytes) -> Path:
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8"))
        return path

    return write


def refused(path: Path, text: str) -> None:
    with pytest.raises(PartError, match=f"^mesh.files: .*{path.name}.*{text}"):
        read(path)


# OBJ


@pytest.mark.parametrize(
    "text",
    [
        V + "f 1 2 3\nf 3 2 4\n",
        V + "f 1 2 4 3\n",
        V + "vt 0 0\nvn 0 0 1\nf 1/1 2/1 3/1\nf 3/1/1 2/1/1 4/1/1\n",
        V + "f 1//1 2//1 \\\n 4//1 3//1",
        V + "f \\\r\n1 \\\r\n2 4 3\r\n",
        V.replace("\n", "\r\n") + "f\t1\t2 4  3 # f 9 9 9\r\n",
        V.replace("\n", "\r") + "f 1 2 4 3\r",
        "\ufeff" + V + "f 1 2 4 3",
        "f 1 2 4 3\n" + V,  # vertices may come later
        V.replace("\n", " 0.5 0.5 0.5\n") + "f 1 2 4 3\n",  # colours
        "#\n\nmtllib a b.mtl\no a\ng x y\ns off\nusemtl m\n" + V + "fo 1 2 4 3\n",
        V + "f -4 -3 -1 -2\n",
        "o a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\ng b\nv 1 1 0\nf -2/-1 -3/-1 -1/-1\nvt 0 0\n",
        V + "cstype bezier\ndeg 3 3\nvp 0 0\nf 1 2 4 3\nend\n",
    ],
)
def test_obj(write: Write, text: str) -> None:
    mesh, left_out = read(write("a.obj", text))
    check(mesh, *ONE)
    assert left_out == ""


def test_obj_relative_indices_in_blocks(write: Write) -> None:
    """Each quad has its own four vertices right above it."""
    text = ""
    for k in range(5):
        text += "".join(f"v {x} {y} {k}\n" for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))) + "f -4 -3 -2 -1\n"
    mesh, _ = read(write("a.obj", text))
    assert mesh[1].reshape(-1, 6).max(axis=1).tolist() == [3, 7, 11, 15, 19] and area(mesh) == pytest.approx(5.0)


def test_obj_says_what_it_leaves_out(write: Write) -> None:
    mesh, left_out = read(write("a.obj", V + "f 1 2 4 3\nl 1 2\nl 2 3 4\np 1\nf 1 2\nf 3\n"))
    check(mesh, *ONE)
    assert left_out == "lines (2), points (1), faces with fewer than 3 corners (2)"
    refused(
        write("b.obj", V + "l 1 2\nf 1 2\n"), r"no triangles, only lines \(1\), faces with fewer than 3 corners \(1\)$"
    )


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (V + "f 1 2 0\n", "line 5: index 0 leads to no vertex; 4 stand above it"),
        (V + "f -5 2 3\n", "line 5: index -5 leads to no vertex; 4 stand above it"),
        ("v 0 0 0\nf -1 -2 -3\n" + V, "line 2: index -2 leads to no vertex; 1 stand above it"),
        (V + "f 1 2 5\n", "vertex indices from 0 to 4, counted from 0, but 4 vertices"),
        (V + "f 1 2 three\n", "line 5: expected the index of a vertex, got 'three'"),
        (V + "f 1 /2 3\n", "line 5: expected the index of a vertex, got '/2'"),
        (V + "v 1 2\nf 1 2 3\n", "line 5: expected three coordinates"),
        (V + "v 1 2 x\nf 1 2 3\n", r"vertex 5 .*expected three numbers, got \['1', '2', 'x'\]"),
        (V + "f 1 2 3\nsurf 0 1 0 1 1 2 3 4\n", "line 6: 'surf' is not read; export the mesh as polygons"),
        (V + "f 1 2 3\ncurv 0 1 1 2 3\n", "line 6: 'curv' is not read"),
        (V + "f 1 2 3\ncall other.obj\n", "line 6: 'call' is not read"),
        (V + "f 1 2 3\nF 2 3 4\n", "line 6: 'F' is no statement of OBJ"),
        ("w 9 9 9\n" + V + "f 1 2 3\n", "line 1: 'w' is no statement of OBJ"),  # else all indices would be off by one
        (V + "f 1 2 \\", "line 5: the file ends within a statement"),
        (V + "f 1 4 3 2\n", "polygon 0 .*crosses itself"),
    ],
)
def test_obj_that_is_wrong(write: Write, text: str, reason: str) -> None:
    refused(write("a.obj", text), reason)


# PLY

HEAD = "ply\nformat {}\n{}end_header\n"
FLOATS = "".join(f"property float {name}\n" for name in "xyz")
ROWS = "".join(f"{x:g} {y:g} {z:g}\n" for x, y, z in SQUARE)
BYTES = np.array(SQUARE, "<f4").tobytes()


def text_ply(elements: str, body: str) -> str:
    return HEAD.format("ascii 1.0", elements) + body


def square_ply(elements: str, body: str) -> str:
    return text_ply(f"element vertex 4\n{FLOATS}{elements}", ROWS + body)


def bytes_ply(elements: str, body: bytes, order: str = "little") -> bytes:
    return HEAD.format(f"binary_{order}_endian 1.0", elements).encode() + body


@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize("position", ["float", "double", "int16"])
@pytest.mark.parametrize(
    ("counts", "indices"), [("uchar", "int"), ("ushort", "uint"), ("int8", "uint8"), ("uint32", "short")]
)
@pytest.mark.parametrize("faces", [TWO, [(0, 1, 3, 2)], [(0, 1, 2), (2, 1, 3), (0, 1)], [(1, 0), (0, 1, 3, 2)]])
def test_ply_of_every_type(write: Write, order: str, position: str, counts: str, indices: str, faces: Any) -> None:
    codes = {"float": "f4", "double": "f8", "int16": "i2", "uchar": "u1", "int": "i4", "ushort": "u2", "uint": "u4"}
    codes |= {"int8": "i1", "uint8": "u1", "uint32": "u4", "short": "i2"}
    sign = "<" if order == "little" else ">"
    body = np.array(SQUARE, sign + codes[position]).tobytes()
    for number, face in enumerate(faces):
        body += np.array(number, sign + "f8").tobytes() + np.array(len(face), sign + codes[counts]).tobytes()
        body += np.array(face, sign + codes[indices]).tobytes() + np.array(3, sign + "u1").tobytes()
    elements = (
        "comment by hand\nelement vertex 4\n" + FLOATS.replace("float", position) + f"element face {len(faces)}\n"
    )
    elements += f"property double quality\nproperty list {counts} {indices} vertex_index\nproperty uchar flags\n"
    mesh, left_out = read(write("a.ply", bytes_ply(elements, body, order)))
    check(mesh, *ONE)
    assert left_out == ("" if all(len(face) > 2 for face in faces) else "faces with fewer than 3 corners (1)")


@pytest.mark.parametrize(
    "content",
    [
        square_ply("element face 1\nproperty list uchar int vertex_indices\n", "4 0 1 3 2\n"),
        square_ply("element face 2\nproperty list uchar int vertex_index\n", "3 0 1 2 3 2 1 3"),
        square_ply("element face 1\nproperty list uchar int vertex_indices\n", "4 0 1 3 2\n").replace("\n", "\r\n"),
        square_ply("element face 1\nproperty list uchar int vertex_indices\n", "4 0 1 3 2\n").replace("\n", "\r"),
        square_ply("element tristrips 1\nproperty list int int vertex_indices\n", "4 0 1 2 3\n"),
        square_ply("element tristrips 1\nproperty list int int vertex_indices\n", "9 0 1 2 -1 -1 2 1 3 -1\n"),
        square_ply("element tristrips 2\nproperty list int int vertex_indices\n", "4 0 1 2 -1\n3 2 1 3\n"),
        square_ply("element face 0\nproperty list uchar int vertex_indices\nelement tristrips 1\n"
                   "property list int int vertex_indices\n", "4 0 1 2 3\n"),
        text_ply("element face 1\nproperty list uchar int vertex_indices\nelement vertex 4\n"
                 f"property list uchar int near\n{FLOATS}element camera 1\nproperty float fov\n",
                 "4 0 1 3 2\n" + "".join(f"2 7 8 {row}\n" for row in ROWS.splitlines()) + "90\n"),
        bytes_ply(f"element vertex 4\n{FLOATS}element face 1\nproperty list uchar int vertex_indices\n",
                  BYTES + struct.pack("<B4i", 4, 0, 1, 3, 2) + b"\n"),
        bytes_ply(f"element vertex 4\n{FLOATS}element tristrips 1\nproperty list int int vertex_indices\n",
                  BYTES + struct.pack("<5i", 4, 0, 1, 2, 3)),
    ],
)  # fmt: skip
def test_ply_of_every_layout(write: Write, content: str | bytes) -> None:
    mesh, left_out = read(write("a.ply", content))
    check(mesh, *ONE)
    assert left_out == ""


def test_ply_strips_and_faces_beside_each_other(write: Write) -> None:
    elements = "element face 1\nproperty list uchar int vertex_indices\nelement tristrips 1\n"
    elements += "property list int int vertex_indices\nelement edge 1\nproperty int vertex1\nproperty int vertex2\n"
    mesh, left_out = read(write("a.ply", square_ply(elements, "3 0 1 2\n3 1 3 2\n0 1\n")))
    check(mesh, *ONE)
    assert left_out == "rows of 'edge' (1)"
    normals = np.cross(*(mesh[0][mesh[1][:, k]] - mesh[0][mesh[1][:, 0]] for k in (1, 2)))
    assert (normals[:, 2] > 0.0).all()


def test_ply_strips_turn_every_other_triangle(write: Write) -> None:
    elements = "element tristrips 1\nproperty list int int vertex_indices\n"
    mesh, _ = read(write("a.ply", square_ply(elements, "8 0 1 2 3 -1 0 1 2\n")))
    assert mesh[1].tolist() == [[0, 1, 2], [2, 1, 3], [0, 1, 2]]


LIST = "element face 1\nproperty list uchar int vertex_indices\n"


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (square_ply(LIST, "3 0 1"), "cut short within element 'face'"),
        (square_ply(LIST, "3 0 1 2 9\n"), "1 values are left over"),
        (square_ply(LIST, "3 0 1 x\n"), "element 'face' does not hold the numbers"),
        (square_ply(LIST, "3 0 1 1.5\n"), "element 'face' does not hold the numbers"),
        (square_ply(LIST, "-3 0 1 2\n"), "says that it has -3 values"),
        (square_ply(LIST, "3.5 0 1 2\n"), "says that it has 3.5 values"),
        (
            square_ply(LIST.replace("vertex_indices", "corners"), "3 0 1 2\n"),
            "expected one list of face, vertex_indices",
        ),
        (square_ply(LIST.replace(" int ", " float "), "3 0 1 2\n"), "the indices of face are no integers"),
        (square_ply(LIST + LIST, "3 0 1 2\n3 0 1 2\n"), "two elements 'face'"),
        (square_ply("element tristrips 1\nproperty list int int vertex_indices\n", "4 0 1 -2 3\n"), "from -2 to 3"),
        (square_ply("element tristrips 1\nproperty list int int vertex_indices\n", "4 0 1 2 4\n"), "from 0 to 4"),
        (text_ply("element vertex 1\nproperty float x\n", "0\n"), "its vertices have no y"),
        (text_ply(LIST, "3 0 1 2\n"), "no element 'vertex'"),
        (text_ply("element vertex 1\nproperty half x\n", "0\n"), "header is not understood: 'property half x'"),
        (text_ply("property float x\n", "0\n"), "header is not understood"),
        ("ply\nelement vertex 0\nend_header\n", "names no format"),
        ("ply\nformat ascii 1.0\nelement vertex 0\n", "header has no end"),
        (
            bytes_ply(f"element vertex 4\n{FLOATS}{LIST}", BYTES + struct.pack("<B2i", 3, 0, 1)),
            "cut short within .*'face'",
        ),
        (bytes_ply(f"element vertex 5\n{FLOATS}", BYTES), "cut short within element 'vertex'"),
        (bytes_ply(f"element vertex 99999999999\n{FLOATS}", BYTES), "cut short within element 'vertex'"),
        (
            bytes_ply(f"element vertex 4\n{FLOATS}{LIST}", BYTES + 2 * struct.pack("<B3i", 3, 0, 1, 2)),
            "13 bytes are left over",
        ),
        (
            bytes_ply(f"element vertex 4\n{FLOATS}{LIST.replace('uchar', 'char')}", BYTES + struct.pack("<b", -1)),
            "says that it has -1 values",
        ),
    ],
)
def test_ply_that_is_wrong(write: Write, content: str | bytes, reason: str) -> None:
    refused(write("a.ply", content), reason)


# STL


def binary_stl(count: int, triangles: int = 2, head: bytes = b"", extra: bytes = b"") -> bytes:
    corners = np.array(SQUARE, "<f4")[np.array([TWO[k % 2] for k in range(triangles)], int).reshape(-1, 3)]
    facets = b"".join(bytes(12) + corner.tobytes() + b"\0\0" for corner in corners)
    return head.ljust(80, b" ") + struct.pack("<I", count) + facets + extra


def text_stl(name: str, triangles: Any = TWO) -> str:
    text = f"solid {name}\n"
    for triangle in triangles:
        corners = "".join("      vertex {} {} {}\n".format(*SQUARE[k]) for k in triangle)
        text += f"  facet normal 0 0 1\n    outer loop\n{corners}    endloop\n  endfacet\n"
    return text + f"endsolid {name}\n"


@pytest.mark.parametrize(
    "content",
    [
        binary_stl(2),
        binary_stl(2, head=b"solid made by a program"),
        binary_stl(2, head=b"solid\nfacet normal 0 0 1\nouter loop\nvertex"),
        text_stl("a"),
        text_stl(""),
        text_stl("facet vertex endsolid 1 2 3"),
        text_stl("a", TWO[:1]) + "\n\n" + text_stl("b c", TWO[1:]),
        text_stl("a").upper().replace("\n", "\r\n"),
        "\n " + text_stl("a"),
        text_stl("a").replace("\n", "\r"),
    ],
)
def test_stl(write: Write, content: str | bytes) -> None:
    mesh, left_out = read(write("a.stl", content))
    check(mesh, *ONE)
    assert left_out == ""


def test_stl_with_something_behind(write: Write) -> None:
    mesh, left_out = read(write("a.stl", binary_stl(2, extra=b"\r\n")))
    check(mesh, *ONE)
    assert left_out == "2 bytes at the end"


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (binary_stl(0, 0), "has no triangles$"),
        (binary_stl(0), "says that it has 0 triangles, but 2 fit into its bytes"),
        (binary_stl(1), "says that it has 1 triangles, but 2 fit into its bytes"),
        (binary_stl(3), "cut short: it should have 3 triangles and has 2"),
        (binary_stl(2)[:-1], "cut short: it should have 2 triangles and has 1"),
        (binary_stl(2)[:50], "it has 50 bytes"),
        (binary_stl(3, head=b"solid by a program"), "cut short: it should have 3 triangles and has 2"),
        (text_stl("a").rpartition("endsolid")[0], "cut short: 'endsolid' is missing after line 15"),
        (text_stl("a").rpartition("  endfacet")[0], "cut short: 'endfacet' is missing"),
        (text_stl("a")[:120], "cut short: 'endloop' is missing after line 6"),
        (text_stl("a").replace("vertex", "vertx", 1), "line 4 does not belong into a text STL .*vertx"),
        (text_stl("a", [(0, 1, 3, 2)]), "line 7 does not belong into a text STL .*vertex"),
        (text_stl("a", [(0, 1)]), "line 6 does not belong into a text STL .*endloop"),
        (text_stl("a").replace("vertex 1.0", "vertex one"), "a coordinate is no number"),
        (text_stl("a").replace("vertex 1.0 0.0 0.0", "vertex 1.0 0.0"), "line 5 does not belong"),
        ("solid a\nendsolid a\n", "has no triangles$"),
        (text_stl("a") + "facet normal 0 0 1\n", "line 17 does not belong"),
    ],
)
def test_stl_that_is_wrong(write: Write, content: str | bytes, reason: str) -> None:
    refused(write("a.stl", content), reason)


# OFF


@pytest.mark.parametrize(
    "text",
    [
        f"OFF\n4 2 0\n{ROWS}3 0 1 2\n3 2 1 3\n",
        f"OFF 4 1 0\n{ROWS}4 0 1 3 2\n",
        f"OFF4 1\n{ROWS}4 0 1 3 2",
        f"# a comment\nOFF # OFF\n\n4 1 0 # 9\n\n{ROWS}\n# faces\n4 0 1 3 2 255 0 0 # red\n",
        f"\t OFF\r\n4 1 0\r\n{ROWS}4 0 1 3 2 0.5 0.5 0.5 1\r\n".replace("\n", "\r\n"),
        "COFF\n4 1 0\n" + ROWS.replace("\n", " 255 0 0 255\n") + "4 0 1 3 2\n",
        "NOFF\n4 1 0\n" + ROWS.replace("\n", " 0 0 1\n") + "4 0 1 3 2\n",
        "STCNOFF\n4 1 0\n" + ROWS.replace("\n", " 0 0 1 1 0 0 1 0.5 0.5\n") + "4 0 1 3 2\n",
    ],
)
def test_off(write: Write, text: str) -> None:
    mesh, left_out = read(write("a.off", text))
    check(mesh, *ONE)
    assert left_out == ""


def test_off_with_a_concave_polygon_and_a_line(write: Write) -> None:
    rows = "0 0 0\n4 0 0\n4 0 3\n3 0 3\n3 0 1\n1 0 1\n1 0 3\n0 0 3\n"
    mesh, left_out = read(write("a.off", f"OFF\n8 2 0\n{rows}8 0 1 2 3 4 5 6 7\n2 0 1\n"))
    check(mesh, 6, (0, 0, 0), (4, 0, 3), 8.0)
    assert left_out == "faces with fewer than 3 corners (1)"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (f"4OFF\n4 1 0\n{ROWS}4 0 1 3 2\n", "other dimensions than 3"),
        (f"nOFF\n3\n4 1 0\n{ROWS}4 0 1 3 2\n", "other dimensions than 3"),
        ("OFF BINARY\n\0\0\0", "or binary, is not read"),
        (f"OFF\n4 1 0\n{ROWS}", "need a line each, but 4 lines follow"),
        (f"OFF\n4 1 0\n{ROWS}3 0 1 2\n3 2 1 3\n", "need a line each, but 6 lines follow"),
        (f"OFF\n4 1 0\n{ROWS}4 0 1 3\n", "face 0 .* has fewer corners than it says"),
        (f"OFF\n4 1 0\n{ROWS}4 0 1 3 4\n", "from 0 to 4, counted from 0, but 4 vertices"),
        (f"OFF\n4 1 0\n{ROWS}3 0 1 -1\n", "from -1 to 1"),
        (f"OFF\n4 1 0\n{ROWS}3 0 1 a\n", "does not hold the numbers"),
        ("OFF\n4\n", "expected the counts"),
        ("OFF\n6 1 0\n" + "0 1\n" * 6 + "3 0 1 2\n", "a vertex has fewer than three coordinates"),
        ("OFFSET\n4 1 0\n", "does not begin with OFF"),
    ],
)
def test_off_that_is_wrong(write: Write, text: str, reason: str) -> None:
    refused(write("a.off", text), reason)


# 3MF

CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
PRODUCTION = "http://schemas.microsoft.com/3dmanufacturing/production/2015/06"
RELATIONS = (
    '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship Id="r" Target='
    '"/3D/3dmodel.model" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
)
MESH = (
    "<mesh><vertices>"
    + "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in SQUARE)
    + '</vertices><triangles><triangle v1="0" v2="1" v3="2" pid="1"/>'
    + '<triangle v1="2" v2="1" v3="3"/></triangles></mesh>'
)


def object_3mf(number: int, content: str) -> str:
    return f'<object id="{number}" type="model">{content}</object>'


def model(resources: str, build: str, attributes: str = 'unit="meter"') -> str:
    return (
        f'<?xml version="1.0"?><model {attributes} xmlns="{CORE}" xmlns:p="{PRODUCTION}" xmlns:b="urn:beams" '
        f'xmlns:q="urn:q"><!-- by hand --><resources>{resources}</resources><build>{build}</build></model>'
    )


def write_3mf(path: Path, content: str, **others: str) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("_rels/.rels", RELATIONS)
        archive.writestr("3D/3dmodel.model", content)
        for name, text in others.items():
            archive.writestr(f"3D/{name}.model", text)
    return path


@pytest.mark.parametrize(
    ("unit", "metres"),
    [("micron", 1e-6), ("millimeter", 1e-3), ("centimeter", 0.01), ("inch", 0.0254), ("foot", 0.3048), ("meter", 1.0)],
)
def test_3mf_units(tmp_path: Path, unit: str, metres: float) -> None:
    path = write_3mf(tmp_path / "a.3mf", model(object_3mf(1, MESH), '<item objectid="1"/>', f'unit="{unit}"'))
    check(read(path)[0], 2, (0, 0, 0), (metres, metres, 0), metres**2)
    check(read(path, 2.0)[0], 2, (0, 0, 0), (2, 2, 0), 4)


def test_3mf_places_components_and_items(tmp_path: Path) -> None:
    """Rows times matrices: first the component, then the item; an object that is not built is not there."""
    moved = '<component objectid="1" transform="2 0 0 0 1 0 0 0 1 0 0 5"/>'
    part = f'<components>{moved}<component objectid="1"/></components>'
    objects = object_3mf(1, MESH) + object_3mf(2, part) + object_3mf(3, MESH.replace("1.0", "9.0"))
    build = '<item objectid="2" transform="0 1 0 -1 0 0 0 0 1 10 0 0"/><item objectid="1"/>'
    mesh, _ = read(write_3mf(tmp_path / "a.3mf", model(objects, build)))
    check(mesh, 6, (0, 0, 0), (10, 2, 5), 4)
    corners = mesh[0][mesh[1][:2]].reshape(-1, 3)  # x and y of the square become y, twice, and -x, from 10 on
    assert corners.min(axis=0).tolist() == [9, 0, 5] and corners.max(axis=0).tolist() == [10, 2, 5]


def test_3mf_mirrored_is_not_inside_out(tmp_path: Path) -> None:
    build = '<item objectid="1" transform="-1 0 0 0 1 0 0 0 1 0 0 0"/>'
    mesh, _ = read(write_3mf(tmp_path / "a.3mf", model(object_3mf(1, MESH), build)))
    normals = np.cross(*(mesh[0][mesh[1][:, k]] - mesh[0][mesh[1][:, 0]] for k in (1, 2)))
    assert (normals[:, 2] > 0.0).all() and mesh[0].min() == -1.0


def test_3mf_in_several_parts(tmp_path: Path) -> None:
    component = '<components><component objectid="7" p:path="/3D/other.model"/></components>'
    build = '<item objectid="1"/><item objectid="7" p:path="/3D/other.model" transform="1 0 0 0 1 0 0 0 1 0 0 2"/>'
    content = model(object_3mf(1, component), build, 'unit="meter" requiredextensions="p"')
    mesh, _ = read(write_3mf(tmp_path / "a.3mf", content, other=model(object_3mf(7, MESH), "")))
    check(mesh, 4, (0, 0, 0), (1, 1, 2), 2)


LOOP = '<components><component objectid="1"/></components>'


@pytest.mark.parametrize(
    ("resources", "build", "attributes", "reason"),
    [
        (
            object_3mf(1, MESH),
            '<item objectid="1"/>',
            'requiredextensions="b"',
            "requires the extension urn:beams, which",
        ),
        (object_3mf(1, MESH), '<item objectid="1"/>', 'requiredextensions="x"', "requires the extension x, which"),
        (object_3mf(1, MESH), '<item objectid="1"/>', 'unit="cubit"', "unit: expected one of"),
        (object_3mf(1, MESH), '<item objectid="2"/>', "", "refers to object '2', which is not there"),
        (object_3mf(1, MESH), "", "", "builds none of them"),
        (object_3mf(1, LOOP), '<item objectid="1"/>', "", "contain one another"),
        (object_3mf(1, "<q:field/>"), '<item objectid="1"/>', "", r"expected one of .*got \['field'\]"),
        (
            object_3mf(1, MESH.replace("</mesh>", "<b:beamlattice/></mesh>")),
            '<item objectid="1"/>',
            "",
            "lattice of beams, which is not read",
        ),
        (object_3mf(1, MESH.replace('v3="3"', 'v3="4"')), '<item objectid="1"/>', "", "from 0 to 4"),
        (object_3mf(1, MESH.replace('v3="3"', 'v3="-1"')), '<item objectid="1"/>', "", "from -1 to 2"),
        (object_3mf(1, MESH.replace('v3="3"', "")), '<item objectid="1"/>', "", "expected numbers for x, y, z"),
        (object_3mf(1, MESH), '<item objectid="1" transform="1 0 0"/>', "", "transform: expected 12 numbers, got 3"),
    ],
)
def test_3mf_that_is_wrong(tmp_path: Path, resources: str, build: str, attributes: str, reason: str) -> None:
    refused(write_3mf(tmp_path / "a.3mf", model(resources, build, attributes)), reason)


def test_3mf_cut_short(tmp_path: Path) -> None:
    path = write_3mf(tmp_path / "a.3mf", model(object_3mf(1, MESH), '<item objectid="1"/>'))
    data = path.read_bytes()
    for length in range(0, len(data), 50):
        path.write_bytes(data[:length])
        refused(path, "it is no 3MF")
