#!/usr/bin/env python3
"""Pack Optiland's material catalog for nsq-gpu, and write the oracle that its tests compare with.

    pip install optiland==0.6.3
    python python/tools/make_catalog.py            # writes src/scene/catalog.bin
    python python/tools/make_catalog.py --oracle   # writes tests/data/materials.json as well

Every name is resolved here, once, by the package itself, because its search (substring, edit distance, a sort that
keeps no order between equals) is not worth repeating elsewhere. Two runs with the same package, Python and zlib give
the same bytes. The data is refractiveindex.info's (CC0), as Optiland ships it.

Which entries are packed: every glass; every other entry without a table of more than MAX_ROWS rows; and, up to
MAX_DEFAULT_ROWS rows, those on the shelf of common crystals, metals, plastics and liquids and those that a category
name (`Ag`, `H2O`) resolves to. Entries that the package itself cannot evaluate are left out. A name that resolves to
an entry left out keeps its path and the reason, so that nsq-gpu can refuse it in plain words.

Layout of catalog.bin (a zlib stream; `u` is a LEB128 varint, `s` a zigzag varint, `text` is u bytes of UTF-8):

    references  u count, then text each
    entries     u count, then: text path, text title, text page, u reference, u kind,
                kind 0 (table):   numbers wavelengths [um], numbers n
                kind 1-9 (formula of that number): numbers range [um, um], numbers coefficients
                u extinction: 0 none; 1 numbers k on the wavelengths of n; 2 numbers wavelengths, numbers k
    omitted     u count, then: text path, u reason (0 too large, 1 no n, 2 refused by the package)
    names       u count, then: text name (distinct in lower case), u target (entries, then omitted), u 1 if the name is
                an entry's own name and 0 if the package's search found a near one, u count and u each: the other
                targets that match as well
    numbers     u count; if not 0: u form = 3 * (1 if each has an exponent of its own) + order of differences,
                the decimal exponents (one, or s differences of each), s differences of the integer mantissas.
                A value is the f64 nearest to mantissa * 10^exponent.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import re
import sys
import warnings
import zlib
from decimal import Decimal
from pathlib import Path

import numpy as np
import yaml
from optiland.materials import _material_matching, material_file
from optiland.materials.material_file import MaterialFile
from optiland.materials.registry import MaterialRegistry

ROOT = Path(__file__).resolve().parents[2]
CATALOG = ROOT / "src" / "scene" / "catalog.bin"
ORACLE = ROOT / "tests" / "data" / "materials.json"
DATA = Path(_material_matching._DATA_NK_DIR)

PACKAGE_VERSION = "0.6.3"
MAX_BYTES = 1_000_000
MAX_ROWS = 1000
MAX_DEFAULT_ROWS = 4000
COMMON_SHELF = "3d"
NAME_COLUMNS = ("category_name", "name", "filename_no_ext")

TOO_LARGE, NO_INDEX, REFUSED = range(3)

# What people call these; names that the package does not resolve drop out.
USUAL_SPELLINGS = """
fused silica; silica; quartz; crystal quartz; sapphire; alumina; calcite; rutile; diamond; graphite; graphene;
silicon; germanium; gallium arsenide; zinc selenide; zinc sulfide; cleartran; zinc oxide; magnesium fluoride;
calcium fluoride; barium fluoride; lithium fluoride; sodium chloride; potassium bromide; silver; gold; aluminum;
aluminium; copper; chromium; chrome; nickel; titanium; tungsten; platinum; iron; steel; stainless steel; brass;
bronze; mercury; silver chloride; water; heavy water; seawater; ice; air; vacuum; helium; nitrogen; oxygen; argon;
carbon dioxide; methane; ethanol; methanol; acetone; glycerol; glycerin; benzene; toluene; propanol; isopropanol;
ethylene glycol; immersion oil; pmma; acrylic; plexiglas; lucite; polycarbonate; pc; polystyrene; ps; styrene; coc;
cop; topas; zeonex; okp4; okp-4; ultem; pei; pet; petg; pdms; nylon; teflon; ptfe; cellulose; kapton; polyethylene;
pva; san; nas-21; cr-39; mylar; su-8; bk7; nbk7; n-bk7; k9; h-k9l; b270; b-270; borofloat; borofloat33; pyrex; 7740;
7980; soda lime; soda-lime; zerodur; ule; infrasil; suprasil; yag; yap; ylf; yvo4; bbo; lbo; ktp; kdp; adp;
linbo3; litao3; tio2; sio; sio2; si3n4; al2o3; zro2; hfo2; ta2o5; nb2o5; mgo; mgf2; caf2; baf2; lif; nacl; kbr; kcl;
csi; csbr; ito; zns; znse; znte; cds; cdse; cdte; gaas; gap; gan; inp; insb; inas; pbs; pbse; ge; si; c; ag; au; al;
cu; cr; ni; ti; w; pt; fe; hg; h2o; d2o; n2; o2; ar; he; co2; ch4; blood; skin; cornea; lens; colon; sf6; n-sf6; sf11
"""


class Packer:
    """Appends the primitives of the layout to a buffer."""

    def __init__(self) -> None:
        self.bytes = bytearray()

    def unsigned(self, value: int) -> None:
        while value >= 0x80:
            self.bytes.append(value & 0x7F | 0x80)
            value >>= 7
        self.bytes.append(value)

    def signed(self, value: int) -> None:
        self.unsigned(value * 2 if value >= 0 else -value * 2 - 1)

    def text(self, value: str) -> None:
        data = value.encode()
        self.unsigned(len(data))
        self.bytes += data

    def numbers(self, values) -> None:
        values = [float(value) for value in values]
        self.unsigned(len(values))
        if values:
            # The form that compresses best on its own is close enough to the best in the stream.
            self.bytes += min(number_forms(values), key=lambda data: len(zlib.compress(data, 9)))


def number_forms(values: list[float]):
    """Yield `values` in every form that is exact."""
    decimals = [decimal_parts(value) for value in values]
    lowest = min(exponent for _, exponent in decimals)
    shared = [mantissa * 10 ** (exponent - lowest) for mantissa, exponent in decimals]
    forms = [(1, [exponent for _, exponent in decimals], [mantissa for mantissa, _ in decimals])]
    if max(map(abs, shared)) < 2**53:
        forms.append((0, [lowest], shared))
    for own, exponents, mantissas in forms:
        check_exact(values, exponents, mantissas)
        for order in range(3):
            packer = Packer()
            packer.unsigned(3 * own + order)
            for value in differences(exponents, 1):
                packer.signed(value)
            for value in differences(mantissas, order):
                packer.signed(value)
            yield bytes(packer.bytes)


def decimal_parts(value: float) -> tuple[int, int]:
    """Shortest decimal of `value` as (mantissa, exponent), without trailing zeros."""
    sign, digits, exponent = Decimal(repr(value)).normalize().as_tuple()
    mantissa = int("".join(map(str, digits)))
    if mantissa == 0:
        return 0, 0
    return (-mantissa if sign else mantissa), exponent


def check_exact(values: list[float], exponents: list[int], mantissas: list[int]) -> None:
    """Stop if the decimals would not give the very same f64."""
    if len(exponents) == 1:
        exponents = exponents * len(values)
    for value, exponent, mantissa in zip(values, exponents, mantissas, strict=True):
        if abs(mantissa) >= 2**62 or float(f"{mantissa}e{exponent}") != value:
            sys.exit(f"{value!r} does not survive the packing")


def differences(values: list[int], order: int) -> list[int]:
    """Differences of the given order, each list starting from 0."""
    for _ in range(order):
        values = [value - before for before, value in zip([0, *values[:-1]], values, strict=True)]
    return values


def plain_text(html: str) -> str:
    """Text of a refractiveindex.info field, without markup and on one line."""
    text = re.sub(r"<br\s*/?>", " ", html)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", "", text)).strip()


def page_of(filename: str) -> str:
    return filename.removesuffix(".yml")


class Resolution:
    """What the package takes a name for."""

    def __init__(self, matches) -> None:
        best = matches["similarity_score"].iloc[0]
        self.filename = matches["filename"].iloc[0]
        self.exact = bool(best == 0)
        tied = set(matches.loc[matches["similarity_score"] == best, "filename"])
        self.others = sorted(tied - {self.filename})


def resolve(catalog, name: str) -> Resolution | None:
    """Search as `Material(name)` does: same frame, same function, first row."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            matches = _material_matching._find_matches(catalog, name, None, None, None)
    except re.error:  # The package reads a name as a regular expression.
        return None
    return None if matches.empty else Resolution(matches)


