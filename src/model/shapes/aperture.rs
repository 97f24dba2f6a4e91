//! Apertures: parts of the plane across the axis that need be neither round nor on the axis.

use crate::Result;
use crate::model::checks;
use glam::DVec2;
use schemars::JsonSchema;
use serde::Deserialize;
use std::f64::consts::TAU;

/// Deepest nesting of apertures in apertures; the shader keeps a bit for each.
const DEEPEST: usize = 16;
/// Most corners of all polygons of an aperture, and most parts.
const MAX_CORNERS: usize = 4096;
const MAX_PARTS: usize = 64;

/// A part of the plane across the axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Aperture {
    /// What it is made of.
    pub outline: ApertureOutline,
    /// True for all that the outline leaves out.
    pub inverted: bool,
}

/// What an aperture is bounded by.
#[derive(Debug, Clone, PartialEq)]
pub enum ApertureOutline {
    /// An ellipse, or a circle.
    Ellipse(Axes),
    /// A rectangle.
    Rectangle(Axes),
    /// A polygon of these corners \[mm\]; what an odd number of its sides surrounds is inside.
    Polygon(Vec<DVec2>),
    /// What is in one of both.
    Union(Box<[Aperture; 2]>),
    /// What is in both.
    Intersection(Box<[Aperture; 2]>),
    /// What is in the first alone.
    Difference(Box<[Aperture; 2]>),
}

/// Where an ellipse or a rectangle lies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axes {
    /// The middle \[mm\].
    pub middle: DVec2,
    /// The semi-axes along x and y \[mm\].
    pub semi_axes: DVec2,
}

impl Axes {
    fn scaled(&self, p: DVec2) -> DVec2 {
        (p - self.middle) / self.semi_axes
    }

    fn numbers(&self) -> [f64; 4] {
        let per = self.semi_axes.recip();
        [self.middle.x, self.middle.y, per.x, per.y]
    }
}

impl Aperture {
    /// True if a point is in it.
    pub fn holds(&self, p: DVec2) -> bool {
        let inside = match &self.outline {
            ApertureOutline::Ellipse(axes) => axes.scaled(p).length_squared() <= 1.0,
            ApertureOutline::Rectangle(axes) => axes.scaled(p).abs().max_element() <= 1.0,
            ApertureOutline::Polygon(corners) => {
                let sides = corners.iter().zip(corners.iter().cycle().skip(1));
                let is_left_of = |(a, b): &(&DVec2, &DVec2)| {
                    (a.y > p.y) != (b.y > p.y) && p.x < (b.x - a.x) * (p.y - a.y) / (b.y - a.y) + a.x
                };
                sides.filter(is_left_of).count() % 2 == 1
            }
            ApertureOutline::Union(parts) => parts.iter().any(|part| part.holds(p)),
            ApertureOutline::Intersection(parts) => parts.iter().all(|part| part.holds(p)),
            ApertureOutline::Difference(parts) => parts[0].holds(p) && !parts[1].holds(p),
        };
        inside != self.inverted
    }

    /// Itself for shaders/geometry/clip.table.wgsl: the parts, each before what is made of them.
    pub fn numbers(&self) -> Vec<f64> {
        let of = |code: f64, numbers: &[f64]| [&[code], numbers].concat();
        let combined =
            |parts: &[Aperture; 2], code: f64| [parts[0].numbers(), parts[1].numbers(), vec![code]].concat();
        let mut numbers = match &self.outline {
            ApertureOutline::Ellipse(axes) => of(0.0, &axes.numbers()),
            ApertureOutline::Rectangle(axes) => of(1.0, &axes.numbers()),
            ApertureOutline::Polygon(corners) => {
                let mut numbers = vec![2.0, corners.len() as f64];
                numbers.extend(corners.iter().flat_map(|corner| corner.to_array()));
                numbers
            }
            ApertureOutline::Union(parts) => combined(parts, 3.0),
            ApertureOutline::Intersection(parts) => combined(parts, 4.0),
            ApertureOutline::Difference(parts) => combined(parts, 5.0),
        };
        if self.inverted {
            numbers.push(6.0);
        }
        numbers
    }

