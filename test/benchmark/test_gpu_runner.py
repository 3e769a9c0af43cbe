# SPDX-License-Identifier: Apache-2.0
"""benchmark/gpu_runner.py on the CPU: figures of what works, last words of what does not, no time for a wrong mask."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

pytest.importorskip("warp")

_BENCHMARK = Path(__file__).resolve().parents[2] / "benchmark"
pytestmark = pytest.mark.slow
_MODULES = ("occluders.placing", "samples.normals", "accelerators.light_grid.binning")
_METHODS = ("light_grid/packed", "cone_hierarchy/linear", "wp.Mesh refit + any-hit", "wp.Bvh rebuild + any-hit")

# One pipeline cannot be loaded, and a second ends its process without a word.
_TROUBLE = """
import os, sys
class Trouble:
    def find_spec(self, name, path=None, target=None):
        if name == "shadow_tracer.gpu.accelerators.cone_hierarchy.linear":
            raise RuntimeError("no cones today")
        spherical = "shadow_tracer.gpu.accelerators.spherical_grid.spherical"
        if name == spherical and "gpu_measure" in sys.argv[0] and "measure" in sys.argv:
            os._exit(3)
sys.meta_path.insert(0, Trouble())
"""


def _run(tmp_path: Path, *words: str, **environment: str) -> tuple[subprocess.CompletedProcess[str], dict[str, Any]]:
    target = tmp_path / "gpu.json"
    command = [
        sys.executable,
        str(_BENCHMARK / "gpu_runner.py"),
        "--device",
        "cpu",
        "--json",
        str(target),
        "--modules",
        *_MODULES,
    ]
    command += words
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=500, check=False, env={**os.environ, **environment}
    )
    assert target.is_file(), done.stderr
    return done, json.loads(target.read_text())


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[subprocess.CompletedProcess[str], dict[str, Any]]:
    folder = tmp_path_factory.mktemp("runner")
    (folder / "sitecustomize.py").write_text(_TROUBLE)
    words = ["--only", "table", "--scenes", "nowhere:9", "robots:400", "--size", "24", "--frames", "3"]
    methods = ["light_grid/packed", "cone_hierarchy/linear", "light_grid/spherical", *_METHODS[2:]]
    path = os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH")]))
    return _run(folder, *words, "--methods", *methods, PYTHONPATH=path)


def test_figures(measured: tuple[subprocess.CompletedProcess[str], dict[str, Any]]) -> None:
    done, found = measured
    assert found["device"]["name"] == "CPU" and found["machine"]["warp-lang"] and found["machine"]["commit"]
    timed = [row for row in found["rows"] if "wall ms" in row]
    packed = [(row["mesh"], row["graph"]) for row in timed if row["method"] == "light_grid/packed"]
    assert packed == [("moving", False), ("resting", False), ("moving", True), ("resting", True)]
    assert {row["method"] for row in timed} == {"light_grid/packed", *_METHODS[2:]}
    for row in timed:
        assert 100 < row["rays"] <= 24 * 24 and row["triangles"] > 400
        assert 0.0 < row["device ms"]["least"] <= row["device ms"]["median"] <= row["wall ms"]["p95"]
        assert row["frames"] == 3 and row["wrong"] <= (0 if "/" in row["method"] else 0.001 * row["rays"])
    first = timed[0]
    assert first["launched"]["kernels"] > 5 and {"upload", "unproject", "trace", "download"} <= set(first["stages ms"])
    assert first["device ratio"] > 0.0 and first["device bytes"] > 0 and first["counters"]["rays"] == first["rays"]
    assert "| light_grid/packed" in done.stdout and "| wp.Bvh rebuild + any-hit" in done.stdout


def test_failures_do_not_take_others_along(
    measured: tuple[subprocess.CompletedProcess[str], dict[str, Any]],
) -> None:
    done, found = measured
    failures = {row["method"]: row for row in found["rows"] if "failure" in row}
    assert set(failures) == {"-", "cone_hierarchy/linear", "light_grid/spherical"}
    assert "nowhere" in failures["-"]["failure"]
    assert "no cones today" in failures["cone_hierarchy/linear"]["failure"]
    died = failures["light_grid/spherical"]
    assert died["exit code"] == 3 and died["failure"] == "ended without a word"
    assert [row["module"] for row in found["modules"]] == list(_MODULES)
    assert not any("failure" in row for row in found["modules"])
    assert found["done"] and done.returncode == 1, done.stderr
    assert "cone_hierarchy/linear: failure" in done.stdout


def test_tests_are_run_and_summed_up(tmp_path: Path) -> None:
    words = ["--only", "tests", "--groups", "arithmetic", "--jobs", "1", "--pytest=-k", "--pytest=signs"]
    _, found = _run(tmp_path, *words)
    (group,) = found["tests"]
    assert group["exit code"] == 0 and group["passed"] > 0 and not group["failed"], group


def test_out_of_time(tmp_path: Path) -> None:
    _, found = _run(tmp_path, "--only", "table", "--seconds", "0.5")
    assert found["device"] == {"failure": "no time was left"}


@pytest.fixture
def programs(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """gpu_measure, imported as its own program does it."""
    monkeypatch.syspath_prepend(str(_BENCHMARK))
    return importlib.import_module("gpu_measure")


def test_no_time_for_a_wrong_mask(programs: Any) -> None:
    import warp as wp

    class Fake(programs.Entry):
        def step(self, frame: int) -> int:
            return frame

        def stages(self) -> dict[str, float]:
            return {"upload": 5.0, "trace": 1.0, "download": 5.0}

        def wrong(self, frame: int, found: int) -> int:
            assert found == frame
            return 2 if frame == self.bad else 0

    case = type("FourFrames", (), {"frames": [None] * 4})()
    figures = programs.Figures(case, wp.get_device("cpu"), 6, 10.0)
    entry = Fake()
    entry.bad = -1
    good = figures.run(entry)
    assert good["device ms"]["median"] == 1.0 and good["frames"] == 6 and good["wrong"] == 0
    entry.bad = 3
    row = figures.run(entry)
    assert row == {"failure": "2 wrong pixels in frame 3: no times are given", "wrong": 2}
    entry.most_wrong = 2
    assert figures.run(entry)["wrong"] == 2


def test_launches_are_counted(programs: Any) -> None:
    import warp as wp

    array, other = wp.zeros(4, dtype=int, device="cpu"), wp.zeros(4, dtype=int, device="cpu")
    before = wp.launch, wp.copy, wp.array.zero_
    with programs.counted() as counts:
        array.zero_()
        wp.copy(other, array)
        wp.utils.array_scan(array, other, inclusive=True)
    assert counts == {"kernels": 0, "other": 3}
    assert (wp.launch, wp.copy, wp.array.zero_) == before


def test_summary_of_tests(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(_BENCHMARK))
    (tmp_path / "test_some.py").write_text(
        "import pytest\ndef test_a(): pass\ndef test_b(): assert 1 == 2\n"
        "@pytest.fixture\ndef broken(): raise RuntimeError('no')\ndef test_c(broken): pass\n"
        "def test_d(): pytest.skip('not here')\n"
    )
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:randomly",
        f"--rootdir={tmp_path}",
        "-c",
        os.devnull,
    ]
    subprocess.run([*command, f"--junit-xml={tmp_path / 'r.xml'}", str(tmp_path)], capture_output=True, check=False)
    found = importlib.import_module("gpu_tests").summary(tmp_path / "r.xml")
    assert [found[name] for name in ("passed", "failures", "errors", "skipped")] == [1, 1, 1, 1]
    assert [each["test"].split("::")[1] for each in found["failed"]] == ["test_b", "test_c"]
    assert "assert 1 == 2" in found["failed"][0]["why"]


def test_groups_name_files(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(_BENCHMARK))
    listed = [path for paths in importlib.import_module("gpu_tests").GROUPS.values() for path in paths]
    assert all((_BENCHMARK.parent / path).exists() for path in listed)
    assert len(set(listed)) == len(listed) > 20
