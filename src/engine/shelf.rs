//! Compiled shaders of earlier traces. Scenes whose shaders have the same text share one: with live numbers, all scenes
//! of one shape do ([`crate::program::layout::numbers`]).

use crate::engine::stages::{Additions, Stages};
use crate::error::Result;
use crate::gpu::Gpu;
use crate::program::parsed::Parsed;
use crate::program::{Precision, Program};
use std::sync::{Arc, Mutex, PoisonError};

/// Compiled shaders by their text, for one device. The shaders that were used last are kept.
#[derive(Default)]
pub struct Shelf {
    /// The one used last stands at the end.
    shaders: Mutex<Vec<Shader>>,
}

struct Shader {
    parsed: Arc<Parsed>,
    /// Strictly compiled, and not.
    stages: [Option<Arc<Stages>>; 2],
}

/// Most shaders that a shelf keeps. One takes a driver some megabytes.
const MOST_SHADERS: usize = 32;

impl Shelf {
    /// An empty shelf.
    pub fn new() -> Self {
        Self::default()
    }

    /// The number of shaders that it keeps.
    pub fn len(&self) -> usize {
        self.lock().len()
    }

    /// True if it keeps none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Vec<Shader>> {
        self.shaders.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The module of a text, parsed now if it was not before.
    pub(crate) fn parsed(&self, wgsl: String, precision: Precision) -> Result<Arc<Parsed>> {
        let mut shaders = self.lock();
        let shader = match shaders.iter().position(|shader| shader.parsed.wgsl == wgsl) {
            Some(at) => shaders.remove(at),
            None => Shader { parsed: Arc::new(Parsed::of(wgsl, precision)?), stages: [None, None] },
        };
        let parsed = shader.parsed.clone();
        shaders.push(shader);
        let surplus = shaders.len().saturating_sub(MOST_SHADERS);
        shaders.drain(..surplus);
        Ok(parsed)
    }

    /// The stages of a program without additions, compiled now if they were not before.
    pub(crate) fn stages(&self, gpu: &Gpu, program: &Program, strict: bool) -> Result<Arc<Stages>> {
        let compile = || Stages::new(gpu, program, strict, &Additions::default()).map(Arc::new);
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