    /// Ellipses that hold what it is made of, by their middles and semi-axes \[mm\].
    fn around(&self) -> Vec<Axes> {
        match &self.outline {
            ApertureOutline::Ellipse(axes) => vec![*axes],
            ApertureOutline::Rectangle(axes) => {
                vec![Axes { semi_axes: std::f64::consts::SQRT_2 * axes.semi_axes, ..*axes }]
            }
            ApertureOutline::Polygon(corners) => {
                let low = corners.iter().fold(DVec2::INFINITY, |low, corner| low.min(*corner));
                let high = corners.iter().fold(DVec2::NEG_INFINITY, |high, corner| high.max(*corner));
                let semi_axes = std::f64::consts::FRAC_1_SQRT_2 * (high - low);
                vec![Axes { middle: 0.5 * (low + high), semi_axes }]
            }
            ApertureOutline::Union(parts)
            | ApertureOutline::Intersection(parts)
            | ApertureOutline::Difference(parts) => parts.iter().flat_map(Aperture::around).collect(),
        }
    }

    /// Points spread over what the aperture has within a distance from the axis \[mm\]. Empty if the aperture lies
    /// beyond.
    pub fn samples(&self, widest: f64) -> Vec<DVec2> {
        const POINTS: i32 = 4096;
        /// The turn that repeats itself least.
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        let spiral = |axes: Axes| {
            (0..POINTS).map(move |i| {
                let share = ((f64::from(i) + 0.5) / f64::from(POINTS)).sqrt();
                axes.middle + DVec2::from_angle(f64::from(i) * GOLDEN * TAU) * share * axes.semi_axes
            })
        };
        let is_part = |p: &DVec2| p.length() <= widest && self.holds(*p);
        // Its parts may be far smaller than the surface, or larger.
        let mut over = self.around();
        over.push(Axes { middle: DVec2::ZERO, semi_axes: DVec2::splat(widest) });
        let candidates = over.into_iter().map(|axes| spiral(axes).filter(is_part).collect::<Vec<_>>());
        let inside = candidates.max_by_key(Vec::len).unwrap_or_default();
        // Not every 34th or 89th, which are turned by next to nothing.
        (0..12.min(inside.len())).map(|k| inside[(k * inside.len() / 12 + 5 * k) % inside.len()]).collect()
    }

    /// Its outlines as closed curves \[mm\].
    pub fn curves(&self) -> Vec<Vec<DVec2>> {
        const STEPS: i32 = 64;
        let polygon = |corners: &[DVec2]| {
            let sides = corners.iter().zip(corners.iter().cycle().skip(1));
            let points = |(from, to): (&DVec2, &DVec2)| {
                (0..=STEPS / 4)
                    .map(|step| from.lerp(*to, 4.0 * f64::from(step) / f64::from(STEPS)))
                    .collect::<Vec<_>>()
            };
            sides.flat_map(points).collect()
        };
        match &self.outline {
            ApertureOutline::Ellipse(axes) => {
                let point = |step: i32| {
                    axes.middle + DVec2::from_angle(TAU * f64::from(step) / f64::from(STEPS)) * axes.semi_axes
                };
                vec![(0..=STEPS).map(point).collect()]
            }
            ApertureOutline::Rectangle(axes) => {
                let corner = |x: f64, y: f64| axes.middle + DVec2::new(x, y) * axes.semi_axes;
                vec![polygon(&[corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)])]
            }
            ApertureOutline::Polygon(corners) => vec![polygon(corners)],
            ApertureOutline::Union(parts)
            | ApertureOutline::Intersection(parts)
            | ApertureOutline::Difference(parts) => parts.iter().flat_map(Aperture::curves).collect(),
        }
    }
}

/// The word for an outline in a scene file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OutlineKind {
    /// An ellipse, or a circle: `semi_axis_x`, `semi_axis_y`, `x`, `y`, `hole_radius`.
    Ellipse,
    /// A rectangle, with the same keys.
    Rectangle,
    /// A polygon: `vertices`.
    Polygon,
    /// What is in one of two `parts`.
    Union,
    /// What is in both `parts`.
    Intersection,
    /// What is in the first of two `parts` alone.
    Difference,
}

