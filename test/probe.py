# SPDX-License-Identifier: Apache-2.0
"""What tests ask about the inside of a tracer, and do to it, by name: no other file of the suite need know how the
device side keeps things."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import pytest

from shadow_tracer import DepthCamera, ShadowTracer, depth_camera

# The form of kernels that the CPU takes in this process, see conftest.py, and that of a CUDA thread.
USUAL, CUDA = "usual_form", "cuda_form"
FORMS = (USUAL, CUDA)
in_both_forms = pytest.mark.parametrize("kernel_form", FORMS, indirect=True)
in_cuda_form = pytest.mark.parametrize("kernel_form", [CUDA], indirect=True)


def in_forms(argument: str, usual: Sequence[Any], cuda: Sequence[Any]) -> pytest.MarkDecorator:
    """Give an argument of a test some values in the usual form, and some in the form of CUDA."""
    cases = []
    for form, values in ((USUAL, usual), (CUDA, cuda)):
        for value in values:
            name = value if isinstance(value, str) else "/".join(value)
            cases.append(pytest.param(value, form, id=name if form == USUAL else f"{name}-{form}"))
    return pytest.mark.parametrize((argument, "kernel_form"), cases, indirect=["kernel_form"])


@contextmanager
def form(name: str) -> Iterator[None]:
    """Let the CPU run kernels in one of :data:`FORMS`. A tracer that is made meanwhile is not to be used afterwards,
    nor one that was made before, except in the same form again. The fixture ``kernel_form`` does it for a whole test.
    """
    if name == USUAL:
        yield
        return
    from shadow_tracer.gpu.device import forms

    with pytest.MonkeyPatch.context() as patch, forms.cuda_form():
        patch.setattr(depth_camera, "_cameras", {})  # render_depth keeps one from call to call, of the other form
        yield


def wide(device: str) -> bool:
    """Whether kernels on ``device`` take the form of the CPU, not that of a CUDA thread."""
    import warp as wp

    from shadow_tracer.gpu.device import forms  # not before conftest.py has chosen the form

    return forms.wide(wp.get_device(device))


def reset(tracer: ShadowTracer) -> ShadowTracer:
    """Bring a tracer that others have used to the state of a fresh one, and return it: an empty scene, and nothing
    learned or kept of earlier frames.

    The anchor, rays, records, cuts between the threads, the choice of ``auto`` and ``mesh_bvh``'s guesses at occluders
    all carry over from frame to frame. None changes an answer, but each changes how many nodes, entries and triangles
    are looked at for it. What stays is what depends on no frame: buffers, loaded kernels, and recordings, whose keys
    name all that they depend on.
    """
    tracer.scene.clear()
    tracer.front_face_culling = False
    tracer.release_verify()
    for samples in tracer.sample_sets:
        tracer.release_samples(samples)
    tracer._last.clear()
    engine: Any = tracer._engine
    if engine._chooser is not None:
        engine._chooser = type(engine._chooser)(engine._chooser.candidates)
    for inside in engine._seat.run(engine._found).tracers:
        inside._anchor, inside._lights = None, ()
        inside._samples.forget()
        inside._context.records.forget()
        inside._balances = {names: type(balance)(balance._shares) for names, balance in inside._balances.items()}
        if engine._chooser is not None:
            inside._chooser = engine._chooser
            inside._team = inside._teams[engine._chooser.candidates[0]]
        for share in inside._all_shares():
            _forget(share)
    return tracer


def trace_points(tracer: ShadowTracer, points: Any, lights: Any, bias: float = 0.0, valid: Any = None) -> Any:
    """States of (N, 3) points, those that are not ``valid`` left out, with the counters that ``states_at`` drops."""
    return tracer._engine.trace_points(tracer.scene, points, lights, bias, valid, tracer.front_face_culling)


@dataclass(frozen=True)
class RayTree:
    """The ray tree of ``cone_hierarchy/linear``, what it was made of, and what a descent takes beside it."""

    tree: Any
    order: Any
    frame: Any
    scene: Any
    group: Any
    count: int
    space: Any
    occluders: Any
    answers: Any


def ray_tree(tracer: ShadowTracer, points: Any, light: Any, bias: float) -> RayTree:
    """The tree as it is before any triangle has gone through it: descents close nodes that are done."""
    from shadow_tracer.gpu.exact.faces import Occluders
    from shadow_tracer.gpu.exact.light_frame import make_light_frame
    from shadow_tracer.gpu.exact.light_space import make_light_space

    inside: Any = tracer._engine.inside
    pipeline, taken = inside._pipeline, []
    pipeline._descend = taken.append
    tracer.occluded(points, light, bias)
    del pipeline._descend
    frame, scene, who = inside._frame, inside._scene, pipeline._admission
    occluders = Occluders()
    occluders.count, occluders.triangles = scene.triangle_count, scene.triangles
    occluders.records, occluders.corners = inside._context.records.memory, pipeline._corners.of(0)
    space = make_light_space(make_light_frame(light, inside._anchor))
    tree, answers = pipeline._buffers.tree, pipeline._context.answers(taken[0])
    found = int(who.counts.numpy()[0])
    return RayTree(tree, pipeline._order, frame, scene, who.groups, found, space, occluders, answers)


def scene_bytes(tracer: ShadowTracer) -> int:
    """Bytes that the scene takes on the device, alone of what all sets of samples share."""
    engine: Any = tracer._engine
    return int(engine._seat.run(engine._found).scene.nbytes())


def fail_in_a_frame(tracer: ShadowTracer) -> None:
    """Raise ``ZeroDivisionError`` in the middle of a frame."""
    engine: Any = tracer._engine
    engine._whole(lambda inside: 1 // 0)


def structure(tracer: ShadowTracer) -> Any:
    """What the rays of a walker go through, of its only share."""
    inside: Any = tracer._engine.inside
    return inside._pipeline.structure


def closest_hits(tracer: ShadowTracer, camera: Any) -> Any:
    """What the pixels of a camera see of the tracer's scene, as it was in the last frame, through the structure of its
    only share."""
    from shadow_tracer.gpu.accelerators.closest_hits import ClosestHits

    inside: Any = tracer._engine.inside
    return ClosestHits(inside._scene, tracer.bounds).render(inside._pipeline, camera)


def kept(tracer: ShadowTracer, samples: str) -> tuple[Any, list[tuple[int, int]]]:
    """What a set of samples keeps from frame to frame: its anchor, and the first pixel and number of pixels of each of
    its shares."""
    engine: Any = tracer._engine
    inside = engine._seat.run(engine._found).tracers[engine._sets[samples]]
    return inside._anchor, [(share.frame.first, share.frame.count) for share in inside._team]


def forget_anchor(tracer: ShadowTracer) -> None:
    """The anchor of an earlier frame, which serves again where it can, is not used."""
    inside: Any = tracer._engine.inside
    inside._anchor = None


def recordings(tracer: ShadowTracer) -> int:
    """How many kinds of frames have been recorded."""
    graphs: Any = tracer._engine.inside._graphs
    count: int = graphs.recorded()
    return count


def uploads(tracer: ShadowTracer, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Grows by the bytes of each array that is copied into the tracer's buffers, empty ones aside."""
    sizes: list[int] = []
    inside: Any = tracer._engine.inside
    upload = inside._frame.upload

    def counted(destination: Any, source: Any, offset: int = 0) -> None:
        sizes.append(source.nbytes)
        upload(destination, source, offset)

    for share in [inside, *inside._all_shares()]:
        frame = share._frame if share is inside else share.frame
        monkeypatch.setattr(frame, "upload", counted)
    return sizes


