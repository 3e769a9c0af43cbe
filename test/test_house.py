# SPDX-License-Identifier: Apache-2.0
"""The rules of the house: imports run downwards, nothing heavy is imported early, files and functions keep their
size."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

_ROOT = Path(__file__).resolve().parent.parent
_PACKAGE = _ROOT / "shadow_tracer"
_MODULES = sorted(_PACKAGE.rglob("*.py"))
_IDS = [path.relative_to(_ROOT).as_posix() for path in _MODULES]

# What each room may use of the package beside itself, by the start of the module's name. What is not listed, the room
# may not import.
_GPU = "shadow_tracer.gpu."
_REGISTRY = _GPU + "accelerators.registry"
_ROS_ROOM = "shadow_tracer.ros."
_BELOW_ROS = (
    "shadow_tracer.visibility",
    "shadow_tracer.self_test",
    "shadow_tracer.tracer",
    _REGISTRY,
    "shadow_tracer.scene",
)
_FOR_ALL = (_ROS_ROOM + "settings", _ROS_ROOM + "diagnostics")
_MAY_USE: dict[str, tuple[str, ...]] = {
    "scene": (),
    "gpu/device": ("shadow_tracer.scene.checks",),
    "gpu/exact": (_GPU + "device", "shadow_tracer.scene"),
    "gpu/samples": (_GPU + "device", _GPU + "exact", "shadow_tracer.scene"),
    "gpu/occluders": (_GPU + "device", _GPU + "exact", "shadow_tracer.scene"),
    "gpu/visibility": (_GPU + "device", _GPU + "exact", _GPU + "samples", "shadow_tracer.scene"),
    # An accelerator's room may use what lies in accelerators/ itself, and none of its sisters: see below.
    "gpu/accelerators": (
        *(_GPU + room for room in ("device", "exact", "samples", "occluders", "visibility")),
        "shadow_tracer.scene",
    ),
    "gpu/engine": (
        *(_GPU + room for room in ("device", "exact", "samples", "occluders", "visibility")),
        _GPU + "accelerators.interface",
        _REGISTRY,
        "shadow_tracer.scene",
    ),
    "frame_surface": ("shadow_tracer.depth_camera", "shadow_tracer.scene"),
    "visibility": (
        "shadow_tracer.frame_surface",
        _GPU + "visibility.packed_states",
        _GPU + "visibility.light_bits",
        _GPU + "visibility.irradiance",
        "shadow_tracer.scene",
    ),
    "point_answers": (
        "shadow_tracer.visibility",
        _GPU + "engine",
        _GPU + "visibility.irradiance",
        "shadow_tracer.scene",
    ),
    "cone_answers": (_GPU + "engine", "shadow_tracer.scene"),
    "tracer": (
        "shadow_tracer.frame_surface",
        "shadow_tracer.visibility",
        "shadow_tracer.point_answers",
        "shadow_tracer.cone_answers",
        _REGISTRY,
        _GPU + "engine",
        _GPU + "device",
        _GPU + "visibility",
        "shadow_tracer.scene",
    ),
    "self_test": ("shadow_tracer.visibility", "shadow_tracer.tracer", _REGISTRY, "shadow_tracer.scene"),
    "depth_camera": (
        _GPU + "accelerators.camera_grid",
        _GPU + "visibility.depth_image",
        _GPU + "device",
        "shadow_tracer.scene",
    ),
    "dose_files": ("shadow_tracer.scene",),
    "dose_picture": ("shadow_tracer.dose_files", "shadow_tracer.depth_camera", "shadow_tracer.scene"),
    "dose": ("shadow_tracer.dose_files", "shadow_tracer.dose_picture", "shadow_tracer.tracer", "shadow_tracer.scene"),
    "planning": ("shadow_tracer.dose", "shadow_tracer.scene"),
    "terrain": ("shadow_tracer.tracer", "shadow_tracer.scene"),
    "__init__": (
        "shadow_tracer.dose",
        "shadow_tracer.planning",
        "shadow_tracer.frame_surface",
        "shadow_tracer.visibility",
        "shadow_tracer.cone_answers",
        "shadow_tracer.terrain",
        "shadow_tracer.tracer",
        "shadow_tracer.depth_camera",
        _REGISTRY,
        "shadow_tracer.scene",
    ),
    # In ros/ itself: settings and diagnostics, which all rooms use, and the names that users import.
    "ros": (*_BELOW_ROS, _ROS_ROOM + "wire", _ROS_ROOM + "node"),
    "ros/wire": (*_BELOW_ROS, *_FOR_ALL),
    "ros/world": (*_BELOW_ROS, *_FOR_ALL, _ROS_ROOM + "wire"),
    "ros/cameras": (*_BELOW_ROS, *_FOR_ALL, _ROS_ROOM + "wire"),
    "ros/parameters": (*_BELOW_ROS, *_FOR_ALL, *(_ROS_ROOM + room for room in ("wire", "world", "cameras"))),
    "ros/node": (*_BELOW_ROS, *_FOR_ALL, *(_ROS_ROOM + room for room in ("wire", "world", "cameras", "parameters"))),
    "apps": ("shadow_tracer.ros", "shadow_tracer.self_test", "shadow_tracer.tracer", _REGISTRY, "shadow_tracer.scene"),
    "apps/bag": ("shadow_tracer.ros", *_BELOW_ROS),
    "apps/fleet": (),
    "apps/bags": ("shadow_tracer.apps.bag", "shadow_tracer.apps.fleet", "shadow_tracer.ros", *_BELOW_ROS),
    "apps/terrain": ("shadow_tracer.apps.fleet", "shadow_tracer.terrain", "shadow_tracer.scene"),
    "apps/demo": (
        "shadow_tracer.ros",
        "shadow_tracer.depth_camera",
        "shadow_tracer.dose_picture",
        *_BELOW_ROS,
    ),
    "testing": (
        "shadow_tracer.testing",
        "shadow_tracer.ros.wire.cdr",
        "shadow_tracer.ros.diagnostics",
        "shadow_tracer.ros.node.node",
        "shadow_tracer.scene",
    ),
}
_ROS = (
    "rclpy",
    "sensor_msgs",
    "shape_msgs",
    "geometry_msgs",
    "std_msgs",
    "visualization_msgs",
    "nav_msgs",
    "diagnostic_msgs",
    "std_srvs",
    "tf2_ros",
)
_FOREIGN = {
    "scene": ("warp", *_ROS),
    "gpu": _ROS,
    "visibility": ("warp", *_ROS),
    "frame_surface": ("warp", *_ROS),
    "dose_files": ("warp", *_ROS),
    "dose_picture": ("warp", *_ROS),
    "dose": ("warp", *_ROS),
    "planning": ("warp", *_ROS),
    "point_answers": ("warp", *_ROS),
    "cone_answers": ("warp", *_ROS),
    "tracer": ("warp", *_ROS),
    "self_test": ("warp", *_ROS),
    "depth_camera": ("warp", *_ROS),
    "terrain": ("warp", *_ROS),
    "__init__": ("warp", *_ROS),
    "ros": ("warp",),
    "apps": ("warp",),
    "testing": ("warp", "pytest"),
}


def _imports(path: Path) -> set[str]:
    """Full names of all modules a file imports, wherever in the file; `from a import b` counts as a and, if b is a
    module, a.b."""
    parts = path.relative_to(_ROOT).with_suffix("").parts
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = (
                ".".join([*parts[: len(parts) - node.level], *([node.module] if node.module else [])])
                if node.level
                else node.module or ""
            )
            names.add(base)
            for alias in node.names:
                inner = _ROOT / base.replace(".", "/") / alias.name
                if inner.with_suffix(".py").exists() or inner.is_dir():
                    names.add(f"{base}.{alias.name}")
    return names


def _within(name: str, prefixes: tuple[str, ...]) -> bool:
    return any(name == prefix or name.startswith(prefix + ".") for prefix in prefixes)


def _room(path: Path) -> str:
    """Its folder in the package, or the folder there if there are several."""
    parts = path.relative_to(_PACKAGE).parts
    inner = parts[0] == "gpu" or (parts[0] in ("ros", "apps") and len(parts) > 2)
    return "/".join(parts[:2]).removesuffix(".py") if inner else parts[0].removesuffix(".py")


def _files_of(room: str) -> list[str]:
    """What lies in a room itself, not in those within."""
    return [f"{room}.{path.stem}" for path in (_ROOT / room.replace(".", "/")).glob("*.py")]


@pytest.mark.parametrize("path", _MODULES, ids=_IDS)
def test_arrows_run_down(path: Path) -> None:
    room = _room(path)
    if room == "gpu/__init__":
        assert not _imports(path) - {"__future__"}
        return
    assert room in _MAY_USE, f"{room}: a room the house does not know"
    own = f"shadow_tracer.{room.replace('/', '.')}"
    allowed = (*_MAY_USE[room], own) if room not in ("ros", "apps") else (*_MAY_USE[room], *_files_of(own))
    for name in _imports(path):
        if _within(name, ("shadow_tracer",)) and name != "shadow_tracer":
            # the bare room of an allowed module appears where `from shadow_tracer.gpu import engine` is written
            assert _within(name, allowed) or any(one.startswith(name + ".") for one in allowed), (
                f"{room} reaches {name}"
            )
        if name == "shadow_tracer":
            assert room.startswith(("ros", "apps")), f"{room} reaches the whole package"
        assert not _within(name, _FOREIGN[room.split("/")[0]]), f"{room} imports {name}"


_ACCELERATORS = sorted(path.parent for path in (_PACKAGE / "gpu" / "accelerators").glob("*/__init__.py"))


@pytest.mark.parametrize("folder", _ACCELERATORS, ids=[folder.name for folder in _ACCELERATORS])
def test_accelerators_do_not_know_each_other(folder: Path) -> None:
    others = tuple(f"{_GPU}accelerators.{other.name}" for other in _ACCELERATORS if other != folder)
    for path in sorted(folder.rglob("*.py")):
        assert not any(_within(name, others) for name in _imports(path)), f"{path} reaches another accelerator"


def test_every_variant_is_in_a_room_of_its_kind() -> None:
    from shadow_tracer.gpu.accelerators.registry import AUTO, REGISTRY

    folders = {folder.name for folder in _ACCELERATORS}
    for name, entry in REGISTRY.items():
        for variant, where in entry.classes.items():
            assert (where is None) == (name == AUTO)
            assert where is None or where.split(".")[0] in folders, f"{name}/{variant}: no such room"


# Who asks a device what it is, for memory, streams, recordings or Warp's own builders. In which form kernels run is
# asked of ``forms``, so that the CPU can run the form of CUDA.
_ASKS_THE_DEVICE = (
    "accelerators/bvh/mesh_bvh.py",
    *(f"device/{name}.py" for name in ("forms", "graphs", "seats", "stages", "transfers", "views")),
    "engine/engine.py",
)


def test_the_form_of_kernels_is_decided_in_one_place() -> None:
    asking = {path.relative_to(_PACKAGE / "gpu").as_posix() for path in _MODULES if _reaches(path, "is_cpu", "is_cuda")}
    assert asking == set(_ASKS_THE_DEVICE), "say forms.wide(device) where the form of a kernel is meant"


def _reaches(path: Path, *attributes: str) -> bool:
    text = path.read_text()
    if not any(each in text for each in attributes):
        return False  # without parsing it
    return any(isinstance(node, ast.Attribute) and node.attr in attributes for node in ast.walk(ast.parse(text)))


@pytest.mark.parametrize("path", _MODULES, ids=_IDS)
def test_sizes(path: Path) -> None:
    text = path.read_text()
    assert text.count("\n") <= 420, "a file holds one concept, in about 400 lines"
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            length = (node.end_lineno or node.lineno) - node.lineno + 1
            assert length <= 62, f"{node.name} has {length} lines, about 60 are allowed"


_KERNELS = sorted((_PACKAGE / "gpu").rglob("*.py"))


@pytest.mark.parametrize("path", _KERNELS, ids=lambda path: path.relative_to(_ROOT).as_posix())
def test_cpp_lies_in_headers(path: Path) -> None:
    """A string holds no more C++ than a call, or what puts a few arguments together for it."""
    tree = ast.parse(path.read_text())
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    prose = {id(node.body[0].value) for node in ast.walk(tree) if isinstance(node, documented) and _says(node.body)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in prose:
            lines = node.value.strip().count("\n") + 1
            assert ";" not in node.value or lines <= 6, f"line {node.lineno}: {lines} lines of C++ in a string"


def _says(body: list[ast.stmt]) -> bool:
    return bool(body) and isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant)


# Who looks inside a tracer, a frame or a depth camera. New questions are asked there by name, so that a change inside
# breaks one file.
_LOOKS_INSIDE = {"probe.py"}
_INSIDES = [_PACKAGE / f"{name}.py" for name in ("tracer", "visibility", "depth_camera")]
_INSIDES += sorted((_PACKAGE / "gpu" / "engine").glob("*.py"))


def _private_names(paths: list[Path]) -> set[str]:
    """Of attributes and methods of all classes in some files."""
    names: set[str] = set()
    for node in (node for path in paths for node in ast.walk(ast.parse(path.read_text()))):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in ("self", "cls"):
            names.add(node.attr)
        elif isinstance(node, ast.ClassDef):
            names |= {part.name for part in node.body if isinstance(part, ast.FunctionDef)}
    return {name for name in names if name.startswith("_") and not name.startswith("__")}


def _pokes(path: Path, names: set[str]) -> set[str]:
    """Which of these names a file takes of another object than ``self``, or has as a string, as monkeypatch wants."""
    found: set[str] = set()
    text = path.read_text()
    if not names.intersection(re.findall(r"\w+", text)):
        return found  # without parsing it
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Attribute) and not (isinstance(node.value, ast.Name) and node.value.id == "self"):
            found |= {node.attr} & names
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found |= {node.value} & names
    return found


def test_tests_ask_about_the_inside_in_one_place() -> None:
    # What lies deeper than in the tracer itself may bear the name of something in a node, at which other tests look.
    names = _private_names(_INSIDES) - _private_names(sorted((_PACKAGE / "ros").rglob("*.py")))
    names |= _private_names([_PACKAGE / "tracer.py"])
    assert len(names) > 50 and {"_engine", "_last", "_bands_of"} <= names
    folder = _ROOT / "test"
    poking = {path.relative_to(folder).as_posix(): _pokes(path, names) for path in folder.rglob("*.py")}
    poking = {name: pokes for name, pokes in poking.items() if pokes and name != Path(__file__).name}
    assert poking.keys() <= _LOOKS_INSIDE, f"ask in probe.py: {poking}"
    assert poking.keys() >= _LOOKS_INSIDE, "take it off the list"


_SOURCES = [*_MODULES, *sorted((_ROOT / "test").rglob("*.py")), *sorted((_ROOT / "benchmark").rglob("*.py"))]


@pytest.mark.parametrize("path", _SOURCES, ids=lambda path: path.relative_to(_ROOT).as_posix())
def test_licence_header(path: Path) -> None:
    lines = path.read_text().splitlines()
    first = lines[1] if lines and lines[0].startswith("#!") else lines[0]
    assert first == "# SPDX-License-Identifier: Apache-2.0"


_BLOCKER = """
import sys
class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {blocked!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Blocker())
sys.path.insert(0, {root!r})
before = set(sys.modules)
import shadow_tracer
print(*sorted({{name.partition(".")[0] for name in set(sys.modules) - before}} - sys.stdlib_module_names))
"""


def _child(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)


def test_import_needs_numpy_alone() -> None:
    code = _BLOCKER.format(blocked={"warp", "trimesh", "PIL", "scipy", "matplotlib", "rich", *_ROS}, root=str(_ROOT))
    done = _child(code)
    assert done.returncode == 0, done.stderr
    assert set(done.stdout.split()) == {"numpy", "shadow_tracer"}


def test_without_warp_the_error_says_what_to_install() -> None:
    code = _BLOCKER.format(blocked={"warp"}, root=str(_ROOT)) + "\nshadow_tracer.ShadowTracer()\n"
    done = _child(code)
    assert (
        done.returncode == 1
        and "ImportError" in done.stderr.splitlines()[-1]
        and "warp-lang" in done.stderr.splitlines()[-1]
    ), done.stderr


def test_scene_and_lights_work_without_warp() -> None:
    code = _BLOCKER.format(blocked={"warp"}, root=str(_ROOT)) + (
        "\nscene = shadow_tracer.Scene()\nscene.put('a', [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])\n"
        "shadow_tracer.Camera(4, 3, 1, 1, 0, 0).unproject([[1.0] * 4] * 3)\n"
        "print('names', *shadow_tracer.available_pipelines())\n"
    )
    done = _child(code)
    assert done.returncode == 0, done.stderr
    assert "mesh_bvh" in done.stdout and "brute_force" in done.stdout
