//! Freeforms: a conic of revolution and a polynomial of x and y, kept as a sum of products of Chebyshev polynomials.
//!
//! Whatever basis a scene file has, the polynomial is expanded anew over the square about the aperture. Clenshaw's
//! recurrence then loses to rounding what the coefficients add up to (Mason and Handscomb, Chebyshev Polynomials,
//! section 2.4). The loss is next to nothing for a polynomial that is of one size over the square. A Zernike polynomial
//! of a high order is far larger in the corners than in the disk. For order 12 its coefficients add up to 1e4, and for
//! order 20 to 1e7. A surface whose rounding would show is refused.

use crate::Result;
use crate::model::shapes::profile::AsphereProfile;
use crate::model::shapes::sag::{Bounds, ROOM, Sag, SagAt, SagSurface, largest_bend};
use crate::model::shapes::{Normal, Shape, ShapeKind, ShapeWgsl};
use crate::model::{checks, coefficient_rows};
use crate::shaders::shader;
use glam::{DMat2, DVec2};
use std::f64::consts::PI;
use std::sync::Arc;

/// The surface.
pub type FreeformSurface = SagSurface<Freeform>;

/// The freeform.
pub const FREEFORM: ShapeWgsl = ShapeWgsl {
    name: "freeform",
    file: shader!("shapes/freeform.wgsl"),
    num_arguments: 10,
    normal: Normal::Sag,
};

/// Highest power of x, and of y.
pub const HIGHEST_POWER: usize = 31;

/// Largest error of a height by rounding in f64 \[mm\].
const LARGEST_ERROR: f64 = 1e-9;

/// z = conic(r) + the sum of `coefficients[i][j]` T_i(x / R) T_j(y / R), within the semi-diameter R.
#[derive(Debug, Clone, PartialEq)]
pub struct Freeform {
    /// The conic, with the semi-diameter.
    pub conic: AsphereProfile,
    sum: Arc<Sum>,
}

/// The polynomial.
#[derive(Debug, PartialEq)]
struct Sum {
    /// Coefficients \[mm\], a row for each i.
    rows: Vec<Vec<f64>>,
    /// Bounds of the whole surface.
    bounds: Bounds,
    /// The numbers that the polynomial was given by, whatever the semi-diameter.
    definition: Vec<f64>,
    /// As shaders/shapes/freeform.wgsl reads them ([`coefficient_rows::backwards`]).
    table: Vec<f64>,
}

/// A polynomial of x and y, as some basis has it.
pub struct Polynomial<'a> {
    /// Highest powers of x and of y.
    pub powers: [usize; 2],
    /// Highest sum of both powers.
    pub order: usize,
    /// Its value at a point \[mm\].
    pub value: &'a dyn Fn(DVec2) -> f64,
    /// The numbers that distinguish it from others.
    pub definition: Vec<f64>,
}

impl<'a> Polynomial<'a> {
    /// A polynomial that a table of coefficients gives, with a row for each power of x.
    /// `more` are further numbers of the basis.
    pub fn of_rows(rows: &[Vec<f64>], more: &[f64], value: &'a dyn Fn(DVec2) -> f64) -> Self {
        let last = |row: &Vec<f64>| row.iter().rposition(|c| *c != 0.0);
        let highest = || rows.iter().enumerate().filter_map(|(i, row)| last(row).map(|j| (i, j)));
        Polynomial {
            powers: [
                highest().map(|(i, _)| i).max().unwrap_or(0),
                highest().map(|(_, j)| j).max().unwrap_or(0),
            ],
            order: highest().map(|(i, j)| i + j).max().unwrap_or(0),
            value,
            definition: [more, &rows.concat(), &rows.iter().map(|row| row.len() as f64).collect::<Vec<_>>()]
                .concat(),
        }
    }
}

impl Freeform {
    /// The freeform of numbers that were checked.
    pub fn new(radius: f64, conic: f64, aperture_radius: f64, polynomial: &Polynomial<'_>) -> Self {
        let conic = AsphereProfile::new(radius, conic, aperture_radius, 2, &[]);
        let rows = expanded(aperture_radius, polynomial);
        let bounds = bounds(&conic, &rows);
        let table = coefficient_rows::backwards(&rows);
        Freeform {
            conic,
            sum: Arc::new(Sum { rows, bounds, definition: polynomial.definition.clone(), table }),
        }
    }