def candidate_names(catalog) -> dict[str, str]:
    """Names worth resolving: lower case, because the package's search ignores case, and as they are written."""
    names = {name for column in NAME_COLUMNS for name in catalog[column]}
    for text in {*catalog["category_name_full"], *catalog["name"]}:
        names.update(spellings_in_title(plain_text(text)))
    names = {name for name in names if len(name) > 1 or name in set(catalog["category_name"])}
    spellings = {}
    for name in [*sorted(names), *(spelling.strip() for spelling in USUAL_SPELLINGS.replace("\n", " ").split(";"))]:
        spellings.setdefault(name.lower(), name)
    return dict(sorted(spellings.items()))


def spellings_in_title(title: str) -> list[str]:
    """`Al2O3 (Aluminium sesquioxide, Sapphire)` gives its formula and both names."""
    match = re.fullmatch(r"([^()]+) \(([^()]+)\)", title)
    if not match:
        return []
    return [match[1].strip(), *(part.strip() for part in match[2].split(","))]


def load_material(filename: str) -> MaterialFile:
    return MaterialFile(str(DATA / filename))


def omission(filename: str, keep_large: bool, limit: int) -> tuple[int | None, MaterialFile | None]:
    """Why an entry is left out (None if it is packed), and the entry itself."""
    try:
        material = load_material(filename)
    except ValueError:
        return REFUSED, None
    if material._n_formula is None:
        return NO_INDEX, None
    try:
        material.n(np.array([1.0])), material.k(np.array([1.0]))
    except ValueError:
        return REFUSED, None
    rows = max(len(grid) if grid is not None else 0 for grid in (material._n_wavelength, material._k_wavelength))
    if rows > limit and not keep_large:
        return TOO_LARGE, None
    return None, material


