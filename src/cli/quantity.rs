//! Fractions and times as people write them: `1%`, `0.01`, `30s`, `5m`, `1.5h`.

use std::time::Duration;

/// Parses a fraction between 0 and 1. A bare `1` may mean 1 % or 100 %, and is refused.
pub fn parse_fraction(text: &str) -> Result<f64, String> {
    let trimmed = text.trim();
    let (number, scale) = match trimmed.strip_suffix('%') {
        Some(number) => (number.trim(), 0.01),
        None => (trimmed, 1.0),
    };
    match number.parse::<f64>() {
        Ok(value) if value > 0.0 && value * scale < 1.0 => Ok(value * scale),
        _ => Err(format!("`{text}` is not a fraction between 0 and 1; write 1% or 0.01")),
    }
}

/// Parses a time; without a unit, the time is in seconds.
pub fn parse_time(text: &str) -> Result<Duration, String> {
    let expected = || format!("`{text}` is not a time above 0; write 30s, 5m or 1.5h");
    let trimmed = text.trim();
    let units = [("ms", 1e-3), ("s", 1.0), ("m", 60.0), ("h", 3600.0)];
    let with_unit = units.into_iter().find_map(|(unit, scale)| Some((trimmed.strip_suffix(unit)?, scale)));
    let (number, scale) = with_unit.unwrap_or((trimmed, 1.0));
    let seconds = number.trim().parse::<f64>().map_err(|_| expected())? * scale;
    let time = Duration::try_from_secs_f64(seconds).map_err(|_| expected())?;
    if time.is_zero() { Err(expected()) } else { Ok(time) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fractions_read_as_people_write_them() {
        assert_eq!(parse_fraction("1%"), Ok(0.01));
        assert_eq!(parse_fraction(" 2.5 % "), Ok(0.025));
        assert_eq!(parse_fraction("0.03"), Ok(0.03));
        for wrong in ["0", "-1%", "nan", "inf", "%", "", "one", "1", "1.5", "100%"] {
            assert!(parse_fraction(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn times_read_as_people_write_them() {
        for (text, ms) in
            [("30s", 30_000), ("90", 90_000), ("5m", 300_000), ("1.5h", 5_400_000), ("200ms", 200)]
        {
            assert_eq!(parse_time(text), Ok(Duration::from_millis(ms)), "{text}");
        }
        for wrong in ["0", "-1s", "nan", "inf", "s", "", "1d", "1e400"] {
            assert!(parse_time(wrong).is_err(), "{wrong}");
        }
    }
}
