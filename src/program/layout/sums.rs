//! The buffers that sums and counters lie in, and how they are cut where they are larger than what an adapter binds.
//!
//! A buffer that is cut lies in several variables of the shaders, its parts. The number of elements of a part is a
//! power of two. So the high bits of an index choose the part, and the low bits the element in it. Only the composed
//! text is rewritten. So shaders/ knows nothing of parts, and a scene whose sums fit has the text of the files.

use crate::error::{Error, Result};
use crate::program::layout::bindings;
use crate::program::layout::words::Words;
use std::fmt::{Display, Write};

/// The buffers of a program's sums.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SumBuffers {
    /// Sums of weights.
    pub sums: SumBuffer,
    /// The words above them, which 64-bit atomics need.
    pub tops: Option<SumBuffer>,
    /// Numbers of events.
    pub counters: SumBuffer,
}

/// A buffer of atomics.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SumBuffer {
    /// Its variable in the shaders.
    pub name: &'static str,
    /// What its elements are.
    pub words: Words,
    /// Number of elements.
    pub num_elements: u64,
    /// Elements of each part but the last: so many to the power of two.
    pub part_bits: u32,
    /// Bindings of the parts.
    pub bindings: Vec<u32>,
}

/// The built-in functions of atomics that shaders/ use, what a part's is called, and whether it takes and gives a value.
const OPERATIONS: [(&str, &str, bool, bool); 4] = [
    ("atomicAdd", "add_to", true, true),
    ("atomicOr", "or_into", true, true),
    ("atomicLoad", "load_from", false, true),
    ("atomicStore", "store_in", true, false),
];

impl SumBuffers {
    /// The buffers of so many sums and counters, in parts of at most `part_bytes`.
    ///
    /// # Errors
    /// [`Error::Usage`] if there are too many cells for 32 bits.
    pub fn of(num_sums: u32, num_counters: u32, native: bool, part_bytes: u64) -> Result<Self> {
        let mut next = bindings::SECOND_PART;
        let mut buffer = |name, binding, words: Words, num_cells: u32| -> Result<SumBuffer> {
            let num_elements = u64::from(num_cells) * words.per_cell();
            if num_elements > 1 << 32 {
                return Err(Error::Usage(format!(
                    "{num_cells} sums are too many to number; use fewer pixels, or --standard-error off"
                )));
            }
            let part_bits = (part_bytes / words.element_bytes()).max(1).ilog2();
            let num_parts = num_elements.div_ceil(1 << part_bits).max(1) as u32;
            let others = next..next + num_parts - 1;
            next = others.end;
            let bindings = std::iter::once(binding).chain(others).collect();
            Ok(SumBuffer { name, words, num_elements, part_bits, bindings })
        };
        let (words, tops) = if native { (Words::Low, Some(Words::Top)) } else { (Words::All, None) };
        Ok(SumBuffers {
            sums: buffer("sums", bindings::SUMS, words, num_sums)?,
            tops: tops.map(|words| buffer("tops", bindings::TOPS, words, num_sums)).transpose()?,
            counters: buffer("counters", bindings::COUNTERS, Words::Counter, num_counters)?,
        })
    }

    /// Each of them.
    pub fn all(&self) -> impl Iterator<Item = &SumBuffer> {
        [Some(&self.sums), self.tops.as_ref(), Some(&self.counters)].into_iter().flatten()
    }

    /// The text with the buffers in their parts; where each has one, the text as it is.
    ///
    /// # Errors
    /// [`Error::Internal`] if the text does something with a buffer that is unknown here.
    pub fn cut(&self, wgsl: String) -> Result<String> {
        self.all().filter(|buffer| buffer.bindings.len() > 1).try_fold(wgsl, |text, buffer| {
            buffer
                .cut(&text)
                .ok_or_else(|| Error::Internal(format!("the shader's `{}` cannot be cut", buffer.name)))
        })
    }
}

impl SumBuffer {
    /// Bytes of each part.
    pub fn part_bytes(&self) -> impl Iterator<Item = u64> {
        let part = 1 << self.part_bits;
        let elements = (0..self.bindings.len() as u64).map(move |i| (self.num_elements - i * part).min(part));
        elements.map(|elements| elements * self.words.element_bytes())
    }