def choose_entries(catalog, resolutions) -> tuple[dict[str, MaterialFile], dict[str, int]]:
    """Split the catalog into packed entries and omitted ones."""
    common = set(catalog.loc[catalog["group"] == COMMON_SHELF, "filename"])
    for category in set(catalog["category_name"]):
        resolution = resolutions.get(category.lower())
        if resolution:
            common.add(resolution.filename)
    packed, omitted = {}, {}
    for filename in sorted(set(catalog["filename"])):
        limit = MAX_DEFAULT_ROWS if filename in common else MAX_ROWS
        reason, material = omission(filename, filename.startswith("glass/"), limit)
        if material is None:
            omitted[filename] = reason
        else:
            packed[filename] = material
    return packed, omitted


def pack_entry(packer: Packer, filename: str, material: MaterialFile, row, reference: int) -> None:
    packer.text(page_of(filename))
    packer.text(plain_text(row["category_name_full"]))
    packer.text(plain_text(row["name"]))
    packer.unsigned(reference)
    if material._n_formula.startswith("formula "):
        packer.unsigned(int(material._n_formula.split()[1]))
        packer.numbers(material._formula_wavelength_range)
        packer.numbers(np.ravel(material.coefficients))
    else:
        packer.unsigned(0)
        packer.numbers(material._n_wavelength)
        packer.numbers(material._n)
    pack_extinction(packer, material)


def pack_extinction(packer: Packer, material: MaterialFile) -> None:
    if material._k is None:
        packer.unsigned(0)
    elif material._n_wavelength is not None and np.array_equal(material._n_wavelength, material._k_wavelength):
        packer.unsigned(1)
        packer.numbers(material._k)
    else:
        packer.unsigned(2)
        packer.numbers(material._k_wavelength)
        packer.numbers(material._k)


def source_of(filename: str) -> str:
    with open(DATA / filename, encoding="utf-8") as stream:
        return plain_text(str(load_yaml(stream).get("REFERENCES", "")))


def pack(catalog, spellings, resolutions, packed, omitted) -> bytes:
    packer = Packer()
    sources = {filename: source_of(filename) for filename in packed}
    references = sorted(set(sources.values()))
    packer.unsigned(len(references))
    for reference in references:
        packer.text(reference)
    rows = catalog.drop_duplicates("filename").set_index("filename")
    packer.unsigned(len(packed))
    for filename, material in packed.items():
        pack_entry(packer, filename, material, rows.loc[filename], references.index(sources[filename]))
    packer.unsigned(len(omitted))
    for filename, reason in omitted.items():
        packer.text(page_of(filename))
        packer.unsigned(reason)
    targets = {filename: index for index, filename in enumerate([*packed, *omitted])}
    packer.unsigned(len(resolutions))
    for name, resolution in resolutions.items():
        packer.text(spellings[name])
        packer.unsigned(targets[resolution.filename])
        packer.unsigned(int(resolution.exact))
        packer.unsigned(len(resolution.others))
        for other in resolution.others:
            packer.unsigned(targets[other])
    return zlib.compress(bytes(packer.bytes), 9)