    /// Refuses a polynomial whose numbers leave f64, or lose too much of it. `place` is where the surface stands.
    pub(super) fn checked(self, place: &str) -> Result<Self> {
        let sum: f64 = self.sum.rows.iter().flatten().map(|c| c.abs()).sum();
        let Bounds { lowest, highest, slope, bend } = self.sum.bounds;
        let is_finite = [sum, lowest, highest, slope, bend].iter().all(|number| number.is_finite());
        if is_finite && sum * f64::EPSILON <= LARGEST_ERROR {
            return Ok(self);
        }
        let problem = format!(
            "rounding of its polynomial, whose parts add up to {sum:.3e} mm, would hide more than {LARGEST_ERROR:e} mm"
        );
        checks::refuse(
            format!("{place}.coefficients"),
            problem,
            "give smaller coefficients, or fewer of high order",
        )?;
        Ok(self)
    }

    /// Refuses a conic part that no freeform has, and too many coefficients.
    pub fn check(
        radius: f64,
        conic: f64,
        aperture_radius: f64,
        coefficients: &[Vec<f64>],
        at: &dyn Fn(&str) -> String,
    ) -> Result<()> {
        AsphereProfile::check(radius, conic, aperture_radius, &[], at)?;
        let place = |i: usize| format!("{}[{i}]", at("coefficients"));
        if coefficients.len() > HIGHEST_POWER + 1 {
            let problem = format!("there are {} rows", coefficients.len());
            return checks::refuse(
                at("coefficients"),
                problem,
                format!("give at most {}", HIGHEST_POWER + 1),
            );
        }
        for (i, row) in coefficients.iter().enumerate() {
            if row.len() > HIGHEST_POWER + 1 {
                let problem = format!("there are {} coefficients", row.len());
                return checks::refuse(place(i), problem, format!("give at most {}", HIGHEST_POWER + 1));
            }
            for (j, &coefficient) in row.iter().enumerate() {
                checks::between(format!("{}[{j}]", place(i)), coefficient, -1e30, 1e30)?;
            }
        }
        Ok(())
    }

    /// Refuses an aperture that is wider than what a basis is defined on.
    pub fn check_norm(key: &str, norm: f64, aperture_radius: f64, at: &dyn Fn(&str) -> String) -> Result<()> {
        checks::size(at(key), norm)?;
        if aperture_radius <= norm {
            return Ok(());
        }
        let problem = format!("the polynomials end {norm} mm off the axis, within the aperture");
        checks::refuse(at(key), problem, "give at least the aperture_radius")
    }
}

/// The coefficients of Chebyshev polynomials over the square of half side R. Coefficients follow from values at the
/// nodes, by the discrete orthogonality of the polynomials (Mason and Handscomb, section 4.6).
fn expanded(aperture_radius: f64, polynomial: &Polynomial<'_>) -> Vec<Vec<f64>> {
    let [nx, ny] = polynomial.powers.map(|power| power + 1);
    let node = |k: usize, n: usize| (PI * (k as f64 + 0.5) / n as f64).cos();
    let weight = |i: usize, k: usize, n: usize| {
        let scale = if i == 0 { 1.0 } else { 2.0 } / n as f64;
        scale * (PI * (i * (2 * k + 1)) as f64 / (2 * n) as f64).cos()
    };
    let at = |k: usize, l: usize| (polynomial.value)(aperture_radius * DVec2::new(node(k, nx), node(l, ny)));
    let values: Vec<Vec<f64>> = (0..nx).map(|k| (0..ny).map(|l| at(k, l)).collect()).collect();
    // Along y first.
    let along = |values: &Vec<f64>, j: usize| (0..ny).map(|l| weight(j, l, ny) * values[l]).sum::<f64>();
    let half: Vec<Vec<f64>> = values.iter().map(|row| (0..ny).map(|j| along(row, j)).collect()).collect();
    let coefficient = |i: usize, j: usize| (0..nx).map(|k| weight(i, k, nx) * half[k][j]).sum::<f64>();
    let row = |i: usize| {
        let num = ny.min((polynomial.order + 1).saturating_sub(i)).max(1);
        (0..num).map(|j| coefficient(i, j)).collect()
    };
    (0..nx.min(polynomial.order + 1)).map(row).collect()
}

/// A sum of Chebyshev polynomials at u, by Clenshaw's recurrence.
pub(super) fn clenshaw(coefficients: impl DoubleEndedIterator<Item = f64>, u: f64) -> f64 {
    let step = |[b, c]: [f64; 2], coefficient: f64| [coefficient + 2.0 * u * b - c, b];
    let [last, before] = coefficients.rev().fold([0.0, 0.0], step);
    last - u * before
}

