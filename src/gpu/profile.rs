//! How long each stage of a submission keeps the device, by the device's own timestamps.

use crate::error::{Error, Result};
use crate::gpu::Gpu;

/// Timestamps that a query set holds in WebGPU.
const MAX_TIMESTAMPS: u32 = wgpu::QUERY_SET_MAX_QUERIES;

/// Times the stages of a bounded number of dispatches at once, and adds up their durations.
#[derive(Debug)]
pub struct Profile {
    queries: wgpu::QuerySet,
    timestamps: wgpu::Buffer,
    /// The stages of dispatches whose timestamps have not been read.
    pending: Vec<&'static str>,
    times: Vec<StageSum>,
}

/// The time of one stage so far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StageSum {
    /// The stage, by its entry point.
    pub stage: &'static str,
    /// How often the stage was dispatched.
    pub num_dispatches: u64,
    /// Time on the device \[s\].
    pub seconds: f64,
}

impl Profile {
    /// A profile of submissions of at most `num_dispatches` dispatches.
    ///
    /// # Errors
    /// [`Error::Usage`] if the adapter has no timestamps, or not enough.
    pub fn new(gpu: &Gpu, num_dispatches: u64) -> Result<Self> {
        let count = num_dispatches.saturating_mul(2);
        if !gpu.device.features().contains(wgpu::Features::TIMESTAMP_QUERY) {
            return Err(Error::Usage(format!(
                "the adapter `{}` has no timestamps to profile by",
                gpu.info.name
            )));
        }
        if count > u64::from(MAX_TIMESTAMPS) {
            return Err(Error::Usage(format!(
                "a profile holds {MAX_TIMESTAMPS} timestamps, and so deep a trace takes {count}; lower max_depth"
            )));
        }
        let queries = gpu.device.create_query_set(&wgpu::QuerySetDescriptor {
            label: Some("profile"),
            ty: wgpu::QueryType::Timestamp,
            count: count as u32,
        });
        let timestamps = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("timestamps"),
            size: count * 8,
            usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        Ok(Profile { queries, timestamps, pending: Vec::new(), times: Vec::new() })
    }

    /// Begins a compute pass for the next dispatch of a stage.
    pub fn begin_pass<'e>(
        &mut self,
        encoder: &'e mut wgpu::CommandEncoder,
        stage: &'static str,
    ) -> wgpu::ComputePass<'e> {
        let first = 2 * self.pending.len() as u32;
        self.pending.push(stage);
        encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some(stage),
            timestamp_writes: Some(wgpu::ComputePassTimestampWrites {
                query_set: &self.queries,
                beginning_of_pass_write_index: Some(first),
                end_of_pass_write_index: Some(first + 1),
            }),
        })
    }

    /// Ends the submission's passes.
    pub fn resolve(&self, encoder: &mut wgpu::CommandEncoder) {
        encoder.resolve_query_set(&self.queries, 0..2 * self.pending.len() as u32, &self.timestamps, 0);
    }

    /// Waits for the submission, and adds up its times.
    ///
    /// # Errors
    /// [`Error::Device`] if the device fails.
    pub fn collect(&mut self, gpu: &Gpu) -> Result<()> {
        let bytes = gpu.read(&self.timestamps, 16 * self.pending.len() as u64)?;
        let ticks: Vec<u64> = bytemuck::pod_collect_to_vec(&bytes);
        let period_sec = 1e-9 * f64::from(gpu.queue.get_timestamp_period());
        for (stage, span) in std::mem::take(&mut self.pending).into_iter().zip(ticks.chunks_exact(2)) {
            self.add(stage, period_sec * span[1].saturating_sub(span[0]) as f64);
        }
        Ok(())
    }

    fn add(&mut self, stage: &'static str, seconds: f64) {
        if !self.times.iter().any(|sum| sum.stage == stage) {
            self.times.push(StageSum { stage, num_dispatches: 0, seconds: 0.0 });
        }
        if let Some(sum) = self.times.iter_mut().find(|sum| sum.stage == stage) {
            sum.num_dispatches += 1;
            sum.seconds += seconds;
        }
    }

    /// The times of all stages, in the order of their first dispatches.
    pub fn times(&self) -> &[StageSum] {
        &self.times
    }
}
