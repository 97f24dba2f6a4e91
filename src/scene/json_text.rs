//! Scene text -> a tree of JSON values.
//!
//! Python writes a flat surface's radius as bare `Infinity`, which JSON forbids and JSON5 allows, so the text is read
//! as JSON5. The tree cannot hold such numbers; it carries them as the strings that Python prints.

use std::cell::{Cell, RefCell};

use indexmap::IndexMap;
use serde::de::{self, DeserializeSeed, Deserializer, MapAccess, SeqAccess, Visitor};
use serde_json::Number;

use crate::model::key_path::KeyPath;
use crate::scene::json_tree::{Array, Value};
use crate::{Error, Result};

/// Longest scene text that is read \[bytes\]; numbers in rows take at most four times as much memory, and twice that while they
/// grow.
pub(super) const MAX_BYTES: usize = 256 << 20;

/// Most values that are not numbers in a row: of 100 bytes or more each.
const MAX_VALUES: usize = 1 << 24;

/// Deepest nesting of arrays and objects: parsing recurses, and the stack must not run out.
const MAX_DEPTH: usize = 128;

/// Reads JSON or JSON5 text, refusing duplicate keys, deep nesting and absurd length.
pub(super) fn parse(text: &str) -> Result<Value> {
    if text.len() > MAX_BYTES {
        return Err(Error::scene(
            "the scene file",
            format!("it is longer than {MAX_BYTES} bytes"),
            "keep large data such as meshes in files of their own",
        ));
    }
    let refusal = RefCell::new(None);
    let (num_values, has_infinity) = (Cell::new(0), Cell::new(false));
    let root = Node {
        depth: 0,
        place: KeyPath::Root,
        refusal: &refusal,
        num_values: &num_values,
        has_infinity: &has_infinity,
    };
    let mut deserializer = json5::Deserializer::from_str(text);
    let parsed = root.deserialize(&mut deserializer).and_then(|value| at_end(&mut deserializer, value));
    // The parser takes 1e309 for Infinity, which is a radius. As a text it is a number nowhere.
    if let Some(quoted) = has_infinity.get().then(|| with_large_numbers_quoted(text)).flatten() {
        return parse(&quoted);
    }
    match (refusal.into_inner(), parsed) {
        (Some(refused), _) => Err(refused),
        (None, parsed) => parsed.map_err(|err| syntax_error(text, &err)),
    }
}

/// The text with quotes about each number beyond the largest; none if it has no such number.
fn with_large_numbers_quoted(text: &str) -> Option<String> {
    let mut quoted = String::new();
    let (mut written, mut at) = (0, 0);
    while let Some(first) = text[at..].chars().next() {
        let rest = &text[at..];
        let skipped = match first {
            '"' | '\'' => {
                let mut escaped = false;
                let end = rest[1..].find(|c| {
                    let is_end = c == first && !escaped;
                    escaped = c == '\\' && !escaped;
                    is_end
                });
                end.map(|end| end + 2)
            }
            '/' if rest.starts_with("/*") => rest[2..].find("*/").map(|end| end + 4),
            '/' => rest.find(['\n', '\r', '\u{2028}', '\u{2029}']),
            c if c.is_alphanumeric() || "_$+-.".contains(c) => {
                let word = rest.split(|c: char| !(c.is_alphanumeric() || "_$+-.".contains(c))).next()?;
                if is_too_large(word) {
                    quoted.extend([&text[written..at], "\"", word, "\""]);
                    written = at + word.len();
                }
                Some(word.len())
            }
            c => Some(c.len_utf8()),
        };
        at += skipped.unwrap_or(rest.len());
    }
    (written > 0).then(|| quoted + &text[written..])
}

/// True for a decimal number that no f64 holds.
pub(super) fn is_too_large(word: &str) -> bool {
    word.contains(|c: char| c.is_ascii_digit()) && word.parse::<f64>().is_ok_and(f64::is_infinite)
}

/// The value, if nothing but white space and comments follows it.
fn at_end(rest: &mut json5::Deserializer<'_>, value: Value) -> std::result::Result<Value, json5::Error> {
    match rest.deserialize_any(Nothing) {
        Err(err) if err.code() == Some(json5::ErrorCode::EofParsingValue) => Ok(value),
        Err(err) => Err(err),
        Ok(()) => Ok(value),
    }
}

/// A visitor that takes no value: where one comes, the text goes on after its end.
struct Nothing;

impl Visitor<'_> for Nothing {
    type Value = ();

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("the end of the scene")
    }
}

fn syntax_error(text: &str, err: &json5::Error) -> Error {
    let (line, column) = match err.position() {
        Some(at) => (at.line + 1, at.column + 1),
        None => end_of(text),
    };
    let place = format!("line {line}, column {column}");
    let cause = err.code().map_or_else(|| err.to_string(), |code| code.to_string());
    if text.trim().is_empty() {
        return Error::scene(place, "the file is empty", "give the path of a scene file");
    }
    // At the end of the text, the parser points at the innermost bracket that is still open.
    if cause.starts_with("EOF") {
        return Error::scene(
            place,
            "the text ends before what opens here is closed",
            "close it; is the file whole?",
        );
    }
    let remedy = "check the brackets, commas and quotes before this point";
    Error::scene(place, format!("the text is not JSON: {cause}"), remedy)
}

