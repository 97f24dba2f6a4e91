//! The values that a sweep gives to numbers, as they are written on the command line.

use crate::cli::trace::between_commas;
use crate::run::sweep::{Axis, MOST_POINTS, Tolerance};
use crate::scene::units;

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

pub(super) fn parse_values(text: &str) -> std::result::Result<Axis, String> {
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
    Ok(Axis { name, values })
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
}
