"""Optiland's non-sequential scenes, traced on any GPU.

``pip install ./python`` builds the program ``nsq-gpu`` and installs it with this package. Then a backend is all that
a script changes::

    from nsq_gpu import NsqGpuBackend

    result = scene.trace(10_000_000, seed=0, backend=NsqGpuBackend())
    result.detectors["camera"].plot()
    print(result.report())

The result is Optiland's own: ``SimulationResult`` with ``IrradianceMap``, ``SpectralResult``, ``FarFieldPattern``,
``RayDatabase``, ``Diagnostics`` and ``ray_paths``; live detectors and absorbers are left as NumpyBackend leaves them.
The draws are Optiland's too, so in f64 a result equals NumpyBackend's ray by ray, to rounding, unless Sobol points are
asked for.

Traces of at most a million rays share one process of the program, which stays; scenes of one shape, which differ in
their numbers alone, share a compiled shader there, so that a trace takes milliseconds. ``Session`` is such a process of
your own, with sweeps: ``session.sweep(scene, {"L1.r1": [50, 55, 60]}, 100_000)``. ``nsq_gpu.use()`` makes the backend the
default of ``scene.trace``, and ``nsq_gpu.cluster`` spreads a trace over a Dask cluster.

The result is a :class:`Result`: a table where a shell or a notebook shows it, ``result.plot(scale="log")``,
``result.save("run_1")`` and ``load("run_1")``, ``to_xarray()`` and ``to_pandas()``.

Each detector's result also has ``standard_error``, an array of the shape and in the unit of its map (None for a ray
database), and ``total_flux_standard_error`` [W]; both are None if they were not asked for by
``NsqGpuBackend(standard_error=True)`` and would have cost something, unless hits say nothing of the error. Only the
results of ``scene.trace`` have them, and a live detector's ``get_result()`` does not.

``NsqGpuBackend(seed, precision, adapter, binary, timeout, progress, target_error, time_limit, standard_error, sampler,
max_depth, paths, where)``: ``precision="auto"`` takes f64 where the adapter is good at it, else f32 or, where that is
too coarse and f64 is missing, ``"df64"``, pairs of f32; ``sampler="sobol"`` draws Sobol points, with which errors fall
faster, instead of Optiland's random numbers; ``progress=True`` shows a bar at once, and None one of a trace that
lasts; ``target_error=0.01`` stops when every detector's relative error is at most 1 % (the flux's error, and the
map's: the sum of the pixels' standard errors over the sum of their values), and ``time_limit`` after so many
seconds, with ``num_rays`` as the cap; where the target is not met, ToleranceWarning is given; ``max_depth=64`` takes
the place of the 16 events that ``scene.trace`` passes; ``paths=True`` sums up light by its path, in ``result.paths``,
and ``where="reflections == 2"`` keeps the light of some paths; ``timeout`` is in seconds. Ctrl-C raises
``Interrupted``, whose ``partial`` is what was computed. After a trace ``backend.report`` holds what Optiland's result
has no field for, such as the exact ledger.

ResultWarning is given where numbers are not what was asked for: light that the depth limit cut off, with the number to
give, detectors without light, sources without a ray, maps that are mostly noise. ``result.report()`` is Optiland's, but
for the energy it says what the ledger says.

``jacobian(scene, ["L1.r1"], num_rays)`` gives maps of derivatives with standard errors; ``loss_gradient`` the gradient of a loss
by any number of parameters, in one pass. With Optiland's backend set to torch,
results carry a graph to tensors that have ``requires_grad``, where TorchBackend's do; ``backward()`` walks rays back.

``register_operands()`` puts ghosts, fluxes and uniformity of a lens's scene into Optiland's optimisers, beside spot sizes;
``Problem(scene, {"L1.r1": (20, 60)}, operands)`` is a design with bounds, targets, a budget, and errors.

``diff(a, b, num_rays)`` says what a change does: both scenes by the same draws, A - B with standard errors of its own.

``ghosts(optic)`` is the table of a lens's ghosts over its fields, with maps of the worst ones.

``pst(telescope, range(0, 61, 2), "image", scatter_to={"M*": "image"})`` is the point source transmittance, ``stray_surfaces`` the
surfaces to blame, and ``veiling_glare(optic, half_spot_deg=1)`` the glare in the image of a black spot.

``finish("black paint")``, ``polished``, ``ground`` and ``dusty`` are surfaces with the sources of their numbers;
``from_step("mount.step", {"barrel*": "black paint"}, scene=scene)`` adds mounts and baffles of a CAD program.

``export_scene(scene, "scene.json")`` writes a file that alone, given to ``nsq-gpu trace``, traces as the live scene
does, with all that ``scene.to_json`` drops; ``load_scene("scene.json")`` reads it back, or a file of your own; of
JSON5, it takes comments and trailing commas, and no more. What no file can hold (polarised coatings, classes of
your own) is refused by name: ``UnsupportedSceneError``.

``python -m nsq_gpu.compare scene.json -n 1e5 [--torch]`` traces a file with this backend and with Optiland's, prints
both side by side, and exits with 6 where they disagree, and with the command's codes where something fails.

The program is looked for in this order: the argument ``binary``, the environment variable ``NSQ_GPU_BINARY``, the
folder where pip installs programs, PATH.
"""

