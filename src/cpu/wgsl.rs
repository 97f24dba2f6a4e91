//! The WGSL that the CPU backend adds to the module of a scene: the deposit log, and the stages of paths.

use crate::cpu::log::format::EntryFormat;
use crate::cpu::path::compose::Stages;
use crate::cpu::request::CpuShader;
use crate::error::Result;
use crate::program::Precision;
use crate::program::addition::ShaderAddition;
use crate::program::wgsl::composition::Composition;
use crate::program::wgsl::constants::Constants;
use crate::program::wgsl::text::Text;
use crate::program::wgsl::variants::either;
use crate::shaders::{ShaderFile, shader};

impl CpuShader {
    fn constants(&self) -> Constants {
        let mut constants = Constants::default();
        if self.hot_path.is_some() {
            constants.uint("PATH_RAYS_PER_INVOCATION", self.rays_per_invocation);
        }
        if let Some(log) = &self.deposit_log {
            constants.uint("LOG_WORDS", log.num_words());
            constants.bool("MEDIA_ABSORB_WEAKLY", self.media_absorb_weakly);
            constants.bool("LOGS_POSITIONS", log.logs_positions());
            constants.bool("LOGS_WEIGHTS", log.logs_weights());
        }
        constants
    }

    /// The files that stand in no slot of the plain module.
    fn files(&self, composition: &Composition) -> Vec<ShaderFile> {
        let entries = self.deposit_log.as_ref().map(|log| entries_file(log.format));
        if self.hot_path.is_none() {
            return entries.into_iter().collect();
        }
        let several = self.rays_per_invocation > 1;
        let optional = [
            entries,
            self.path_log.as_ref().map(|_| self.arrivals_file(composition)),
            several.then_some(shader!("cpu/path/path_rays.wgsl")),
            self.has_pairs.then_some(shader!("cpu/path/ray_pair.wgsl")),
        ];
        let always = [
            shader!("cpu/path/hot_path.wgsl"),
            either(
                composition.wrong_sides().is_some(),
                shader!("cpu/path/sides.guarded.wgsl"),
                shader!("cpu/path/sides.none.wgsl"),
            ),
            shader!("cpu/path/miss_tests.wgsl"),
            either(
                self.path_log.is_some(),
                shader!("cpu/path/path_log.arrivals.wgsl"),
                shader!("cpu/path/path_log.entries.wgsl"),
            ),
            either(
                self.logs_weights(),
                shader!("cpu/path/path_losses.reported.wgsl"),
                shader!("cpu/path/path_losses.deposited.wgsl"),
            ),
        ];
        always.into_iter().chain(optional.into_iter().flatten()).collect()
    }

    fn arrivals_file(&self, composition: &Composition) -> ShaderFile {
        match (self.logs_weights(), composition.precision()) {
            (true, _) => shader!("cpu/log/arrivals.weighted.wgsl"),
            (false, Precision::F64) => shader!("cpu/log/arrivals.reals.wgsl"),
            (false, Precision::F32 | Precision::Df64) => shader!("cpu/log/arrivals.packed.wgsl"),
        }
    }
}

impl ShaderAddition for CpuShader {
    fn replaces(&self) -> Vec<(&'static str, ShaderFile)> {
        let files = [
            (self.hot_path.is_some(), "stages/ids", shader!("stages/ids.listed.wgsl")),
            (self.deposit_log.is_some(), "sums/ends", shader!("cpu/log/ends.logged.wgsl")),
            (self.logs_passes(), "sums/passes", shader!("cpu/log/passes.logged.wgsl")),
        ];
        files.into_iter().filter_map(|(is_taken, slot, file)| is_taken.then_some((slot, file))).collect()
    }

    fn add(&self, composition: &Composition, text: &mut Text) -> Result<()> {
        text.composed("cpu::wgsl", self.constants().text());
        text.files(self.files(composition));
        text.composed("cpu::path::compose", &Stages { extension: self, composition }.text()?);
        Ok(())
    }

    fn logs_passes(&self) -> bool {
        self.deposit_log.as_ref().is_some_and(|log| log.max_passes > 0)
    }

    fn restores_bins(&self) -> bool {
        self.hot_path.is_some()
    }

    fn keeps_bin_of(&self, primitive: usize) -> bool {
        let paths = self.hot_path.iter().chain(self.side_traces.iter().map(|side| &side.path));
        paths.flat_map(|path| &path.events).any(|event| event.primitive == primitive)
    }
}

fn entries_file(format: EntryFormat) -> ShaderFile {
    match format {
        EntryFormat::Counts => shader!("cpu/log/entries.counts.wgsl"),
        EntryFormat::Packed => shader!("cpu/log/entries.packed.wgsl"),
        EntryFormat::Reals => shader!("cpu/log/entries.reals.wgsl"),
    }
}