/// An aperture in a scene file.
#[derive(Debug, Clone, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "Aperture")]
pub struct Written {
    /// What bounds it.
    pub outline: OutlineKind,
    /// Semi-axis along x of an ellipse or a rectangle \[mm\].
    #[serde(default)]
    pub semi_axis_x: Option<f64>,
    /// Semi-axis along y \[mm\].
    #[serde(default)]
    pub semi_axis_y: Option<f64>,
    /// Middle along x \[mm\]; 0 if null.
    #[serde(default)]
    pub x: Option<f64>,
    /// Middle along y \[mm\]; 0 if null.
    #[serde(default)]
    pub y: Option<f64>,
    /// Radius of a round hole about the middle \[mm\]; none if null.
    #[serde(default)]
    pub hole_radius: Option<f64>,
    /// Corners \[mm\] of a polygon.
    #[serde(default)]
    pub vertices: Option<Vec<[f64; 2]>>,
    /// Two apertures.
    #[serde(default)]
    pub parts: Option<Vec<Written>>,
    /// True for all that it leaves out.
    #[serde(default)]
    pub inverted: bool,
}

impl Written {
    /// Refuses numbers that no aperture has. `at` gives the place of a key.
    pub(super) fn check(&self, at: &dyn Fn(&str) -> String) -> Result<()> {
        self.check_within(at, 0)?;
        let (parts, corners) = self.size();
        if parts > MAX_PARTS || corners > MAX_CORNERS {
            let problem = format!("the aperture has {parts} parts and {corners} corners");
            return checks::refuse(
                at("parts"),
                problem,
                format!("give at most {MAX_PARTS} and {MAX_CORNERS}"),
            );
        }
        Ok(())
    }