/// T_n and its first two derivatives at u, for n up to `most`.
fn chebyshev(most: usize, u: f64) -> Vec<[f64; 3]> {
    let mut all = vec![[1.0, 0.0, 0.0], [u, 1.0, 0.0]];
    for n in 2..=most.max(1) {
        let ([a, da, dda], [b, db, ddb]) = (all[n - 1], all[n - 2]);
        all.push([2.0 * u * a - b, 2.0 * (a + u * da) - db, 2.0 * (2.0 * da + u * dda) - ddb]);
    }
    all
}

/// The value of the sum, its gradient and its second derivatives (xx, xy, yy) in units of the semi-diameter.
fn sum_at(rows: &[Vec<f64>], x: &[[f64; 3]], y: &[[f64; 3]]) -> (f64, DVec2, [f64; 3]) {
    let (mut value, mut gradient, mut second) = (0.0, DVec2::ZERO, [0.0; 3]);
    for (row, [t, dt, ddt]) in rows.iter().zip(x) {
        let [f, df, ddf] = [0, 1, 2].map(|k| row.iter().zip(y).map(|(c, y)| c * y[k]).sum::<f64>());
        value += t * f;
        gradient += DVec2::new(dt * f, t * df);
        second = [second[0] + ddt * f, second[1] + dt * df, second[2] + t * ddf];
    }
    (value, gradient, second)
}

/// Derivatives of T_0, T_1 and so on at u, over the factorial of their order: `[n][order]`, up to the highest power.
fn taylor(num: usize, u: f64) -> Vec<Vec<f64>> {
    let mut all: Vec<Vec<f64>> = Vec::new();
    for n in 0..num {
        // T_n = 2 u T_(n-1) - T_(n-2), and of its Taylor terms 2 u t_k + 2 t_(k-1) - t_k.
        let term = |n: usize, k: usize| all.get(n).and_then(|terms| terms.get(k)).copied().unwrap_or(0.0);
        let terms = (0..=n).map(|k| match (n, k) {
            (0, _) => 1.0,
            (1, 0) => u,
            (1, _) => 1.0,
            _ => {
                let below = if k > 0 { term(n - 1, k - 1) } else { 0.0 };
                2.0 * u * term(n - 1, k) + 2.0 * below - term(n - 2, k)
            }
        });
        let terms: Vec<f64> = terms.collect();
        all.push(terms);
    }
    all
}

/// The most that a sum, its slopes and its second derivatives are on a square about a point, in semi-diameters. The
/// bounds follow from all Taylor terms at the point.
#[derive(Debug, Default)]
struct Local {
    value: f64,
    off_value: f64,
    slope: DVec2,
    off_slope: DVec2,
    bend: [f64; 3],
}

impl Local {
    /// `x` are the Taylor terms of T_i at the point, `along_y[i]` the Taylor terms of the rows' sums. `half` is half
    /// the square's side.
    fn of(x: &[Vec<f64>], along_y: &[Vec<f64>], half: f64) -> Self {
        let num_y = along_y.iter().map(Vec::len).max().unwrap_or(0);
        let mut local = Local::default();
        for p in 0..x.len() {
            for q in 0..num_y {
                let term: f64 =
                    (p..x.len()).map(|i| x[i][p] * along_y[i].get(q).copied().unwrap_or(0.0)).sum();
                let (fp, fq) = (p as f64, q as f64);
                let power = |n: f64| term.abs() * half.powi((fp + fq - n) as i32);
                match (p, q) {
                    (0, 0) => local.value = term,
                    (1, 0) => local.slope.x = term,
                    (0, 1) => local.slope.y = term,
                    _ => {}
                }
                if p + q >= 1 {
                    local.off_value += power(0.0);
                }
                if p + q >= 2 {
                    local.off_slope += DVec2::new(fp, fq) * power(1.0);
                    local.bend[0] += fp * (fp - 1.0) * power(2.0);
                    local.bend[1] += fp * fq * power(2.0);
                    local.bend[2] += fq * (fq - 1.0) * power(2.0);
                }
            }
        }
        local
    }
}

