//! Compiled shaders of earlier traces. Scenes whose shaders have the same text share one: with live numbers, all scenes
//! of one shape do ([`crate::program::layout::numbers`]).

use crate::engine::stages::{ExtraBindings, Stages};
use crate::error::Result;
use crate::gpu::Gpu;
use crate::program::addition::ShaderAdditions;
use crate::program::parsed::Parsed;
use crate::program::{Precision, Program};
use std::sync::{Arc, Mutex, PoisonError};

/// Compiled shaders by their text, for one device. The shaders that were used last are kept.
#[derive(Default)]
pub struct PipelineCache {
    /// The one used last stands at the end.
    shaders: Mutex<Vec<Shader>>,
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
        let mut shaders = self.lock();
        let shader = match shaders.iter().position(|shader| shader.parsed.wgsl == wgsl) {
            Some(at) => shaders.remove(at),
            None => {
                Shader { parsed: Arc::new(Parsed::of(wgsl, precision, additions)?), stages: [None, None] }
            }
        };
        let parsed = shader.parsed.clone();
        shaders.push(shader);
        let surplus = surplus(shaders.iter().map(|shader| shader.parsed.num_bytes()));
        shaders.drain(..surplus);
        Ok(parsed)
    }

    /// The stages of a program whose additions bring none, compiled now if they were not before.
    fn stages(&self, gpu: &Gpu, program: &Program, strict: bool) -> Result<Arc<Stages>> {
        let compile = || Stages::new(gpu, program, strict, &ExtraBindings::default()).map(Arc::new);
        let mut shaders = self.lock();
        let shader = shaders.iter_mut().find(|shader| Arc::ptr_eq(&shader.parsed, &program.parsed));
        let Some(shader) = shader else { return compile() };
        let place = &mut shader.stages[usize::from(strict)];
        if let Some(stages) = place {
            return Ok(stages.clone());
        }
        Ok(place.insert(compile()?).clone())
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
