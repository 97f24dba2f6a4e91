"""What this machine's adapter does with nsq-gpu, in one folder with a page: `make gpu-report`.

A graphics processor that nobody has tried is judged in ten minutes. Only Python and the built programs are needed,
nsq-gpu with nsq-bench beside it: no network, no cargo, no package. `NSQ_BENCH_BINARY` names nsq-bench elsewhere. Sections
of the page: adapters, agreement with Optiland's committed results, the same bits, speed, what slows the trace down. Exit
code 1 if anything is wrong.

    python3 benches/gpu_report.py --binary target/release/nsq-gpu -o gpu-report-out [--quick] [--adapter NAME]
"""

import argparse
import ast
import hashlib
import json
import os
import statistics
import struct
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# sha256 of every array of every scene, traced strictly by lavapipe in f32 and f64: what another adapter should give.
STRICT_BITS = ROOT / "benches" / "strict_bits.json"
STRICT_RAYS = 5000
# In f64 counts are equal, totals agree to TOTAL_LIMIT of the launched flux, maps to MAP_LIMIT of their peak.
TOTAL_LIMIT, MAP_LIMIT = 1e-11, 1e-9
# Derivatives of pixels in f64, relative to the sum of a map's absolute derivatives.
GRADIENT_LIMIT = 1e-9
# In f32 an edge may fall to the other side: so many counts in all interactions may differ.
F32_LIMIT = 1e-4
# Cases that show what a table of paths costs: few and many rays, events and surfaces, and one lit pixel.
PATH_CASES = "rays_1e5,surfaces_0,depth_32,lens_8,spheres_100,mesh_100k,spot"
COUNTS = ["num_rays_absorbed", "num_rays_escaped", "num_rays_flux_killed", "num_rays_depth_killed"]
FLUXES = ["detected", "tapped", "absorbed", "bulk_absorbed", "escaped", "lost"]


class Tracer:
    """The command, on the adapter that was asked for."""

    def __init__(self, binary, bench, adapter):
        self.binary, self.bench, self.adapter = binary, bench, ["--adapter", adapter] if adapter else []

    def run(self, *arguments, program=None):
        """Runs the command: its exit code, what it printed, and what it said on stderr."""
        done = subprocess.run([program or self.binary, *map(str, arguments)], capture_output=True, text=True)
        return done.returncode, done.stdout, done.stderr

    def measure(self, *arguments):
        """Runs nsq-bench in the same way, on this adapter."""
        return self.run(*arguments, *self.adapter, program=self.bench)

    def trace(self, scene, num_rays, *options, output=None):
        """Traces a scene: its report. With `output` the files of the result are written there."""
        where = ["-o", output, "--no-pictures"] if output else []
        code, printed, said = self.run("trace", scene, "-n", num_rays, "--json", "--progress", "never",
                                       *self.adapter, *options, *where)
        if code:
            raise RuntimeError(f"{Path(scene).stem}: exit code {code}: {said.strip()}")
        return json.loads(printed)


def array(file, name):
    """One array of an .npz as a flat list of numbers."""
    with zipfile.ZipFile(file) as archive:
        data = archive.read(f"{name}.npy")
    length = struct.unpack("<H", data[8:10])[0]
    header = ast.literal_eval(data[10 : 10 + length].decode())
    kind = {"<f8": "d", "<u8": "Q", "<i8": "q", "<f4": "f", "<u4": "I"}[header["descr"]]
    body = data[10 + length :]
    return header["shape"], struct.unpack(f"<{len(body) // struct.calcsize(kind)}{kind}", body)


def bits(folder):
    """One hash of all arrays of a result, in the order of their names; `meta` names the program that wrote them."""
    hasher = hashlib.sha256()
    for file in sorted(Path(folder).glob("*.npz")):
        with zipfile.ZipFile(file) as archive:
            for member in sorted(set(archive.namelist()) - {"meta.npy"}):
                hasher.update(member.encode() + archive.read(member))
    return hasher.hexdigest()


def traced_bits(tracer, scene, num_rays, *options):
    """One hash of all arrays of a trace."""
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder) / "results"
        tracer.trace(scene, num_rays, *options, output=folder)
        return bits(folder)


def scenes(quick):
    """The scenes of the collection whose results no rounding decides, with Optiland's results of them."""
    oracles = {file.stem: json.loads(file.read_text()) for file in sorted((ROOT / "tests/oracle").glob("*.json"))}
    settled = [(name, oracle) for name, oracle in oracles.items() if not oracle["chaotic"]]
    return settled[:: 6 if quick else 1]


def scene_file(name):
    return ROOT / "scenes" / f"{name}.json"