@dataclass(frozen=True)
class Layout:
    """How the scene lies in a tracer's buffers.

    Attributes:
        first: of each mesh its first vertex and its first triangle.
        looked_at: triangles that are looked at, gaps among them.
        live: triangles of meshes.
        places: lights that there are records of at the same time.
    """

    first: dict[str, tuple[int, int]]
    looked_at: int
    live: int
    places: int


def layout(tracer: ShadowTracer) -> Layout:
    """As of the last frame."""
    inside: Any = tracer._engine.inside
    scene = inside._scene
    first = {name: (part.first_vertex, part.first_triangle) for name, part in scene._parts.items()}
    return Layout(first, scene.triangle_count, scene.live_triangles, inside._context.records.places)


def scene_uploads(tracer: ShadowTracer, monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """Grows by what is copied into, or made in, the scene's buffers: which, and how many elements."""
    inside: Any = tracer._engine.inside
    scene, found = inside._scene, list[tuple[str, int]]()
    upload, place = scene.upload, scene._place
    names = {scene.triangles.ptr: "triangles", scene.local.ptr: "local", scene.vertices.ptr: "world"}

    def counted(destination: Any, source: Any, offset: int = 0) -> None:
        found.append((names[destination.ptr], len(source)))
        upload(destination, source, offset)

    def placed(mesh: Any, first: int) -> None:
        found.append(("placed", len(mesh.vertices)))
        place(mesh, first)

    monkeypatch.setattr(scene, "upload", counted)
    monkeypatch.setattr(scene, "_place", placed)
    return found


def remade(tracer: ShadowTracer, trace: Callable[[], object]) -> dict[str, set[int]]:
    """What ``trace`` makes of the scene: blocks of 128 triangles of which a record is written for any light, such of
    which corners are; and boxes of 256 triangles, where there are any. Its answers are wrong, and those of the next
    frame unless the light or all of the scene has changed."""
    import warp as wp

    from shadow_tracer.gpu.accelerators.light_grid.candidates import CandidateRecords
    from shadow_tracer.gpu.occluders.corners import Corners

    inside: Any = tracer._engine.inside
    context, sentinel = inside._context, 7.25
    boxes, corners = (context.shared.find(kind) for kind in (CandidateRecords, Corners))
    # The array, and how many of its numbers belong to a light and to what is counted.
    arrays = {"records": (context.records.memory, 16 * context.records.stride, 16 * 128)}
    if boxes is not None:
        arrays["boxes"] = (boxes._boxes._boxes, 1 << 60, 96)
    if corners is not None:
        arrays["vertices"] = (corners._vertices, 4 * corners.stride, 4)
    for name, (array, _, _) in arrays.items():
        array.fill_(sentinel if name == "boxes" else wp.vec4(sentinel))
    trace()
    found = {}
    for name, (array, apart, size) in arrays.items():
        written = (array.numpy().reshape(-1) != sentinel).nonzero()[0]
        found[name] = {int(number) % apart // size for number in written}
    return found


def tree_builds(tracer: ShadowTracer, monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Grows whenever the tree of ``mesh_bvh`` is made for another scene: whether it has been built or refitted."""
    inside: Any = tracer._engine.inside
    pipeline, builds = inside._pipeline, list[bool]()
    make_tree = pipeline._make_tree

    def counted(rebuild: bool) -> None:
        builds.append(rebuild)
        make_tree(rebuild)

    monkeypatch.setattr(pipeline, "_make_tree", counted)
    return builds


def kept_depth_camera(device: str) -> DepthCamera | None:
    """The one that ``render_depth`` keeps from call to call."""
    return depth_camera._cameras.get(device)


def loaded(tracer: ShadowTracer) -> set[Any]:
    """What has been launched on the tracer's device, in the tracer's form, by anybody."""
    return tracer._engine._seat.loaded


def _forget(share: Any) -> None:
    if share._kept is not None:
        share._kept.forget()
    pipeline = getattr(getattr(share.pipeline, "_rest", None), "pipeline", share.pipeline)  # of meshes beside surfaces
    hints = getattr(getattr(pipeline, "_tree", None), "hints", None)  # of mesh_bvh: what hid each ray last
    if hints is not None:
        hints.zero_()


def charts(tracer: ShadowTracer) -> tuple[list[str], int]:
    """Of ``height_field``: names of the surfaces that have a chart, and the number of the one that the last light has
    been swept over, -1 if none has."""
    inside: Any = tracer._engine.inside
    pipeline = inside._pipeline
    return [placed.mesh.name for placed in pipeline._charts.placed], int(pipeline._sweeps.sweep.number)


def lose_places(tracer: ShadowTracer) -> None:
    """Let no chart of ``height_field`` know where its positions are, until its surface changes."""
    inside: Any = tracer._engine.inside
    inside._pipeline._charts.structure.beside.fill_(1.0e30)
