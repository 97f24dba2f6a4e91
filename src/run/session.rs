//! What runs keep from one to the next: the device, and compiled shaders.

use crate::error::{Error, Result};
use crate::gpu::{AdapterChoice, Gpu};
use crate::run::{PipelineCache, Run};

/// A device, and compiled shaders of the runs that traced on it. Python's `Session` is a process of `nsq-gpu serve`,
/// which holds one session of this type.
pub struct Session {
    choice: AdapterChoice,
    opened: Option<Opened>,
}

struct Opened {
    gpu: Gpu,
    cache: PipelineCache,
}

impl Session {
    /// A session on this adapter, which is opened when it is first needed.
    pub fn new(choice: AdapterChoice) -> Self {
        Session { choice, opened: None }
    }

    /// Opens the device, unless it is open.
    ///
    /// # Errors
    /// [`Error::NoAdapter`] if no adapter fits.
    pub fn open(&mut self) -> Result<&Gpu> {
        self.opened().map(|opened| &opened.gpu)
    }

    fn opened(&mut self) -> Result<&Opened> {
        if self.opened.is_none() {
            self.opened = Some(Opened { gpu: Gpu::open(&self.choice)?, cache: PipelineCache::new() });
        }
        self.opened.as_ref().ok_or_else(|| Error::Internal("no device".into()))
    }

    /// Closes the device, which may be lost. The next run opens another.
    pub fn close(&mut self) {
        self.opened = None;
    }

    /// The number of compiled shaders that are kept, and the bytes of their texts.
    pub fn shaders(&self) -> [usize; 2] {
        self.opened.as_ref().map_or([0, 0], |opened| [opened.cache.len(), opened.cache.num_bytes()])
    }

    /// The run on the session's device, with its shaders. The shaders serve scenes whose numbers are live: in short
    /// traces, or as `live` says.
    ///
    /// # Errors
    /// As [`Session::open`].
    pub fn run<'a>(&'a mut self, run: Run<'a>, live: Option<bool>) -> Result<Run<'a>> {
        let Opened { gpu, cache } = self.opened()?;
        Ok(Run { cache: Some(cache), live, ..run.on(gpu) })
    }
}