    fn scalar(&self) -> &'static str {
        if self.words.element_bytes() == 8 { "u64" } else { "u32" }
    }

    fn declaration(&self, binding: impl Display, name: &str) -> String {
        let scalar = self.scalar();
        format!(
            "@group(GROUP_SCENE) @binding({binding}) var<storage, read_write> {name}: array<atomic<{scalar}>>;"
        )
    }

    fn part_name(&self, part: usize) -> String {
        format!("{}_{part}", self.name)
    }

    fn cut(&self, text: &str) -> Option<String> {
        let whole = self.declaration(format_args!("BINDING_{}", self.name.to_uppercase()), self.name);
        let (before, after) = text.split_once(&whole)?;
        let (before, after) = (self.call_functions(before)?, self.call_functions(after)?);
        let mut cut = before;
        for (part, &binding) in self.bindings.iter().enumerate() {
            let _ = writeln!(cut, "{}", self.declaration(binding, &self.part_name(part)));
        }
        OPERATIONS.iter().for_each(|operation| cut.push_str(&self.function(operation)));
        Some(cut + &after)
    }

    /// `atomicAdd(&sums[cell], value)` as `add_to_sums(cell, value)`, and so on.
    fn call_functions(&self, text: &str) -> Option<String> {
        let access = format!("(&{}[", self.name);
        let mut pieces = text.split(&access);
        let mut calls = pieces.next()?.to_string();
        for piece in pieces {
            let (builtin, verb, ..) = OPERATIONS.iter().find(|(builtin, ..)| calls.ends_with(builtin))?;
            let end = end_of_index(piece)?;
            calls.truncate(calls.len() - builtin.len());
            let _ = write!(calls, "{verb}_{}({}{}", self.name, &piece[..end], &piece[end + 1..]);
        }
        Some(calls)
    }

    /// Does to the element at an index of the whole what the built-in function does.
    fn function(&self, &(builtin, verb, takes, gives): &(&str, &str, bool, bool)) -> String {
        let (name, scalar) = (self.name, self.scalar());
        let (parameter, argument) =
            if takes { (format!(", value: {scalar}"), ", value") } else { (String::new(), "") };
        let (result, start, end) =
            if gives { (format!(" -> {scalar}"), "return ", "") } else { (String::new(), "", " return;") };
        let mask = (1_u64 << self.part_bits) - 1;
        let mut text = format!(
            "fn {verb}_{name}(at: u32{parameter}){result} {{\n    let within = at & {mask}u;\n    switch at >> {}u {{\n",
            self.part_bits
        );
        let last = self.bindings.len() - 1;
        for part in 0..=last {
            let case = if part == last { "default".into() } else { format!("case {part}u") };
            let variable = self.part_name(part);
            let _ =
                writeln!(text, "        {case}: {{ {start}{builtin}(&{variable}[within]{argument});{end} }}");
        }
        text + "    }\n}\n"
    }
}

/// Where the bracket closes that opened before the text.
fn end_of_index(text: &str) -> Option<usize> {
    let mut depth = 1;
    text.char_indices().find_map(|(at, char)| {
        depth += match char {
            '[' => 1,
            ']' => -1,
            _ => 0,
        };
        (depth == 0).then_some(at)
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn buffer(num_elements: u64, part_bits: u32, num_parts: u32) -> SumBuffer {
        let parts = bindings::SECOND_PART..bindings::SECOND_PART + num_parts - 1;
        let bindings = std::iter::once(bindings::COUNTERS).chain(parts).collect();
        SumBuffer { name: "counters", words: Words::Counter, num_elements, part_bits, bindings }
    }

    #[test]
    fn parts_hold_every_element_once() {
        for (num_elements, part_bits, expected) in
            [(9, 2, vec![16, 16, 4]), (8, 2, vec![16, 16]), (3, 2, vec![12])]
        {
            let buffer = buffer(num_elements, part_bits, expected.len() as u32);
            assert_eq!(buffer.part_bytes().collect::<Vec<_>>(), expected);
        }
    }

    #[test]
    fn accesses_become_calls_whatever_their_index() {
        let buffer = buffer(9, 2, 3);
        let text =
            "let a = atomicAdd(&counters[3u * b[i] + 1u], f(v[0])) > ~v; atomicLoad(&counters[c]) == 0u";
        let expected = "let a = add_to_counters(3u * b[i] + 1u, f(v[0])) > ~v; load_from_counters(c) == 0u";
        assert_eq!(buffer.call_functions(text).unwrap(), expected);
        assert_eq!(buffer.call_functions("atomicMax(&counters[c], 1u)"), None);
        assert_eq!(buffer.call_functions("f(&counters[c"), None);
    }

    #[test]
    fn what_is_cut_is_valid() {
        let text = "@group(GROUP_SCENE) @binding(BINDING_COUNTERS) var<storage, read_write> counters: array<atomic<u32>>;\n\
            @compute @workgroup_size(1) fn main() {\n\
            if atomicLoad(&counters[7u]) == 0u { atomicStore(&counters[8u], atomicAdd(&counters[1u], 2u)); }\n\
            atomicOr(&counters[5u], 3u);\n}";
        let cut = bindings::declared(&buffer(9, 2, 3).cut(text).unwrap());
        let module =
            naga::front::wgsl::parse_str(&cut).unwrap_or_else(|e| panic!("{}", e.emit_to_string(&cut)));
        let bindings = crate::gpu::compute::bindings_of(&module);
        assert_eq!(bindings.iter().map(|b| b.number).collect::<Vec<_>>(), [4, 32, 33]);
        assert!(!cut.contains("counters["), "{cut}");
    }
}
