"""Mounts from STEP files: solids, names and places, refusals, and light in a baffle tube.

``data/mount.step`` is an AP214 assembly in mm that Open CASCADE 8.0 wrote (cadquery-ocp-novtk 8.0.1.1): a ``barrel``, a tube of radii 12
and 10 and length 60; ``vane 1`` and ``vane 2``, one product ``vane`` at z = 20 and 40, rings of radii 10 and 5 and thickness 0.5; a
``foot``, a box of 10 x 4 x 6 about its z axis, turned by 30 degrees, at y = -20, z = 10; and a ``window``, a disk of radius 9 and
thickness 2 at z = 55.
"""

from __future__ import annotations

import builtins
import math
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from optiland.nonsequential import NSQScene
from optiland.nonsequential.components.configs import InteractionType, LensConfig, SurfaceConfig
from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.configs import CollimatedSourceConfig, PointSourceConfig

import nsq_gpu
from nsq_gpu import from_step
from nsq_gpu.step import parts
from tests import live
from tests.live import cs, glass

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("cascadio")

MOUNT = Path(__file__).parent / "data" / "mount.step"
ALL_BLACK = {"window": None, "*": "absorbing"}
LINE = Spectrum(np.array([0.55]), np.array([1.0]))


def behind(scene: NSQScene, source: Any, place: float) -> NSQScene:
    """Add a source before the mount, and a detector behind it."""
    scene.add_source("lamp", cs(z=place), source)
    scene.add_detector("screen", cs(z=80.0), IrradianceDetectorConfig(width=60.0, height=60.0, num_pixels_x=6, num_pixels_y=6))
    return scene


def ledger(scene: NSQScene, num_rays: int) -> dict[str, float]:
    which = live.backend()
    with live.quiet():
        scene.trace(num_rays, seed=0, backend=which)
    assert which.report["ledger"]["imbalance_quanta"] == "0"
    return {key: which.report["ledger"][key]["flux"] for key in ("detected", "absorbed", "surface", "escaped", "depth")}


# Solids


def test_parts_are_the_solids_where_the_assembly_puts_them() -> None:
    found = parts(MOUNT, tolerance=0.01)
    assert list(found) == ["barrel", "vane 1", "vane 2", "foot", "window"]
    ring, polygon = math.pi * (10.0**2 - 5.0**2), 1e-3
    solids = {
        "barrel": (math.pi * (12.0**2 - 10.0**2) * 60.0, 2.0 * math.pi * (12.0 + 10.0) * 60.0 + 2.0 * math.pi * (12.0**2 - 10.0**2)),
        "vane 1": (ring * 0.5, 2.0 * ring + 2.0 * math.pi * 15.0 * 0.5), "vane 2": (ring * 0.5, 2.0 * ring + 2.0 * math.pi * 15.0 * 0.5),
        "foot": (240.0, 2.0 * (40.0 + 60.0 + 24.0)),
        "window": (math.pi * 81.0 * 2.0, 2.0 * math.pi * 81.0 + 2.0 * math.pi * 9.0 * 2.0),
    }
    for name, (volume, area) in solids.items():
        mesh = found[name]
        assert mesh.is_watertight and mesh.is_winding_consistent, name
        # Positive where normals point outwards.
        assert mesh.volume == pytest.approx(volume, rel=polygon), name
        assert mesh.area == pytest.approx(area, rel=polygon), name
    corner = np.array([[math.cos(math.pi / 6.0), math.sin(math.pi / 6.0)], [-math.sin(math.pi / 6.0), math.cos(math.pi / 6.0)]])
    reach = np.abs(corner * np.array([[5.0], [2.0]])).sum(axis=0)
    boxes = {"barrel": ([-12.0, -12.0, 0.0], [12.0, 12.0, 60.0]), "vane 1": ([-10.0, -10.0, 20.0], [10.0, 10.0, 20.5]),
             "vane 2": ([-10.0, -10.0, 40.0], [10.0, 10.0, 40.5]), "window": ([-9.0, -9.0, 55.0], [9.0, 9.0, 57.0]),
             "foot": ([-reach[0], -20.0 - reach[1], 10.0], [reach[0], -20.0 + reach[1], 16.0])}
    for name, box in boxes.items():
        np.testing.assert_allclose(found[name].bounds, box, atol=0.01)
    # Flat faces are exact to the float32 of a GLB file.
    np.testing.assert_allclose(found["foot"].bounds, boxes["foot"], atol=1e-5)
    assert found["barrel"].bounds[1, 2] == pytest.approx(60.0, abs=1e-5)


