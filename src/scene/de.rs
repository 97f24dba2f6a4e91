//! A tree of JSON values -> typed structs, by serde, with errors that name the place and the remedy.
//!
//! Two things differ from serde_json's own deserializer. An enum is read from an object by its `type` key without
//! buffering, so that paths stay whole. An enum takes other kinds of JSON by variants named `$null`, `$number`,
//! `$string` and `$object` (an object without `type`). Numbers accept the strings that [`crate::scene::json_text`]
//! writes for the non-finite ones.

use indexmap::IndexMap;
use serde::de::value::StrDeserializer;
use serde::de::{
    self, DeserializeSeed, Deserializer, EnumAccess, MapAccess, SeqAccess, VariantAccess, Visitor,
};
use serde::forward_to_deserialize_any;
use serde_json::Number;
use serde_path_to_error::Segment;

use crate::model::key_path::{did_you_mean, key_of, quoted, ticked};
use crate::scene::json_text::is_too_large;
use crate::scene::json_tree::{Array, Value, View};
use crate::{Error, Result};

/// The key that names the kind of an object.
const TAG: &str = "type";

/// Reads `value` as a `T`.
pub(super) fn typed<'de, T: de::Deserialize<'de>>(value: &'de Value) -> Result<T> {
    serde_path_to_error::deserialize(Tree::new(View::Value(value))).map_err(|err| {
        let place = err.path().iter().fold(String::new(), |place, segment| match segment {
            Segment::Seq { index } => format!("{place}[{index}]"),
            Segment::Map { key } => key_of(&place, key),
            Segment::Enum { .. } | Segment::Unknown => place,
        });
        err.into_inner().at(&place)
    })
}

/// What can be wrong with a value.
#[derive(Debug)]
enum Fault {
    UnknownKey { key: String, known: &'static [&'static str] },
    UnknownWord { word: String, known: &'static [&'static str] },
    UnknownType { word: String, known: &'static [&'static str] },
    MissingKey(&'static str),
    MissingType { known: &'static [&'static str] },
    Kind { found: String, wanted: String },
    Other(String),
}

impl Fault {
    fn at(self, place: &str) -> Error {
        let here = if place.is_empty() { "the scene file" } else { place };
        match self {
            Fault::UnknownKey { key, known } => {
                // The path tracker already ends with the key where it saw one.
                let own = key_of("", &key);
                let place = if place.ends_with(&own) { place.to_owned() } else { key_of(place, &key) };
                Error::scene(place, format!("unknown key {}", ticked(&key)), did_you_mean(&key, words(known)))
            }
            Fault::UnknownWord { word, known } => Error::scene(
                here,
                format!("unknown value {}", quoted(&word)),
                did_you_mean(&word, words(known)),
            ),
            Fault::UnknownType { word, known } => {
                let remedy = did_you_mean(&word, words(known));
                Error::scene(key_of(place, TAG), format!("unknown type {}", quoted(&word)), remedy)
            }
            Fault::MissingKey(key) => Error::scene(here, format!("the key `{key}` is missing"), "add it"),
            Fault::MissingType { known } => Error::scene(
                here,
                "the key `type` is missing",
                format!("add it; {}", did_you_mean("", words(known))),
            ),
            Fault::Kind { found, wanted } => {
                Error::scene(here, format!("found {found}"), format!("expected {wanted}"))
            }
            Fault::Other(problem) => Error::scene(here, problem, "see the schema of scene files"),
        }
    }
}

/// The variants that a user can write, without the internal `$` ones.
fn words(known: &'static [&'static str]) -> impl Iterator<Item = &'static str> + Clone {
    known.iter().copied().filter(|word| !word.starts_with('$'))
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{self:?}")
    }
}

impl std::error::Error for Fault {}

impl de::Error for Fault {
    fn custom<T: std::fmt::Display>(problem: T) -> Self {
        Fault::Other(problem.to_string())
    }

