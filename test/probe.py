# SPDX-License-Identifier: Apache-2.0
"""What tests ask about the inside of a tracer, and do to it, by name: no other file of the suite need know how the
device side keeps things. What they ask about one accelerator lies in ``probe_accelerators.py``, about the scene on the
device in ``probe_occluders.py``.

Unless it says otherwise, an answer is that of the first set of samples, and of the last frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from shadow_tracer import DepthCamera, Frame, ShadowTracer, depth_camera

if TYPE_CHECKING:  # what lies in gpu is imported when conftest.py has chosen the form
    from shadow_tracer.gpu.accelerators.interface import Accelerator, Context
    from shadow_tracer.gpu.engine.automatic import Chooser
    from shadow_tracer.gpu.engine.band import Band
    from shadow_tracer.gpu.engine.bands import Balance
    from shadow_tracer.gpu.engine.costs import Names
    from shadow_tracer.gpu.exact.light_frame import Anchor
    from shadow_tracer.gpu.occluders.world import SceneBuffers

# The form of kernels that the CPU takes in this process, see conftest.py, and that of a CUDA thread; and the usual one,
# where every pair of points and triangles is asked about, however many there are.
USUAL, CUDA, EVERY_PAIR = "usual_form", "cuda_form", "every_pair"
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
    """Let the CPU run kernels in one of :data:`FORMS`, or EVERY_PAIR. A tracer that is made meanwhile is not to be used
    afterwards, nor one that was made before, except in the same form again. The fixture ``kernel_form`` does it for a
    whole test.
    """
    if name == USUAL:
        yield
        return
    if name == EVERY_PAIR:
        with few_pairs(1 << 60):
            yield
        return
    from shadow_tracer.gpu.device import forms

    with pytest.MonkeyPatch.context() as patch, forms.cuda_form():
        forget_depth_cameras(patch)  # render_depth keeps one from call to call, of the other form
        yield


@contextmanager
def few_pairs(most: int) -> Iterator[None]:
    """Let so many pairs of points and triangles be few: 0 for a test of what the pipeline does with them."""
    from shadow_tracer.gpu.visibility import few_pairs as few

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(few, "MOST_PAIRS", most)
        patch.setattr(few, "MOST_POINTS", most)
        yield


def wide(device: str) -> bool:
    """Whether kernels on ``device`` take the form of the CPU, not that of a CUDA thread."""
    import warp as wp

    from shadow_tracer.gpu.device import forms

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
    for inside in _all(tracer).tracers:
        inside._anchor, inside._lights = None, ()
        inside._samples.forget()
        inside._context.records.forget()
        inside._balances = {names: type(balance)(balance._count) for names, balance in inside._balances.items()}
        if engine._chooser is not None:
            inside._chooser = engine._chooser
            inside._bands = inside._bands_of[engine._chooser.candidates[0]]
        for band in inside._all_bands():
            _forget(band)
    return tracer


def trace_points(
    tracer: ShadowTracer, points: Any, lights: Any, bias: float = 0.0, valid: Any = None, samples: str | None = None
) -> Any:
    """States of (N, 3) points, those that are not ``valid`` left out, with the counters that ``states_at`` drops, by a
    set of samples."""
    cull = tracer.front_face_culling
    return tracer._engine.trace_points(tracer.scene, points, lights, bias, valid, cull, samples=samples)


# --- who traces ---


def bands(tracer: ShadowTracer) -> list[Band]:
    """Those of the pipeline in use; of ``auto``, of the one that was chosen last."""
    return tracer._engine.inside._bands


def band_counts(tracer: ShadowTracer) -> dict[Names, int]:
    """How many bands there are of the pipeline, or of each that ``auto`` chooses among."""
    return {names: len(bands) for names, bands in tracer._engine.inside._bands_of.items()}


def pipeline(tracer: ShadowTracer) -> Any:
    """The :class:`Accelerator` of the first band."""
    return bands(tracer)[0].pipeline


def context(tracer: ShadowTracer) -> Context:
    """What pipelines work on: the samples of all bands, the scene, triangle records, and what pipelines share."""
    return tracer._engine.inside._context


def verifier(tracer: ShadowTracer) -> str | None:
    """Name of the second pipeline, None if there is none."""
    second, name = _all(tracer).verifier, tracer._engine.verifier
    assert (set() if second is None else second.pipelines) == (set() if name is None else {name})
    return name


def verifying_pipeline(tracer: ShadowTracer) -> Accelerator:
    """The second pipeline; there must be one."""
    return _all(tracer).verifier._bands[0].pipeline


def chooser(tracer: ShadowTracer) -> Chooser | None:
    """Who chooses among the pipelines of ``auto``, for all sets of samples; None for all other pipelines."""
    found = tracer._engine.chooser
    assert all(inside._chooser is found for inside in _all(tracer).tracers)
    return found


def calibrated(tracer: ShadowTracer) -> set[Names]:
    """The candidates of ``auto`` that have been measured on this device."""
    return set(chooser(tracer)._base)


def lessons(who: Chooser, names: Names) -> int:
    """How many kinds of situations are remembered of a candidate."""
    return len(who._factors[names])


def balances(tracer: ShadowTracer) -> dict[Names, Balance]:
    """Where images are cut, of each pipeline that has several bands."""
    return tracer._engine.inside._balances


def cut_at(balance: Balance, parts: Any) -> None:
    """Have the next images cut at these parts of their measurements, ascending, one less than there are bands."""
    balance._wanted = np.asarray(parts, float)


def rays_again(tracer: ShadowTracer) -> list[bool]:
    """Whether each band has used the rays of an earlier frame again."""
    return [band._again for band in bands(tracer)]


# --- what a frame has found, and where it can be made to fail ---


def counters(tracer: ShadowTracer) -> dict[str, int]:
    """Those of the samples, as they are on the device."""
    return context(tracer).samples.read_counters()


def states(frame: Frame) -> Any:
    """(L, H, W) states, which are the frame's: to write to them is to falsify the answer."""
    found = frame._states
    found.setflags(write=True)
    return found


