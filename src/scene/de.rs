//! A tree of JSON values -> typed structs, by serde, with errors that name the place and the remedy.
//!
//! Two things differ from serde_json's own deserializer. An enum is read from an object by its `type` key without
//! buffering, so that paths stay whole; and an enum can take other JSON kinds by variants named `$null`, `$number`,
//! `$string` and `$object` (an object without `type`). Numbers accept the strings that [`super::text`] writes for the
//! non-finite ones.

use serde::de::value::StrDeserializer;
use serde::de::{
    self, DeserializeSeed, Deserializer, EnumAccess, MapAccess, SeqAccess, VariantAccess, Visitor,
};
use serde::forward_to_deserialize_any;
use serde_json::{Map, Number, Value};
use serde_path_to_error::Segment;

use super::place::{did_you_mean, key_of, quoted, ticked};
use crate::{Error, Result};

/// The key that names the kind of an object.
const TAG: &str = "type";

/// Reads `value` as a `T`.
pub(super) fn typed<'de, T: de::Deserialize<'de>>(value: &'de Value) -> Result<T> {
    serde_path_to_error::deserialize(Tree { value, skip: None }).map_err(|err| {
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
    value: &'de Value,
    skip: Option<&'static str>,
}

impl<'de> Tree<'de> {
    fn new(value: &'de Value) -> Self {
        Tree { value, skip: None }
    }

    fn wrong<T>(&self, wanted: &str) -> Outcome<T> {
        Err(Fault::Kind { found: describe(self.value), wanted: wanted.to_owned() })
    }

    fn real(&self) -> Option<f64> {
        match self.value {
            Value::Number(number) => number.as_f64(),
            Value::String(word) if word == "Infinity" => Some(f64::INFINITY),
            Value::String(word) if word == "-Infinity" => Some(f64::NEG_INFINITY),
            _ => None,
        }
    }

    /// The JSON kind as a variant name of an enum that takes it.
    fn kind(&self) -> &'static str {
        match self.value {
            Value::Null => "$null",
            _ if self.real().is_some() => "$number",
            Value::String(_) => "$string",
            Value::Object(_) => "$object",
            Value::Bool(_) | Value::Array(_) | Value::Number(_) => "$other",
        }
    }
}

fn describe(value: &Value) -> String {
    match value {
        Value::Null => "null".to_owned(),
        Value::Bool(value) => value.to_string(),
        Value::Number(number) => format!("the number {number}"),
        Value::String(text) if text == "NaN" => "NaN, which is not a number".to_owned(),
        Value::String(text) => format!("the text {}", quoted(text)),
        Value::Array(_) => "an array".to_owned(),
        Value::Object(_) => "an object".to_owned(),
    }
}

/// Whole numbers may be written as `1e3`.
fn whole(number: &Number) -> Option<u64> {
    const EXACT: f64 = 9_007_199_254_740_992.0;
    number.as_u64().or_else(|| {
        number.as_f64().filter(|x| x.fract() == 0.0 && (0.0..=EXACT).contains(x)).map(|x| x as u64)
    })
}

impl<'de> Deserializer<'de> for Tree<'de> {
    type Error = Fault;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Outcome<V::Value> {
        match self.value {
            Value::Null => visitor.visit_unit(),
            Value::Bool(value) => visitor.visit_bool(*value),
            Value::Number(_) => self.deserialize_f64(visitor),
            Value::String(text) => visitor.visit_borrowed_str(text),
            Value::Array(items) => visitor.visit_seq(Items { items: items.iter() }),
            Value::Object(object) => visitor.visit_map(Entries::new(object, self.skip)),
        }
    }

    fn deserialize_f64<V: Visitor<'de>>(self, visitor: V) -> Outcome<V::Value> {
        match self.real() {
            Some(value) => visitor.visit_f64(value),
            None => self.wrong("a number"),
        }
    }

    fn deserialize_u64<V: Visitor<'de>>(self, visitor: V) -> Outcome<V::Value> {
        match self.value {
            Value::Number(number) if whole(number).is_some() => visitor.visit_u64(whole(number).unwrap_or(0)),
            _ => self.wrong("a whole number, 0 or above"),
        }
    }

    fn deserialize_u32<V: Visitor<'de>>(self, visitor: V) -> Outcome<V::Value> {
        match self.value {
            Value::Number(number) if whole(number).is_some_and(|n| n <= u64::from(u32::MAX)) => {
                visitor.visit_u64(whole(number).unwrap_or(0))
            }
            _ => self.wrong("a whole number from 0 to 4294967295"),
        }
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Outcome<V::Value> {
        match self.value {
            Value::Bool(value) => visitor.visit_bool(*value),
            _ => self.wrong("true or false"),
        }
    }

    fn deserialize_str<V: Visitor<'de>>(self, visitor: V) -> Outcome<V::Value> {
        match self.value {
            Value::String(text) => visitor.visit_borrowed_str(text),
            _ => self.wrong("a text in quotes"),
        }
    }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Outcome<V::Value> {
        self.deserialize_str(visitor)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Outcome<V::Value> {
        match self.value {
            Value::Array(items) => visitor.visit_seq(Items { items: items.iter() }),
            _ => self.wrong("an array"),
        }
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, len: usize, visitor: V) -> Outcome<V::Value> {
        match self.value {
            Value::Array(items) if items.len() == len => visitor.visit_seq(Items { items: items.iter() }),
            _ => self.wrong(&format!("an array of {len} items")),
        }
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Outcome<V::Value> {
        match self.value {
            Value::Object(object) => visitor.visit_map(Entries::new(object, self.skip)),
            _ => self.wrong("an object"),
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
            Value::Null => visitor.visit_none(),
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
        if let Value::Object(object) = self.value
            && let Some(tag) = object.get(TAG)
        {
            let Value::String(tag) = tag else {
                return Tree::new(tag).wrong("a text in quotes for `type`");
            };
            if !words(variants).any(|word| word == tag) {
                return Err(Fault::UnknownType { word: tag.clone(), known: variants });
            }
            return visitor.visit_enum(Variant { tag, body: Tree { value: self.value, skip: Some(TAG) } });
        }
        if variants.contains(&kind) {
            return visitor.visit_enum(Variant { tag: kind, body: self });
        }
        match self.value {
            Value::String(word) if words(variants).next().is_some() => {
                visitor.visit_enum(Variant { tag: word, body: self })
            }
            Value::Object(_) => Err(Fault::MissingType { known: variants }),
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

struct Items<'de> {
    items: std::slice::Iter<'de, Value>,
}

impl<'de> SeqAccess<'de> for Items<'de> {
    type Error = Fault;

    fn next_element_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Outcome<Option<T::Value>> {
        self.items.next().map(|value| seed.deserialize(Tree::new(value))).transpose()
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.items.len())
    }
}

struct Entries<'de> {
    entries: serde_json::map::Iter<'de>,
    skip: Option<&'static str>,
    value: Option<&'de Value>,
}

impl<'de> Entries<'de> {
    fn new(object: &'de Map<String, Value>, skip: Option<&'static str>) -> Self {
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
            Some(value) => seed.deserialize(Tree::new(value)),
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
            Value::String(_) | Value::Null => Ok(()),
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
