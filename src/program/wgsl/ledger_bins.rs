//! Keeps the ledger's bins in registers: each goes to memory once an invocation (shaders/sums/ledger.wgsl).

use crate::model::surface_optics::lossy_mirrors;
use crate::program::addition::ShaderAdditions;
use crate::program::wgsl::composition::Composition;
use std::fmt::Write;

/// A bin: its cell as WGSL has it, and whether it sums weight or only counts rays.
struct Bin {
    cell: String,
    has_quanta: bool,
}

impl Composition<'_> {
    /// The variables of the bins, with functions that add to them (`add_to_bin`) and send them to memory
    /// (`plain_flush_bins`). If an addition wants it, two more functions take back what a ray has put into them
    /// (`keep_bins`, `restore_bins`).
    pub(super) fn bins(&self, additions: &ShaderAdditions) -> String {
        let mut variables = String::new();
        let mut add = String::from("fn add_to_bin(cell: u32, q: Quanta) {\n");
        let mut flush = String::from("fn plain_flush_bins() {\n");
        let mut keep = String::from("fn keep_bins() {\n");
        let mut restore = String::from("fn restore_bins() {\n");
        let restores = additions.any(|addition| addition.restores_bins());
        let mut register = |name: String, kind: &str, zero: &str| {
            let _ = writeln!(variables, "var<private> {name}: {kind} = {zero};");
            if restores {
                let _ = writeln!(variables, "var<private> kept_{name}: {kind} = {zero};");
            }
            let _ = writeln!(keep, "    kept_{name} = {name};");
            let _ = writeln!(restore, "    {name} = kept_{name};");
        };
        for (i, Bin { cell, has_quanta }) in self.bins_in_registers(additions).iter().enumerate() {
            register(format!("bin_{i}_events"), "u32", "0u");
            let _ = writeln!(add, "    if cell == {cell} {{\n        bin_{i}_events += 1u;");
            if *has_quanta {
                register(format!("bin_{i}"), "Quanta", "NO_QUANTA");
                let _ = writeln!(add, "        bin_{i} = q_add(bin_{i}, q);");
                let _ = writeln!(flush, "    flush_bin({cell}, bin_{i}_events, bin_{i});");
            } else {
                let _ = writeln!(flush, "    flush_count({cell}, bin_{i}_events);");
            }
            let _ = writeln!(add, "        return;\n    }}");
        }
        if !self.options.baked {
            add.push_str("    count(cell);\n    deposit(cell, q);\n");
        }
        let mut text = format!("{variables}{add}}}\n{flush}}}\n");
        if restores {
            let _ = write!(text, "{keep}}}\n{restore}}}\n");
        }
        text
    }

    /// The bins that rays of this scene can meet. Mirrors in a table deposit in memory, except those that an addition
    /// wants in registers.
    fn bins_in_registers(&self, additions: &ShaderAdditions) -> Vec<Bin> {
        let f = &self.features;
        let scatters = !f.bsdfs.is_empty();
        let of_ledger = [
            (f.refractive, "CELL_UNDERFLOWS", false),
            (f.roulette, "CELL_ROULETTE_GAIN", true),
            (f.bulk_absorption, "CELL_BULK", true),
            (f.importance || self.cuts_weights(), "CELL_IMPORTANCE_LOSS", true),
            (f.importance, "CELL_IMPORTANCE_GAIN", true),
            (f.coated, "CELL_COATING", true),
            (scatters, "CELL_BSDF", true),
            (scatters, "CELL_BSDF_GAIN", true),
        ];
        let of_ledger = of_ledger.into_iter().filter(|(present, ..)| *present);
        let of_ledger = of_ledger.map(|(_, cell, has_quanta)| Bin { cell: cell.into(), has_quanta });
        let mirrors = lossy_mirrors(self.ir)
            .filter(|&i| self.options.baked || additions.any(|addition| addition.keeps_bin_of(i as usize)))
            .map(|i| Bin { cell: format!("{}u", self.cells.surfaces + i), has_quanta: true });
        of_ledger.chain(mirrors).collect()
    }
}
