//! Shapes of surfaces: the list of them, and what each must say of itself.
//!
//! Each shape stands in one file here, and its distance function in one file of shaders/shapes/. docs/adding-a-kind.md
//! says how to add one. Everything is said in the shape's own frame, whose axis is z: lengths in mm.

pub mod annulus;
pub mod aperture;
pub mod biconic;
pub mod chebyshev;
pub mod clipped_conic;
pub mod conic;
pub mod even_asphere;
mod extent;
pub mod freeform;
pub mod frustum;
pub mod mesh;
pub mod odd_asphere;
pub mod plane;
pub mod polynomial;
pub mod profile;
mod quadric;
#[cfg(test)]
mod roof;
mod sag;
pub mod sphere;
pub mod toroidal;
pub mod zernike;

pub use crate::model::shapes::annulus::Annulus;
pub use crate::model::shapes::aperture::{Aperture, Axes};
pub use crate::model::shapes::biconic::Biconic;
pub use crate::model::shapes::clipped_conic::ClippedConic;
pub use crate::model::shapes::conic::Conic;
pub use crate::model::shapes::extent::{Across, Extent};
pub use crate::model::shapes::freeform::Freeform;
pub use crate::model::shapes::frustum::Frustum;
pub use crate::model::shapes::mesh::MeshId;
pub use crate::model::shapes::plane::Outline;
pub use crate::model::shapes::profile::AsphereProfile;
pub use crate::model::shapes::quadric::{Level, Quadric};
pub use crate::model::shapes::sag::{Bounds, Sag, SagSurface};
pub use crate::model::shapes::sphere::Sphere;
pub use crate::model::shapes::toroidal::Toroidal;

use crate::Result;
use crate::model::list::kinds;
use crate::model::mesh::Mesh;
use crate::shaders::ShaderFile;
use glam::{DVec2, DVec3};
use std::f64::consts::{PI, TAU};

kinds! {
    Shape: Geometry,
    functions ShapeKind: ShapeWgsl,
    /// A shape as a scene file gives it, by its `type`. The geometric normal points local +z for conic, plane and
    /// annulus, inward for a sphere, outward for a frustum, and along the face normal for a mesh.
    written "Shape": WrittenShape;
    /// A conic of revolution.
    Conic(conic::Conic) by Conic = CONIC;
    /// A plane: a rectangle by width and height, a disk by aperture_radius, or unlimited.
    Plane(plane::Outline) by Plane = PLANE, Rectangle = RECTANGLE, Disk = DISK;
    /// A flat ring.
    Annulus(annulus::Annulus) by Annulus = ANNULUS;
    /// A cone or a cylinder without its ends.
    Frustum(frustum::Frustum) by Frustum = FRUSTUM;
    /// A sphere about the local origin.
    Sphere(sphere::Sphere) by Sphere = SPHERE;
    /// A triangle mesh: from a file, or vertices and faces.
    Mesh(mesh::MeshId) by Mesh = MESH;
    /// A conic within an aperture that need be neither round nor on the axis.
    ClippedConic(clipped_conic::ClippedConic) by ClippedConic = CLIPPED_CONIC;
    /// A conic and even powers of the distance from the axis.
    EvenAsphere(even_asphere::EvenAsphere) by EvenAsphere = EVEN_ASPHERE;
    /// A conic and all powers of the distance from the axis.
    OddAsphere(odd_asphere::OddAsphere) by OddAsphere = ODD_ASPHERE;
    /// Two conic profiles, one along x and one along y, whose heights add up.
    Biconic(biconic::BiconicSurface) by Biconic = BICONIC;
    /// A profile along y, turned about an axis parallel to y.
    Toroidal(toroidal::ToroidalSurface) by Toroidal = TOROIDAL;
    /// A conic and a polynomial of x and y.
    Polynomial(polynomial::FreeformSurface) by Freeform = FREEFORM;
    /// A conic and products of Chebyshev polynomials of x and y.
    Chebyshev(chebyshev::FreeformSurface);
    /// A conic and Zernike polynomials.
    Zernike(zernike::FreeformSurface);
    /// A roof: the example of docs/adding-a-kind.md, which is no quadric.
    #[cfg(test)]
    Roof(roof::Roof) by #[cfg(test)] Roof = ROOF;
}

/// What the shaders have of a shape.
#[derive(Debug)]
pub struct ShapeWgsl {
    /// Its functions begin with this name. All shapes have `<name>_distance(o, d, arguments, leaving) -> real`, the
    /// distance from o along d to the first crossing, or MISS. All have `<name>_holds(p, arguments) -> bool`, true if a
    /// point of the surface without its limits belongs to the shape.
    pub name: &'static str,
    /// The file that holds them.
    pub file: ShaderFile,
    /// How many numbers [`Geometry::arguments`] gives.
    pub num_arguments: usize,
    /// Where its normal comes from.
    pub normal: Normal,
}

