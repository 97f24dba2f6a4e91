//! The values that a sweep gives to numbers: lists, and draws of tolerances.

use crate::cli::trace::between_commas;
use crate::error::{Error, Result};
use crate::scene::{Scene, units};

/// The distribution of a tolerance of size s.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Distribution {
    /// Normal, of standard deviation s.
    Normal,
    /// Uniform, from -s to s.
    Uniform,
}

/// Numbers of the scene, by their names.
pub(super) type Numbers = Vec<(String, f64)>;

/// Most points of a sweep.
const MOST_POINTS: usize = 1_000_000;

/// A number's name and its values.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Values {
    pub(super) name: String,
    pub(super) values: Vec<f64>,
}

/// A number's name and the size of its tolerance.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tolerance {
    pub(super) name: String,
    size: f64,
    /// True: the size is a fraction of the number.
    relative: bool,
}

fn name_and_rest(text: &str) -> std::result::Result<(String, &str), String> {
    let (name, rest) =
        text.rsplit_once('=').ok_or(format!("`{text}` has no `=`; write it as in L1.r1=50:60:11"))?;
    Ok((name.trim().into(), rest.trim()))
}

/// A number's name and its value: L1.r1=50.5.
pub(crate) fn parse_number(text: &str) -> std::result::Result<(String, f64), String> {
    let (name, rest) = name_and_rest(text)?;
    let number = units::parse(&name, rest)?;
    Ok((name, number))
}

pub(super) fn parse_values(text: &str) -> std::result::Result<Values, String> {
    let (name, rest) = name_and_rest(text)?;
    let values = match rest.split(':').collect::<Vec<_>>()[..] {
        [first, last, count] => {
            let (ends, count) = (with_units(&name, &[first, last])?, units::plain(count)?);
            let (first, last) = (ends[0], ends[1]);
            if !(1.0..=MOST_POINTS as f64).contains(&count) || count.fract() != 0.0 {
                return Err(format!("`{rest}` has {count} values; give a whole number from 1 to 1e6"));
            }
            let step = |i: f64| if count == 1.0 { first } else { first + (last - first) * i / (count - 1.0) };
            let values: Vec<f64> = (0..count as u32).map(|i| step(i.into())).collect();
            if values.iter().any(|value| !value.is_finite()) {
                return Err(format!("`{rest}` has values that are not finite; give a shorter range"));
            }
            values
        }
        [list] => with_units(&name, &list.split(',').collect::<Vec<_>>())?,
        _ => {
            return Err(format!(
                "`{rest}` is no list of values; write 50:60:11 (first, last, how many) or 50,55,60"
            ));
        }
    };
    Ok(Values { name, values })
}

/// Numbers of a list, or the ends of a range. The unit of the last counts for those without one.
fn with_units(name: &str, texts: &[&str]) -> std::result::Result<Vec<f64>, String> {
    let last = texts.last().map_or("", |last| units::unit_of(last));
    let number = |text: &&str| match units::unit_of(text) {
        "" => units::parse(name, &format!("{text}{last}")),
        _ if last.is_empty() => {
            Err(format!("`{text}` has a unit, and the last number has none; give it one"))
        }
        _ => units::parse(name, text),
    };
    texts.iter().map(number).collect()
}

/// Tolerances between commas.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tolerances(pub(super) Vec<Tolerance>);

pub(super) fn parse_tolerances(text: &str) -> std::result::Result<Tolerances, String> {
    between_commas(text)
        .iter()
        .map(|one| parse_tolerance(one))
        .collect::<std::result::Result<_, _>>()
        .map(Tolerances)
}

fn parse_tolerance(text: &str) -> std::result::Result<Tolerance, String> {
    let (name, rest) = name_and_rest(text)?;
    let (digits, relative) = rest.strip_suffix('%').map_or((rest, false), |digits| (digits, true));
    let size = if relative { units::plain(digits)? * 0.01 } else { units::parse(&name, digits)? };
    if size.is_finite() && size > 0.0 {
        Ok(Tolerance { name, size, relative })
    } else {
        Err(format!("`{rest}` is no tolerance above 0; write 0.1%, 0.05 or 50um"))
    }
}

/// Every combination of the values, the last name's changing fastest; or the values of one place in each list.
pub(super) fn combinations(set: &[Values], zip: bool) -> Result<Vec<Numbers>> {
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
    let mut points: Vec<Numbers> = vec![Vec::new()];
    for Values { name, values } in set {
        let with = |point: &Vec<(String, f64)>, value: &f64| [&point[..], &[(name.clone(), *value)]].concat();
        points = points.iter().flat_map(|point| values.iter().map(move |value| with(point, value))).collect();
    }
    Ok(points)
}