    fn invalid_type(found: de::Unexpected<'_>, wanted: &dyn de::Expected) -> Self {
        Fault::Kind { found: found.to_string(), wanted: wanted.to_string() }
    }

    fn invalid_value(found: de::Unexpected<'_>, wanted: &dyn de::Expected) -> Self {
        Fault::Kind { found: found.to_string(), wanted: wanted.to_string() }
    }

    fn unknown_field(key: &str, known: &'static [&'static str]) -> Self {
        Fault::UnknownKey { key: key.to_owned(), known }
    }

    fn unknown_variant(word: &str, known: &'static [&'static str]) -> Self {
        Fault::UnknownWord { word: word.to_owned(), known }
    }

    fn missing_field(key: &'static str) -> Self {
        Fault::MissingKey(key)
    }
}

type Outcome<T> = std::result::Result<T, Fault>;

/// One value of the tree; for an object whose `type` was read already, `skip` hides that key.
#[derive(Clone, Copy)]
struct Tree<'de> {
    value: View<'de>,
    skip: Option<&'static str>,
}

impl<'de> Tree<'de> {
    fn new(value: View<'de>) -> Self {
        Tree { value, skip: None }
    }

    fn wrong<T>(&self, wanted: &str) -> Outcome<T> {
        Err(Fault::Kind { found: describe(self.value), wanted: wanted.to_owned() })
    }

    fn real(&self) -> Option<f64> {
        match self.value {
            View::Number(number) => Some(number),
            View::Value(Value::Number(number)) => number.as_f64(),
            View::Value(Value::String(word)) if &**word == "Infinity" => Some(f64::INFINITY),
            View::Value(Value::String(word)) if &**word == "-Infinity" => Some(f64::NEG_INFINITY),
            _ => None,
        }
    }

    fn is_too_large(&self) -> bool {
        matches!(self.value, View::Value(Value::String(text)) if is_too_large(text))
    }

    fn whole(&self) -> Option<u64> {
        match self.value {
            View::Number(number) => whole_of(number),
            View::Value(Value::Number(number)) => whole(number),
            _ => None,
        }
    }

    fn items(&self) -> Option<Items<'de>> {
        match self.value {
            View::Row(row) => Some(Items::Row(row.iter())),
            View::Value(Value::Array(array)) => Some(Items::Array { array, next: 0 }),
            View::Number(_) | View::Value(_) => None,
        }
    }

    fn object(&self) -> Option<&'de IndexMap<String, Value>> {
        match self.value {
            View::Value(value) => value.object(),
            View::Number(_) | View::Row(_) => None,
        }
    }

    /// The JSON kind as a variant name of an enum that takes it.
    fn kind(&self) -> &'static str {
        match self.value {
            _ if self.real().is_some() => "$number",
            View::Value(Value::Null) => "$null",
            View::Value(Value::String(_)) => "$string",
            View::Value(Value::Object(_)) => "$object",
            View::Value(Value::Bool(_) | Value::Array(_) | Value::Number(_))
            | View::Number(_)
            | View::Row(_) => "$other",
        }
    }
}

fn describe(value: View<'_>) -> String {
    match value {
        View::Value(Value::Null) => "null".to_owned(),
        View::Value(Value::Bool(value)) => value.to_string(),
        View::Value(Value::Number(number)) => format!("the number {number}"),
        View::Number(number) => format!("the number {number}"),
        View::Value(Value::String(text)) if &**text == "NaN" => "NaN, which is not a number".to_owned(),
        View::Value(Value::String(text)) if is_too_large(text) => {
            format!("the number {}, which is beyond the largest, {:e}", ticked(text), f64::MAX)
        }
        View::Value(Value::String(text)) => format!("the text {}", quoted(text)),
        View::Value(Value::Array(_)) | View::Row(_) => "an array".to_owned(),
        View::Value(Value::Object(_)) => "an object".to_owned(),
    }
}

