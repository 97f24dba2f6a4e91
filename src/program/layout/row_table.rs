//! Small tables that shaders read by row, either compiled in (constants and selects) or from a buffer.

use crate::error::Result;
use crate::model::Precision;
use crate::program::layout::bindings;
use crate::program::layout::numbers::Numbers;
use crate::program::layout::reals::{StructLayout, put_real};
use std::collections::HashMap;
use std::fmt::Write;
use std::sync::LazyLock;

/// A table with one row per surface, detector, primitive, or medium and wavelength.
#[derive(Debug, Clone)]
pub struct RowTable {
    /// Name of the struct in the shader.
    pub name: &'static str,
    /// Name of the variable and, with `_of`, of the function that gives a row.
    pub rows: &'static str,
    /// The binding, in the group of the scene, where the table lies in a buffer.
    pub binding: u32,
    /// Columns of reals lie in the buffer even where all rows share their value.
    live: bool,
    columns: Vec<Column>,
}

#[derive(Debug, Clone)]
struct Column {
    name: String,
    values: Values,
}

#[derive(Debug, Clone)]
enum Values {
    Real(Vec<f64>),
    Uint(Vec<u32>),
}

impl RowTable {
    /// An empty table.
    pub fn new(name: &'static str, rows: &'static str, binding: u32) -> Self {
        RowTable { name, rows, binding, live: false, columns: Vec::new() }
    }

    /// With all reals in the buffer, so that the text does not depend on them.
    pub fn with_live(self, live: bool) -> Self {
        RowTable { live, ..self }
    }

    /// Adds a column of reals.
    pub fn real(&mut self, name: &str, values: impl IntoIterator<Item = f64>) {
        self.columns.push(Column { name: name.into(), values: Values::Real(values.into_iter().collect()) });
    }

    /// Adds a column of unsigned integers.
    pub fn uint(&mut self, name: &str, values: impl IntoIterator<Item = u32>) {
        self.columns.push(Column { name: name.into(), values: Values::Uint(values.into_iter().collect()) });
    }

    /// The struct, and the function that gives row `i` from constants: what all rows share is a constant, the rest is
    /// chosen by selects.
    pub fn baked(&self, numbers: &Numbers) -> Result<String> {
        let mut text = declaration(self.name, self.columns.iter());
        let fields: Result<Vec<String>> = self.columns.iter().map(|c| c.chosen(numbers)).collect();
        let _ = write!(
            text,
            "fn {}_of(i: u32) -> {} {{\n    return {}(\n        {},\n    );\n}}\n",
            self.rows,
            self.name,
            self.name,
            fields?.join(",\n        ")
        );
        Ok(text)
    }

    /// The struct, and the function that gives row `i` from constants, row by row: for many rows, which selects would nest too
    /// deeply. No `switch`: of one with 76 cases or more, lavapipe of Mesa 22.3 gave wrong rows to the last cases.
    pub fn in_turn(&self, numbers: &Numbers) -> Result<String> {
        let (name, rows) = (self.name, self.rows);
        let mut text = declaration(name, self.columns.iter());
        let _ = writeln!(text, "fn {rows}_of(i: u32) -> {name} {{\n    var row = {};", self.row(numbers, 0)?);
        for row in 1..self.columns.first().map_or(0, Column::len) {
            let _ = writeln!(text, "    if i == {row}u {{ row = {}; }}", self.row(numbers, row)?);
        }
        text.push_str("    return row;\n}\n");
        Ok(text)
    }

    /// One row, as a value.
    pub fn row(&self, numbers: &Numbers, row: usize) -> Result<String> {
        let value = |column: &Column| match &column.values {
            Values::Real(values) => numbers.expression(values[row]),
            Values::Uint(values) => Ok(format!("{}u", values[row])),
        };
        let values: Result<Vec<String>> = self.columns.iter().map(value).collect();
        Ok(format!("{}({})", self.name, values?.join(", ")))
    }

    /// The struct, a buffer of what differs between rows, and the function that gives row `i` from it: what all rows
    /// share is a constant. A table of at most `uniform_bytes` lies in a uniform buffer.
    pub fn table(&self, numbers: &Numbers, uniform_bytes: u32) -> Result<String> {
        let (name, rows, precision) = (self.name, self.rows, numbers.precision());
        let varying = self.varying();
        let mut text = declaration(name, self.columns.iter());
        let mut row = String::new();
        if !varying.is_empty() {
            let count = varying[0].len();
            let (stride, padding) = uniform_stride(&varying, precision);
            let memory = if stride * count <= uniform_bytes as usize {
                text.push_str(&declaration(
                    &format!("{name}Row"),
                    varying.iter().copied().chain(&PADDING[..padding]),
                ));
                format!("var<uniform> {rows}_table: array<{name}Row, {count}>")
            } else {
                text.push_str(&declaration(&format!("{name}Row"), varying.iter().copied()));
                format!("var<storage, read> {rows}_table: array<{name}Row>")
            };
            let _ = writeln!(text, "@group({}) @binding({}) {memory};", bindings::SCENE, self.binding);
            row = format!("let row = {rows}_table[i];\n    ");
        }
        let field = |column: &Column| -> Result<String> {
            if self.is_varying(column) { Ok(format!("row.{}", column.name)) } else { column.chosen(numbers) }
        };
        let fields = self.columns.iter().map(field).collect::<Result<Vec<String>>>()?.join(",\n        ");
        let _ = writeln!(
            text,
            "fn {rows}_of(i: u32) -> {name} {{\n    {row}return {name}(\n        {fields},\n    );\n}}"
        );
        Ok(text)
    }

