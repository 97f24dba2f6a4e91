//! Numbers and names for people.

use std::path::Path;

/// True for a character that moves a terminal's cursor, breaks a line, or turns the order in which text is read.
fn is_active(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// A name as tables, warnings and pictures show it: [`plain`], and cut after 60 characters. A scene may use any text as a
/// name, but no name may garble a terminal or flood it.
pub(crate) fn shown(name: &str) -> String {
    const MOST_CHARACTERS: usize = 60;
    let mut shown: String = plain(&name.chars().take(MOST_CHARACTERS).collect::<String>());
    if name.chars().nth(MOST_CHARACTERS).is_some() {
        shown.push('…');
    }
    shown
}

/// Text on one line, whose active characters are escaped.
pub(crate) fn plain(text: &str) -> String {
    escaped(text, &[])
}

/// Bytes as hexadecimal digits, such as the bytes of a hash.
pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A path on one line, whose active characters are escaped.
pub(crate) fn path_text(path: &Path) -> String {
    plain(&path.display().to_string())
}

/// Text as it goes to a terminal: active characters are escaped, but for the ends of lines and tabs.
pub(crate) fn for_terminal(text: &str) -> String {
    escaped(text, &['\n', '\t'])
}

fn escaped(text: &str, kept: &[char]) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        if is_active(c) && !kept.contains(&c) { escaped.extend(c.escape_default()) } else { escaped.push(c) }
    }
    escaped
}

/// A value as indented JSON that ends in a line break. Active characters, which stand in strings alone, are written as
/// `\u202e`, which means the same.
pub fn pretty_json(value: &impl serde::Serialize) -> serde_json::Result<String> {
    let text = serde_json::to_string_pretty(value)? + "\n";
    let mut safe = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            c if c != '\n' && is_active(c) => safe.push_str(&format!("\\u{:04x}", u32::from(c))),
            c => safe.push(c),
        }
    }
    Ok(safe)
}

/// A text as a cell of comma-separated values, quoted where RFC 4180 asks for it. An apostrophe comes before what a
/// spreadsheet would run as a formula: a scene may come from anywhere.
pub(crate) fn csv_text(text: &str) -> String {
    let apostrophe = if text.starts_with(['=', '+', '-', '@', '\t', '\r', '\n']) { "'" } else { "" };
    match text.contains([',', '"', '\n', '\r']) {
        true => format!("\"{apostrophe}{}\"", text.replace('"', "\"\"")),
        false => format!("{apostrophe}{text}"),
    }
}

/// `value` with `digits` significant digits, without trailing zeros; in exponential form outside 1e-4 to 1e9.
pub(crate) fn significant(value: f64, digits: usize) -> String {
    if value == 0.0 || !value.is_finite() {
        return if value == 0.0 { "0".into() } else { value.to_string() };
    }
    let scientific = format!("{value:.*e}", digits - 1);
    let (mantissa, exponent) = scientific.split_once('e').unwrap_or((&scientific, "0"));
    let exponent: i32 = exponent.parse().unwrap_or(0);
    if (-4..9).contains(&exponent) {
        let decimals = (digits as i32 - 1 - exponent).max(0) as usize;
        trim_zeros(&format!("{value:.decimals$}")).into()
    } else {
        format!("{}e{exponent}", trim_zeros(mantissa))
    }
}

/// As many digits of a value as give its error two; seven where no error is known.
pub(crate) fn digits_beside(value: f64, error: Option<f64>) -> usize {
    let known = error.filter(|error| *error > 0.0 && error.is_finite() && value != 0.0);
    let place = |value: f64| value.abs().log10().floor();
    known.map_or(7, |error| (place(value) - place(error) + 2.0).clamp(2.0, 15.0) as usize)
}

fn trim_zeros(number: &str) -> &str {
    if number.contains('.') { number.trim_end_matches('0').trim_end_matches('.') } else { number }
}

/// A value in standard errors: infinite if the only error is rounding, and `None` if the error is not known. The value
/// is a difference of numbers as large as `scale`: what their rounding leaves counts as 0.
pub(crate) fn sigmas(value: f64, error: Option<f64>, scale: f64) -> Option<f64> {
    const ROUNDING: f64 = 1e-12;
    match error {
        _ if value.abs() <= ROUNDING * scale => Some(0.0),
        Some(error) if error > ROUNDING * value.abs() => Some(value / error),
        Some(_) => Some(f64::INFINITY),
        None => None,
    }
}

/// [`sigmas`] in a table.
pub(crate) fn score(value: f64, error: Option<f64>, scale: f64) -> String {
    sigmas(value, error, scale).map_or("-".into(), |sigmas| format!("{sigmas:.1}"))
}

/// Names in a sentence; of more, the sentence has the number.
pub(crate) const MOST_NAMES: usize = 8;

