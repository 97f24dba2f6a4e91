//! A tree of JSON values that takes little more memory than its contents. Rows of numbers, of which meshes and tables
//! are made, are stored as rows.

use indexmap::IndexMap;
use serde_json::Number;

/// A value of a scene file.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Value {
    Null,
    Bool(bool),
    Number(Number),
    String(Box<str>),
    Array(Array),
    /// In the order of the file.
    Object(Box<IndexMap<String, Value>>),
}

/// The items of an array.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Array {
    Numbers(Vec<f64>),
    /// Arrays of so many numbers, one after the other.
    Rows {
        length: usize,
        numbers: Vec<f64>,
    },
    Values(Vec<Value>),
}

/// A value where it stands in a tree.
#[derive(Clone, Copy)]
pub(super) enum View<'a> {
    Value(&'a Value),
    Number(f64),
    Row(&'a [f64]),
}

impl Value {
    pub fn object(&self) -> Option<&IndexMap<String, Value>> {
        match self {
            Value::Object(object) => Some(object),
            _ => None,
        }
    }

    /// A number that an f64 holds as it is.
    fn exact(&self) -> Option<f64> {
        const EXACT: u64 = 1 << f64::MANTISSA_DIGITS;
        match self {
            Value::Number(number) if number.is_f64() => number.as_f64(),
            Value::Number(number) if number.as_i64().is_some_and(|whole| whole.unsigned_abs() <= EXACT) => {
                number.as_f64()
            }
            _ => None,
        }
    }
}

impl Array {
    pub fn len(&self) -> usize {
        match self {
            Array::Numbers(numbers) => numbers.len(),
            Array::Rows { length, numbers } => numbers.len() / length,
            Array::Values(values) => values.len(),
        }
    }

    pub fn get(&self, index: usize) -> Option<View<'_>> {
        match self {
            Array::Numbers(numbers) => numbers.get(index).copied().map(View::Number),
            Array::Rows { length, numbers } => {
                numbers.get(index * length..(index + 1) * length).map(View::Row)
            }
            Array::Values(values) => values.get(index).map(View::Value),
        }
    }

    /// Appends a value; returns how many values have come to be stored one by one.
    pub fn push(&mut self, value: Value) -> usize {
        match (&mut *self, &value) {
            (Array::Values(values), _) if !values.is_empty() => {
                values.push(value);
                return 1;
            }
            (Array::Numbers(numbers), _) if value.exact().is_some() => {
                numbers.extend(value.exact());
                return 0;
            }
            (Array::Rows { length, numbers }, Value::Array(Array::Numbers(row))) if row.len() == *length => {
                numbers.extend(row);
                return 0;
            }
            _ => {}
        }
        if self.len() == 0 {
            match value {
                Value::Array(Array::Numbers(row)) if !row.is_empty() => {
                    *self = Array::Rows { length: row.len(), numbers: row };
                    return 0;
                }
                value => {
                    *self = Array::Values(vec![value]);
                    return 1;
                }
            }
        }
        let mut values: Vec<Value> =
            (0..self.len()).filter_map(|i| self.get(i)).map(View::to_value).collect();
        values.push(value);
        let stored = values.len();
        *self = Array::Values(values);
        stored
    }

    /// Gives back the room that further items would have had.
    pub fn shrink(&mut self) {
        match self {
            Array::Numbers(numbers) | Array::Rows { numbers, .. } => numbers.shrink_to_fit(),
            Array::Values(values) => values.shrink_to_fit(),
        }
    }
}

impl Default for Array {
    fn default() -> Self {
        Array::Numbers(Vec::new())
    }
}

impl View<'_> {
    fn to_value(self) -> Value {
        match self {
            View::Value(value) => value.clone(),
            View::Number(number) => Number::from_f64(number).map_or(Value::Null, Value::Number),
            View::Row(row) => Value::Array(Array::Numbers(row.to_vec())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number(x: f64) -> Value {
        Value::Number(Number::from_f64(x).unwrap())
    }

    fn array(items: &[Value]) -> (Array, usize) {
        let mut array = Array::default();
        let stored = items.iter().map(|item| array.push(item.clone())).sum();
        (array, stored)
    }

    #[test]
    fn rows_of_numbers_are_stored_as_rows_and_read_as_they_were_pushed() {
        let row = |numbers: &[f64]| Value::Array(Array::Numbers(numbers.to_vec()));
        let whole = Value::Number(7.into());
        let large = Value::Number(u64::MAX.into());
        let cases = [
            (vec![number(1.5), whole.clone(), number(-0.0)], 0),
            (vec![row(&[1.0, 2.0]), row(&[3.0, 4.0])], 0),
            (vec![row(&[1.0, 2.0]), row(&[3.0])], 2),
            (vec![row(&[1.0, 2.0]), whole.clone()], 2),
            (vec![row(&[]), row(&[])], 2),
            (vec![number(1.0), number(2.0), Value::Null, number(3.0)], 4),
            (vec![number(1.0), large.clone()], 2),
            (vec![Value::Null, number(1.0)], 2),
            (vec![], 0),
        ];
        for (items, expected) in cases {
            let (array, stored) = array(&items);
            assert_eq!(stored, expected, "{items:?}");
            assert_eq!(array.len(), items.len());
            for (i, item) in items.iter().enumerate() {
                let found = array.get(i).unwrap().to_value();
                match (&found, item) {
                    (Value::Number(a), Value::Number(b)) => {
                        assert_eq!(a.as_f64().map(f64::to_bits), b.as_f64().map(f64::to_bits));
                    }
                    _ => assert_eq!(&found, item),
                }
            }
            assert!(array.get(items.len()).is_none());
        }
    }

    /// A triangle of a mesh takes no more than its three numbers.
    #[test]
    fn the_tree_of_a_mesh_is_three_numbers_a_row() {
        let row = Value::Array(Array::Numbers(vec![0.0, 1.0, 2.0]));
        let (mut array, _) = array(&vec![row; 1000]);
        array.shrink();
        let Array::Rows { length: 3, numbers } = array else { panic!("{array:?}") };
        assert_eq!(numbers.capacity(), 3000);
    }
}