/// The scene as it is, then samples of its tolerances. A sample does not depend on how others end.
pub(super) fn samples(
    text: &str,
    tolerances: &[Tolerance],
    distribution: Distribution,
    seed: u64,
    num_samples: u32,
) -> Result<Vec<Numbers>> {
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
    let mut draws = Draw(seed);
    let mut sample = || {
        let numbers = tolerances.iter().zip(&nominal).map(|(tolerance, nominal)| {
            let size = tolerance.size * if tolerance.relative { nominal.abs() } else { 1.0 };
            let unit = match distribution {
                Distribution::Uniform => 2.0 * draws.uniform() - 1.0,
                Distribution::Normal => draws.normal(),
            };
            (tolerance.name.clone(), nominal + size * unit)
        });
        numbers.collect::<Numbers>()
    };
    let samples: Vec<_> = (0..num_samples).map(|_| sample()).collect();
    Ok(std::iter::once(names.into_iter().zip(nominal).collect()).chain(samples).collect())
}

/// Random numbers for tolerances: SplitMix64 (Steele, Lea, Flood: Fast splittable pseudorandom number generators, 2014).
struct Draw(u64);

impl Draw {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let bits = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let bits = (bits ^ (bits >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        bits ^ (bits >> 31)
    }

    /// In (0, 1).
    fn uniform(&mut self) -> f64 {
        ((self.bits() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    }

    /// Of mean 0 and variance 1 (Box and Muller).
    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.uniform().ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_read_as_people_write_them() {
        let values = |text| parse_values(text).map(|values| values.values);
        assert_eq!(values("L1.r1=50:60:3"), Ok(vec![50.0, 55.0, 60.0]));
        assert_eq!(values("L1.r1=1,-2e1"), Ok(vec![1.0, -20.0]));
        assert_eq!(values("L1.r1=7:9:1"), Ok(vec![7.0]));
        assert_eq!(values("L1.y=-50um:50um:3"), Ok(vec![-0.05, 0.0, 0.05]));
        assert_eq!(values("L1.y=-50:50um:3"), Ok(vec![-0.05, 0.0, 0.05]));
        assert_eq!(values("L1.y=-1mm:50 um:1"), Ok(vec![-1.0]));
        assert_eq!(values("L1.rx=1mrad,2mrad"), Ok(vec![0.001, 0.002]));
        assert_eq!(values("L1.rx=0, 1mrad"), Ok(vec![0.0, 0.001]));
        assert_eq!(parse_values("\"a=b\".r1=3").map(|values| values.name), Ok("\"a=b\".r1".into()));
        for wrong in [
            "L1.r1",
            "L1.r1=",
            "L1.r1=1:2",
            "L1.r1=1:2:0",
            "L1.r1=1:2:1.5",
            "L1.r1=a,b",
            "L1.r1=1:2:1e9",
            "L1.r1=1,NaN",
            "L1.r1=1e999",
            "L1.y=-50um:50:3",
            "L1.y=0:50um:3um",
            "L1.y=1um,2,3",
            "L1.y=1,,3um",
        ] {
            assert!(parse_values(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn tolerances_are_absolute_or_in_percent() {
        let tolerance = |text| parse_tolerance(text).map(|t| (t.size, t.relative));
        assert_eq!(tolerance("L1.r1=0.5%"), Ok((0.005, true)));
        assert_eq!(tolerance("L1.r1=0.5"), Ok((0.5, false)));
        assert_eq!(tolerance("L1.y=50um"), Ok((0.05, false)));
        let all = parse_tolerances(r#"L4.y=0.05, "a,b".rx=1mrad,gap_3=0.02"#).unwrap().0;
        let all: Vec<(&str, f64)> = all.iter().map(|one| (one.name.as_str(), one.size)).collect();
        assert_eq!(all, [("L4.y", 0.05), ("\"a,b\".rx", 1e-3), ("gap_3", 0.02)]);
        assert!(parse_tolerances("L4.y=0.05,").is_err());
        for wrong in ["L1.r1=0", "L1.r1=1deg", "L1.r1=1mm%", "L1.r1=-1%", "L1.r1=x", "L1.r1"] {
            assert!(parse_tolerance(wrong).is_err(), "{wrong}");
        }
        assert_eq!(parse_tolerance("L1.r1=1mm%"), Err("`1mm` is no number".into()));
    }

    #[test]
    fn points_are_all_combinations_or_pairs() {
        let set = [("a", vec![1.0, 2.0]), ("b", vec![3.0, 4.0])]
            .map(|(name, values)| Values { name: name.into(), values });
        let numbers = |points: Vec<Numbers>| -> Vec<Vec<f64>> {
            points.into_iter().map(|point| point.into_iter().map(|(_, value)| value).collect()).collect()
        };
        let all = numbers(combinations(&set, false).unwrap());
        assert_eq!(all, [[1.0, 3.0], [1.0, 4.0], [2.0, 3.0], [2.0, 4.0]]);
        assert_eq!(numbers(combinations(&set, true).unwrap()), [[1.0, 3.0], [2.0, 4.0]]);
        let other = [set[0].clone(), Values { name: "b".into(), values: vec![1.0] }];
        assert!(combinations(&other, true).is_err());
    }

    #[test]
    fn normal_draws_have_mean_0_and_variance_1() {
        let mut draws = Draw(7);
        let values: Vec<f64> = (0..20_000).map(|_| draws.normal()).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let variance = values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64;
        // Four and a half standard errors.
        assert!(
            mean.abs() < 4.5 / 20_000_f64.sqrt() && (variance - 1.0).abs() < 4.5 * (2.0 / 20_000_f64).sqrt()
        );
    }
}