from nsq_gpu.backend import NsqGpuBackend
from nsq_gpu.binary import find_binary
from nsq_gpu.convert import from_file, from_optic
from nsq_gpu.default import use
from nsq_gpu.design.operands import register_operands
from nsq_gpu.design.problem import Problem
from nsq_gpu.difference import Difference, diff
from nsq_gpu.display import register as _register
from nsq_gpu.errors import (
    AdapterError,
    BinaryNotFoundError,
    DeviceError,
    Interrupted,
    MissingLibraryError,
    NsqGpuError,
    NsqGpuWarning,
    ResultWarning,
    SceneError,
    ToleranceWarning,
    TraceTimeoutError,
    UnknownNameError,
    UnsupportedSceneError,
    UsageError,
)
from nsq_gpu.export import export_scene
from nsq_gpu.finishes import dusty, finish, ground, polished
from nsq_gpu.ghost_table import Ghosts
from nsq_gpu.ghosting import ghosts
from nsq_gpu.glare import VeilingGlare, veiling_glare
from nsq_gpu.gradients import Jacobian, jacobian, loss_gradient
from nsq_gpu.loading import load_scene
from nsq_gpu.paths import CoatingTable, PathTable
from nsq_gpu.pst_table import PstResult
from nsq_gpu.pst_trace import pst
from nsq_gpu.results import Result
from nsq_gpu.session import Session
from nsq_gpu.step import from_step
from nsq_gpu.storing import load
from nsq_gpu.stray import StraySurfaces, stray_surfaces
from nsq_gpu.sweeps import Sweep
from nsq_gpu.verifying import Verification, verify

_register()

__all__ = [
    "AdapterError",
    "BinaryNotFoundError",
    "CoatingTable",
    "DeviceError",
    "Difference",
    "Ghosts",
    "Interrupted",
    "Jacobian",
    "MissingLibraryError",
    "NsqGpuBackend",
    "NsqGpuError",
    "NsqGpuWarning",
    "PathTable",
    "Problem",
    "PstResult",
    "Result",
    "ResultWarning",
    "SceneError",
    "Session",
    "StraySurfaces",
    "Sweep",
    "ToleranceWarning",
    "TraceTimeoutError",
    "UnknownNameError",
    "UnsupportedSceneError",
    "UsageError",
    "VeilingGlare",
    "Verification",
    "diff",
    "dusty",
    "export_scene",
    "find_binary",
    "finish",
    "from_file",
    "from_optic",
    "from_step",
    "ghosts",
    "ground",
    "jacobian",
    "load",
    "load_scene",
    "loss_gradient",
    "polished",
    "pst",
    "register_operands",
    "stray_surfaces",
    "use",
    "veiling_glare",
    "verify",
]
