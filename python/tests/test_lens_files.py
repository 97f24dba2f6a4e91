"""A lens file is the lens it says: every card is carried, refused by its line, or remarked; nothing else comes of it."""

from __future__ import annotations

import itertools
import random
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from optiland.coatings import SimpleCoating
from optiland.materials import IdealMaterial
from optiland.rays import RealRays

import nsq_gpu
from nsq_gpu import lensfiles
from nsq_gpu.convert import prescription
from nsq_gpu.convert.__main__ import main
from nsq_gpu.lensfiles import codev, glasses, oslo, zemax
from tests import live
from tests.lens_texts import CORPUS, ZEMAX_HEADER, Example, Read, breaks, near, number, oslo as oslo_text, read, seq, typed, zmx

TABLES = {".zmx": {**zemax.HEADER, **zemax.SURFACE}, ".seq": codev.CARDS, ".len": oslo.CARDS}
EXAMPLES = [(suffix, index, example) for suffix, examples in CORPUS.items() for index, example in enumerate(examples)]


def label(value: Any) -> str:
    return value.card if isinstance(value, Example) else str(value)


def holds(example: Example, suffix: str, folder: Path) -> str:
    """Return why an example does not hold, or ""."""
    try:
        found = read(folder, f"lens{suffix}", example.text)
    except nsq_gpu.NsqGpuError as error:
        if example.refused is None:
            return f"refused: {error}"
        if not re.search(r"lens\.\w+:\d+: |lens\.\w+: (RDM is not stated|cannot read it)", str(error)):
            return f"no line: {error}"
        return "" if example.refused in str(error) else f"refused for another reason: {error}"
    if example.refused is not None:
        return "not refused"
    said = "\n".join(found.reading.remarks)
    if example.remarked is not None:
        return "" if example.remarked in said else f"not remarked: {said}"
    if example.passed_over:
        return "" if example.card in found.reading.passed_over and example.card not in said else "not passed over"
    assert example.right is not None
    return "" if example.right(found) else "the number is another"


@pytest.mark.parametrize(("suffix", "index", "example"), EXAMPLES, ids=label)
def test_a_card_is_carried_refused_or_remarked(suffix: str, index: int, example: Example, tmp_path: Path) -> None:
    assert holds(example, suffix, tmp_path) == ""


@pytest.mark.parametrize("suffix", TABLES)
def test_every_card_of_the_tables_has_a_file(suffix: str) -> None:
    fates = {fate for rule in TABLES[suffix].values() for fate in [rule.fate]}
    shown = {example.card for example in CORPUS[suffix]}
    assert set(TABLES[suffix]) - shown == set()
    assert len(fates) >= 3


@pytest.mark.parametrize("suffix", TABLES)
def test_a_card_of_no_meaning_changes_nothing(suffix: str, tmp_path: Path) -> None:
    plain = read(tmp_path, f"plain{suffix}", {".zmx": zmx, ".seq": seq, ".len": oslo_text}[suffix]())
    wanted = [(found.geometry.to_dict(), number(found.thickness)) for found in plain.surfaces]
    for example in CORPUS[suffix]:
        if example.passed_over:
            found = read(tmp_path, f"lens{suffix}", example.text)
            assert str([(surface.geometry.to_dict(), number(surface.thickness)) for surface in found.surfaces]) == str(wanted)


# Unknown cards and glasses


def test_unknown_cards_are_left_out_where_the_user_says_so(tmp_path: Path) -> None:
    for suffix, text in {".zmx": zmx(face=["XYZW 1"]), ".seq": seq(face=["XYZ 1"]), ".len": oslo_text(["XYZ 1"])}.items():
        found = read(tmp_path, f"lens{suffix}", text, unknown="remark")
        assert any("unknown, and was left out" in remark for remark in found.reading.remarks)
        assert near(found.radius(), 50.0)
    with pytest.raises(nsq_gpu.UsageError, match="give 'refuse' or 'remark'"):
        nsq_gpu.from_file(tmp_path / "lens.zmx", unknown="ignore")