def test_facets_lie_within_the_tolerance() -> None:
    coarse, fine = (parts(MOUNT, tolerance=tolerance, angular_tolerance=1.0)["barrel"] for tolerance in (0.3, 0.003))
    assert len(coarse.faces) < len(fine.faces) / 3
    for mesh, tolerance in ((coarse, 0.3), (fine, 0.003)):
        middles = mesh.triangles_center[np.abs(mesh.face_normals[:, 2]) < 0.5]
        radii = np.hypot(middles[:, 0], middles[:, 1])
        apart = np.minimum(np.abs(radii - 12.0), np.abs(radii - 10.0))
        assert apart.max() <= tolerance
    fold = parts(MOUNT, tolerance=1.0, angular_tolerance=0.05)["barrel"].face_adjacency_angles
    assert fold[(fold > 1e-3) & (fold < 1.0)].max() <= 0.05 + 1e-6


def test_the_unit_of_the_file_and_the_scale_count(tmp_path: Path) -> None:
    """The same numbers in metres are a mount of 60 m."""
    text = MOUNT.read_text(encoding="utf-8")
    assert text.count("SI_UNIT(.MILLI.,.METRE.)") > 0
    (tmp_path / "metres.STP").write_text(text.replace("SI_UNIT(.MILLI.,.METRE.)", "SI_UNIT($,.METRE.)"), encoding="utf-8")
    metres = parts(tmp_path / "metres.STP", scale=1e-3, tolerance=10.0)
    assert metres["foot"].extents == pytest.approx(parts(MOUNT)["foot"].extents, rel=1e-6)
    assert parts(MOUNT, scale=25.4)["foot"].volume == pytest.approx(240.0 * 25.4**3, rel=1e-6)


def test_equal_names_get_numbers_and_nameless_parts_their_products(tmp_path: Path) -> None:
    text = MOUNT.read_text(encoding="utf-8")
    (tmp_path / "same.step").write_text(text.replace("'vane 2'", "'vane 1'"), encoding="utf-8")
    assert list(parts(tmp_path / "same.step")) == ["barrel", "vane 1", "vane 1 2", "foot", "window"]
    (tmp_path / "nameless.step").write_text(text.replace("'vane 1'", "'NAUO2'").replace("'vane 2'", "'=>[0:1:1:3]'"), encoding="utf-8")
    assert list(parts(tmp_path / "nameless.step")) == ["barrel", "vane", "vane 2", "foot", "window"]
    scene = from_step(MOUNT, {"barrel": "absorbing", "*": None}, scene=from_step(MOUNT, {"barrel": "black paint", "*": None}))
    assert scene.component_names == ["barrel", "barrel 2"]


# Finishes


def test_finishes_go_by_patterns_the_first_of_which_counts() -> None:
    scene = from_step(MOUNT, {"barrel": "black anodised aluminium", "vane 2": nsq_gpu.finish("black nickel"),
                              "vane": SurfaceConfig(interaction=InteractionType.REFLECTIVE, reflectance=0.3, bsdf=nsq_gpu.finish("black paint")["bsdf"]),
                              "win*": None, "*": "absorbing"})
    assert scene.component_names == ["barrel", "vane 1", "vane 2", "foot"]
    kinds = [type(surface).__name__ for surface in scene.surfaces]
    assert kinds == ["ReflectiveComponent"] * 3 + ["AbsorbingComponent"]
    assert [surface.name for surface in scene.surfaces] == scene.component_names
    # `vane` is a product: `vane 1` is one of it.
    assert [surface.reflectance for surface in scene.surfaces[:3]] == [1.0, 0.3, 1.0]
    assert [type(surface.bsdf).__name__ for surface in scene.surfaces[:3]] == ["TabulatedBSDF", "LambertianBSDF", "TabulatedBSDF"]


