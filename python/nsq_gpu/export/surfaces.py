"""Live surfaces -> ``nsq_gpu.surfaces``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from optiland.coatings import BaseCoating, BaseCoatingPolarized, SimpleCoating
from optiland.nonsequential.bsdf import HarveyShackBSDF, LambertianBSDF, SpecularBRDF, TabulatedBSDF
from optiland.nonsequential.components.absorbing import AbsorbingComponent
from optiland.nonsequential.components.base import BaseComponent
from optiland.nonsequential.components.geometry.analytic.annulus import AnnularPlaneGeometry
from optiland.nonsequential.components.geometry.analytic.conic import ConicGeometry, ParaboloidGeometry
from optiland.nonsequential.components.geometry.analytic.frustum import CylindricalFrustumGeometry
from optiland.nonsequential.components.geometry.analytic.plane import FinitePlaneGeometry, PlaneGeometry
from optiland.nonsequential.components.geometry.analytic.sphere import SphereGeometry
from optiland.nonsequential.components.geometry.mesh.mesh_geometry import MeshGeometry
from optiland.nonsequential.components.reflective import ReflectiveComponent
from optiland.nonsequential.components.refractive import RefractiveComponent

from nsq_gpu.bsdf import KCorrelation, MeasuredBSDF
from nsq_gpu.coatings import TabulatedCoating
from nsq_gpu.export.materials import Media
from nsq_gpu.export.values import Json, coordinate_system, number, numbers, optional, radius, refuse, refuse_type, rows
from nsq_gpu.shapes import (
    Aperture,
    Biconic,
    Chebyshev,
    ClippedConic,
    EvenAsphere,
    OddAsphere,
    Polynomial,
    Toroidal,
    Zernike,
)

INTERACTIONS: dict[type, str] = {
    RefractiveComponent: "refractive",
    ReflectiveComponent: "reflective",
    AbsorbingComponent: "absorbing",
}


def surface(component: BaseComponent, label: str, media: Media) -> Json:
    """Return a live surface as a single surface of the file."""
    place = f"surface {label!r}"
    interaction = INTERACTIONS.get(type(component))
    if interaction is None:
        raise refuse_type(place, "it", component, "a refractive, reflective or absorbing component of Optiland")
    document: Json = {
        "name": label,
        "cs": coordinate_system(component.cs, place),
        "shape": shape(component.geometry, place),
        "interaction": interaction,
        "material_front": media.reference(component.material_front, place),
    }
    if isinstance(component, RefractiveComponent):
        document["material_back"] = media.reference(component.material_back, place)
        _add(document, "coating", coating(component.coating, media, place))
    if isinstance(component, ReflectiveComponent):
        if type(component.reflectance) is TabulatedCoating:
            document["coating"] = _tabulated_coating(component.reflectance)
        else:
            document["reflectance"] = reflectance(component.reflectance, media, f"{place}: reflectance")
    _add(document, "bsdf", bsdf(component.bsdf, place))
    scatter_fraction = number(component.scatter_fraction, f"{place}: scatter_fraction")
    _add(document, "scatter_fraction", None if scatter_fraction == 1.0 else scatter_fraction)
    return document


def _add(document: Json, key: str, value: Any) -> None:
    if value is not None:
        document[key] = value


# Shapes


def _conic(geometry: Any, place: str) -> Json:
    return {"type": "conic", "radius": radius(geometry.radius, f"{place}: radius"),
            "conic": number(geometry.conic, f"{place}: conic"),
            "aperture_radius": number(geometry.aperture_radius, f"{place}: aperture_radius")}


def _clipped_conic(geometry: Any, place: str) -> Json:
    return {**_conic(geometry, place), "type": "clipped_conic", "aperture": _aperture(geometry.aperture, place)}


def _aperture(aperture: Any, place: str) -> Json:
    if type(aperture) is not Aperture:
        raise refuse_type(place, "its aperture", aperture, "nsq_gpu.shapes.Aperture")
    place = f"{place}: aperture"
    if aperture.outline == "polygon":
        own: Json = {"vertices": rows(aperture.vertices, f"{place}: vertices")}
    elif aperture.outline in ("union", "intersection", "difference"):
        own = {"parts": [_aperture(part, f"{place}: parts[{i}]") for i, part in enumerate(aperture.parts)]}
    else:
        own = _numbers_of(aperture, ("semi_axis_x", "semi_axis_y", "x", "y", "hole_radius"), place)
    return {"outline": aperture.outline, **own, "inverted": bool(aperture.inverted)}


def _even_asphere(geometry: Any, place: str) -> Json:
    coefficients = [number(value, f"{place}: coefficients[{i}]") for i, value in enumerate(geometry.coefficients)]
    return {**_conic(geometry, place), "type": "even_asphere", "coefficients": coefficients}


def _odd_asphere(geometry: Any, place: str) -> Json:
    return {**_even_asphere(geometry, place), "type": "odd_asphere"}


def _biconic(geometry: Any, place: str) -> Json:
    radii = {key: radius(getattr(geometry, key), f"{place}: {key}") for key in ("radius_x", "radius_y")}
    return {"type": "biconic", **radii, **_numbers_of(geometry, ("conic_x", "conic_y", "aperture_radius"), place)}


def _toroidal(geometry: Any, place: str) -> Json:
    radii = {key: radius(getattr(geometry, key), f"{place}: {key}") for key in ("radius_x", "radius_y")}
    coefficients = [number(value, f"{place}: coeffs_poly_y[{i}]") for i, value in enumerate(geometry.coeffs_poly_y)]
    return {"type": "toroidal", **radii, **_numbers_of(geometry, ("conic", "aperture_radius"), place), "coeffs_poly_y": coefficients}


def _polynomial(geometry: Any, place: str) -> Json:
    return {**_conic(geometry, place), "type": "polynomial", "coefficients": rows(geometry.coefficients, f"{place}: coefficients")}


def _chebyshev(geometry: Any, place: str) -> Json:
    return {**_polynomial(geometry, place), "type": "chebyshev", **_numbers_of(geometry, ("norm_x", "norm_y"), place)}


def _zernike(geometry: Any, place: str) -> Json:
    return {**_even_asphere(geometry, place), "type": "zernike", "zernike_type": geometry.zernike_type,
            **_numbers_of(geometry, ("norm_radius",), place)}


def _unlimited_plane(geometry: Any, place: str) -> Json:
    return {"type": "plane"}


def _plane(geometry: Any, place: str) -> Json:
    if geometry.aperture_radius is not None:
        return {"type": "plane", "aperture_radius": number(geometry.aperture_radius, f"{place}: aperture_radius")}
    return {"type": "plane", **_numbers_of(geometry, ("width", "height"), place)}


def _annulus(geometry: Any, place: str) -> Json:
    return {"type": "annulus", **_numbers_of(geometry, ("inner_radius", "outer_radius", "z_offset"), place)}


def _frustum(geometry: Any, place: str) -> Json:
    return {"type": "frustum", **_numbers_of(geometry, ("r_front", "r_back", "z_front", "z_back"), place)}


def _sphere(geometry: Any, place: str) -> Json:
    return {"type": "sphere", "radius": number(geometry.radius, f"{place}: radius"),
            "aperture_radius": optional(geometry.aperture_radius, f"{place}: aperture_radius")}


def _mesh(geometry: Any, place: str) -> Json:
    vertices = np.asarray(geometry.mesh.vertices, dtype=np.float64)
    if not np.isfinite(vertices).all():
        raise refuse(f"{place}: vertices", "some are not finite", "give finite vertices")
    return {"type": "mesh", "vertices": vertices.tolist(),
            "faces": np.asarray(geometry.mesh.faces, dtype=np.int64).tolist()}


def _numbers_of(geometry: Any, keys: tuple[str, ...], place: str) -> Json:
    return {key: number(getattr(geometry, key), f"{place}: {key}") for key in keys}


SHAPES: dict[type, Callable[[Any, str], Json]] = {
    ConicGeometry: _conic,
    ParaboloidGeometry: _conic,
    ClippedConic: _clipped_conic,
    EvenAsphere: _even_asphere,
    OddAsphere: _odd_asphere,
    Biconic: _biconic,
    Toroidal: _toroidal,
    Polynomial: _polynomial,
    Chebyshev: _chebyshev,
    Zernike: _zernike,
    PlaneGeometry: _unlimited_plane,
    FinitePlaneGeometry: _plane,
    AnnularPlaneGeometry: _annulus,
    CylindricalFrustumGeometry: _frustum,
    SphereGeometry: _sphere,
    MeshGeometry: _mesh,
}


def shape(geometry: Any, place: str) -> Json:
    """Return a shape."""
    write = SHAPES.get(type(geometry))
    if write is None:
        raise refuse_type(place, "its shape", geometry,
                          "a conic, plane, annulus, frustum, sphere or mesh of Optiland, or a shape of nsq_gpu.shapes")
    written = write(geometry, place)
    if "aperture" not in written and getattr(geometry, "aperture", None) is not None:
        written["aperture"] = _aperture(geometry.aperture, place)
    return written


# What happens at a surface


def reflectance(value: Any, media: Media, place: str) -> float | Json:
    """Return a reflectance: a number, or a table over the wavelengths where it is a function or varies."""
    if isinstance(value, BaseCoating):
        return number(_simple(value, place).reflectance, place)
    if not callable(value):
        return number(value, place)
    values = media.table(value(media.wavelength_array()), place)
    return {"wavelengths": media.wavelengths, "values": values}


def coating(value: Any, media: Media, place: str) -> Json | None:
    """Return the coating of a refractive surface."""
    if value is None:
        return None
    if type(value) is TabulatedCoating:
        return _tabulated_coating(value)
    place = f"{place}: coating"
    simple = _simple(value, place)
    return {"type": "simple", "reflectance": number(simple.reflectance, f"{place}: reflectance"),
            "transmittance": number(simple.transmittance, f"{place}: transmittance")}


def _tabulated_coating(value: TabulatedCoating) -> Json:
    return {"type": "tabulated", "wavelengths": value.wavelengths_um.tolist(), "angles": value.angles_deg.tolist(),
            "reflectance": value.R.tolist(), "transmittance": value.T.tolist(),
            "reflectance_back": value.R_back.tolist(), "transmittance_back": value.T_back.tolist()}


def _simple(value: Any, place: str) -> SimpleCoating:
    if isinstance(value, BaseCoatingPolarized):
        raise refuse(place, f"a {type(value).__name__} is polarised, and rays carry no polarisation",
                     "use nsq_gpu.coatings.TabulatedCoating.from_coating, a SimpleCoating, a number or a function of the wavelength")
    if type(value) is not SimpleCoating:
        raise refuse_type(place, "it", value, "a SimpleCoating or nsq_gpu.coatings.TabulatedCoating")
    return value


def _lambertian(model: Any, place: str) -> Json:
    return {"type": "lambertian", "reflectance_value": number(model.reflectance_value, f"{place}: reflectance_value")}


def _harvey_shack(model: Any, place: str) -> Json:
    return {"type": "harvey_shack", **_numbers_of(model, ("b0", "l0", "s"), place)}


def _k_correlation(model: Any, place: str) -> Json:
    return {"type": "k_correlation", **_numbers_of(model, ("b0", "B", "s"), place)}


def _tabulated(model: Any, place: str) -> Json:
    # The values that are sampled, not the file that they came from, which may have changed since.
    theta_i, theta_s = (numbers(axis, f"{place}: {name}")
                        for axis, name in zip(model._interp.grid, ("theta_i", "theta_s"), strict=True))
    rows = [numbers(row, f"{place}: bsdf") for row in np.asarray(model._interp.values)]
    return {"type": "tabulated", "theta_i": theta_i, "theta_s": theta_s, "bsdf": rows}


def _measured(model: Any, place: str) -> Json:
    axes = ("angle_of_incidence_deg", "scatter_azimuth_deg", "scatter_radial_deg")
    tis = {} if model.given_tis is None else {"tis": model.given_tis.tolist()}
    return {"type": "measured", "scatter_type": model.scatter_type, **{axis: getattr(model, axis).tolist() for axis in axes},
            "values": model.values.tolist(), **tis}


BSDFS: dict[type, Callable[[Any, str], Json]] = {
    LambertianBSDF: _lambertian,
    HarveyShackBSDF: _harvey_shack,
    KCorrelation: _k_correlation,
    TabulatedBSDF: _tabulated,
    MeasuredBSDF: _measured,
}


def bsdf(model: Any, place: str) -> Json | None:
    """Return a scatter model."""
    if model is None:
        return None
    place = f"{place}: bsdf"
    if type(model) is SpecularBRDF:
        return {"type": "specular"}
    write = BSDFS.get(type(model))
    if write is None:
        raise refuse_type(place, "it", model, "LambertianBSDF, HarveyShackBSDF, TabulatedBSDF, SpecularBRDF or a law of nsq_gpu.bsdf")
    if type(model) is MeasuredBSDF:
        # Its scatter_type has the side.
        return write(model, place)
    fraction = number(model.transmissive_fraction, f"{place}: transmissive_fraction")
    return {**write(model, place), "transmissive_fraction": fraction}