def load_yaml(stream):
    """What `yaml.safe_load` returns, ten times faster where libyaml is there."""
    return yaml.load(stream, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))


# Names that the oracle always holds: the examples of the documentation, and each formula that occurs.
ORACLE_NAMES = "n-bk7 bk7 sf6 sio2 h2o au ag al caf2 znse n-sf11 pmma acrylic water b270".split()


def oracle(resolutions, packed) -> dict:
    """n and k from the package's own entry point for a seeded random sample of names and wavelengths."""
    from optiland.nonsequential.materials.nsq_material import NSQMaterial

    generator = random.Random(20_240_601)
    known = [name for name, resolution in resolutions.items() if resolution.filename in packed]
    chosen = [name for name in ORACLE_NAMES if name in known]
    for kind in sorted({material._n_formula for material in packed.values()}):
        chosen.append(next(name for name in known if packed[resolutions[name].filename]._n_formula == kind))
    chosen += generator.sample(known, 500)
    cases = []
    for name in dict.fromkeys(chosen):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            material = NSQMaterial.from_glass(name)
        file = material.optiland_material
        wavelengths = oracle_wavelengths(file, generator)
        cases.append(
            {
                "name": name,
                "entry": page_of(Path(file.filename).relative_to(DATA).as_posix()),
                "ambiguous": bool(resolutions[name].others) or not resolutions[name].exact,
                "wavelengths": wavelengths,
                "n": finite(material.n(np.array(wavelengths))),
                "k": finite(material.k(np.array(wavelengths))),
            }
        )
    return {"optiland": PACKAGE_VERSION, "cases": cases}


def oracle_wavelengths(file: MaterialFile, generator: random.Random) -> list[float]:
    """Both ends of the range, four wavelengths within it and one beyond either end [um]."""
    low, high = file.spectral_range("n")
    inside = [generator.uniform(low, high) for _ in range(4)]
    return [low, high, *inside, low * generator.uniform(0.8, 1.0), high * generator.uniform(1.0, 1.2)]


def finite(values) -> list[float | None]:
    """A formula may have no real value outside its range: JSON says null."""
    return [float(value) if math.isfinite(value) else None for value in values]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--oracle", action="store_true", help="write tests/data/materials.json as well")
    arguments = parser.parse_args()
    from importlib.metadata import version

    if version("optiland") != PACKAGE_VERSION:
        sys.exit(f"the catalog is pinned to optiland {PACKAGE_VERSION}; this is {version('optiland')}")
    registry = MaterialRegistry.instance()
    if registry._user_entries:
        sys.exit("catalogs of your own are registered with Optiland: they would end up in the file")
    material_file.yaml.safe_load = load_yaml
    catalog = registry._get_combined_df()
    spellings = candidate_names(catalog)
    found = {name: resolve(catalog, name) for name in spellings}
    resolutions = {name: resolution for name, resolution in found.items() if resolution}
    packed, omitted = choose_entries(catalog, resolutions)
    data = pack(catalog, spellings, resolutions, packed, omitted)
    if len(data) >= MAX_BYTES:
        sys.exit(f"{len(data)} bytes: over the budget of {MAX_BYTES}; lower MAX_ROWS")
    CATALOG.write_bytes(data)
    report(data, resolutions, packed, omitted)
    if arguments.oracle:
        cases = oracle(resolutions, packed)
        lines = ",\n".join(json.dumps(case) for case in cases["cases"])
        ORACLE.write_text(f'{{"optiland": "{cases["optiland"]}", "cases": [\n{lines}\n]}}\n', encoding="utf-8")


def report(data: bytes, resolutions, packed, omitted) -> None:
    several = sum(1 for resolution in resolutions.values() if resolution.exact and resolution.others)
    near = sum(1 for resolution in resolutions.values() if not resolution.exact)
    lost = sum(1 for resolution in resolutions.values() if resolution.filename in omitted)
    reasons = [list(omitted.values()).count(reason) for reason in (TOO_LARGE, NO_INDEX, REFUSED)]
    print(f"{len(data)} bytes; {len(packed)} entries; omitted (too large, no index, refused): {reasons}")
    print(f"{len(resolutions)} names: {several} match several entries, {near} none exactly, {lost} omitted entries")


if __name__ == "__main__":
    main()
