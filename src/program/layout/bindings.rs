//! The bindings of all shaders in one list. WGSL takes its numbers from here
//! (`@group(GROUP_SCENE) @binding(BINDING_SUMS)`), and so does the host for its buffers.

use std::collections::BTreeSet;
use std::fmt::Write;

/// Numbers with names, and the WGSL constants of these names.
macro_rules! numbers {
    ($prefix:literal, $list:ident: $($(#[$about:meta])+ $name:ident = $number:literal;)+) => {
        $($(#[$about])+ pub const $name: u32 = $number;)+

        const $list: &[(&str, u32)] = &[$((concat!($prefix, stringify!($name)), $number)),+];
    };
}

numbers! { "GROUP_", GROUPS:
    /// What is the same for all dispatches of a trace.
    SCENE = 0;
    /// The queues, in either direction.
    QUEUES = 1;
    /// Of the shader between dispatches, which has a layout of its own.
    BETWEEN = 0;
}

numbers! { "BINDING_", BINDINGS:
    /// Which rays a dispatch traces, and its seed.
    RANGE = 0;
    /// The random generator's table.
    RNG_TABLE = 1;
    /// Sums of weights.
    SUMS = 2;
    /// The words above them, which 64-bit atomics need.
    TOPS = 3;
    /// Numbers of events.
    COUNTERS = 4;
    /// The table of media.
    MEDIA = 5;
    /// The spectra of sources.
    SPECTRA = 6;
    /// Reflectances, and what coatings let pass, by wavelength.
    REFLECTANCES = 7;
    /// The bins of spectral detectors.
    SPECTRAL_BINS = 8;
    /// The table of surfaces.
    SURFACES = 9;
    /// The table of detectors.
    DETECTORS = 10;
    /// The table of primitives.
    PRIMITIVES = 11;
    /// Rows for the host.
    EVENTS = 12;
    /// The source of a dispatch, where a scene has several.
    SOURCE = 13;
    /// The tables of shapes, sources, BSDFs and coatings.
    TABLES = 14;
    /// The table of faces in contact.
    CONTACTS = 16;
    /// Triangles, where they do not lie among the rows of trees.
    MESH_ROWS = 17;
    /// Trees, triangles and primitives.
    TREE_ROWS = 19;
    /// The deposit log, and of arrivals: stages write it as unlike types.
    LOG = 20;
    /// Which facets of meshes are in contact.
    FACETS = 21;
    /// The ids of the rays of a dispatch, where these are listed.
    LISTED_IDS = 22;
    /// The scene's numbers, where these are live.
    NUMBERS = 23;
    /// The table of paths.
    PATHS = 24;
    /// How large the table of paths is, and whether it takes new keys.
    PATHS_HEAD = 25;
    /// What a loss gains by a unit of weight in each cell.
    ADJOINTS = 26;
    /// What a loss gains by a unit of each number, by invocation.
    ADJOINT_SUMS = 27;
    /// With which probability rays reflect.
    GUIDE = 28;
    /// The word that compilers must not know to be zero (shaders/math/df64.wgsl).
    DF64_ZERO = 30;
    /// The second of all parts of sums that are cut. It ends the list: the others follow it.
    SECOND_PART = 32;
}

numbers! { "BINDING_", BINDINGS_OF_QUEUES:
    /// How many rays wait.
    QUEUE_COUNTS = 0;
    /// Rays that a dispatch reads.
    QUEUE_IN = 1;
    /// Rays that it writes.
    QUEUE_OUT = 2;
}

numbers! { "BINDING_", BINDINGS_BETWEEN:
    /// How many rays wait.
    COUNTS = 0;
    /// Workgroups of the next dispatch.
    WORKGROUPS = 1;
}

/// A text, below the WGSL constants of what it names.
pub fn declared(text: &str) -> String {
    // Each text is read once, not once for each name: live answers compose often.
    let in_parentheses =
        text.split('(').filter(|rest| ["GROUP_", "BINDING_"].iter().any(|p| rest.starts_with(p)));
    let named: BTreeSet<&str> = in_parentheses.filter_map(|rest| Some(rest.split_once(')')?.0)).collect();
    let mut constants = String::from("// ==== composed by program::layout::bindings\n");
    for (name, number) in [GROUPS, BINDINGS, BINDINGS_OF_QUEUES, BINDINGS_BETWEEN].concat() {
        if named.contains(name) {
            let _ = writeln!(constants, "const {name}: u32 = {number}u;");
        }
    }
    constants + "\n" + text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_number_of_a_group_is_given_once() {
        for list in [BINDINGS, BINDINGS_OF_QUEUES, BINDINGS_BETWEEN] {
            let numbers: BTreeSet<u32> = list.iter().map(|(_, number)| *number).collect();
            assert_eq!(numbers.len(), list.len());
            assert_eq!(numbers.last(), list.last().map(|(_, number)| number));
        }
    }
}
