"""The report of a conversion: how large the detector is and why, what was carried, and from which line."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from optiland.coatings import SimpleCoating
from optiland.optic import Optic
from optiland.physical_apertures import RadialAperture, RectangularAperture
from optiland.samples.objectives import CookeTriplet
from optiland.samples.simple import AsphericSinglet

import nsq_gpu
from nsq_gpu.convert import prescription
from nsq_gpu.convert.__main__ import main
from tests import live
from tests.lens_texts import oslo as oslo_text
from tests.lens_texts import seq, zmx
from tests.test_convert import BACK, FRONT, REFUSED, lens
from tools.prescriptions import samples

pytestmark = pytest.mark.in_turn


# The detector


def last_element(scene: Any) -> float:
    """Return the diameter of the largest face of the element that light meets last: by names and the scene's shapes."""
    report = scene.conversion_report
    acting = [names[0] for names in report.components.values() if names and not names[0].startswith("stop")]
    element = acting[-1].split(".")[0]
    shapes = dict(zip(scene.component_names, (part.geometry for part in scene.surfaces), strict=True))
    own = [name for name in acting if name.split(".")[0] == element]
    return 2.0 * max(float(getattr(shapes[name], "aperture_radius", 0.0) or 0.0) for name in own)


@pytest.mark.parametrize(("name", "kind"), [pair for pair in samples() if pair[0] not in REFUSED],
                         ids=lambda value: value if isinstance(value, str) else "")
def test_the_detector_is_as_wide_as_the_image_circle_or_the_last_element(name: str, kind: type[Optic]) -> None:
    optic = kind()
    with live.quiet():
        scene = nsq_gpu.from_optic(optic)
    [image], report = scene.detectors, scene.conversion_report
    size = (float(image.width), float(image.height))
    assert report.detector_size == size
    assert f"Detector image: {size[0]:.4g} x {size[1]:.4g} mm, {report.detector_reason}" in report.summary()
    # The light of all fields, by the sequential engine.
    with live.quiet(), prescription.in_double(), prescription.without_polarised_coatings(optic) as coatings:
        _, rays = prescription.read(optic, coatings)
    position, rotation = prescription.placed(optic.image_surface.geometry.cs)
    places = (rays.places[-1][rays.arrive] - position) @ rotation
    assert size[0] == size[1] == max(report.image_circle, last_element(scene))
    assert 2.0 * np.hypot(places[:, 0], places[:, 1]).max() <= report.image_circle * (1.0 + 1e-9)


def test_ghosts_of_a_lens_meet_its_detector() -> None:
    def ghosts(**options: Any) -> float:
        scene = nsq_gpu.from_optic(AsphericSinglet(), **options)
        with live.quiet():
            result = scene.trace(20_000, seed=1, max_depth=16, backend=live.backend(where="reflections == 2"))
        return float(result.detectors["image"].total_flux)

    # The circle of the image alone, and ten times the lens.
    assert ghosts(detector_size=(0.1641, 0.1641)) == 0.0
    assert ghosts() > 0.2 * ghosts(detector_size=(200.0, 200.0)) > 0.0