/// Names for a sentence: `a, b and 3 more`.
pub(crate) fn listed(names: impl ExactSizeIterator<Item = impl AsRef<str>>) -> String {
    let more = names.len().saturating_sub(MOST_NAMES);
    let names: Vec<_> = names.take(MOST_NAMES).collect();
    let names = names.iter().map(AsRef::as_ref).collect::<Vec<&str>>().join(", ");
    if more > 0 { format!("{names} and {} more", thousands(more as u64)) } else { names }
}

/// `count` with separators: 1,234,567.
pub(crate) fn thousands(count: u64) -> String {
    let digits = count.to_string();
    let groups: Vec<&str> =
        digits.as_bytes().rchunks(3).rev().map(|group| std::str::from_utf8(group).unwrap_or("")).collect();
    groups.join(",")
}

/// A fraction as a percentage.
pub(crate) fn percent(fraction: f64) -> String {
    format!("{} %", significant(100.0 * fraction, 4))
}

/// `value` with an SI prefix: (0.00123, "W") is "1.23 mW".
pub(crate) fn with_prefix(value: f64, unit: &str) -> String {
    let (factor, prefix) = si_prefix(value);
    format!("{} {prefix}{unit}", significant(value / factor, 4))
}

/// The largest SI prefix that leaves `value` at 1 or more: its factor and its letter.
pub(crate) fn si_prefix(value: f64) -> (f64, &'static str) {
    const PREFIXES: [(f64, &str); 11] = [
        (1e12, "T"),
        (1e9, "G"),
        (1e6, "M"),
        (1e3, "k"),
        (1.0, ""),
        (1e-3, "m"),
        (1e-6, "µ"),
        (1e-9, "n"),
        (1e-12, "p"),
        (1e-15, "f"),
        (1e-18, "a"),
    ];
    let fits = |&&(factor, _): &&(f64, &str)| value.abs() >= factor * (1.0 - 1e-9);
    if value == 0.0 { (1.0, "") } else { *PREFIXES.iter().find(fits).unwrap_or(&PREFIXES[10]) }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "a test may fail")]

    use super::*;

    #[test]
    fn no_active_character_is_left() {
        let text = "a\u{1b}[2J\u{7f}\u{9b}\u{202e}\u{2066}\u{200f}\u{61c}\u{2028}é\r\t\n";
        let escaped = r"a\u{1b}[2J\u{7f}\u{9b}\u{202e}\u{2066}\u{200f}\u{61c}\u{2028}é\r";
        assert_eq!(plain(text), format!(r"{escaped}\t\n"));
        assert_eq!(for_terminal(text), format!("{escaped}\t\n"));
        assert_eq!(shown(&"\u{202e}".repeat(61)), r"\u{202e}".repeat(60) + "…");
        let safe = pretty_json(&[text]).unwrap();
        assert!(safe.contains(r"a\u001b[2J\u007f\u009b\u202e\u2066\u200f\u061c\u2028é\r\t\n"), "{safe}");
        assert_eq!(serde_json::from_str::<Vec<String>>(&safe).unwrap(), [text]);
    }

    #[test]
    fn no_cell_of_a_csv_is_a_formula_or_more_than_a_cell() {
        for (text, cell) in [
            ("", ""),
            ("L1.front", "L1.front"),
            ("a = b", "a = b"),
            ("=1+1", "'=1+1"),
            ("+1", "'+1"),
            ("-1", "'-1"),
            ("@SUM(A1)", "'@SUM(A1)"),
            ("\t=1", "'\t=1"),
            ("a,b", "\"a,b\""),
            ("a\"b", "\"a\"\"b\""),
            ("a\rb\n", "\"a\rb\n\""),
            ("\r=1", "\"'\r=1\""),
            ("=HYPERLINK(\"x\",\"y\")", "\"'=HYPERLINK(\"\"x\"\",\"\"y\"\")\""),
        ] {
            assert_eq!(csv_text(text), cell, "{text:?}");
        }
    }

    #[test]
    fn numbers_read_as_people_write_them() {
        assert_eq!(significant(0.0, 4), "0");
        assert_eq!(significant(0.90449, 3), "0.904");
        assert_eq!(significant(1.0, 6), "1");
        assert_eq!(significant(1234.5678, 6), "1234.57");
        assert_eq!(significant(120.0, 2), "120");
        assert_eq!(significant(-2.5e-7, 4), "-2.5e-7");
        assert_eq!(significant(1e12, 4), "1e12");
        assert_eq!(significant(1.234_567e-8, digits_beside(1.234_567e-8, Some(1.4e-10))), "1.235e-8");
        assert_eq!(digits_beside(1.0, None), 7);
        assert_eq!(digits_beside(3e-9, Some(1e-3)), 2);
        assert_eq!(thousands(0), "0");
        assert_eq!(thousands(999), "999");
        assert_eq!(thousands(1_234_567), "1,234,567");
        assert_eq!(percent(0.5), "50 %");
        assert_eq!(with_prefix(0.00123, "W"), "1.23 mW");
        assert_eq!(with_prefix(0.0, "W"), "0 W");
        assert_eq!(with_prefix(1.0, "W"), "1 W");
        assert_eq!(with_prefix(2e-6, "W/mm²"), "2 µW/mm²");
    }
}