/// Bounds over the aperture, which is cut into squares. In each square the sum is what its Taylor terms allow. The
/// conic part lies between its values at the nearest and the farthest point from the axis.
fn bounds(conic: &AsphereProfile, rows: &[Vec<f64>]) -> Bounds {
    const CELLS: i32 = 96;
    let radius = conic.aperture_radius;
    // Half the side of a cell; the cells go a little beyond the rim. From here on lengths are in semi-diameters.
    let half = ROOM / f64::from(CELLS);
    let middle = |cell: i32| half * f64::from(2 * cell + 1 - CELLS);
    let along_x: Vec<Vec<Vec<f64>>> = (0..CELLS).map(|cell| taylor(rows.len(), middle(cell))).collect();
    let most = rows.iter().map(Vec::len).max().unwrap_or(0);
    let row_sums = |cell: i32| -> Vec<Vec<f64>> {
        let terms = taylor(most, middle(cell));
        let of_row = |row: &Vec<f64>| {
            (0..row.len()).map(|q| (q..row.len()).map(|j| row[j] * terms[j][q]).sum()).collect::<Vec<f64>>()
        };
        rows.iter().map(of_row).collect()
    };
    let mut all = Bounds { lowest: 0.0, highest: 0.0, slope: 0.0, bend: 0.0 };
    for j in 0..CELLS {
        let along_y = row_sums(j);
        for (i, x) in (0..).zip(&along_x) {
            let centre = DVec2::new(middle(i), middle(j));
            let nearest = (centre.abs() - half).max(DVec2::ZERO).length();
            if nearest > ROOM {
                continue;
            }
            let local = Local::of(x, &along_y, half);
            let farthest = (centre.abs() + half).length().min(ROOM);
            let ends = [nearest, farthest].map(|r| conic.at(DVec2::new(radius * r, 0.0)));
            let heights = ends.map(|end| end.height);
            all.lowest = all.lowest.min(local.value - local.off_value + heights[0].min(heights[1]));
            all.highest = all.highest.max(local.value + local.off_value + heights[0].max(heights[1]));
            // The conic's slope turns and grows over the cell by no more than its bend times the cell's diagonal.
            let within = centre.length().min(farthest);
            let slope = conic.at(radius * within * centre.normalize_or(DVec2::X)).gradient;
            let bend_of = |end: &SagAt| end.hessian.x_axis.x.abs().max(end.hessian.y_axis.y.abs());
            let conic_bend = bend_of(&ends[0]).max(bend_of(&ends[1]));
            let turned = conic_bend * radius * half * std::f64::consts::SQRT_2 * 2.0;
            let total = slope + local.slope / radius;
            all.slope = all.slope.max(total.length() + local.off_slope.length() / radius + turned);
            let [xx, xy, yy] = local.bend.map(|bend| bend / (radius * radius));
            all.bend = all.bend.max(largest_bend(xx, xy, yy) + conic_bend);
            if [local.value, local.off_value, xx, xy, yy].iter().any(|number| !number.is_finite()) {
                return Bounds { highest: f64::INFINITY, ..all };
            }
        }
    }
    all.with_room(radius)
}

impl Sag for Freeform {
    fn aperture_radius(&self) -> f64 {
        self.conic.aperture_radius
    }

    fn at(&self, p: DVec2) -> SagAt {
        let (rows, radius) = (&self.sum.rows, self.conic.aperture_radius);
        let most = rows.len().max(rows.iter().map(Vec::len).max().unwrap_or(0));
        let [x, y] = (p / radius).to_array().map(|u| chebyshev(most, u));
        let (value, gradient, [xx, xy, yy]) = sum_at(rows, &x, &y);
        let conic = self.conic.at(p);
        let second = DMat2::from_cols(DVec2::new(xx, xy), DVec2::new(xy, yy));
        SagAt {
            height: conic.height + value,
            gradient: conic.gradient + gradient / radius,
            hessian: conic.hessian + second * (1.0 / (radius * radius)),
        }
    }

    fn height(&self, p: DVec2) -> f64 {
        let [u, v] = (p / self.conic.aperture_radius).to_array();
        let along_y = |row: &Vec<f64>| clenshaw(row.iter().copied(), v);
        self.conic.height(p) + clenshaw(self.sum.rows.iter().map(along_y), u)
    }

    fn bounds(&self) -> Bounds {
        self.sum.bounds
    }

    fn kind(&self) -> ShapeKind {
        ShapeKind::Freeform
    }

    fn magnitude(&self) -> f64 {
        self.sum.rows.iter().flatten().map(|c| c.abs()).sum::<f64>() + self.conic.conic_magnitude()
    }

    fn numbers(&self) -> Vec<f64> {
        vec![1.0 / self.conic.aperture_radius, self.conic.curvature, self.conic.axial()]
    }

    fn coefficients(&self) -> &[f64] {
        &self.sum.table
    }

    fn is_one_with(&self, other: &Self) -> bool {
        self.conic.is_one_with(&other.conic) && self.sum.definition == other.sum.definition
    }

    fn of_shape(shape: &Shape) -> Option<&SagSurface<Self>> {
        let (Shape::Polynomial(surface) | Shape::Chebyshev(surface) | Shape::Zernike(surface)) = shape else {
            return None;
        };
        Some(surface)
    }
}