def uncapped(name, folder):
    """The scene with ray databases that keep every row, as the committed results have them: its file."""
    if "max_rays" not in scene_file(name).read_text():
        return scene_file(name)
    scene = json.loads(scene_file(name).read_text())
    for detector in scene["detectors"]:
        detector.pop("max_rays", None)
    for extra in scene.get("nsq_gpu", {}).get("detectors", {}).values():
        extra.pop("max_rays", None)
    file = folder / f"{name}.json"
    file.write_text(json.dumps(scene))
    return file


def map_deviation(folder, name, digest):
    """The largest deviation of a map's bins in units of its peak: of all, or of those that the digest holds; 0 for rows.

    The innermost ring of a far field is left out: at the pole rounding decides the azimuth.
    """
    if "peak" not in digest:
        return 0.0
    kind = "intensity" if digest["kind"] == "far_field" else "irradiance"
    shape, values = array(folder / f"{name}.npz", kind)
    if list(shape) != digest["shape"]:
        return float("inf")
    bins = digest.get("bins") or range(len(values))
    expected = digest.get("bin_values") or digest["values"]
    first = shape[1] if kind == "intensity" else 0
    pairs = [(values[i], value) for i, value in zip(bins, expected) if i >= first]
    return max((abs(ours - theirs) for ours, theirs in pairs), default=0.0) / (digest["peak"] or 1.0)


def parity(tracer, precision, quick):
    """Every scene against Optiland's committed result: a row each, and whether all are right."""
    rows, wrong, differing, interactions = [], [], 0, 0.0
    for name, oracle in scenes(quick):
        with tempfile.TemporaryDirectory() as folder:
            scene, folder = uncapped(name, Path(folder)), Path(folder) / "results"
            report = tracer.trace(scene, oracle["num_rays"], "--seed", oracle["seed"], "--max-depth", 16,
                                  "--precision", precision, output=folder)
            maps = [map_deviation(folder, detector, digest) for detector, digest in oracle["detectors"].items()]
        counts = [abs(report[count] - oracle[count]) for count in COUNTS]
        counts += [abs(report["detectors"][detector]["num_rays_hit"] - digest["num_rays_hit"])
                   for detector, digest in oracle["detectors"].items()]
        total = max(abs(report[f"total_flux_{flux}"] - oracle[f"total_flux_{flux}"]) for flux in FLUXES)
        total /= oracle["total_flux_in"]
        largest = max(maps, default=0.0)
        differing += sum(counts)
        interactions += oracle["interactions_per_ray"] * oracle["num_rays"]
        rows.append((name, sum(counts), total, largest, report["ledger"]["imbalance_quanta"]))
        is_right = precision == "f32" or (not any(counts) and total <= TOTAL_LIMIT and largest <= MAP_LIMIT)
        if not is_right or report["ledger"]["imbalance_quanta"] not in (0, "0"):
            wrong.append(name)
    if precision == "f32" and differing > F32_LIMIT * interactions:
        wrong.append(f"{differing} counts differ in {interactions:.0f} interactions")
    return rows, wrong


def strict(tracer, precision, quick):
    """How many scenes have committed bits, and which give others in strict arithmetic, or are refused."""
    known = json.loads(STRICT_BITS.read_text())[precision]
    different = []
    for name in list(known)[:: 6 if quick else 1]:
        try:
            found = traced_bits(tracer, scene_file(name), STRICT_RAYS, "--precision", precision, "--strict")
        except RuntimeError as error:
            different.append(str(error))
            continue
        if found != known[name]:
            different.append(name)
    return len(known), different


def write_strict_bits(tracer):
    """Writes the bits of every scene: for lavapipe, whose bits are the ones committed."""
    known = {"f32": {}, "f64": {}}
    for precision, of_scenes in known.items():
        for file in sorted((ROOT / "scenes").glob("*.json")):
            of_scenes[file.stem] = traced_bits(tracer, file, STRICT_RAYS, "--precision", precision, "--strict")
    STRICT_BITS.write_text(json.dumps(known, indent=1) + "\n")


def forms(tracer, quick):
    """Which scenes give other bits in strict f32 and f64 without native 64-bit integers."""
    different = []
    for name in [file.stem for file in sorted((ROOT / "scenes").glob("*.json"))][:: 12 if quick else 3]:
        for precision in ["f32", "f64"]:
            found = {traced_bits(tracer, scene_file(name), STRICT_RAYS, "--precision", precision, "--strict", *options)
                     for options in [(), ("--portable",)]}
            if len(found) > 1:
                different.append(f"{name} in {precision}")
    return different