/// Whole numbers may be written as `1e3`.
fn whole(number: &Number) -> Option<u64> {
    number.as_u64().or_else(|| number.as_f64().and_then(whole_of))
}

fn whole_of(number: f64) -> Option<u64> {
    const EXACT: f64 = 9_007_199_254_740_992.0;
    (number.fract() == 0.0 && (0.0..=EXACT).contains(&number)).then_some(number as u64)
}

impl<'de> Deserializer<'de> for Tree<'de> {
    type Error = Fault;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Outcome<V::Value> {
        match self.value {
            View::Value(Value::Null) => visitor.visit_unit(),
            View::Value(Value::Bool(value)) => visitor.visit_bool(*value),
            View::Value(Value::Number(_)) | View::Number(_) => self.deserialize_f64(visitor),
            View::Value(Value::String(text)) => visitor.visit_borrowed_str(text),
            View::Value(Value::Array(_)) | View::Row(_) => self.deserialize_seq(visitor),
            View::Value(Value::Object(object)) => visitor.visit_map(Entries::new(object, self.skip)),
        }
    }

    fn deserialize_f64<V: Visitor<'de>>(self, visitor: V) -> Outcome<V::Value> {
        match self.real() {
            Some(value) => visitor.visit_f64(value),
            None if self.is_too_large() => self.wrong("a finite number"),
            None => self.wrong("a number"),
        }
    }

    fn deserialize_u64<V: Visitor<'de>>(self, visitor: V) -> Outcome<V::Value> {
        match self.whole() {
            Some(number) => visitor.visit_u64(number),
            None => self.wrong("a whole number, 0 or above"),
        }
    }

    fn deserialize_u32<V: Visitor<'de>>(self, visitor: V) -> Outcome<V::Value> {
        match self.whole().filter(|number| *number <= u64::from(u32::MAX)) {
            Some(number) => visitor.visit_u64(number),
            None => self.wrong("a whole number from 0 to 4294967295"),
        }
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Outcome<V::Value> {
        match self.value {
            View::Value(Value::Bool(value)) => visitor.visit_bool(*value),
            _ => self.wrong("true or false"),
        }
    }

    fn deserialize_str<V: Visitor<'de>>(self, visitor: V) -> Outcome<V::Value> {
        match self.value {
            View::Value(Value::String(text)) => visitor.visit_borrowed_str(text),
            _ => self.wrong("a text in quotes"),
        }
    }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Outcome<V::Value> {
        self.deserialize_str(visitor)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Outcome<V::Value> {
        match self.items() {
            Some(items) => visitor.visit_seq(items),
            None => self.wrong("an array"),
        }
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, len: usize, visitor: V) -> Outcome<V::Value> {
        match self.items().filter(|items| items.size_hint() == Some(len)) {
            Some(items) => visitor.visit_seq(items),
            None => self.wrong(&format!("an array of {len} items")),
        }
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Outcome<V::Value> {
        match self.object() {
            Some(object) => visitor.visit_map(Entries::new(object, self.skip)),
            None => self.wrong("an object"),
        }
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        _fields: &'static [&'static str],
        visitor: V,
    ) -> Outcome<V::Value> {
        self.deserialize_map(visitor)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Outcome<V::Value> {
        match self.value {
            View::Value(Value::Null) => visitor.visit_none(),
            _ => visitor.visit_some(self),
        }
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _name: &'static str,
        visitor: V,
    ) -> Outcome<V::Value> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _name: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Outcome<V::Value> {
        let kind = self.kind();
        if let Some(tag) = self.object().and_then(|object| object.get(TAG)) {
            let Value::String(tag) = tag else {
                return Tree::new(View::Value(tag)).wrong("a text in quotes for `type`");
            };
            if !words(variants).any(|word| word == &**tag) {
                return Err(Fault::UnknownType { word: tag.to_string(), known: variants });
            }
            return visitor.visit_enum(Variant { tag, body: Tree { value: self.value, skip: Some(TAG) } });
        }
        if variants.contains(&kind) {
            return visitor.visit_enum(Variant { tag: kind, body: self });
        }
        match self.value {
            View::Value(Value::String(word)) if words(variants).next().is_some() => {
                visitor.visit_enum(Variant { tag: word, body: self })
            }
            View::Value(Value::Object(_)) => Err(Fault::MissingType { known: variants }),
            _ => self.wrong(&choices(variants)),
        }
    }

    forward_to_deserialize_any! {
        i8 i16 i32 i64 i128 u8 u16 u128 f32 char bytes byte_buf unit unit_struct tuple_struct identifier ignored_any
    }
}

/// What an enum takes, in words.
fn choices(variants: &'static [&'static str]) -> String {
    let listed: Vec<String> = words(variants).map(ticked).collect();
    let number = if variants.contains(&"$number") { " or a number" } else { "" };
    format!("one of {}{number}", listed.join(", "))
}