/// Line and column just past the last character, from 1.
fn end_of(text: &str) -> (usize, usize) {
    let last = text.rsplit('\n').next().unwrap_or("");
    (text.matches('\n').count() + 1, last.chars().count() + 1)
}

/// A seed that reads one value, knowing where it stands.
#[derive(Clone, Copy)]
struct Node<'a> {
    depth: usize,
    place: KeyPath<'a>,
    /// Where a refusal that is not about syntax waits while the parser unwinds.
    refusal: &'a RefCell<Option<Error>>,
    /// Values that are stored one by one.
    num_values: &'a Cell<usize>,
    /// Set where a number is infinite.
    has_infinity: &'a Cell<bool>,
}

impl Node<'_> {
    fn refuse<E: de::Error>(&self, problem: String, remedy: &str) -> E {
        let place = match self.place {
            KeyPath::Root => "the scene file".to_owned(),
            place @ (KeyPath::Key(..) | KeyPath::Index(..)) => place.to_string(),
        };
        self.refusal.borrow_mut().get_or_insert_with(|| Error::scene(place, problem, remedy));
        E::custom("refused")
    }

    /// Notes that so many more values are stored one by one.
    fn count<E: de::Error>(&self, more: usize) -> std::result::Result<(), E> {
        self.num_values.set(self.num_values.get().saturating_add(more));
        if self.num_values.get() <= MAX_VALUES {
            return Ok(());
        }
        self.refusal.borrow_mut().get_or_insert_with(|| {
            Error::scene(
                "the scene file",
                format!("it holds more than {MAX_VALUES} values beside rows of numbers"),
                "keep large data such as meshes in files of their own",
            )
        });
        Err(E::custom("refused"))
    }

    fn check_depth<E: de::Error>(&self) -> std::result::Result<(), E> {
        if self.depth < MAX_DEPTH {
            return Ok(());
        }
        // The full place would be as deep as the nesting itself.
        self.refusal.borrow_mut().get_or_insert_with(|| {
            Error::scene(
                "the scene file",
                format!("arrays and objects are nested deeper than {MAX_DEPTH} levels"),
                "flatten it; a chain of reference_cs can be combined into one",
            )
        });
        Err(E::custom("refused"))
    }
}

impl<'de> DeserializeSeed<'de> for Node<'_> {
    type Value = Value;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> std::result::Result<Value, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Node<'_> {
    type Value = Value;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a JSON value")
    }

    fn visit_unit<E>(self) -> std::result::Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_bool<E>(self, value: bool) -> std::result::Result<Value, E> {
        Ok(Value::Bool(value))
    }

    fn visit_u64<E>(self, value: u64) -> std::result::Result<Value, E> {
        Ok(Value::Number(value.into()))
    }

    fn visit_i64<E>(self, value: i64) -> std::result::Result<Value, E> {
        Ok(Value::Number(value.into()))
    }

    fn visit_f64<E>(self, value: f64) -> std::result::Result<Value, E> {
        self.has_infinity.set(self.has_infinity.get() || value.is_infinite());
        Ok(match Number::from_f64(value) {
            Some(number) => Value::Number(number),
            None if value.is_nan() => Value::String("NaN".into()),
            None if value > 0.0 => Value::String("Infinity".into()),
            None => Value::String("-Infinity".into()),
        })
    }

    fn visit_str<E>(self, value: &str) -> std::result::Result<Value, E> {
        Ok(Value::String(value.into()))
    }

    fn visit_string<E>(self, value: String) -> std::result::Result<Value, E> {
        Ok(Value::String(value.into()))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> std::result::Result<Value, A::Error> {
        self.check_depth()?;
        let mut array = Array::default();
        loop {
            let place = KeyPath::Index(&self.place, array.len());
            let item = Node { depth: self.depth + 1, place, ..self };
            match items.next_element_seed(item)? {
                Some(value) => self.count(array.push(value))?,
                None => {
                    array.shrink();
                    return Ok(Value::Array(array));
                }
            }
        }
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> std::result::Result<Value, A::Error> {
        self.check_depth()?;
        let mut object = IndexMap::new();
        while let Some(key) = entries.next_key::<String>()? {
            let place = KeyPath::Key(&self.place, &key);
            let item = Node { depth: self.depth + 1, place, ..self };
            self.count(1)?;
            if object.contains_key(&key) {
                return Err(item.refuse("the key stands here twice".to_owned(), "remove one of the two"));
            }
            let value = entries.next_value_seed(item)?;
            object.insert(key, value);
        }
        object.shrink_to_fit();
        Ok(Value::Object(Box::new(object)))
    }
}