def cost_of_strictness(tracer, num_rays):
    """The rates of the Cooke triplet and of a scattering telescope, strict and not, as a table."""
    rows = []
    for name in ["cooke_triplet", "scattering_telescope", "kaleidoscope"]:
        for precision in ["f32", "f64"]:
            def median(strict):
                runs = [tracer.trace(scene_file(name), num_rays, "--precision", precision, f"--strict={strict}") for _ in range(4)]
                return statistics.median(run["rays_per_sec"] for run in runs[1:]) / 1e6
            strict, free = median("on"), median("off")
            rows.append((name, precision, f"{strict:.1f}", f"{free:.1f}", f"{strict / free:.2f}"))
    return table(["scene", "precision", "strict [M rays/s]", "not strict", "ratio"], rows)


def determinism(tracer):
    """Scenes whose bits depend on the run or on the size of batches."""
    unequal = []
    for name in ["cooke_triplet", "kaleidoscope", "scattering_telescope", "mesh_lens"]:
        found = {traced_bits(tracer, scene_file(name), 100_000, "--precision", "f32", *options)
                 for options in [(), (), ("--batch-size", 4096)]}
        if len(found) > 1:
            unequal.append(name)
    return unequal


def derivatives(tracer):
    """Derivatives by the draws of Optiland's TorchBackend, of which the committed ones are: the worst of each scene, and faults."""
    rows, faults = [], []
    for file in sorted((ROOT / "tests" / "oracle" / "gradients").glob("*.scene.json")):
        name = file.name.removesuffix(".scene.json")
        known = json.loads(file.with_name(f"{name}.json").read_text())
        scene = json.loads(file.read_text())
        screen = next(one for one in scene["detectors"] if one["name"] == known["detector"])
        area = screen["width"] * screen["height"] / (screen["num_pixels_x"] * screen["num_pixels_y"])
        worst = 0.0
        with tempfile.TemporaryDirectory() as folder:
            output = Path(folder) / "out"
            try:
                tracer.trace(file, known["num_rays"], "--seed", known["seed"], "--max-depth", known["max_depth"],
                             "--precision", "f64", "--gradient", ",".join(known["parameters"]), output=output)
            except RuntimeError as error:
                faults.append(str(error))
                continue
            for parameter, expected in known["parameters"].items():
                _, slopes = array(output / "gradients.npz", f"{known['detector']}/{parameter}")
                # A pixel's flux is its irradiance times its area, which grows with either side.
                key = parameter.rsplit(".", 1)[1]
                side = screen[key] if parameter.startswith(screen["name"]) and key in ("width", "height") else None
                grown = [flux / side if side else 0.0 for flux in known["data"]]
                size = sum(abs(value) for value in expected["data"])
                apart = max(abs(slope * area + more - value)
                            for slope, more, value in zip(slopes, grown, expected["data"]))
                worst = max(worst, apart / size)
        rows.append((name, len(known["parameters"]), f"{worst:.1e}"))
        if not worst < GRADIENT_LIMIT:
            faults.append(f"{name}: a derivative is {worst:.1e} off")
    return rows, faults


def rate(tracer, folder, name, scene, num_rays):
    """The median rate of three traces of a scene, after one to warm up [rays/s]."""
    file = Path(folder) / f"{name}.json"
    file.write_text(json.dumps(scene))
    runs = [tracer.trace(file, num_rays, "--precision", "f32")["rays_per_sec"] for _ in range(4)]
    return statistics.median(runs[1:])


def beam(radius, absorption):
    """A beam through a plate of glass onto a map of 256 x 256 pixels."""
    frame = {"x": 0.0, "y": 0.0, "rx": 0.0, "ry": 0.0, "rz": 0.0, "reference_cs": None}
    return {
        "nsq_schema_version": 1,
        "components": [{"type": "lens", "name": "L", "cs": {**frame, "z": 10.0}, "config": {
            "r1": 1e9, "r2": -1e9, "thickness": 5.0, "material": {"type": "medium", "name": "glass"},
            "front_aperture_radius": 20.0}}],
        "sources": [{"type": "collimated", "name": "S", "cs": {**frame, "z": 0.0}, "total_flux": 1.0,
                     "spectrum": {"wavelengths": [0.55], "weights": [1.0]}, "aperture_radius": radius,
                     "profile": "tophat"}],
        "detectors": [{"type": "irradiance", "name": "D", "cs": {**frame, "z": 30.0}, "width": 20.48,
                       "height": 20.48, "num_pixels_x": 256, "num_pixels_y": 256}],
        "nsq_gpu": {"version": 1, "media": {"glass": {"type": "constant", "n": 1.5, "k": absorption}}},
    }


def slowdowns(tracer, num_rays):
    """Rates of traces that differ in one thing: a spot in one pixel, and a glass that absorbs [rays/s]."""
    with tempfile.TemporaryDirectory() as folder:
        return {
            "a beam over the whole map": rate(tracer, folder, "wide", beam(10.0, 0.0), num_rays),
            "a spot in one pixel": rate(tracer, folder, "spot", beam(0.01, 0.0), num_rays),
            "the beam through glass that absorbs": rate(tracer, folder, "absorbing", beam(10.0, 1e-6), num_rays),
        }