    /// How many ellipses, rectangles and polygons it is made of, and how many corners.
    fn size(&self) -> (usize, usize) {
        match self.parts.as_deref() {
            None | Some([]) => (1, self.vertices.as_ref().map_or(0, Vec::len)),
            Some(parts) => {
                parts.iter().map(Written::size).fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1))
            }
        }
    }

    fn check_within(&self, at: &dyn Fn(&str) -> String, depth: usize) -> Result<()> {
        let axes = ["semi_axis_x", "semi_axis_y", "x", "y", "hole_radius"];
        let given = [self.semi_axis_x, self.semi_axis_y, self.x, self.y, self.hole_radius];
        let mut extra: Vec<&str> =
            axes.into_iter().zip(given).filter_map(|(key, value)| value.map(|_| key)).collect();
        extra.extend(self.vertices.as_ref().map(|_| "vertices"));
        extra.extend(self.parts.as_ref().map(|_| "parts"));
        let own: &[&str] = match self.outline {
            OutlineKind::Ellipse | OutlineKind::Rectangle => &axes,
            OutlineKind::Polygon => &["vertices"],
            OutlineKind::Union | OutlineKind::Intersection | OutlineKind::Difference => &["parts"],
        };
        extra.retain(|key| !own.contains(key));
        if let Some(key) = extra.first() {
            return checks::refuse(
                at(key),
                "an aperture of this outline has no such key",
                format!("give {}", own.join(", ")),
            );
        }
        match self.outline {
            OutlineKind::Ellipse | OutlineKind::Rectangle => {
                for (key, value) in [("semi_axis_x", self.semi_axis_x), ("semi_axis_y", self.semi_axis_y)] {
                    match value {
                        Some(value) => checks::size(at(key), value)?,
                        None => return checks::refuse(at(key), "it is missing", "give the semi-axis in mm"),
                    }
                }
                checks::position(at("x"), self.x.unwrap_or(0.0))?;
                checks::position(at("y"), self.y.unwrap_or(0.0))?;
                self.hole_radius
                    .filter(|radius| *radius != 0.0)
                    .map_or(Ok(()), |radius| checks::size(at("hole_radius"), radius))
            }
            OutlineKind::Polygon => {
                let corners = self.vertices.as_deref().unwrap_or_default();
                if !(3..=MAX_CORNERS).contains(&corners.len()) {
                    let problem = format!("a polygon has {} corners", corners.len());
                    return checks::refuse(at("vertices"), problem, format!("give 3 to {MAX_CORNERS}"));
                }
                for (i, corner) in corners.iter().enumerate() {
                    for (j, &value) in corner.iter().enumerate() {
                        checks::position(format!("{}[{i}][{j}]", at("vertices")), value)?;
                    }
                }
                Ok(())
            }
            OutlineKind::Union | OutlineKind::Intersection | OutlineKind::Difference => {
                let parts = self.parts.as_deref().unwrap_or_default();
                if parts.len() != 2 {
                    let problem = format!("there are {} parts", parts.len());
                    return checks::refuse(
                        at("parts"),
                        problem,
                        "give two apertures; a part may be made of parts itself",
                    );
                }
                if depth >= DEEPEST {
                    return checks::refuse(
                        at("parts"),
                        "apertures are nested too deep",
                        format!("nest at most {DEEPEST}"),
                    );
                }
                for (i, part) in parts.iter().enumerate() {
                    let place = format!("{}[{i}]", at("parts"));
                    part.check_within(&|key| format!("{place}.{key}"), depth + 1)?;
                }
                Ok(())
            }
        }
    }

    /// The aperture of numbers that were checked.
    pub(super) fn aperture(&self) -> Aperture {
        let axes = || Axes {
            middle: DVec2::new(self.x.unwrap_or(0.0), self.y.unwrap_or(0.0)),
            semi_axes: DVec2::new(self.semi_axis_x.unwrap_or(1.0), self.semi_axis_y.unwrap_or(1.0)),
        };
        let parts = || {
            let part = |i: usize| self.parts.as_ref().and_then(|parts| parts.get(i)).map(Written::aperture);
            let none = || Aperture { outline: ApertureOutline::Polygon(Vec::new()), inverted: false };
            Box::new([part(0).unwrap_or_else(none), part(1).unwrap_or_else(none)])
        };
        let corners = || self.vertices.iter().flatten().map(|corner| DVec2::from(*corner)).collect();
        let outline = match self.outline {
            OutlineKind::Ellipse => ApertureOutline::Ellipse(axes()),
            OutlineKind::Rectangle => ApertureOutline::Rectangle(axes()),
            OutlineKind::Polygon => ApertureOutline::Polygon(corners()),
            OutlineKind::Union => ApertureOutline::Union(parts()),
            OutlineKind::Intersection => ApertureOutline::Intersection(parts()),
            OutlineKind::Difference => ApertureOutline::Difference(parts()),
        };
        match self.hole_radius.filter(|radius| *radius > 0.0) {
            None => Aperture { outline, inverted: self.inverted },
            Some(radius) => {
                let hole = Axes { semi_axes: DVec2::splat(radius), ..axes() };
                let parts = [
                    Aperture { outline, inverted: false },
                    Aperture { outline: ApertureOutline::Ellipse(hole), inverted: false },
                ];
                Aperture { outline: ApertureOutline::Difference(Box::new(parts)), inverted: self.inverted }
            }
        }
    }
}

/// An aperture for shaders/geometry/clip.table.wgsl: how many numbers it has, and these.
pub(super) fn table(aperture: Option<&Aperture>) -> Vec<f64> {
    let numbers = aperture.map(Aperture::numbers).unwrap_or_default();
    [vec![numbers.len() as f64], numbers].concat()
}

/// Refuses a surface of which its aperture leaves no sample. `place` is where the surface stands in the scene file.
pub(super) fn check_rest(place: &str, samples: &[glam::DVec3]) -> Result<()> {
    match samples.is_empty() {
        false => Ok(()),
        true => checks::refuse(
            place,
            "its aperture leaves nothing of the surface, or too thin a sliver to find",
            "give an aperture that overlaps what lies within aperture_radius",
        ),
    }
}
