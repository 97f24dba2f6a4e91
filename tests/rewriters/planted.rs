//! Errors planted in rewritten texts, one operation at a time, and the texts of single functions.

/// The range of a function's text.
fn range_of(text: &str, name: &str) -> Option<std::ops::Range<usize>> {
    let first = text.find(&format!("fn {name}("))?;
    let length = text[first..].find("\n}\n")? + 3;
    Some(first..first + length)
}

/// The texts of all functions whose names begin so.
pub fn functions_of(text: &str, names: &[&str]) -> String {
    let heads = text.match_indices("\nfn ").map(|(at, _)| &text[at + 4..]);
    let found = heads.filter(|head| names.iter().any(|name| head.starts_with(name)));
    let names = found.filter_map(|head| head.split_once('(').map(|(name, _)| name));
    names.filter_map(|name| range_of(text, name)).map(|range| format!("{}\n", &text[range])).collect()
}

/// Replaces the operation of a number in a function by another one. Gives what was replaced, or nothing if the function has
/// fewer operations. Integers stay as they are: a loop must end.
pub fn spoil(text: &mut String, name: &str, number: usize) -> Option<String> {
    const OTHERS: [(&str, &str); 7] = [
        (" + ", " - "),
        (" - ", " + "),
        (" * ", " / "),
        (" / ", " * "),
        ("(-(", "(+("),
        ("dot(", "0.5lf * dot("),
        ("cross(", "-cross("),
    ];
    let range = range_of(text, name)?;
    let body = &text[range.clone()];
    let mut all: Vec<(usize, &str, &str)> = OTHERS
        .iter()
        .flat_map(|(old, new)| body.match_indices(old).map(move |(at, _)| (at, *old, *new)))
        .filter(|(at, ..)| {
            let line = body[*at..].lines().next().unwrap_or_default();
            let is_integer =
                |word: &str| word.ends_with('u') && word.starts_with(|c: char| c.is_ascii_digit());
            !line.split(|c: char| !c.is_ascii_alphanumeric()).any(is_integer)
        })
        .collect();
    all.sort_unstable();
    let (at, old, new) = *all.get(number)?;
    let line = body[..at].rfind('\n').map_or(0, |at| at + 1);
    let what = format!("{}: {old}, not {new}", body[line..].lines().next().unwrap_or_default().trim());
    let new = if new == "(+(" { "((" } else { new };
    text.replace_range(range.start + at..range.start + at + old.len(), new);
    Some(what)
}