def table(head, rows):
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(map(str, row)) + " |" for row in rows])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--binary", default=str(ROOT / "target/release/nsq-gpu"), help="the built command")
    parser.add_argument("-o", "--output", default="gpu-report-out", type=Path, help="folder of the results")
    parser.add_argument("--adapter", help="part of the adapter's name, as `nsq-gpu adapters` prints it")
    parser.add_argument("--quick", action="store_true", help="every sixth scene, and few rays")
    parser.add_argument("--write-strict-bits", action="store_true", help="write the bits that others are held to")
    options = parser.parse_args()
    bench = os.environ.get("NSQ_BENCH_BINARY") or Path(options.binary).with_name("nsq-bench")
    tracer = Tracer(options.binary, bench, options.adapter)
    if options.write_strict_bits:
        return write_strict_bits(tracer)
    options.output.mkdir(parents=True, exist_ok=True)
    page, wrong, start = ["# nsq-gpu on this machine"], [], time.monotonic()

    def section(title, *texts):
        page.extend([f"## {title}", *texts])
        (options.output / "report.md").write_text("\n\n".join(page) + "\n")
        print(f"{time.monotonic() - start:6.0f} s  {title}", flush=True)

    def judged(what, faults):
        wrong.extend(f"{what}: {fault}" for fault in faults)
        return "Right." if not faults else "Wrong: " + "; ".join(faults) + "."

    adapters = tracer.run("adapters", "--measure")[1]
    section("Adapters", f"```\n{adapters.rstrip()}\n```")
    for precision in ["f64", "f32"]:
        try:
            rows, faults = parity(tracer, precision, options.quick)
        except RuntimeError as error:
            rows, faults = [], [str(error)]
        section(f"Agreement with Optiland in {precision}", judged(precision, faults),
                table(["scene", "counts that differ", "largest total", "largest bin", "imbalance [quanta]"],
                      [(n, c, f"{t:.1e}", f"{m:.1e}", i) for n, c, t, m, i in rows]))
    for precision in ["f64", "f32"]:
        num_known, different = strict(tracer, precision, options.quick)
        # Only where quotients and square roots are the nearest numbers can bits be the same as on another adapter.
        is_nearest = f"rounding in {precision}: to the nearest" in adapters
        found = (judged(f"strict {precision}", different) if is_nearest else
                 f"{len(different)} scenes differ: this adapter does not round to the nearest (above).")
        section(f"The bits of lavapipe in strict {precision}", found, f"{num_known} scenes are known.")
    section("Strict arithmetic: the same bits in every form, and its cost", judged("forms", forms(tracer, options.quick)),
            cost_of_strictness(tracer, 100_000 if options.quick else 10_000_000))
    section("The same bits in every run and batch", judged("bits", determinism(tracer)))
    rates = slowdowns(tracer, 100_000 if options.quick else 10_000_000)
    widest = rates["a beam over the whole map"]
    section("What slows the trace down",
            table(["trace", "rate [M rays/s]", "of the first"],
                  [(what, f"{value / 1e6:.2f}", f"{value / widest:.2f}") for what, value in rates.items()]))
    stages = tracer.trace(scene_file("cooke_triplet"), 1_000_000, "--precision", "f32", "--profile")
    times = stages["diagnostics"]["stage_times"]
    section("Stages of the Cooke triplet", f"```json\n{json.dumps(times, indent=1)}\n```")
    code, printed, said = tracer.measure("--paths", "--runs", 3, "--scenes", PATH_CASES,
                                         *(["--max-rays", "1e5"] if options.quick else []))
    section("The cost of the table of paths", f"```\n{(printed if code == 0 else said).rstrip()}\n```")
    if code:
        wrong.append(f"nsq-bench --paths: exit code {code}")
    rows, faults = derivatives(tracer)
    section("Derivatives, beside Optiland's TorchBackend", judged("derivatives", faults),
            table(["scene", "parameters", "largest difference"], rows))
    code, printed, said = tracer.measure("--gradients", "--runs", 3, "--scenes", "rays_1e7,lens_0,lens_8",
                                         *(["--max-rays", "1e5"] if options.quick else []))
    section("The cost of derivatives", f"```\n{(printed if code == 0 else said).rstrip()}\n```")
    if code:
        wrong.append(f"nsq-bench --gradients: exit code {code}")
    code, printed, said = tracer.measure("-o", options.output / "bench", "--overwrite",
                                         *(["--quick"] if options.quick else []))
    section("Speed of every case", f"```\n{(printed if code == 0 else said).rstrip()}\n```")
    if code:
        wrong.append(f"nsq-bench: exit code {code}")
    section("Verdict", "All is right." if not wrong else "\n".join(f"- {fault}" for fault in wrong))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