    /// Some of the rows, in this order.
    pub fn picked(&self, rows: &[u32]) -> Self {
        let pick = |column: &Column| Column { name: column.name.clone(), values: column.values.picked(rows) };
        RowTable { columns: self.columns.iter().map(pick).collect(), ..self.clone() }
    }

    /// True if rows differ in a column.
    pub fn has_varying(&self, name: &str) -> bool {
        self.varying().into_iter().any(|column| column.name == name)
    }

    /// Texels, of four words each, that a row takes in an image.
    pub fn num_texels(&self, precision: Precision) -> usize {
        let words = self.varying().into_iter().map(|column| column.num_words(precision));
        words.sum::<usize>().div_ceil(TEXEL_WORDS)
    }

    /// The struct, and the function that gives the row whose texels begin with the one numbered `first` (`tree_row`):
    /// what differs between rows, in turn. What all rows share is a constant. In f32, and in f64 where the device has 64-bit
    /// integers.
    pub fn texels(&self, numbers: &Numbers) -> Result<String> {
        let (name, rows, precision) = (self.name, self.rows, numbers.precision());
        let mut text = declaration(name, self.columns.iter());
        let _ = writeln!(text, "fn {rows}_at(first: u32) -> {name} {{");
        for texel in 0..self.num_texels(precision) {
            let _ = writeln!(text, "    let texel_{texel} = tree_row(first + {texel}u);");
        }
        let mut next = 0;
        let mut field = |column: &Column| -> Result<String> {
            if !self.is_varying(column) {
                return column.chosen(numbers);
            }
            let word = next;
            next += column.num_words(precision);
            Ok(column.of_words(word, precision))
        };
        let fields =
            self.columns.iter().map(&mut field).collect::<Result<Vec<String>>>()?.join(",\n        ");
        let _ = writeln!(text, "    return {name}(\n        {fields},\n    );\n}}");
        Ok(text)
    }

    /// The words of all rows' texels.
    pub fn texel_words(&self, precision: Precision) -> Result<Vec<u32>> {
        let row_words = TEXEL_WORDS * self.num_texels(precision);
        let varying = self.varying();
        let num_rows = varying.first().map_or(0, |column| column.len());
        let mut words = Vec::with_capacity(row_words * num_rows);
        for row in 0..num_rows {
            for column in &varying {
                words.extend(column.words(row, precision)?);
            }
            words.resize(row_words * (row + 1), 0);
        }
        Ok(words)
    }

    fn varying(&self) -> Vec<&Column> {
        self.columns.iter().filter(|column| self.is_varying(column)).collect()
    }

    fn is_varying(&self, column: &Column) -> bool {
        self.live && column.len() > 1 && matches!(column.values, Values::Real(_)) || column.varies()
    }

    /// The struct, and a uniform that holds one row.
    pub fn uniform(&self) -> String {
        format!(
            "{}@group({}) @binding({}) var<uniform> {}_uniform: {};\n",
            declaration(self.name, self.columns.iter()),
            bindings::SCENE,
            self.binding,
            self.rows,
            self.name
        )
    }

    /// The bytes of each row, for a uniform that holds one at a time.
    pub fn bytes_by_row(&self, module: &naga::Module, precision: Precision) -> Result<Vec<Vec<u8>>> {
        let columns: Vec<&Column> = self.columns.iter().collect();
        let layout = StructLayout::of(module, self.name)?;
        let bytes = packed(&columns, &layout, precision)?;
        Ok(bytes.chunks_exact(layout.stride).map(<[u8]>::to_vec).collect())
    }

    /// The bytes of a table's buffer, with each field where the composed module has it; none if all rows are the same.
    pub fn bytes(&self, module: &naga::Module, precision: Precision) -> Result<Option<Vec<u8>>> {
        match self.varying() {
            columns if columns.is_empty() => Ok(None),
            columns => {
                let layout = StructLayout::of(module, &format!("{}Row", self.name))?;
                Ok(Some(packed(&columns, &layout, precision)?))
            }
        }
    }
}

const TEXEL_WORDS: usize = 4;

/// Fills a row of a uniform up to a multiple of 16 bytes.
static PADDING: LazyLock<[Column; 3]> = LazyLock::new(|| {
    ["padding_0", "padding_1", "padding_2"]
        .map(|name| Column { name: name.into(), values: Values::Uint(vec![]) })
});

