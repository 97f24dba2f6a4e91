"""Elements of converted lenses: what their names move, against scenes written by hand and Optiland's own tolerances."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from optiland.coordinate_system import CoordinateSystem
from optiland.materials import Material
from optiland.nonsequential import LensConfig, NSQScene
from optiland.nonsequential.detectors.configs import IrradianceDetectorConfig
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.configs import CollimatedSourceConfig
from optiland.optic import Optic
from optiland.samples.objectives import CookeTriplet, DoubleGauss
from optiland.samples.simple import CementedAchromat
from optiland.samples.telescopes import HubbleTelescope
from optiland.tolerancing.core import Tolerancing
from optiland.tolerancing.monte_carlo import MonteCarlo
from optiland.tolerancing.perturbation import BaseSampler

import nsq_gpu
from nsq_gpu.export import export
from nsq_gpu.scene_file import scene_from_dict
from nsq_gpu.session import Session
from tests import live
from tests.live import cs, glass

pytestmark = pytest.mark.in_turn

FRAME = ("x", "y", "z", "rx", "ry", "rz")
LENSES: dict[str, Callable[[], Optic]] = {
    "triplet": CookeTriplet, "double Gauss": DoubleGauss, "achromat": CementedAchromat, "telescope": HubbleTelescope}


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    with Session(binary=live.binary(), precision="f64") as found:
        yield found


def surfaces(document: Any) -> dict[str, Any]:
    return {item["name"]: item for item in (*document["nsq_gpu"]["surfaces"], *document["detectors"])}


def by_hand(document: Any, element: Any, key: str, value: float) -> Any:
    """Move each surface of an element, as somebody would who writes the file."""
    moved = copy.deepcopy(document)
    first = surfaces(document)[element["faces"][0]]["cs"]
    for name in (*element["faces"], *element["parts"]):
        own = surfaces(moved)[name]["cs"]
        if all(own[axis] == first[axis] for axis in FRAME):
            own[key] = value
        elif key in "xyz":
            own[key] += value - first[key]
        else:
            own |= {axis: own[axis] - first[axis] for axis in "xyz"}
            own["reference_cs"] = {**first, key: value}
    return moved


def traced(session: Session, document: Any, numbers: dict[str, float] | None = None) -> Any:
    answer = session.request(document, {"num_rays": 2000, "seed": 3}, numbers=numbers or {})
    fluxes = {key: answer.report[key] for key in ("total_flux_detected", "total_flux_absorbed", "total_flux_escaped")}
    return fluxes, {name: answer.arrays(name)["irradiance"].tobytes() for name in answer.report["detectors"]}


@pytest.mark.parametrize("name", LENSES)
def test_a_name_of_an_element_is_the_scene_written_by_hand_to_the_bit(name: str, session: Session) -> None:
    document = export(nsq_gpu.from_optic(LENSES[name]())).document
    as_it_is = traced(session, document)
    num_compared = 0
    for element in document["nsq_gpu"]["elements"]:
        first = surfaces(document)[element["faces"][0]]["cs"]
        keys = FRAME if name == "triplet" else ("y", "z", "rx")
        for key in keys:
            value = first[key] + (0.0625 if key in "xyz" else 0.004)
            number = f"{element['name']}.{key}"
            assert session.numbers(document, [number]) == {number: first[key]}
            ours = traced(session, document, {number: value})
            assert ours == traced(session, by_hand(document, element, key, value)), number
            assert ours != as_it_is, number
            num_compared += 1
        assert traced(session, document, {f"{element['name']}.{key}": first[key] for key in FRAME}) == as_it_is
    assert num_compared == len(keys) * len(document["nsq_gpu"]["elements"])


@pytest.mark.parametrize("name", LENSES)
def test_gaps_are_the_thicknesses_of_the_prescription_and_move_what_follows(name: str, session: Session) -> None:
    scene = nsq_gpu.from_optic(LENSES[name]())
    document = export(scene).document
    elements = document["nsq_gpu"]["elements"]
    assert len(elements) == {"triplet": 3, "double Gauss": 4, "achromat": 1, "telescope": 2}[name]
    where = {known: item["cs"]["z"] for known, item in surfaces(document).items()}
    ends = [where[element["faces"][0]] for element in elements[1:]] + [where["image"]]
    for number, (element, end) in enumerate(zip(elements, ends, strict=True)):
        gap = f"gap_{number + 1}"
        along = end - where[element["faces"][-1]]
        size = session.numbers(document, [gap])[gap]
        assert size == abs(along) > 0.0
        moved = copy.deepcopy(document)
        later = {part for other in elements[number + 1:] for part in (*other["faces"], *other["parts"])}
        later |= {part for other in elements[number:] for part in other["behind"]}
        assert "image" in later
        for part in later:
            surfaces(moved)[part]["cs"]["z"] += ((size + 0.25) - size) * math.copysign(1.0, along)
        assert traced(session, document, {gap: size + 0.25}) == traced(session, moved), gap
    with pytest.raises(nsq_gpu.UsageError, match=rf"no such gap; the scene has gap_1{'' if len(elements) == 1 else ' to'}"):
        session.numbers(document, [f"gap_{len(elements) + 1}"])


def test_a_number_that_no_element_has_is_a_wrong_name(session: Session) -> None:
    scene = nsq_gpu.from_optic(LENSES["triplet"]())
    with pytest.raises(nsq_gpu.UnknownNameError, match="`L1` is an element and has no number `radius`"):
        session.sweep(scene, {"L1.radius": [1.0]}, 100)


def test_elements_outlast_a_file_and_name_no_more_than_the_scene_has() -> None:
    scene = nsq_gpu.from_optic(DoubleGauss())
    assert [element["name"] for element in scene.elements] == ["L1", "L2", "L3", "L4"]
    assert scene.elements[1]["behind"] == ["stop"] and scene.elements[3]["behind"] == ["image"]
    document = export(scene).document
    assert document["nsq_gpu"]["elements"] == scene.elements
    again = export(scene_from_dict(json.loads(json.dumps(document)))).document
    assert again["nsq_gpu"]["elements"] == scene.elements
    # A mount that is gone moves no more; a gap whose detector is gone has no name, as it would leave another one behind.
    scene.elements[0]["parts"] += ["L1.other mount"]
    found = export(scene).document["nsq_gpu"]["elements"]
    assert found[0]["parts"] == ["L1.edge", "L1.mount"] and found[0]["behind"] == []
    scene.elements[3]["behind"] = ["film"]
    assert not any("behind" in element for element in export(scene).document["nsq_gpu"]["elements"])
    scene.elements[1]["faces"] = ["L2.front", "L2.rear"]
    assert [element["name"] for element in export(scene).document["nsq_gpu"]["elements"]] == ["L1", "L3", "L4"]


def test_a_frame_with_a_name_moves_what_stands_in_it(session: Session) -> None:
    def barrel(y: float) -> NSQScene:
        scene = NSQScene()
        outer = CoordinateSystem(y=y, z=10.0)
        outer.name = "barrel"
        scene.add_source("beam", cs(z=-5.0), CollimatedSourceConfig(Spectrum.monochromatic(0.55), aperture_radius=4.0, total_flux=1.0))
        for name, z in (("A", 0.0), ("B", 9.0)):
            scene.add_lens(name, CoordinateSystem(z=z, reference_cs=outer), LensConfig(
                r1=60.0, r2=-60.0, thickness=3.0, material=glass(1.5), front_aperture_radius=8.0))
        scene.add_detector("image", cs(z=50.0), IrradianceDetectorConfig(8.0, 8.0, 16, 16))
        return scene

    document = export(barrel(0.0)).document
    assert traced(session, document, {"barrel.y": 0.5}) == traced(session, export(barrel(0.5)).document)
    again = export(scene_from_dict(json.loads(json.dumps(document)))).document
    assert again["components"] == document["components"]


def test_a_gap_has_a_derivative(session: Session) -> None:
    scene = nsq_gpu.from_optic(CookeTriplet(), detector_size=(30.0, 45.0), detector_pixels=(6, 9))
    names = ["L2.y", "L2.rx", "gap_2"]
    found = nsq_gpu.jacobian(scene, names, 20_000, binary=live.binary())
    nominal = session.numbers(scene, names)
    for name, step in zip(names, (0.02, 2e-3, 0.05), strict=True):
        values = [nominal[name] - step, nominal[name] + step]
        ends = session.sweep(scene, {name: values}, 20_000, maps=True).maps["image"]
        slope = (ends[1] - ends[0]) / (2.0 * step)
        ours = found[name, "image"]
        # Light that the mounts clip crosses edges, which a difference sees alone.
        ours, theirs = ours.map.ravel(), slope.ravel()
        assert np.corrcoef(ours, theirs)[0, 1] > 0.95, name
        assert 0.9 < ours @ theirs / (theirs @ theirs) < 1.1, name


class Drawn(BaseSampler):
    """Values one after the other, from the first of a run on."""

    def __init__(self, values: Any) -> None:
        self.size, self._values = len(values), iter(values)

    def sample(self) -> float:
        return float(next(self._values))


def test_decentre_and_tilt_are_those_of_optilands_own_monte_carlo(session: Session) -> None:
    thickness, samples = 5.0, 25
    optic = Optic()
    optic.surfaces.add(index=0, radius=np.inf, thickness=np.inf)
    optic.surfaces.add(index=1, radius=np.inf, thickness=2.0, is_stop=True)
    optic.surfaces.add(index=2, radius=60.0, thickness=thickness, material=Material("N-BK7"))
    optic.surfaces.add(index=3, radius=-45.0, thickness=46.0)
    optic.surfaces.add(index=4)
    optic.set_aperture("EPD", 12.0)
    optic.fields.set_type("angle")
    optic.fields.add(y=0.0)
    optic.wavelengths.add(value=0.55, is_primary=True)
    document = export(nsq_gpu.from_optic(optic, margin=1.2)).document
    first = surfaces(document)["L1.front"]["cs"]["z"]

    draws = np.random.default_rng(5)
    numbers = {"L1.x": 0.2, "L1.y": 0.2, "L1.rx": 0.02, "L1.ry": 0.02}
    numbers = {name: size * draws.standard_normal(samples) for name, size in numbers.items()}
    x, y, rx, ry = numbers.values()
    # The back vertex of the lens that is turned about its front vertex.
    back = np.stack([x + thickness * np.cos(rx) * np.sin(ry), y - thickness * np.sin(rx), thickness * np.cos(rx) * np.cos(ry)])
    tolerances = Tolerancing(optic)
    tolerances.add_operand("real_x_intercept", {"optic": optic, "surface_number": -1, "Hx": 0, "Hy": 0, "Px": 0, "Py": 0, "wavelength": 0.55})
    tolerances.add_operand("real_y_intercept", {"optic": optic, "surface_number": -1, "Hx": 0, "Hy": 0, "Px": 0, "Py": 0, "wavelength": 0.55})
    tolerances.add_operand("rms_spot_size", {"optic": optic, "surface_number": -1, "Hx": 0, "Hy": 0, "num_rays": 60, "wavelength": 0.55,
                                             "distribution": "uniform"})
    start = float(np.squeeze(optic.surfaces.surfaces[2].geometry.cs.z))
    moved = {2: (x, y, None), 3: (back[0], back[1], start + back[2])}
    for surface, axes in moved.items():
        for axis, values in zip("xyz", axes, strict=True):
            if values is not None:
                tolerances.add_perturbation("decenter", Drawn(values), surface_number=surface, axis=axis)
        for axis, values in (("x", rx), ("y", ry)):
            tolerances.add_perturbation("tilt", Drawn(values), surface_number=surface, axis=axis)
    theirs = MonteCarlo(tolerances)
    theirs.run(samples)
    table = theirs.get_results().to_numpy()[:, -3:]

    rows = {"type": "ray_database", "name": "image", "cs": document["detectors"][0]["cs"], "width": 20.0, "height": 20.0}
    beam = {**document, "detectors": [rows]}
    chief = copy.deepcopy(beam)
    chief["sources"][0]["beam_radii"] = [1e-15, 1e-15]
    for sample in range(samples):
        values = {name: float(drawn[sample]) for name, drawn in numbers.items()}

        def arrive(scene: Any, num_rays: int, values: dict[str, float] = values) -> Any:
            found = session.request(scene, {"num_rays": num_rays, "where": "reflections == 0"}, numbers=values).arrays("image")
            return np.stack([found["x"], found["y"]], axis=1)

        boresight = arrive(chief, 4)
        assert len(boresight) and np.abs(boresight - table[sample, :2]).max() < 1e-9
        spot = arrive(beam, 40_000)
        assert len(spot) > 30_000
        rms = np.sqrt(((spot - spot.mean(axis=0)) ** 2).sum(axis=1).mean())
        assert abs(rms / table[sample, 2] - 1.0) < 5e-3
    assert np.abs(table[:, :2]).max() > 0.1 and first == pytest.approx(2.0)
