//! Paths to keys in a scene file, as error messages name them: `components[2].config.thickness`.

/// How much of the user's text a message shows \[characters\].
const LONGEST_SHOWN: usize = 60;

/// Where a value stands in the file, as a chain on the stack.
#[derive(Clone, Copy)]
pub(crate) enum KeyPath<'a> {
    Root,
    Key(&'a KeyPath<'a>, &'a str),
    Index(&'a KeyPath<'a>, usize),
}

impl std::fmt::Display for KeyPath<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            KeyPath::Root => Ok(()),
            KeyPath::Key(parent, key) => f.write_str(&key_of(&parent.to_string(), key)),
            KeyPath::Index(parent, index) => write!(f, "{parent}[{index}]"),
        }
    }
}

/// The place of a key of the object at `parent`.
pub(crate) fn key_of(parent: &str, key: &str) -> String {
    let plain =
        (1..=LONGEST_SHOWN).contains(&key.len()) && key.chars().all(|c| c.is_alphanumeric() || c == '_');
    match (plain, parent.is_empty()) {
        (true, true) => key.to_owned(),
        (true, false) => format!("{parent}.{key}"),
        (false, _) => format!("{parent}[{}]", quoted(key)),
    }
}

/// Text of the user's as a message shows it: escaped and cut, so that no file can garble or flood a terminal.
pub(crate) fn quoted(text: &str) -> String {
    let mut shown: String = text.chars().take(LONGEST_SHOWN).collect();
    if text.chars().nth(LONGEST_SHOWN).is_some() {
        shown.push('…');
    }
    format!("{shown:?}")
}

/// A word of the file, escaped likewise, in the backticks that mark keys and types.
pub(crate) fn ticked(word: &str) -> String {
    let shown = quoted(word);
    format!("`{}`", &shown[1..shown.len() - 1])
}

/// The known word nearest to a misspelt one, if any is near.
pub(crate) fn nearest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    /// More candidates would take seconds.
    const MAX_CANDIDATES: usize = 10_000;
    let short: String = word.chars().take(80).collect();
    let lower = short.to_lowercase();
    known
        .into_iter()
        .take(MAX_CANDIDATES)
        .map(|candidate| {
            // A capital is the smallest of mistakes.
            let is_alike = lower == candidate.to_lowercase();
            (if is_alike { 0 } else { strsim::damerau_levenshtein(&short, candidate) }, candidate)
        })
        .filter(|(distance, candidate)| *distance <= 1 + candidate.chars().count() / 3)
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, candidate)| candidate)
}

/// Advice to take a known word.
pub(crate) fn suggested(known: &str) -> String {
    format!("did you mean {}?", ticked(known))
}

/// Advice for an unknown word: the nearest known one, else all of them.
pub(crate) fn did_you_mean<'a>(word: &str, known: impl IntoIterator<Item = &'a str> + Clone) -> String {
    if let Some(candidate) = nearest(word, known.clone()) {
        return suggested(candidate);
    }
    let all: Vec<String> = known.into_iter().take(20).map(ticked).collect();
    if all.is_empty() { "remove it".to_owned() } else { format!("known here: {}", all.join(", ")) }
}