/// Where the shaders take a normal from, and whether a ray was born on the shape.
#[derive(Debug)]
pub enum Normal {
    /// From the quadric: the expression that makes a `Quadric` of the arguments, which are WGSL as well.
    Quadric(fn(&[&str]) -> String),
    /// From the facet that was hit.
    Facet,
    /// From the shape's own functions. `<name>_normal(p, arguments) -> vec3<real>` is the unit normal at a point of the
    /// shape. `<name>_height(p, arguments) -> real` is the signed distance of a point from the shape to first order
    /// \[mm\].
    Own,
    /// As of [`Normal::Own`], for a shape whose distance function finds its crossings by shaders/geometry/sag.search.wgsl.
    Sag,
}

/// What the program, the checks of scenes and the viewer ask of a shape.
pub trait Geometry: std::fmt::Debug {
    /// The shader functions that trace the shape. They may belong to a simpler kind, such as the disk for a flat conic;
    /// [`Geometry::arguments`] are then the numbers of that kind.
    fn kind(&self) -> ShapeKind;

    /// The numbers that the functions take after a point and a direction. The first one of a shape with a
    /// [`Geometry::table`] stands for where that begins.
    fn arguments(&self) -> Vec<f64>;

    /// What the functions read from the buffer of tables: for shapes with more numbers than functions take.
    fn table(&self) -> Option<&[f64]> {
        None
    }

    /// What the terms of its height add up to \[mm\]: rounding takes so much times the precision's last place.
    fn terms_size(&self) -> f64 {
        0.0
    }

    /// True if its table begins with an aperture that is no disk about the axis.
    fn is_clipped(&self) -> bool {
        false
    }

    /// The quadric that the shape is a part of, if it is of one.
    fn quadric(&self) -> Option<Quadric> {
        None
    }

    /// The function that is zero on the shape, for shapes with a normal that bends smoothly; by default the quadric's.
    /// A shape without one counts as the plane z = 0 where faces in contact are looked for.
    fn level(&self, p: DVec3) -> Option<Level> {
        self.quadric().map(|quadric| quadric.level(p))
    }

    /// True if a point of the surface without its limits belongs to the shape.
    fn holds(&self, p: DVec3) -> bool;

    /// What the shape fills. `None` for a shape without end. The meshes are the scene's.
    fn extent(&self, meshes: &[Mesh]) -> Option<Extent>;

    /// Points spread over the shape: it is in contact with another one on which all of them lie. None for a shape that is
    /// in contact with no other, or by its facets.
    fn samples(&self) -> Vec<DVec3>;

    /// The circles about the axis that bound it, as radius and height \[mm\].
    fn rims(&self) -> Vec<(f64, f64)> {
        Vec::new()
    }

    /// Curves of a plane through the axis: distances from the axis on both sides, and heights \[mm\].
    fn section(&self) -> Vec<Vec<DVec2>> {
        Vec::new()
    }

    /// Curves that outline the shape from everywhere, beside its rims. The meshes are the scene's.
    fn edges(&self, _meshes: &[Mesh]) -> Vec<Vec<DVec3>> {
        Vec::new()
    }

    /// Two planes across the axis that hold it, where that follows from its numbers well.
    fn slab(&self) -> Option<Slab> {
        None
    }

    /// The radius about the axis of what it leaves open, if it surrounds the axis \[mm\].
    fn opening(&self) -> Option<f64> {
        None
    }

    /// Its place in a plane across the axis, if it is flat.
    fn flat(&self) -> Option<Flat> {
        None
    }

    /// On which side of it the front is: the geometric normal points away from there.
    fn front_side(&self) -> FrontSide {
        FrontSide::Below
    }

    /// True if it bounds a volume alone.
    fn is_closed(&self) -> bool {
        false
    }

    /// The conic that it is, or is a part of.
    fn conic(&self) -> Option<Conic> {
        None
    }

    /// True if another shape is a part of the same curved surface and overlaps it, where both have one frame.
    fn coincides(&self, other: &Shape) -> bool {
        let (Some(one), Some(other_one)) = (self.conic(), other.conic()) else { return false };
        let is_one = (one.curvature, one.conic) == (other_one.curvature, other_one.conic);
        is_one
            && (self.samples().iter().any(|&p| other.holds(p))
                || other.samples().iter().any(|&p| self.holds(p)))
    }

    /// True if the surface looks the same however its frame is turned.
    fn is_round(&self) -> bool {
        false
    }

    /// The normal's z at a tip, where the gradient is zero, if a tip belongs to the shape.
    fn tip(&self) -> Option<f64> {
        None
    }

    /// The mesh that it is, as an index into the scene's.
    fn mesh(&self) -> Option<usize> {
        None
    }