enum Items<'de> {
    Array { array: &'de Array, next: usize },
    Row(std::slice::Iter<'de, f64>),
}

impl<'de> SeqAccess<'de> for Items<'de> {
    type Error = Fault;

    fn next_element_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Outcome<Option<T::Value>> {
        let item = match self {
            Items::Array { array, next } => {
                *next += 1;
                array.get(*next - 1)
            }
            Items::Row(numbers) => numbers.next().copied().map(View::Number),
        };
        item.map(|value| seed.deserialize(Tree::new(value))).transpose()
    }

    fn size_hint(&self) -> Option<usize> {
        Some(match self {
            Items::Array { array, next } => array.len().saturating_sub(*next),
            Items::Row(numbers) => numbers.len(),
        })
    }
}

struct Entries<'de> {
    entries: indexmap::map::Iter<'de, String, Value>,
    skip: Option<&'static str>,
    value: Option<&'de Value>,
}

impl<'de> Entries<'de> {
    fn new(object: &'de IndexMap<String, Value>, skip: Option<&'static str>) -> Self {
        Entries { entries: object.iter(), skip, value: None }
    }
}

impl<'de> MapAccess<'de> for Entries<'de> {
    type Error = Fault;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Outcome<Option<K::Value>> {
        let skip = self.skip;
        let Some((key, value)) = self.entries.find(|(key, _)| skip != Some(key.as_str())) else {
            return Ok(None);
        };
        self.value = Some(value);
        seed.deserialize(StrDeserializer::new(key)).map(Some)
    }

    fn next_value_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Outcome<T::Value> {
        match self.value.take() {
            Some(value) => seed.deserialize(Tree::new(View::Value(value))),
            None => Err(Fault::Other("a value was read before its key".to_owned())),
        }
    }
}

struct Variant<'de> {
    tag: &'de str,
    body: Tree<'de>,
}

impl<'de> EnumAccess<'de> for Variant<'de> {
    type Error = Fault;
    type Variant = Tree<'de>;

    fn variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Outcome<(T::Value, Tree<'de>)> {
        Ok((seed.deserialize(StrDeserializer::new(self.tag))?, self.body))
    }
}

impl<'de> VariantAccess<'de> for Tree<'de> {
    type Error = Fault;

    fn unit_variant(self) -> Outcome<()> {
        match self.value {
            View::Value(Value::String(_) | Value::Null) => Ok(()),
            _ => self.wrong("a text in quotes"),
        }
    }

    fn newtype_variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Outcome<T::Value> {
        seed.deserialize(self)
    }

    fn tuple_variant<V: Visitor<'de>>(self, len: usize, visitor: V) -> Outcome<V::Value> {
        self.deserialize_tuple(len, visitor)
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        _fields: &'static [&'static str],
        visitor: V,
    ) -> Outcome<V::Value> {
        self.deserialize_map(visitor)
    }
}