def light_bits(frame: Frame, light: str) -> Any:
    """(H, W) which points of a light with size reach each pixel: the frame's own array."""
    return frame._reaching[light].bits


def depth_traces(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Grows by the name of the class of the pipeline whenever a depth image is traced, by whatever tracer."""
    from shadow_tracer.gpu.engine.frame import FrameTracer

    names: list[str] = []
    trace_depth = FrameTracer.trace_depth

    def counted(this: Any, *arguments: Any) -> Any:
        names.append(type(this._bands[0].pipeline).__name__)
        return trace_depth(this, *arguments)

    monkeypatch.setattr(FrameTracer, "trace_depth", counted)
    return names


def before_launches(monkeypatch: pytest.MonkeyPatch, do: Callable[[], object]) -> None:
    """Do something in each frame of any tracer between the uploads and the launches."""
    from shadow_tracer.gpu.engine.frame import FrameTracer

    launch = FrameTracer._launch

    def after(this: Any, *arguments: Any) -> None:
        do()
        launch(this, *arguments)

    monkeypatch.setattr(FrameTracer, "_launch", after)


def before_small_scenes(tracer: ShadowTracer, monkeypatch: pytest.MonkeyPatch, do: Callable[[], object]) -> None:
    """Do something before each of the small scenes that a warm-up traces, one for each candidate of ``auto``."""
    trace = tracer._trace_triangle

    def after(*arguments: Any, **named: Any) -> None:
        do()
        trace(*arguments, **named)

    monkeypatch.setattr(tracer, "_trace_triangle", after)


# --- what is kept, and where it lies ---


def anchor(tracer: ShadowTracer) -> Anchor:
    """What float32 numbers are relative to."""
    return tracer._engine.inside._anchor


def stage_uploads(tracer: ShadowTracer) -> None:
    """Have uploads go by way of a copy on the host, as to a GPU."""
    context(tracer).samples.upload._staged = True


def fetched(tracer: ShadowTracer) -> set[int]:
    """Addresses of the arrays on the host into which results are fetched."""
    return {mirror.ptr for _, mirror, _ in context(tracer).samples.host._copies.values()}


def scene_bytes(tracer: ShadowTracer) -> int:
    """Bytes that the scene takes on the device, alone of what all sets of samples share."""
    return int(_all(tracer).scene.nbytes())


def fail_in_a_frame(tracer: ShadowTracer) -> None:
    """Raise ``ZeroDivisionError`` in the middle of a frame."""
    tracer._engine._whole(lambda inside: 1 // 0)


def structure(tracer: ShadowTracer) -> Any:
    """What the rays of a walker go through, of its only band."""
    return pipeline(tracer).build.structure


def builds(tracer: ShadowTracer) -> int:
    """How often the tree of ``bvh`` has been built."""
    return int(pipeline(tracer).build.tree.builds)


def closest_hits(tracer: ShadowTracer, camera: Any) -> Any:
    """What the pixels of a camera see of the tracer's scene, as it was in the last frame, through the structure of its
    only band."""
    from shadow_tracer.gpu.accelerators.closest_hits import ClosestHits

    return ClosestHits(context(tracer).scene, tracer.bounds).render(pipeline(tracer), camera)


def kept(tracer: ShadowTracer, samples: str) -> tuple[Any, list[tuple[int, int]]]:
    """What a set of samples keeps from frame to frame: its anchor, and the first pixel and number of pixels of each of
    its bands."""
    inside = _all(tracer).tracers[tracer._engine._sets[samples]]
    return inside._anchor, [(band.samples.first, band.samples.count) for band in inside._bands]


def forget(tracer: ShadowTracer, samples: str) -> None:
    """Have everything made again in the next frame of a set of samples."""
    tracer._engine.forget(samples)


def forget_anchor(tracer: ShadowTracer) -> None:
    """The anchor of an earlier frame, which serves again where it can, is not used."""
    tracer._engine.inside._anchor = None


def recordings(tracer: ShadowTracer) -> int:
    """How many kinds of frames have been recorded."""
    return tracer._engine.inside._graphs.recorded()


def uploads(tracer: ShadowTracer, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Grows by the bytes of each array that is copied into the tracer's buffers, empty ones aside."""
    sizes: list[int] = []
    inside: Any = tracer._engine.inside
    upload = inside._whole.upload

    def counted(destination: Any, source: Any, offset: int = 0) -> None:
        sizes.append(source.nbytes)
        upload(destination, source, offset)

    for band in [inside, *inside._all_bands()]:
        frame = band._whole if band is inside else band.samples
        monkeypatch.setattr(frame, "upload", counted)
    return sizes


def tree_builds(tracer: ShadowTracer, monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """Grows whenever the tree of ``mesh_bvh`` is made for another scene: whether it has been built or refitted."""
    tree, builds = pipeline(tracer).build, list[bool]()
    make_tree = tree._make_tree

    def counted(rebuild: bool) -> None:
        builds.append(rebuild)
        make_tree(rebuild)

    monkeypatch.setattr(tree, "_make_tree", counted)
    return builds


def depth_camera_scene(camera: DepthCamera) -> SceneBuffers:
    """The scene of a depth camera on the device."""
    return camera._rays.scene


def forget_depth_cameras(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have ``render_depth`` make another one, and keep none of those that it makes meanwhile."""
    monkeypatch.setattr(depth_camera, "_cameras", {})


def kept_depth_camera(device: str) -> DepthCamera | None:
    """The one that ``render_depth`` keeps from call to call."""
    return depth_camera._cameras.get(device)


def loaded(tracer: ShadowTracer) -> set[Any]:
    """What has been launched on the tracer's device, in the form of the tracer, by whatever tracer."""
    return tracer._engine._seat.loaded


def _all(tracer: ShadowTracer) -> Any:
    """Everything on the device, made again if a frame has not ended."""
    engine = tracer._engine
    return engine._seat.run(engine._found)


def _forget(band: Any) -> None:
    if band._kept is not None:
        band._kept.forget()
    walker = getattr(getattr(band.pipeline, "_rest", None), "pipeline", band.pipeline)  # of meshes beside surfaces
    if hasattr(walker, "_hints"):  # of mesh_bvh: what hid each ray last
        walker._hints.zero_()


def charts(tracer: ShadowTracer) -> tuple[list[str], int]:
    """Of ``height_field``: names of the surfaces that have a chart, and the number of the one that the last light has
    been swept over, -1 if none has."""
    accelerator: Any = pipeline(tracer)
    return [placed.mesh.name for placed in accelerator._charts.placed], int(accelerator._sweeps.sweep.number)


def lose_places(tracer: ShadowTracer) -> None:
    """Let no chart of ``height_field`` know where its positions are, until its surface changes."""
    accelerator: Any = pipeline(tracer)
    accelerator._charts.structure.beside.fill_(1.0e30)


def spoil_charts(tracer: ShadowTracer) -> None:
    """Damage what ``height_field`` has made of its surfaces and of the sun: it says that nothing is hidden."""
    accelerator: Any = pipeline(tracer)
    structure = accelerator._charts.structure
    structure.heights.zero_()
    structure.nodes.fill_(0xFFFF)
    accelerator._sweeps.bounds.fill_(-1.0e30)
    accelerator._sweeps._turned.zero_()


def light_frame(tracer: ShadowTracer, light: Any) -> Any:
    """The frame that the last one used around a light, the first one."""
    from shadow_tracer.gpu.exact.light_frame import make_light_frame

    return make_light_frame(light, anchor(tracer))
