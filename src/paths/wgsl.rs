//! Composes how the paths of rays are followed (shaders/paths): what words a path has, and how a filter decides.

use crate::error::{Error, Result};
use crate::guide;
use crate::model::PathFilter;
use crate::paths::ahead;
use crate::paths::filter_state::FilterState;
use crate::paths::layout::PathTableLayout;
use crate::paths::sums::PathSums;
use crate::program::Program;
use crate::program::addition::ShaderAddition;
use crate::program::input::ProgramInput;
use crate::program::wgsl::composition::Composition;
use crate::program::wgsl::constants::Constants;
use crate::program::wgsl::text::Text;
use crate::shaders::{ShaderFile, shader};
use std::fmt::Write;
use std::sync::Arc;

/// Words of a sequence's key, the first of a path.
const KEY_WORDS: usize = 3;

/// How a scene's shader follows paths.
#[derive(Debug)]
pub(super) struct PathShader {
    /// Some rays begin as rays of files, which the host uploads.
    uploads_rays: bool,
    sums: PathSums,
    filter: Option<Arc<PathFilter>>,
    is_guided: bool,
    /// What the rows of the table are.
    pub(super) layout: PathTableLayout,
}

impl PathShader {
    pub(super) fn new(
        sums: PathSums,
        filter: Option<Arc<PathFilter>>,
        is_guided: bool,
        scene: &ProgramInput,
    ) -> Self {
        let layout = match sums {
            PathSums::Maps(_) => PathTableLayout::of_maps(scene.ir, sums.has_ends()),
            PathSums::None | PathSums::Totals { .. } | PathSums::Events { .. } => {
                PathTableLayout::of_totals(scene.ir, sums.has_ends(), scene.constant_weights)
            }
        };
        PathShader { sums, filter, is_guided, uploads_rays: scene.features.uploads_rays(), layout }
    }

    /// How the shader of a program follows paths.
    pub(super) fn of(program: &Program) -> Result<&Self> {
        let none = || Error::Internal("the program follows no paths".into());
        program.additions.get().ok_or_else(none)
    }
}

impl ShaderAddition for PathShader {
    fn replaces(&self) -> Vec<(&'static str, ShaderFile)> {
        let of_sums: &[_] = match self.sums {
            PathSums::Events { .. } => &[
                (
                    "stages/ids",
                    match self.uploads_rays {
                        true => shader!("stages/ids.listed_uploaded.wgsl"),
                        false => shader!("stages/ids.listed.wgsl"),
                    },
                ),
                ("stages/launched", shader!("stages/launched.listed.wgsl")),
            ],
            PathSums::Maps(_) => &[("sums/replicates", shader!("sums/replicates.by_path.wgsl"))],
            _ => &[],
        };
        let always = [
            ("stages/path", shader!("paths/followed.wgsl")),
            ("stages/lobe", shader!("paths/lobes.wgsl")),
            ("stages/family", shader!("paths/families.wgsl")),
            ("stages/queue_entry", shader!("paths/queued.wgsl")),
        ];
        [&always, of_sums].concat()
    }

    fn add(&self, composition: &Composition, text: &mut Text) -> Result<()> {
        text.files(self.files(composition));
        text.composed("paths::wgsl", &self.functions(composition));
        Ok(())
    }

    fn begin(&self) -> &'static str {
        if self.sums.has_table() { "    path_head = path_head_uniform;\n" } else { "" }
    }

    fn rows_per_ray(&self, max_depth: u32) -> u64 {
        match self.sums {
            // Each event, and the end.
            PathSums::Events { .. } => u64::from(max_depth + 2),
            PathSums::None | PathSums::Totals { .. } | PathSums::Maps(_) => 0,
        }
    }

    fn counts_events_unread(&self) -> bool {
        self.sums.has_table()
    }

    fn lists_rays(&self) -> bool {
        matches!(self.sums, PathSums::Events { .. })
    }
}

impl PathShader {
    /// True if rays end as soon as no light of their paths can be kept any more.
    fn ends_early(&self) -> bool {
        self.is_guided && self.filter.is_some()
    }