@pytest.mark.parametrize(("surfaces", "kind", "words"), [
    ({"barrel": "black paint"}, nsq_gpu.UsageError, "no pattern fits 'vane 1', 'vane 2', 'foot', 'window'; give each a finish, or None to leave it out"),
    ({"barel": "black paint", "*": None}, nsq_gpu.UsageError, "no part of .*mount.step' fits the pattern 'barel'; did you mean 'barrel'"),
    ({"Barrel": "black paint", "*": None}, nsq_gpu.UsageError, "fits the pattern 'Barrel'; did you mean 'barrel'"),
    ({"*": "blak paint"}, nsq_gpu.UnknownNameError, "there is no finish 'blak paint'; did you mean 'black paint'"),
    ({"window": nsq_gpu.polished(0.001, 0.55, delta_n=0.5), "*": None}, nsq_gpu.UnsupportedSceneError,
     r"surfaces\['window'\]: it has no reflectance, so the part would refract.*c / \(2 R\).*add the lens as a lens"),
    ({"window": SurfaceConfig(interaction=InteractionType.REFRACTIVE, reflectance=0.1), "*": None}, nsq_gpu.UnsupportedSceneError, "would refract"),
    ({"*": {"reflectence": 0.1}}, nsq_gpu.UsageError, "these are no keywords of SurfaceConfig"),
    ({"*": {"reflectance": 0.1, "aperture_radius": 3.0}}, nsq_gpu.UsageError, "a mesh has no aperture_radius"),
    ({"*": 0.05}, nsq_gpu.UsageError, r"surfaces\['\*'\] is 0\.05; give the name of a finish"),
    (["*"], nsq_gpu.UsageError, 'surfaces is a list; give a dictionary, such as {"barrel'),
])
def test_slips_are_answered_and_the_scene_stays(surfaces: Any, kind: type[Exception], words: str) -> None:
    scene = NSQScene()
    with pytest.raises(kind, match=words):
        from_step(MOUNT, surfaces, scene=scene)
    assert scene.component_names == []


def test_files_that_are_none_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "garbage.step").write_text("solid barrel\n", encoding="utf-8")
    for path, words in ((tmp_path / "missing.step", "cannot be read: No such file"), (tmp_path / "garbage.step", "is it a STEP file"),
                        (tmp_path / "mount.stl", "is no STEP file by its name; give one that ends in .step or .stp")):
        with pytest.raises(nsq_gpu.UsageError, match=words):
            from_step(path, ALL_BLACK)
    with pytest.raises(nsq_gpu.UsageError, match="scale is 0; give a number above 0"):
        from_step(MOUNT, ALL_BLACK, scale=0)
    with pytest.raises(nsq_gpu.UsageError, match="scene is the path 'a.json'; read it"):
        from_step(MOUNT, ALL_BLACK, scene="a.json")  # type: ignore[arg-type]
    importing = builtins.__import__

    def without(name: str, *arguments: Any, **keywords: Any) -> Any:
        if name == "cascadio":
            raise ModuleNotFoundError("No module named 'cascadio'", name="cascadio")
        return importing(name, *arguments, **keywords)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(nsq_gpu.MissingLibraryError, match="cascadio is not installed, and STEP files need it: pip install cascadio trimesh"):
        from_step(MOUNT, ALL_BLACK)


def test_a_curved_part_that_mirrors_is_warned_of_with_the_tilt_of_its_facets() -> None:
    mirror = {"reflectance": 0.9, "interaction": InteractionType.REFLECTIVE}
    with pytest.warns(nsq_gpu.NsqGpuWarning, match="barrel mirrors, and its facets tilt its normals by up to") as said:
        from_step(MOUNT, {"barrel": mirror, "*": None}, tolerance=0.01, angular_tolerance=0.1)
    told = float(re.search(r"up to ([\d.]+) mrad", str(said[0].message))[1])  # type: ignore[index]
    # Chords c of the bore's radius 10: c / (2 R).
    mesh = parts(MOUNT, tolerance=0.01, angular_tolerance=0.1)["barrel"]
    bore = mesh.triangles[(np.hypot(*mesh.triangles_center[:, :2].T) < 10.5) & (np.abs(mesh.face_normals[:, 2]) < 0.5)]
    chord = np.linalg.norm(np.diff(bore[:, [0, 1, 2, 0], :2], axis=1), axis=2).max()
    assert told == pytest.approx(1e3 * chord / (2.0 * 10.0), rel=0.05)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Flat faces have no tilt, and what scatters all of its light mirrors nothing.
        from_step(MOUNT, {"foot": mirror, "*": None})
        from_step(MOUNT, {"barrel": "black paint", "*": None})