def test_a_size_that_is_given_is_the_size(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = nsq_gpu.from_optic(AsphericSinglet(), detector_size=(0.5, 0.25))
    assert (float(scene.detectors[0].width), float(scene.detectors[0].height)) == (0.5, 0.25)
    said = scene.conversion_report.summary()
    assert "Detector image: 0.5 x 0.25 mm, as given; the image circle is 0.1641 mm wide" in said
    file, made = tmp_path / "lens.zmx", tmp_path / "scene.json"
    file.write_text(zmx())
    assert main([str(file), "--size", "24,36", "-o", str(made)]) == 0
    assert "Detector image: 24 x 36 mm, as given" in capsys.readouterr().out
    [image] = nsq_gpu.load_scene(made).detectors
    assert (float(image.width), float(image.height)) == (24.0, 36.0)
    for text in ("24", "24,x", "24,36,48"):
        with pytest.raises(SystemExit) as stop:
            main([str(file), "--size", text])
        assert stop.value.code == 2
        assert "write both in mm, such as 24,36" in capsys.readouterr().err
    assert main([str(file), "--size", "0,36"]) == 2
    assert "detector_size is (0.0, 36.0)" in capsys.readouterr().err


def test_a_detector_in_the_light_is_no_wider_than_the_image() -> None:
    # The prime focus of a mirror, which light passes on its way.
    optic = lens({"thickness": 100.0},
                 {"thickness": -100.0, "radius": -200.0, "material": "mirror", "is_stop": True}, pupil=30.0)
    scene = nsq_gpu.from_optic(optic)
    report = scene.conversion_report
    assert report.detector_size[0] == report.image_circle < 1.0
    assert "as wide as the last element, M1 (30.03 mm), it would stand in the light" in report.detector_reason
    with live.quiet():
        result = scene.trace(2000, seed=1, backend=live.backend())
        wide = nsq_gpu.from_optic(optic, detector_size=(31.0, 31.0)).trace(2000, seed=1, backend=live.backend())
    assert result.num_rays_absorbed == 0
    # All light ends on the front of a detector as wide as the mirror, and is spread over its beam.
    assert float(result.detectors["image"].irradiance.max()) > 100.0 * float(wide.detectors["image"].irradiance.max())


def test_a_detector_in_the_shadow_of_the_last_mirror_is_as_wide_as_that() -> None:
    # Light is a ring where it passes the plane of the image, in front of the first mirror.
    optic = lens({"thickness": 70.0, "aperture": RadialAperture(r_max=20.0, r_min=8.0)},
                 {"thickness": -60.0, "radius": -160.0, "material": "mirror", "is_stop": True},
                 {"thickness": 40.0, "radius": -45.0, "material": "mirror"}, pupil=30.0)
    report = nsq_gpu.from_optic(optic).conversion_report
    assert report.detector_reason == "as wide as the last element, M2"


# What was carried


def test_parts_of_an_optic_come_from_its_surfaces() -> None:
    optic = lens({**FRONT, "surface_type": "even_asphere", "coefficients": [0.0, 1e-6, 0.0, 2e-10], "comment": "a: b",
                  "aperture": RectangularAperture(-6.0, 6.0, -6.0, 6.0)},
                 {**BACK, "conic": -1.5, "coating": SimpleCoating(0.9, 0.1)},
                 {"thickness": 10.0, "aperture": RadialAperture(r_max=7.0)})
    cs = optic.surfaces.surfaces[2].geometry.cs
    cs.x, cs.rx = 0.25, np.radians(2.0)
    report = nsq_gpu.from_optic(optic).conversion_report
    assert [(part.index, part.kind, part.component, part.what) for part in report.carried] == [
        (1, "shape", "L1.front", "even asphere, 2 coefficients"),
        (1, "aperture", "L1.front", "aperture, rectangle"),
        (2, "shape", "L1.back", "conic constant -1.5"),
        (2, "decentre", "L1.back", "decentre, x = 0.25 mm, y = 0 mm"),
        (2, "tilt", "L1.back", "tilt, rx = 2, ry = 0, rz = 0 degrees"),
        (2, "coating", "L1.back", "coating, T = 0.9, R = 0.1"),
        (3, "aperture", "stop", "aperture, disk of radius 7 mm")]
    assert {part.origins for part in report.carried} == {("surface 1 (a: b)",), ("surface 2",), ("surface 3",)}
    assert "Carried: L1.front: even asphere, 2 coefficients, from surface 1 (a: b)" in report.summary()
    assert nsq_gpu.from_optic(CookeTriplet()).conversion_report.carried == []


BREAK = ["TYPE COORDBRK", "PARM 1 0.5", "PARM 2 0", "PARM 3 2.0", "DISZ 3"]
#: Lens files, and the kinds of parts that each has.
FILES = {
    "asphere.zmx": (zmx(face=["TYPE EVENASPH", "CONI -0.5", "PARM 2 1e-6", "PARM 3 0", "PARM 4 1e-10", "CLAP 0 6 0"]),
                    {"shape", "aperture"}),
    "breaks.zmx": (zmx(["COFN QF COATING.DAT"], ["COAT HALF"], before=[["CURV 0", "DISZ 10"], BREAK]),
                   {"decentre", "tilt", "coating"}),
    "conic.zmx": (zmx(face=["CONI 0.25"], image=["COMM film"]), {"shape"}),
    "asphere.seq": (seq(face=["ASP", "K -0.5", "A 1e-6; B 0; C 1e-10", "CIR 6"]), {"shape", "aperture"}),
    "tilts.seq": (seq(face=["XDE 0.5; YDE 0", "ADE 2.0"]), {"decentre", "tilt"}),
    "tilts.len": (oslo_text(["CC -0.5", "DCY 0.5", "TLA 2.0"]), {"shape", "decentre", "tilt"}),
    "aperture.len": (oslo_text(["AP CHK 4.0"]), {"aperture"}),
}


def carried(folder: Path, name: str, text: str) -> list[Any]:
    (folder / "COATING.DAT").write_text("! a table\nMATE X\nIDEAL HALF 0.4 0.6\n")
    (folder / name).write_text(text)
    with live.quiet():
        return nsq_gpu.from_file(folder / name).conversion_report.carried


@pytest.mark.parametrize("name", FILES)
def test_parts_of_a_file_come_from_the_lines_without_which_they_are_none(name: str, tmp_path: Path) -> None:
    text, kinds = FILES[name]
    rows = text.splitlines()
    found = carried(tmp_path, name, text)
    assert {part.kind for part in found} == kinds
    for part in found:
        lines = []
        for place in part.origins:
            line, card = re.fullmatch(rf"{re.escape(name)}:(\d+): (\S+)", place).groups()  # type: ignore[union-attr]
            lines.append(int(line))
            # The line has the card, whose number is not 0.
            assert re.search(rf"(^|[;\s]){card}\b", rows[int(line) - 1])
        without = "\n".join(row for number, row in enumerate(rows, start=1) if number not in lines)
        left = [(other.component, other.kind) for other in carried(tmp_path, name, without)]
        assert (part.component, part.kind) not in left, part
    zeros = [number for number, row in enumerate(rows, start=1) if re.search(r"PARM \d 0$", row)]
    assert not any(f":{number}: " in place for part in found for place in part.origins for number in zeros)


def test_the_command_prints_what_was_carried_and_from_where(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "lens.zmx"
    file.write_text(FILES["asphere.zmx"][0])
    assert main([str(file)]) == 0
    said = capsys.readouterr().out
    rows = FILES["asphere.zmx"][0].splitlines()
    lines = {"".join(row.split()[:2]): number for number, row in enumerate(rows, start=1)}
    numbers = ",".join(map(str, sorted(lines[key] for key in ("CONI-0.5", "TYPEEVENASPH", "PARM2", "PARM4"))))
    assert f"Carried: L1.front: even asphere, 2 coefficients, from lens.zmx:{numbers} (" in said
    assert re.search(r"Carried: L1.front: aperture, disk of radius 6 mm, from lens.zmx:\d+ \(CLAP\)", said)
    assert re.search(r"Detector image: \d", said)