    /// The files that paths need, beside the files of slots.
    fn files(&self, composition: &Composition) -> Vec<ShaderFile> {
        let sums = match self.sums {
            PathSums::None => shader!("paths/sums.none.wgsl"),
            PathSums::Totals { .. } => shader!("paths/sums.totals.wgsl"),
            PathSums::Maps(_) => shader!("paths/sums.maps.wgsl"),
            PathSums::Events { .. } => shader!("paths/sums.events.wgsl"),
        };
        let replayed = match composition.features.splits {
            true => shader!("paths/replayed.families.wgsl"),
            false => shader!("paths/replayed.alone.wgsl"),
        };
        let ending = match self.ends_early() {
            true => shader!("paths/ending.early.wgsl"),
            false => shader!("paths/ending.late.wgsl"),
        };
        let files = [
            (true, ending),
            (true, sums),
            (matches!(self.sums, PathSums::Events { .. }), replayed),
            (self.sums != PathSums::None, shader!("paths/sequence.wgsl")),
            (self.sums.has_table(), shader!("paths/table.wgsl")),
            (self.filter.is_some(), shader!("paths/filter_out.wgsl")),
        ];
        files.into_iter().filter(|(is_needed, _)| *is_needed).map(|(_, file)| file).collect()
    }

    fn functions(&self, composition: &Composition) -> String {
        let has_key = self.sums != PathSums::None;
        let filter = self.filter.as_deref();
        let state = filter.map(|filter| FilterState::of(filter, if has_key { KEY_WORDS } else { 0 }));
        let num_words = state.as_ref().map_or(if has_key { KEY_WORDS } else { 0 }, |state| state.end());
        let mut constants = Constants::default();
        let of_guide = if self.is_guided { guide::wgsl::num_path_words(self.filter.is_some()) } else { 0 };
        constants.uint("PATH_WORDS", (num_words + of_guide).max(1) as u32);
        if self.is_guided {
            constants.uint("GUIDE_NODE", num_words as u32);
            constants.uint("GUIDE_RATIO", num_words as u32 + 1);
            constants.uint("GUIDE_ALONE", num_words as u32 + 2);
        }
        constants.uint("NUM_DETECTORS", composition.ir.detectors.len() as u32);
        constants.bool("PATHS_HAVE_ENDS", self.sums.has_ends());
        if self.sums.has_table() {
            constants.uint("NUM_ENDS", self.layout.num_ends);
            constants.uint("PATH_ROW_WORDS", self.layout.row_words);
            constants.bool("PATH_WEIGHTS_VARY", !composition.constant_weights);
        }
        if has_key {
            let index_bits = composition.splitting.map_or(u32::BITS, |splitting| splitting.index_bits());
            constants.uint("PATH_INDEX_MASK", u32::MAX >> (u32::BITS - index_bits));
        }
        if let Some(filtered) = composition.cells.filtered {
            constants.uint("CELL_FILTERED", filtered);
        }
        let mut text = constants.text().to_string();
        // The number of a ray within its family, in the bits of its index above the place in the dispatch.
        let number = if composition.splitting.is_some() { "index >> INDEX_BITS" } else { "0u" };
        let _ = writeln!(text, "fn family_number(index: u32) -> u32 {{\n    return {number};\n}}");
        let [begin, extend] =
            if has_key { ["    begin_key();\n", "    extend_key(kind, number);\n"] } else { ["", ""] };
        let (mut begin, mut extend) = (begin.to_string(), extend.to_string());
        let mut keeps = "    return true;\n".to_string();
        match &state {
            Some(state) => {
                state.functions(&mut text);
                begin.push_str(&state.begin());
                match self.ends_early() {
                    true => {
                        ahead::functions(state, composition.ir, &mut text);
                        extend.push_str("    extend_filter(kind, number);\n");
                    }
                    false => extend.push_str(&state.extend()),
                }
                keeps = state.keeps();
            }
            None => text.push_str("fn filter_out(weight: real, ends: bool) {}\n"),
        }
        if self.is_guided {
            extend.push_str("    extend_guide(kind, number);\n");
        }
        let _ = write!(
            text,
            "fn start_path() {{\n{begin}}}\n\
             fn extend_path(kind: u32, number: u32) {{\n{extend}}}\n\
             fn keeps_path(index: u32) -> bool {{\n{keeps}}}\n"
        );
        text
    }
}
