//! Compiled shaders of earlier traces. Scenes whose shaders have the same text share one: with live numbers, all scenes
//! of one shape do ([`crate::program::layout::numbers`]).

use crate::engine::stages::{ExtraBindings, Stages};
use crate::error::Result;
use crate::gpu::Gpu;
use crate::program::addition::ShaderAdditions;
use crate::program::parsed::Parsed;
use crate::program::{Precision, Program};
use std::sync::{Arc, Mutex, PoisonError};

/// Compiled shaders by their text, for one device. The shaders that were used last are kept. Clones share them.
#[derive(Clone, Default)]
pub struct PipelineCache {
    /// The one used last stands at the end.
    shaders: Arc<Mutex<Vec<Shader>>>,
}

struct Shader {
    parsed: Arc<Parsed>,
    /// Strictly compiled, and not.
    stages: [Option<Arc<Stages>>; 2],
}

/// Where the shaders of a trace come from.
#[derive(Clone, Copy, Default)]
pub struct Shaders<'s> {
    /// Compiled shaders of earlier traces. The shaders of this trace are added.
    pub cache: Option<&'s PipelineCache>,
    /// Changes the composed text, and keeps nothing: for tests that must notice a wrong shader.
    pub edit: Option<&'s dyn Fn(String) -> String>,
}

impl Shaders<'_> {
    /// The module of a text.
    pub(crate) fn parsed(
        self,
        wgsl: String,
        precision: Precision,
        additions: &ShaderAdditions,
    ) -> Result<Arc<Parsed>> {
        match (self.edit, self.cache) {
            (Some(edit), _) => Parsed::of(edit(wgsl), precision, additions).map(Arc::new),
            (None, Some(cache)) => cache.parsed(wgsl, precision, additions),
            (None, None) => Parsed::of(wgsl, precision, additions).map(Arc::new),
        }
    }

    /// The stages of a program, with those that additions bring.
    pub(crate) fn stages(
        self,
        gpu: &Gpu,
        program: &Program,
        strict: bool,
        extra: &ExtraBindings,
    ) -> Result<Arc<Stages>> {
        match self.cache.filter(|_| self.edit.is_none() && extra.stages.is_empty()) {
            Some(cache) => cache.stages(gpu, program, strict),
            None => Stages::new(gpu, program, strict, extra).map(Arc::new),
        }
    }
}

/// Most shaders that a cache keeps.
const MOST_SHADERS: usize = 32;
/// Most bytes of their texts. Parsed and compiled, a shader takes up to a hundred times the memory of its text on
/// lavapipe. So a cache takes some 500 MB at most.
const MOST_BYTES: usize = 5 << 20;

impl PipelineCache {
    /// An empty cache.
    pub fn new() -> Self {
        Self::default()
    }

    /// The number of shaders that it keeps.
    pub fn len(&self) -> usize {
        self.lock().len()
    }

    /// The bytes of their texts.
    pub fn num_bytes(&self) -> usize {
        self.lock().iter().map(|shader| shader.parsed.num_bytes()).sum()
    }

    /// True if it keeps none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Vec<Shader>> {
        self.shaders.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The module of a text, parsed now if it was not before.
    fn parsed(&self, wgsl: String, precision: Precision, additions: &ShaderAdditions) -> Result<Arc<Parsed>> {
        if let Some(parsed) = self.used(|shader| shader.parsed.wgsl == wgsl, |shader| shader.parsed.clone()) {
            return Ok(parsed);
        }
        // Unlocked: another trace may compile meanwhile.
        let parsed = Arc::new(Parsed::of(wgsl, precision, additions)?);
        let mut shaders = self.lock();
        shaders.push(Shader { parsed: parsed.clone(), stages: [None, None] });
        let surplus = surplus(shaders.iter().map(|shader| shader.parsed.num_bytes()));
        shaders.drain(..surplus);
        Ok(parsed)
    }

    /// The stages of a program whose additions bring none, compiled now if they were not before.
    fn stages(&self, gpu: &Gpu, program: &Program, strict: bool) -> Result<Arc<Stages>> {
        let is_same = |shader: &Shader| Arc::ptr_eq(&shader.parsed, &program.parsed);
        let place = usize::from(strict);
        if let Some(stages) = self.used(is_same, |shader| shader.stages[place].clone()).flatten() {
            return Ok(stages);
        }
        let stages = Arc::new(Stages::new(gpu, program, strict, &ExtraBindings::default())?);
        self.used(is_same, |shader| shader.stages[place] = Some(stages.clone()));
        Ok(stages)
    }

    /// What is read of, or done to, the shader that is so. It is then the one used last.
    fn used<T>(&self, is_so: impl Fn(&Shader) -> bool, with: impl FnOnce(&mut Shader) -> T) -> Option<T> {
        let mut shaders = self.lock();
        let at = shaders.iter().position(is_so)?;
        let mut shader = shaders.remove(at);
        let found = with(&mut shader);
        shaders.push(shader);
        Some(found)
    }
}

/// How many texts, of these lengths in bytes and the one used last at the end, are too many. The last one always stays.
fn surplus(lengths: impl DoubleEndedIterator<Item = usize> + ExactSizeIterator) -> usize {
    let num = lengths.len();
    let mut sum = 0;
    let fits = |length: &usize| {
        sum += length;
        sum <= MOST_BYTES
    };
    let kept = lengths.rev().take(MOST_SHADERS).take_while(fits).count();
    num - kept.max(1).min(num)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shaders_used_last_stay_within_the_bounds() {
        let surplus = |lengths: &[usize]| super::surplus(lengths.iter().copied());
        assert_eq!(surplus(&[]), 0);
        assert_eq!(surplus(&[1; MOST_SHADERS]), 0);
        assert_eq!(surplus(&[1; MOST_SHADERS + 3]), 3);
        assert_eq!(surplus(&[MOST_BYTES / 2; 5]), 3);
        assert_eq!(surplus(&[1, MOST_BYTES + 1]), 1, "the last one stays, however long");
        assert_eq!(surplus(&[MOST_BYTES, 1]), 1);
    }
}