def test_a_glass_that_is_not_found_is_taken_by_its_stated_numbers_where_the_user_says_so(tmp_path: Path) -> None:
    text = zmx(face=["GLAS LUMICERAZ 0 0 2.08 30.0"])
    with pytest.raises(nsq_gpu.UnsupportedSceneError, match="nd = 2.08"):
        read(tmp_path, "lens.zmx", text)
    found = read(tmp_path, "lens.zmx", text, unknown="remark")
    assert near(found.index(), 2.08, 1e-6)
    assert any("nd = 2.08" in remark for remark in found.reading.remarks)
    given = read(tmp_path, "lens.zmx", text, glasses={"lumiceraz": IdealMaterial(2.1)})
    assert given.index() == 2.1


def test_coatings_are_given_or_stand_beside_the_lens(tmp_path: Path) -> None:
    text = zmx(["COFN QF COATING.DAT"], ["COAT HALF"])
    assert "the coating HALF is not at hand" in "\n".join(read(tmp_path, "lens.zmx", text).reading.remarks)
    coating = SimpleCoating(0.25, 0.75)
    assert read(tmp_path, "lens.zmx", text, coatings={"half": coating}).surfaces[1].interaction_model.coating is coating
    (tmp_path / "COATING.DAT").write_text("! a table\nMATE X\nIDEAL HALF 0.4 0.6\n")
    found = read(tmp_path, "lens.zmx", text)
    made = found.surfaces[1].interaction_model.coating
    assert (number(made.transmittance), number(made.reflectance)) == (0.4, 0.6)
    assert not any("HALF" in remark for remark in found.reading.remarks)


@pytest.mark.parametrize("name", glasses._OTHERS)
def test_crystals_and_plastics_have_their_entries(name: str) -> None:
    entry = glasses._Entry(name, glasses._NO_CATALOGUE, glasses._OTHERS[name])
    assert 1.3 < glasses.index_of(glasses._material(entry), 0.5875618 if name not in ("GERMANIUM", "SILICON", "GAAS", "ZNSE") else 4.0) < 4.5


def test_each_glass_is_its_own_entry() -> None:
    # Optiland's search by names finds others for some of these.
    names = [entry for entries in glasses._entries().values() for entry in entries]
    assert len(names) > 1500
    for entry in random.Random(1).sample(names, 100):
        assert glasses._material(entry).filename.endswith(entry.filename)


@pytest.mark.parametrize("options", [{"glasses": {1: IdealMaterial(1.5)}}, {"glasses": ["a"]}, {"glasses": {"N-BK7": "SF6"}}, {"coatings": {"AR": 1}}],
                         ids=["number", "list", "name", "coating"])
def test_materials_and_coatings_are_optilands(options: Any, tmp_path: Path) -> None:
    with pytest.raises(nsq_gpu.UsageError, match="give a dictionary"):
        read(tmp_path, "lens.zmx", zmx(), **options)


def test_a_path_is_a_path() -> None:
    with pytest.raises(nsq_gpu.UsageError, match="give the path"):
        nsq_gpu.from_file(None)


@pytest.mark.parametrize(("row", "said"), [("IDEAL HALF nan 0.5", "no finite number"), ("IDEAL HALF -1 0.5", "no shares of light"),
                                           ("IDEAL HALF 0.9 0.9", "no shares of light"), ("IDEAL HALF", "is missing")])
def test_a_coating_that_is_none_is_refused_by_the_line_of_its_file(row: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "COATING.DAT").write_text(f"! a table\n{row}\n")
    with pytest.raises(nsq_gpu.UsageError, match=f"COATING.DAT:2: IDEAL: .*{said}"):
        read(tmp_path, "lens.zmx", zmx(["COFN QF COATING.DAT"], ["COAT HALF"]))


# The text


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1", "cp1252"])
@pytest.mark.parametrize("suffix", CORPUS)
def test_an_encoding_changes_nothing(suffix: str, encoding: str, tmp_path: Path) -> None:
    # The letter that is no ASCII stands beyond 8 KiB, where a reader that starts anew would double surfaces.
    filler = 200 * ["a line of a designer's remarks that a file may hold"]
    text = {".zmx": zmx(image=[*(f"NOTE 0 {line}" for line in filler), "COMM Bildfl\u00e4che"]),
            ".seq": seq(second=["S -50.0 45.0", *(f"! {line}" for line in filler), "  SLB 'Fl\u00e4che'"]),
            ".len": oslo_text(last=[*(f"// {line}" for line in filler), 'NOT "Fl\u00e4che"'])}[suffix]
    assert len(text) > 8192
    found = read(tmp_path, f"lens{suffix}", text.encode(encoding))
    assert len(found.surfaces) == 4
    assert near(found.radius(), 50.0)
    assert near(found.place(3)[2], 50.0)
    if suffix == ".seq":
        assert found.surfaces[2].comment == "Fl\u00e4che"


