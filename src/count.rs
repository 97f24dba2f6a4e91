//! Numbers of rays as people write them: `1e7`, `10M`, `250000`.

/// Beyond 2^53, a float no longer determines which integer was meant.
const MOST_IN_FLOATS: f64 = 9007199254740992.0;

/// The count that a number is, such as 1e7.
///
/// # Errors
/// What is wrong, for a number that is no count.
pub fn of_number(number: f64) -> Result<u64, String> {
    if number.fract() != 0.0 || !(0.0..=MOST_IN_FLOATS).contains(&number) {
        return Err(format!("{number} is not a number of rays; give a whole number up to 2^53, such as 1e7"));
    }
    Ok(number as u64)
}

/// Parses a count of rays; suffixes are k, M, G and B (1e3, 1e6, 1e9, 1e9).
pub fn parse(text: &str) -> Result<u64, String> {
    let expected = || format!("`{text}` is not a number of rays; write 250000, 1e7 or 10M");
    let trimmed = text.trim().replace('_', "");
    let (digits, scale) = match trimmed.char_indices().last() {
        Some((end, 'k' | 'K')) => (&trimmed[..end], 1e3),
        Some((end, 'M')) => (&trimmed[..end], 1e6),
        Some((end, 'G' | 'B')) => (&trimmed[..end], 1e9),
        _ => (trimmed.as_str(), 1.0),
    };
    if let (Ok(count), true) = (digits.parse::<u64>(), scale == 1.0) {
        return Ok(count);
    }
    let count = digits.parse::<f64>().map_err(|_| expected())? * scale;
    if count.fract() != 0.0 || count < 0.0 {
        return Err(expected());
    }
    if count > MOST_IN_FLOATS {
        return Err(format!(
            "`{text}` is too many: beyond 2^53, about 9e15, numbers are read in digits alone, up to {}",
            u64::MAX
        ));
    }
    Ok(count as u64)
}

#[cfg(test)]
mod tests {
    use crate::count::{of_number, parse};

    #[test]
    fn counts_read_as_people_write_them() {
        for (text, count) in
            [("1e7", 10_000_000), ("10M", 10_000_000), ("2.5k", 2_500), ("7", 7), ("1_000", 1_000)]
        {
            assert_eq!(parse(text), Ok(count), "{text}");
        }
        assert_eq!(parse("18446744073709551615"), Ok(u64::MAX));
    }

    #[test]
    fn invalid_counts_are_refused() {
        for text in ["", "M", "-1", "1.5", "1e30", "nan", "inf", "ten"] {
            assert!(parse(text).is_err(), "{text}");
        }
        for number in [-1.0, 1.5, 1e16, f64::NAN, f64::INFINITY] {
            assert!(of_number(number).is_err(), "{number}");
        }
        assert_eq!(of_number(1e7), Ok(10_000_000));
        assert!(parse("1e18").unwrap_err().contains("2^53"));
    }
}