    /// The values of t, in no order, at which the line o + t d crosses the shape. Checks of compound bodies use them;
    /// rays have WGSL. By default these are the quadric's. Empty for a shape without a quadric.
    fn crossings(&self, o: DVec3, d: DVec3) -> Vec<f64> {
        let all = self.quadric().into_iter().flat_map(|quadric| quadric.crossings(o, d));
        all.filter(|t| t.is_finite() && self.holds(o + *t * d)).collect()
    }
}

/// On which side of a shape its front is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrontSide {
    /// Where local z falls: rays that travel along +z come from there.
    Below,
    /// Outside of what the shape encloses.
    Outside,
    /// Inside of what the shape encloses.
    Inside,
}

/// Two planes across z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slab {
    /// Their heights, in no order \[mm\].
    pub ends: [f64; 2],
    /// By how much the level changes while z grows by 1 at the rim. `None` if the rim is at one of the planes by
    /// definition. An error of the level by rounding is an error of z divided by this.
    pub steepness: Option<f64>,
}

/// A flat shape.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Flat {
    /// Its outline.
    pub outline: Outline,
    /// Radius of the hole in its middle \[mm\].
    pub hole: f64,
    /// Its height \[mm\].
    pub z: f64,
}

/// What each file's `Written` does: the numbers of a shape as scene files have them.
trait WrittenShape {
    /// Refuses numbers that no shape has. `at` gives the place of a key.
    fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()>;

    /// The shape. `place` is where it stands in the scene file. `index` is the number of a mesh among the scene's
    /// meshes; other shapes ignore it.
    fn shape(&self, place: &str, index: Option<usize>) -> Result<Shape>;
}

impl Written {
    /// Refuses numbers that no shape has; `at` gives the place of a key.
    ///
    /// # Errors
    /// [`crate::Error::Scene`] with the place and a remedy.
    pub fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        self.entry().check(at)
    }

    /// The shape that stands in a place of the scene file, with its place among the scene's meshes if it is one.
    ///
    /// # Errors
    /// [`crate::Error::Scene`] with the place and a remedy.
    pub fn shape(&self, place: &str, index: Option<usize>) -> Result<Shape> {
        self.entry().shape(place, index)
    }
}

impl ShapeKind {
    /// The kind of a shape.
    pub fn of(shape: &Shape) -> Self {
        shape.kind()
    }

    /// The kinds of shapes, without repetition.
    pub fn among<'a>(shapes: impl Iterator<Item = &'a Shape>) -> Vec<Self> {
        ShapeKind::distinct(shapes.map(ShapeKind::of))
    }

    /// A function of the kind, such as `conic_distance`.
    pub fn function(self, what: &str) -> String {
        format!("{}_{what}", self.wgsl().name)
    }

    /// How many numbers the functions take.
    pub fn num_arguments(self) -> usize {
        self.wgsl().num_arguments
    }

    /// True if the distance function takes how far the nearest hit is, beyond which it need not search: for facets.
    pub fn is_searched(self) -> bool {
        matches!(self.wgsl().normal, Normal::Facet)
    }

    /// True if the shape is a part of a quadric.
    pub fn is_quadric(self) -> bool {
        matches!(self.wgsl().normal, Normal::Quadric(_))
    }

    /// True if the shape has a function for its normal.
    pub fn has_own_normal(self) -> bool {
        matches!(self.wgsl().normal, Normal::Own | Normal::Sag)
    }
}

/// Points on circles about the axis, given as radius and height \[mm\]: four on each, at unequal angles.
fn ring_samples(rings: &[(f64, f64)]) -> Vec<DVec3> {
    const TURNS: [f64; 4] = [0.0, 0.27, 0.55, 0.8];
    let at = |&(radius, z): &(f64, f64)| TURNS.map(|turn| (DVec2::from_angle(turn * TAU) * radius).extend(z));
    rings.iter().flat_map(at).collect()
}

/// A curve of a plane through the axis between two distances from it, for a height that depends on them \[mm\].
fn section_between(from: f64, to: f64, height: impl Fn(f64) -> f64) -> Vec<DVec2> {
    const STEPS: i32 = 48;
    // Closer together towards the rims, where a sphere is steep.
    let part = |step: i32| 0.5 - 0.5 * (PI * f64::from(step) / f64::from(STEPS)).cos();
    let at = |step: i32| from + (to - from) * part(step);
    (0..=STEPS).map(|step| DVec2::new(at(step), height(at(step)))).collect()
}

/// A circle about the axis as a closed curve, for pictures \[mm\].
pub fn circle(radius: f64, z: f64) -> Vec<DVec3> {
    const STEPS: i32 = 64;
    let point = |step: i32| {
        let (sin, cos) = (TAU * f64::from(step) / f64::from(STEPS)).sin_cos();
        DVec3::new(radius * cos, radius * sin, z)
    };
    (0..=STEPS).map(point).collect()
}