def test_what_is_no_text_is_refused(tmp_path: Path) -> None:
    for name, data in {"a.zmx": bytes(range(256)), "b.len": b"\x00\x01\x02" * 100, "c.seq": b"\xff\xfe\x00"}.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(nsq_gpu.UsageError, match="no text"):
            nsq_gpu.from_file(tmp_path / name)


def test_what_is_no_lens_says_what_to_call_instead(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, folder = tmp_path / "scene.json", tmp_path / "lenses"
    lens = tmp_path / "lens.zmx"
    lens.write_text(zmx())
    assert main([str(lens), "-o", str(scene)]) == 0
    folder.mkdir()
    shutil.copy(lens, folder / "triplet.zmx")
    other = tmp_path / "lens.zar"
    other.write_text("x")
    (tmp_path / "list.json").write_text("[1, 2]")
    (tmp_path / "deep.json").write_text(200_000 * "[")
    for path, said in ((scene, "nsq_gpu.load_scene"), (folder, "such as .*triplet.zmx"), (other, "unpack the archive"), (tmp_path / "list.json", "as an optic"), (tmp_path / "deep.json", "no JSON"),
                       (tmp_path / "none.zmx", "no such file")):
        with pytest.raises(nsq_gpu.UsageError, match=said):
            nsq_gpu.from_file(path)
        assert main([str(path)]) == 2
    capsys.readouterr()


def test_the_scene_is_not_written_over_the_lens(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lens, link = tmp_path / "lens.zmx", tmp_path / "link.json"
    lens.write_bytes(zmx().encode())
    link.symlink_to(lens)
    for output in (lens, link, tmp_path / "." / "lens.zmx"):
        assert main([str(lens), "-o", str(output)]) == 2
        assert "written over the lens" in capsys.readouterr().err
    assert lens.read_bytes() == zmx().encode()


def test_the_command_prints_what_was_not_carried(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lens = tmp_path / "lens.zmx"
    lens.write_text(zmx(["UNIT IN", "HYPR 0", "XYZW 1"], ["COAT AR", "MIRR 2 0", "POPS 0 0"]))
    assert main([str(lens)]) == 0
    said = capsys.readouterr().out
    for part in ("lens.zmx:2: UNIT: lengths are multiplied by 25.4", "XYZW: the card is unknown, and was left out", "the coating AR is not at hand",
                 "Cards skipped, without meaning for light: HYPR, MIRR, POPS", "Glass N-BK7: N-BK7 of schott, nd = 1.51680"):
        assert part in said
    lens.write_text(zmx(face=["XYZW 1"]))
    assert main([str(lens)]) == 3
    assert re.search(r"lens\.zmx:\d+: surface 1: XYZW: the card is unknown", capsys.readouterr().err)
    assert main([str(lens), "--unknown", "remark"]) == 0


# What the light does


def through(scene: Any, num_rays: int = 40_000) -> float:
    """Return the share of the light that reaches the image."""
    with live.quiet():
        result = scene.trace(num_rays, seed=1, max_depth=32, backend=live.backend(precision="f64"))
    return float(result.detectors["image"].total_flux) / sum(float(source.total_flux) for source in scene.sources)


def scene_of(folder: Path, name: str, text: str, **options: Any) -> Any:
    (folder / name).write_text(text)
    with live.quiet():
        return nsq_gpu.from_file(folder / name, **options)


@pytest.mark.parametrize(("face", "share"), [
    (["OBSC 0 2.5 0"], 1.0 - 0.25), (["CLAP 2.5 4 0"], 0.64 - 0.25), (["SQOB 1 2 0"], 1.0 - 8.0 / (25.0 * np.pi)), (["ELAP 4 2 0"], 8.0 / 25.0),
    (["DIAM 2.5 1 0 0 1"], 0.25), (["SPID 0.5 4 0"], 1.0 - (4.0 * 0.5 * 5.0 - 3.0 * 0.25) / (25.0 * np.pi))], ids=lambda value: str(value))
def test_apertures_and_obscurations_leave_the_share_of_their_area(face: list[str], share: float, tmp_path: Path) -> None:
    whole = through(scene_of(tmp_path, "whole.zmx", zmx(["FTYP 0 0 1 1"])))
    assert through(scene_of(tmp_path, "lens.zmx", zmx(["FTYP 0 0 1 1"], face))) / whole == pytest.approx(share, abs=0.01)


@pytest.mark.parametrize(("lines", "absorbed"), [
    (["CLAP 0 6 0"], 0.0), (["OBSC 0 2.5 0"], 0.25), (["SQOB 1 1 0"], 4.0 / (25.0 * np.pi)), (["CLAP 2.5 6 0"], 0.0)], ids=lambda value: str(value))
def test_an_obscuration_of_a_mirror_absorbs_and_a_hole_lets_light_through(lines: list[str], absorbed: float, tmp_path: Path) -> None:
    # A mirror at 45 degrees, so that its image stands beside the light.
    mirror = ["STOP", "TYPE STANDARD", "CURV 0", "DISZ 0", "GLAS MIRROR", *lines]
    fold = ["TYPE COORDBRK", "PARM 3 45", "DISZ 0"]
    rows = [*(line for name, line in {**dict(ZEMAX_HEADER), "FTYP": "FTYP 0 0 1 1"}.items())]
    for index, own in enumerate([["CURV 0", "DISZ INFINITY"], ["CURV 0", "DISZ 20"], fold, mirror, [*fold[:2], "DISZ -30"], ["CURV 0", "DISZ 0"]]):
        rows += [f"SURF {index}", *(f"  {line}" for line in own)]
    scene = scene_of(tmp_path, "lens.zmx", "\n".join(rows))
    with live.quiet():
        result = scene.trace(20_000, seed=1, backend=live.backend(precision="f64"))
    # The beam is a circle across the axis, and an ellipse on the mirror.
    share = float(result.num_rays_absorbed) / 20_000
    assert share == pytest.approx(absorbed * np.cos(np.pi / 4.0), abs=0.01) if absorbed else share == 0.0


def test_vignetting_moves_and_narrows_the_beam(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, "lens.zmx", zmx(["VDYN 0 0.2", "VCYN 0 0.3", "VCXN 0 0.1"]))
    plain = scene_of(tmp_path, "plain.zmx", zmx())
    assert np.allclose(scene.sources[1].beam_radii, (4.5, 3.5))
    assert number(scene.sources[1].cs.y) - number(plain.sources[1].cs.y) == pytest.approx(1.0, abs=1e-9)
    assert any("vignetting moves its pupil" in remark for remark in scene.conversion_report.remarks)
    # CODE V states what is cut above and below: from -0.9 to 0.6 of the radius.
    scene = scene_of(tmp_path, "lens.seq", seq(["VUY 0 0.4", "VLY 0 0.1"]))
    plain = scene_of(tmp_path, "plain.seq", seq())
    assert np.allclose(scene.sources[1].beam_radii, (5.0, 5.0 * 0.75))
    assert number(scene.sources[1].cs.y) - number(plain.sources[1].cs.y) == pytest.approx(-0.15 * 5.0, abs=1e-9)


@pytest.mark.parametrize("aiming", ["RAIM 0 0 1 1", "RAIM 0 2 1 1"])
def test_vignetting_acts_at_the_stop_whether_rays_are_aimed_at_it_or_not(aiming: str, tmp_path: Path) -> None:
    # The stop stands 10 mm behind the lens; what passes it is measured, by rays of the scene's sources.
    text = zmx([aiming, "VDYN 0 0.2", "VCYN 0 0.3", "VCXN 0 0.1", "FTYP 0 0 2 1", "YFLN 0 1", "ENPD 4"], stop=[]).replace(
        "CURV -0.02\r\n  DISZ 45", "CURV -0.02\r\n  DISZ 10\r\nSURF 3\r\n  STOP\r\n  CURV 0\r\n  DISZ 35").replace(
        "SURF 3\r\n  CURV 0\r\n  DISZ 0", "SURF 4\r\n  CURV 0\r\n  DISZ 0")
    (tmp_path / "lens.zmx").write_text(text)
    optic, _ = lensfiles.read_lens(tmp_path / "lens.zmx")
    scene = scene_of(tmp_path, "lens.zmx", text)
    rim = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    starts, directions = scene.sources[1].local_rays(rim, np.full(4, 0.5875618))
    starts = starts + [number(getattr(scene.sources[1].cs, key)) for key in "xyz"]
    places = prescription.trace(optic, RealRays(*starts.T, *directions.T, np.ones(4), np.full(4, 0.5875618))).places[3]
    radius = prescription.trace(optic, RealRays(*np.array([[0.0, 2.0, -10.0]]).T, *np.array([[0.0, 0.0, 1.0]]).T, np.ones(1), np.full(1, 0.5875618))).places[3][0, 1]
    assert np.allclose(places[:2, 0], [0.9 * radius, -0.9 * radius], atol=0.01)
    assert np.allclose(places[2:, 1], [0.9 * radius, -0.5 * radius], atol=0.02)


def test_sources_stand_in_the_order_of_the_fields(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, "lens.zmx", zmx(["FTYP 0 0 3 1", "XFLN 0 0 0", "YFLN 10 0 -5", "FWGN 1 2 3"]))
    assert [source.total_flux for source in scene.sources] == [1.0, 2.0, 3.0]
    assert [round(float(np.degrees(np.arctan2(source.chief[1], source.chief[2]))), 6) for source in scene.sources] == [10.0, 0.0, -5.0]


def test_an_image_has_a_detector_whatever_its_aperture(tmp_path: Path) -> None:
    scene = scene_of(tmp_path, "lens.zmx", zmx(image=["CLAP 0 1 0"]))
    assert any("the image's aperture" in remark for remark in scene.conversion_report.remarks)


# Numbers of the file, by a reader of a few lines that knows no module of ours


def numbers_of_codev(text: str) -> list[tuple[float, float]] | None:
    """Return curvature and thickness [mm] of each surface of a .seq of radii in mm; None where more than SO, S and SI decides."""
    text = re.sub(r"'[^'\n]*'", "", text)
    if re.search(r"^\s*(RDY|CUY|THI|GLA|S\d|CYL|XTO|YTO|[XYZABC]DE|DAR|BEN|REV)|&|;(?!LEN)|\bDIM [^M]|['\"]", text, re.M | re.I):
        return None
    rows = [row.split("!")[0].split() for row in text.splitlines()]
    if not {("RDM;LEN",), ("DIM", "M")} <= {tuple(row[:2]) for row in rows} or any("PRV" in row for row in rows):
        return None
    surfaces = [row for row in rows if row and row[0].upper() in ("SO", "S", "SI")]
    try:
        numbers = [[float(word.replace(",", ".")) for word in row[1:3]] + [0.0, 0.0] for row in surfaces]
    except ValueError:
        return None
    found = [(1.0 / radius if radius else 0.0, thickness) for radius, thickness, *_ in numbers]
    # A file without SO has its object far away.
    found = found if surfaces and surfaces[0][0].upper() == "SO" else [(0.0, 0.0), *found]
    # The image's thickness is a defocus.
    return [*found[:-2], (found[-2][0], found[-2][1] + found[-1][1]), found[-1]] if len(found) > 2 else None


def numbers_of(text: str) -> list[tuple[float, float]] | None:
    """Return curvature and thickness [mm] of each surface of a .zmx of standard surfaces in mm; None where these do not decide."""
    found: list[tuple[float, float]] = []
    for row in text.splitlines():
        words = row.split()
        try:
            if words[:1] == ["SURF"]:
                found.append((0.0, 0.0))
            elif found and words[:1] == ["CURV"]:
                found[-1] = (float(words[1].replace(",", ".")), found[-1][1])
            elif found and words[:1] == ["DISZ"] and words[1] != "INFINITY":
                found[-1] = (found[-1][0], float(words[1].replace(",", ".")))
        except (ValueError, IndexError):
            return None
    return found


def mutated(text: str, chance: random.Random) -> str:
    """Return a text with one to three faults: a letter, a number or a line that is lost, doubled, moved or changed."""
    rows = text.splitlines()
    for _ in range(chance.randint(1, 3)):
        index = chance.randrange(len(rows))
        kind = chance.randrange(8)
        words = rows[index].split(" ")
        if kind == 0:
            del rows[index]
        elif kind == 1:
            rows.insert(index, rows[index])
        elif kind == 2:
            other = chance.randrange(len(rows))
            rows[index], rows[other] = rows[other], rows[index]
        elif kind == 3 and rows[index]:
            place = chance.randrange(len(rows[index]))
            rows[index] = rows[index][:place] + chance.choice("0159-.,eEXSQ \"'&!;\u00e4") + rows[index][place + 1:]
        elif kind == 4:
            rows[index] = " ".join(words[:-1])
        elif kind == 5:
            rows[index] += " " + chance.choice(["0", "-1", "1e400", "nan", "inf", "REFL", "7"])
        elif kind == 6:
            rows[index] = re.sub(r"-?\d+(\.\d+)?", chance.choice(["0", "-3", "1e9", "1e-9", "2.5", "99999999999"]), rows[index], count=1)
        else:
            del rows[index:]
        rows = rows or [""]
    return "\n".join(rows)


def mutants(suffix: str, count: int) -> list[str]:
    chance = random.Random(f"{suffix} 1")
    texts = [example.text for example in CORPUS[suffix] if example.right is not None]
    return [mutated(chance.choice(texts), chance) for _ in range(count)]


@pytest.mark.parametrize(("suffix", "part"), itertools.product(CORPUS, range(4)), ids=str)
def test_a_damaged_file_is_refused_by_its_line_or_is_the_lens_that_it_says(suffix: str, part: int, tmp_path: Path) -> None:
    refused = checked = 0
    for text in mutants(suffix, 680)[part::4]:
        try:
            with live.quiet():
                found = read(tmp_path, f"lens{suffix}", text)
        except nsq_gpu.NsqGpuError as error:
            refused += 1
            # A line, or what the file lacks as a whole.
            assert re.search(r"lens\.\w+:\d+: |cannot read it as a lens|RDM is not stated|no END|Optiland cannot make", str(error)), (str(error), text)
            continue
        assert all(np.isfinite(found.place(index)).all() for index in range(1, len(found.surfaces))), text
        wanted = None
        if suffix == ".zmx" and re.search(r"^UNIT MM", text, re.M) and not re.search(r"COORDBRK|TYPE", text):
            wanted = numbers_of(text)
            assert wanted is not None
        elif suffix == ".seq":
            wanted = numbers_of_codev(text)
        if wanted is not None:
            checked += 1
            assert len(wanted) == len(found.surfaces)
            z = 0.0
            for index, (curvature, thickness) in enumerate(wanted):
                assert near(found.radius(index) if curvature else 0.0, 1.0 / curvature if curvature else 0.0)
                if index > 0:
                    assert near(found.place(index)[2], z)
                    z += thickness
    assert refused > 20
    assert checked > 20 or suffix == ".len"


# Planted errors: the corpus must find each


MUTANTS = [
    (".zmx", zemax, '"IN": 25.4', '"IN": 1.0'),
    (".zmx", zemax, "reverse = parms.pop(6, 0.0) != 0.0", "reverse = parms.pop(6, 0.0) == 2.0"),
    (".zmx", zemax, "angles = [parms.pop(index, 0.0) for index in (3, 4, 5)]", "angles = [parms.pop(index, 0.0) for index in (4, 3, 5)]"),
    (".zmx", zemax, "position = position + rotation[:, 2] * thickness\n                continue", "continue"),
    (".zmx", zemax, "turned = parms.pop(1, 0.0) * self.unit or math.inf", "turned = parms.pop(2, 0.0) * self.unit or math.inf"),
    (".zmx", zemax, "self.unit ** (1 - step * (index + 1))", "self.unit"),
    (".zmx", zemax, '"stop_radius", size.number(0) * self.unit', '"stop_radius", 0.5 * size.number(0) * self.unit'),
    (".zmx", zemax, 'return all_but(shape) if card.name in ("OBSC", "SQOB", "ELOB") else shape', "return shape"),
    (".zmx", zemax, "(narrow_x, narrow_y), (shift_x, shift_y)", "(narrow_x, narrow_y), (0.0, 0.0)"),
    (".zmx", zemax, "found.aims_at_stop = mode != 0", "found.aims_at_stop = False"),
    (".zmx", zemax, "found.is_telecentric = kind.whole(1, 0) == 1", "found.is_telecentric = False"),
    (".zmx", zemax, "if size is not None and size.whole(1, 0) == 1 and has_power", "if False and has_power"),
    (".zmx", zemax, "terms = [(degree - j, j)", "terms = [(j, degree - j)"),
    (".zmx", zemax, "for index, value in enumerate(listed.numbers())}", "for index, value in enumerate(listed.numbers()[:1])}"),
    (".zmx", glasses, "if not distance((entry, material)) <= (_SPREAD", "if not 0.0 <= (_SPREAD"),
    (".zmx", glasses, 'if row["group"] in ("glass", "user")', 'if row["group"] in ("main", "user")'),
    (".seq", codev, "range(4, 22, 2)", "range(2, 20, 2)"),
    (".seq", codev, '"I": 25.4', '"I": 1.0'),
    (".seq", codev, "turned = tilted((-alpha, -beta, gamma))", "turned = tilted((alpha, beta, gamma))"),
    (".seq", codev, 'if kinds == ["DAR"]:', 'if kinds == ["DA"]:'),
    (".seq", codev, "behind = behind @ turned", "pass"),
    (".seq", codev, "return position + rotation @ turned.T @ (step - shift), rotation @ turned.T", "return position + rotation @ step, rotation"),
    (".seq", codev, "opening = both(opening, all_but(self._region(sizes[key])))", "opening = both(opening, self._region(sizes[key]))"),
    (".seq", codev, "for name in _DECENTERS[:3]", "for name in (*_DECENTERS[:2], 'XOD')"),
    (".seq", codev, "(0.5 * (edges[0][1] - edges[0][0]), 0.5 * (edges[1][1] - edges[1][0]))", "(0.0, 0.0)"),
    (".seq", codev, "position = position + rotation[:, 2] * surface.thickness\n                    surface.thickness = 0.0", "surface.thickness = 0.0"),
    (".seq", codev, 'surface.rotation = surface.rotation @ rotation_about(2, 90.0)', "pass"),
    (".seq", codev, '"FNO": ("image_na", 0.5 / value)', '"FNO": ("image_fno", value)'),
    (".len", oslo, '_check_left_out(data, reading)', "pass"),
    (".len", oslo, "glasses.find(reading, card, name)", "IdealMaterial(1.5)"),
]


def planted(module: ModuleType, old: str, new: str) -> ModuleType:
    """Return a module with an error in it."""
    text = Path(str(module.__file__)).read_text(encoding="utf-8")
    assert text.count(old) == 1, f"the text {old!r} stands {text.count(old)} times in {module.__name__}"
    made = ModuleType(module.__name__)
    made.__file__ = module.__file__
    # Dataclasses look up their module.
    sys.modules[f"{module.__name__}_planted"] = made
    made.__dict__.update(__name__=f"{module.__name__}_planted", IdealMaterial=IdealMaterial)
    exec(compile(text.replace(old, new), str(module.__file__), "exec"), made.__dict__)
    return made


@pytest.mark.parametrize(("suffix", "module", "old", "new"), MUTANTS, ids=[f"{number}" for number in range(len(MUTANTS))])
def test_planted_errors_are_found(suffix: str, module: ModuleType, old: str, new: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = planted(module, old, new)
    if module is glasses:
        monkeypatch.setattr(zemax, "glasses", made)
    else:
        monkeypatch.setitem(lensfiles._TEXT, suffix, made.read)
    failed = []
    for example in CORPUS[suffix]:
        try:
            with live.quiet():
                why = holds(example, suffix, tmp_path)
        except Exception as error:
            why = repr(error)
        failed += [example.card] if why else []
        if failed:
            break
    assert failed