/// Bytes of a row in a uniform, and how many columns of [`PADDING`] it takes.
fn uniform_stride(columns: &[&Column], precision: Precision) -> (usize, usize) {
    let size = |column: &Column| 4 * column.num_words(precision);
    let end = columns.iter().fold(0_usize, |end, column| end.next_multiple_of(size(column)) + size(column));
    let stride = end.next_multiple_of(16);
    (stride, (stride - end) / 4)
}

fn declaration<'a>(name: &str, columns: impl Iterator<Item = &'a Column>) -> String {
    let mut text = format!("struct {name} {{\n");
    for column in columns {
        let kind = match column.values {
            Values::Real(_) => "real",
            Values::Uint(_) => "u32",
        };
        let _ = writeln!(text, "    {}: {kind},", column.name);
    }
    text.push_str("}\n");
    text
}

fn packed(columns: &[&Column], layout: &StructLayout, precision: Precision) -> Result<Vec<u8>> {
    let num_rows = columns.first().map_or(0, |column| column.len());
    let mut bytes = vec![0; layout.stride * num_rows];
    for column in columns {
        let offset = layout.offset(&column.name)?;
        for row in 0..num_rows {
            let place = &mut bytes[row * layout.stride + offset..];
            match &column.values {
                Values::Real(values) => put_real(place, values[row], precision)?,
                Values::Uint(values) => place[..4].copy_from_slice(&values[row].to_le_bytes()),
            }
        }
    }
    Ok(bytes)
}

impl Values {
    fn picked(&self, rows: &[u32]) -> Values {
        match self {
            Values::Real(values) => Values::Real(rows.iter().map(|&row| values[row as usize]).collect()),
            Values::Uint(values) => Values::Uint(rows.iter().map(|&row| values[row as usize]).collect()),
        }
    }
}

impl Column {
    fn varies(&self) -> bool {
        match &self.values {
            Values::Real(values) => values.iter().any(|value| value.to_bits() != values[0].to_bits()),
            Values::Uint(values) => values.iter().any(|value| value != &values[0]),
        }
    }

    fn len(&self) -> usize {
        match &self.values {
            Values::Real(values) => values.len(),
            Values::Uint(values) => values.len(),
        }
    }

    /// Words of a value.
    fn num_words(&self, precision: Precision) -> usize {
        match (&self.values, precision) {
            (Values::Real(_), Precision::Df64 | Precision::F64) => 2,
            _ => 1,
        }
    }

    fn words(&self, row: usize, precision: Precision) -> Result<Vec<u32>> {
        let mut bytes = [0; 8];
        match &self.values {
            Values::Real(values) => put_real(&mut bytes, values[row], precision)?,
            Values::Uint(values) => bytes[..4].copy_from_slice(&values[row].to_le_bytes()),
        }
        let words: [u32; 2] = bytemuck::cast(bytes);
        Ok(words[..self.num_words(precision)].to_vec())
    }

    /// The value in the shader, from texels in which its words begin at `first`.
    fn of_words(&self, first: usize, precision: Precision) -> String {
        let word = |i: usize| format!("texel_{}.{}", i / TEXEL_WORDS, ["x", "y", "z", "w"][i % TEXEL_WORDS]);
        match (&self.values, precision) {
            (Values::Uint(_), _) => word(first),
            (Values::Real(_), Precision::F32) => format!("bitcast<f32>({})", word(first)),
            (Values::Real(_), Precision::Df64 | Precision::F64) => {
                format!("bitcast<f64>(u64({}) | (u64({}) << 32u))", word(first), word(first + 1))
            }
        }
    }

    fn chosen(&self, numbers: &Numbers) -> Result<String> {
        let literals: Vec<String> = match &self.values {
            Values::Real(values) => values.iter().map(|&v| numbers.expression(v)).collect::<Result<_>>()?,
            Values::Uint(values) => values.iter().map(|v| format!("{v}u")).collect(),
        };
        Ok(choose(&literals))
    }
}

/// A select over the rows `i`; the most frequent value needs none.
fn choose(literals: &[String]) -> String {
    let mut rows: HashMap<&str, Vec<usize>> = HashMap::new();
    for (row, literal) in literals.iter().enumerate() {
        rows.entry(literal).or_default().push(row);
    }
    let mut values: Vec<(&str, Vec<usize>)> = rows.into_iter().collect();
    values.sort_by_key(|(_, rows)| (std::cmp::Reverse(rows.len()), rows[0]));
    let mut values = values.into_iter();
    let first = values.next().map_or("0", |(literal, _)| literal).to_string();
    values.fold(first, |chosen, (literal, rows)| {
        let conditions: Vec<String> = rows.iter().map(|row| format!("(i == {row}u)")).collect();
        format!("select({chosen}, {literal}, {})", conditions.join(" | "))
    })
}
