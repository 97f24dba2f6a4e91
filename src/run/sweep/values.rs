//! The values that a sweep gives to numbers: lists, and draws of tolerances.

use crate::error::{Error, Result};
use crate::random::Draw;
use crate::scene::Scene;

/// The distribution of a tolerance of size s.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Distribution {
    /// Normal, of standard deviation s.
    Normal,
    /// Uniform, from -s to s.
    Uniform,
}

/// Numbers of the scene, by their names.
pub type NamedNumbers = Vec<(String, f64)>;

/// Most points of a sweep.
pub const MOST_POINTS: usize = 1_000_000;

/// A number's name and its values.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// The name.
    pub name: String,
    /// The values.
    pub values: Vec<f64>,
}

/// A number's name and the size of its tolerance.
#[derive(Debug, Clone, PartialEq)]
pub struct Tolerance {
    /// The name.
    pub name: String,
    /// The size.
    pub size: f64,
    /// True: the size is a fraction of the number.
    pub relative: bool,
}

/// Every combination of the values, the last name's changing fastest; or the values of one place in each list.
///
/// # Errors
/// [`Error::Usage`] for lists of different lengths, or too many points.
pub fn combinations(set: &[Axis], zip: bool) -> Result<Vec<NamedNumbers>> {
    if zip {
        let lengths: Vec<usize> = set.iter().map(|values| values.values.len()).collect();
        if lengths.iter().any(|length| *length != lengths[0]) {
            return Err(Error::Usage(format!(
                "--zip needs as many values for each name; there are {lengths:?}"
            )));
        }
        let point = |i: usize| set.iter().map(|one| (one.name.clone(), one.values[i])).collect();
        return Ok((0..lengths[0]).map(point).collect());
    }
    let num_points = set.iter().fold(1_usize, |product, values| product.saturating_mul(values.values.len()));
    if num_points > MOST_POINTS {
        return Err(Error::Usage(format!("there are {num_points} points; at most {MOST_POINTS} are traced")));
    }
    let mut points: Vec<NamedNumbers> = vec![Vec::new()];
    for Axis { name, values } in set {
        let with = |point: &Vec<(String, f64)>, value: &f64| [&point[..], &[(name.clone(), *value)]].concat();
        points = points.iter().flat_map(|point| values.iter().map(move |value| with(point, value))).collect();
    }
    Ok(points)
}

/// The scene as it is, then samples of its tolerances. A sample does not depend on how others end.
///
/// # Errors
/// [`Error::Usage`] for a name of nothing, and for a share of 0.
pub fn samples(
    text: &str,
    tolerances: &[Tolerance],
    distribution: Distribution,
    seed: u64,
    num_samples: u32,
) -> Result<Vec<NamedNumbers>> {
    let names: Vec<String> = tolerances.iter().map(|tolerance| tolerance.name.clone()).collect();
    let nominal = Scene::numbers(text, &names)?;
    if let Some((none, _)) =
        tolerances.iter().zip(&nominal).find(|(one, nominal)| one.relative && **nominal == 0.0)
    {
        let (name, percent) = (&none.name, none.size * 100.0);
        return Err(Error::Usage(format!(
            "--tolerance {name}={percent}%: `{name}` is 0, and no share of 0 is a tolerance; give a number"
        )));
    }
    let mut draws = Draw::new(seed);
    let mut sample = || {
        let numbers = tolerances.iter().zip(&nominal).map(|(tolerance, nominal)| {
            let size = tolerance.size * if tolerance.relative { nominal.abs() } else { 1.0 };
            let unit = match distribution {
                Distribution::Uniform => 2.0 * draws.uniform() - 1.0,
                Distribution::Normal => draws.normal(),
            };
            (tolerance.name.clone(), nominal + size * unit)
        });
        numbers.collect::<NamedNumbers>()
    };
    let samples: Vec<_> = (0..num_samples).map(|_| sample()).collect();
    Ok(std::iter::once(names.into_iter().zip(nominal).collect()).chain(samples).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_all_combinations_or_pairs() {
        let set = [("a", vec![1.0, 2.0]), ("b", vec![3.0, 4.0])]
            .map(|(name, values)| Axis { name: name.into(), values });
        let numbers = |points: Vec<NamedNumbers>| -> Vec<Vec<f64>> {
            points.into_iter().map(|point| point.into_iter().map(|(_, value)| value).collect()).collect()
        };
        let all = numbers(combinations(&set, false).unwrap());
        assert_eq!(all, [[1.0, 3.0], [1.0, 4.0], [2.0, 3.0], [2.0, 4.0]]);
        assert_eq!(numbers(combinations(&set, true).unwrap()), [[1.0, 3.0], [2.0, 4.0]]);
        let other = [set[0].clone(), Axis { name: "b".into(), values: vec![1.0] }];
        assert!(combinations(&other, true).is_err());
    }
}
