"""Live sources -> ``sources``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import optiland.backend as be
from optiland.nonsequential.scene import NSQScene
from optiland.nonsequential.sources.base import Spectrum
from optiland.nonsequential.sources.collimated import CollimatedSource
from optiland.nonsequential.sources.extended import ExtendedSource
from optiland.nonsequential.sources.point import PointSource

from nsq_gpu.export.materials import Media
from nsq_gpu.export.values import Json, coordinate_system, drop_gradient, number, numbers, optional, refuse_type, rows
from nsq_gpu.sources import Aim, PupilSource, RaySource, TabulatedSource, is_of_its_lumens


def spectra(scene: NSQScene) -> list[Json]:
    """Return the spectrum of every source."""
    return [_spectrum(source.spectrum, f"source {name!r}")
            for name, source in zip(scene.source_names, scene.sources, strict=True)]


def _spectrum(spectrum: Any, place: str) -> Json:
    if type(spectrum) is not Spectrum:
        raise refuse_type(place, "its spectrum", spectrum, "optiland's Spectrum")
    drop_gradient(spectrum.weights, f"{place}: weights", "which line a ray has is drawn")
    return {"wavelengths": numbers(spectrum.wavelengths, f"{place}: wavelengths"),
            "weights": numbers(be.to_numpy(spectrum.weights), f"{place}: weights")}


def sources(scene: NSQScene, media: Media) -> list[Json]:
    """Return every source, in order."""
    named = zip(scene.source_names, scene.sources, spectra(scene), strict=True)
    return [_source(name, source, spectrum, media) for name, source, spectrum in named]


def _source(name: str, source: Any, spectrum: Json, media: Media) -> Json:
    place = f"source {name!r}"
    kind = _KINDS.get(type(source))
    if kind is None:
        raise refuse_type(place, "it", source,
                          "a PointSource, CollimatedSource, ExtendedSource, PupilSource, RaySource or TabulatedSource")
    return {
        "type": kind[0],
        "name": name,
        "cs": coordinate_system(source.cs, place),
        "spectrum": spectrum,
        **_flux(source, place),
        **kind[1](source, place),
        "medium": media.reference(source.medium, f"{place}: medium"),
    }


def _flux(source: Any, place: str) -> Json:
    """Return the flux in the unit that it was given in; the live ``total_flux`` is the truth."""
    if type(source) is TabulatedSource and source.is_of_its_table:
        return {}
    if type(source) is RaySource:
        if source.is_of_its_file:
            return {}
        key = "total_flux" if source.total_flux_lumens is None else "total_flux_lumens"
        return {key: number(getattr(source, key), f"{place}: {key}")}
    if is_of_its_lumens(source):
        return {"total_flux_lumens": number(source.total_flux_lumens, f"{place}: total_flux_lumens")}
    return {"total_flux": number(source.total_flux, f"{place}: total_flux")}


def _point(source: Any, place: str) -> Json:
    return {"half_angle_deg": number(source.half_angle_deg, f"{place}: half_angle_deg")}


def _collimated(source: Any, place: str) -> Json:
    return {
        "aperture_radius": number(source.aperture_radius, f"{place}: aperture_radius"),
        # Whatever is not "gaussian" is a top-hat to Optiland.
        "profile": "gaussian" if source.profile == "gaussian" else "tophat",
        "gaussian_sigma": number(source.gaussian_sigma, f"{place}: gaussian_sigma"),
    }


def _extended(source: Any, place: str) -> Json:
    return {
        "width": number(source.width, f"{place}: width"),
        "height": number(source.height, f"{place}: height"),
        "aperture_radius": optional(source.aperture_radius, f"{place}: aperture_radius"),
        "half_angle_deg": number(source.half_angle_deg, f"{place}: half_angle_deg"),
    }


def _pupil(source: Any, place: str) -> Json:
    written: Json = {key: numbers(np.asarray(getattr(source, key)), f"{place}: {key}") for key in ("beam_radii", "chief", "pupil_radii")}
    if source.aimed:
        written["aimed"] = [_aim(aim, f"{place}: aimed[{i}]") for i, aim in enumerate(source.aimed)]
    return written


def _tabulated(source: Any, place: str) -> Json:
    opening = {key: number(getattr(source, key), f"{place}: {key}") for key in ("width", "height", "radius")
               if getattr(source, key) is not None}
    return {
        "polar_angles_deg": numbers(source.polar_angles_deg, f"{place}: polar_angles_deg"),
        "azimuth_angles_deg": numbers(source.azimuth_angles_deg, f"{place}: azimuth_angles_deg"),
        "intensity": rows(source.intensity, f"{place}: intensity"),
        "intensity_units": source.intensity_units if source.is_of_its_table else "relative",
        **opening,
    }


def _rays(source: Any, place: str) -> Json:
    # Scenes are traced from folders of their own: the path is absolute.
    return {"file": source.file, "order": source.order, "scale": number(source.scale, f"{place}: scale")}


def _aim(aim: Any, place: str) -> Json:
    if type(aim) is not Aim:
        raise refuse_type(place, "it", aim, "nsq_gpu.sources.Aim")
    tables = {key: rows(getattr(aim, key), f"{place}: {key}") for key in ("x", "y", "vector_x", "vector_y")}
    return {"wavelength": number(aim.wavelength, f"{place}: wavelength"), **tables}


_KINDS: dict[type, tuple[str, Callable[[Any, str], Json]]] = {
    PointSource: ("point", _point),
    CollimatedSource: ("collimated", _collimated),
    ExtendedSource: ("extended", _extended),
    PupilSource: ("pupil", _pupil),
    TabulatedSource: ("tabulated", _tabulated),
    RaySource: ("rays", _rays),
}