# Light


def test_a_collimated_beam_passes_the_hole_of_the_vanes() -> None:
    """(5 / 12)^2 of a beam as wide as the barrel; the hole is a polygon within it."""
    scene = behind(from_step(MOUNT, ALL_BLACK, tolerance=0.002, angular_tolerance=0.05), CollimatedSourceConfig(LINE, aperture_radius=12.0), -10.0)
    found = ledger(scene, 200_000)
    hole = (5.0 / 12.0) ** 2
    assert found["detected"] == pytest.approx(hole, abs=4.0 * math.sqrt(hole * (1.0 - hole) / 200_000) + 1e-3 * hole)
    # All else ends on the barrel's end and on the vanes, but for rays between two facets of the barrel's rim.
    assert found["absorbed"] == pytest.approx(1.0 - found["detected"], abs=1e-3)


def test_a_point_source_passes_the_far_vane() -> None:
    """(1 - cos a) / (1 - cos b): a to the edge of the last vane's hole, b the half-angle of the source."""
    scene = behind(from_step(MOUNT, ALL_BLACK, tolerance=0.002, angular_tolerance=0.05), PointSourceConfig(LINE, half_angle_deg=12.0), -30.0)
    edge = math.atan(5.0 / 70.5)
    passes = (1.0 - math.cos(edge)) / (1.0 - math.cos(math.radians(12.0)))
    found = ledger(scene, 200_000)
    assert found["detected"] == pytest.approx(passes, abs=4.0 * math.sqrt(passes * (1.0 - passes) / 200_000) + 1e-3 * passes)
    assert found["absorbed"] == pytest.approx(1.0 - found["detected"], abs=1e-6)


def test_black_paint_in_the_tube_loses_95_percent_a_hit() -> None:
    scene = behind(from_step(MOUNT, {"window": None, "*": "black paint"}), PointSourceConfig(LINE, half_angle_deg=12.0), -30.0)
    direct = (1.0 - math.cos(math.atan(5.0 / 70.5))) / (1.0 - math.cos(math.radians(12.0)))
    found = ledger(scene, 100_000)
    # Of what meets the mount, 95 % is lost at the first hit, and nearly all at the next ones; the least goes back at once.
    assert 0.95 * (1.0 - direct) - 0.01 < found["surface"] < 1.0 - direct + 0.01
    # Light that is scattered forwards joins the direct light, which is less than 5 % of it.
    assert direct - 0.005 < found["detected"] < direct + 0.05 * (1.0 - direct) + 0.005


def test_a_mount_traces_as_numpy_does_and_from_a_file(tmp_path: Path) -> None:
    """Within a hollow mesh, Optiland takes the facet that a ray stands on for a miss: there, the parts absorb."""
    scene = behind(from_step(MOUNT, {"window": None, "foot": "black nickel", "*": "absorbing"}, tolerance=0.3, angular_tolerance=0.5),
                   PointSourceConfig(LINE, half_angle_deg=45.0), -30.0)
    # A lens stays a lens.
    scene.add_lens("L1", cs(z=55.0), LensConfig(60.0, -60.0, 2.0, glass(), 8.0))
    live.assert_equals_numpy(scene, 1500)
    nsq_gpu.export_scene(scene, tmp_path / "scene.json")
    again = nsq_gpu.load_scene(tmp_path / "scene.json")
    assert again.component_names == scene.component_names
    one, other = (ledger(which, 5000) for which in (scene, again))
    assert one == pytest.approx(other, abs=1e-12)
    # A part moves by its name.
    with nsq_gpu.Session(binary=live.binary()) as session, live.quiet():
        fluxes = session.sweep(scene, {"vane 2.y": [0.0, 16.0]}, 20_000).flux["screen"]
    assert fluxes[1] > 1.5 * fluxes[0]
