//! A small harness that runs WGSL on the adapter, for tests.
#![allow(dead_code, reason = "each test binary compiles the harness and uses its part of it")]

use nsq_gpu::program::rewrite::df64;
use nsq_gpu::program::wgsl::library::{Integers, Real};
use std::io::Write;
use wgpu::util::DeviceExt;

/// Every tier: precision and integers.
pub const TIERS: [(Real, Integers); 6] = [
    (Real::F32, Integers::Portable),
    (Real::F32, Integers::Native),
    (Real::Df64, Integers::Portable),
    (Real::Df64, Integers::Native),
    (Real::F64, Integers::Portable),
    (Real::F64, Integers::Native),
];

/// A device with the features of one tier. Its shaders run with every run-time check.
pub struct Gpu {
    device: wgpu::Device,
    queue: wgpu::Queue,
}

/// A storage buffer of group 0: its binding, what it starts with, and whether the shader writes it.
pub struct Storage {
    binding: u32,
    bytes: Vec<u8>,
    written: bool,
}

impl Storage {
    /// A buffer that the shader reads.
    pub fn read<T: bytemuck::NoUninit>(binding: u32, values: &[T]) -> Self {
        Self { binding, bytes: bytemuck::cast_slice(values).to_vec(), written: false }
    }

    /// A buffer of `array<real>` that the shader reads; f32 and df64 round the numbers.
    pub fn reals(binding: u32, real: Real, numbers: &[f64]) -> Self {
        match real {
            Real::F32 => {
                Self::read(binding, &numbers.iter().map(|&number| number as f32).collect::<Vec<f32>>())
            }
            Real::Df64 => Self::read(binding, &numbers.iter().copied().map(df64::split).collect::<Vec<_>>()),
            Real::F64 => Self::read(binding, numbers),
        }
    }

    /// A buffer of zeros that the shader writes.
    pub fn zeros(binding: u32, num_bytes: usize) -> Self {
        Self { binding, bytes: vec![0; num_bytes], written: true }
    }

    /// A buffer that the shader writes, with a start of its own.
    pub fn written<T: bytemuck::NoUninit>(binding: u32, values: &[T]) -> Self {
        Self { written: true, ..Self::read(binding, values) }
    }
}

/// Bytes of a `real`.
pub fn real_bytes(real: Real) -> usize {
    match real {
        Real::F32 => 4,
        Real::Df64 | Real::F64 => 8,
    }
}

/// The numbers of an `array<real>` that a shader wrote.
pub fn reals_of(real: Real, bytes: &[u8]) -> Vec<f64> {
    match real {
        Real::F32 => bytemuck::cast_slice::<u8, f32>(bytes).iter().map(|&number| f64::from(number)).collect(),
        Real::Df64 => bytemuck::cast_slice(bytes).iter().map(|&pair| df64::join(pair)).collect(),
        Real::F64 => bytemuck::cast_slice(bytes).to_vec(),
    }
}

/// The features that a tier needs.
pub fn features(real: Real, integers: Integers) -> wgpu::Features {
    let real = match real {
        Real::F32 | Real::Df64 => wgpu::Features::empty(),
        Real::F64 => wgpu::Features::SHADER_F64,
    };
    let integers = match integers {
        Integers::Portable => wgpu::Features::empty(),
        Integers::Native => wgpu::Features::SHADER_INT64 | wgpu::Features::SHADER_INT64_ATOMIC_ALL_OPS,
    };
    real | integers
}

impl Gpu {
    /// A device for a tier, or a loud line and nothing where this machine has no such adapter.
    pub fn open(test: &str, real: Real, integers: Integers) -> Option<Self> {
        let gpu = pollster::block_on(Self::request(features(real, integers)));
        if gpu.is_none() {
            // Straight to the stream: the test runner hides what a passing test prints.
            writeln!(
                std::io::stderr(),
                "SKIPPED: {test}: no adapter for {real:?} with {integers:?} integers"
            )
            .expect("standard error takes a line");
        }
        gpu
    }

    async fn request(features: wgpu::Features) -> Option<Self> {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
        let options = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            ..Default::default()
        };
        let adapter = instance.request_adapter(&options).await.ok()?;
        if !adapter.features().contains(features) {
            return None;
        }
        let descriptor = wgpu::DeviceDescriptor {
            required_features: features,
            required_limits: adapter.limits(),
            ..Default::default()
        };
        let (device, queue) = adapter.request_device(&descriptor).await.expect("an adapter gives a device");
        Some(Self { device, queue })
    }

    /// Runs the entry point `main` of a shader and returns the bytes of the written buffers, in their order.
    pub fn run(&self, source: &str, storages: &[Storage], workgroups: [u32; 3]) -> Vec<Vec<u8>> {
        let Some(pairs) = rewritten(source) else { return self.run_text(source, storages, workgroups) };
        let zero = Storage::read(df64::ZERO, &[0_u32; 4]);
        let storages: Vec<&Storage> = storages.iter().chain([&zero]).collect();
        self.run_text(&pairs, &storages, workgroups)
    }

    /// Runs the only entry point of a text as it stands.
    pub fn run_text(
        &self,
        text: &str,
        storages: &[impl std::borrow::Borrow<Storage>],
        workgroups: [u32; 3],
    ) -> Vec<Vec<u8>> {
        let storages: Vec<&Storage> = storages.iter().map(std::borrow::Borrow::borrow).collect();
        let pipeline = self.pipeline(text);
        let buffers: Vec<wgpu::Buffer> = storages.iter().map(|storage| self.buffer(storage)).collect();
        let entries: Vec<wgpu::BindGroupEntry> = storages
            .iter()
            .zip(&buffers)
            .map(|(storage, buffer)| wgpu::BindGroupEntry {
                binding: storage.binding,
                resource: buffer.as_entire_binding(),
            })
            .collect();
        let bind_group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &pipeline.get_bind_group_layout(0),
            entries: &entries,
        });
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&pipeline);
            pass.set_bind_group(0, &bind_group, &[]);
            pass.dispatch_workgroups(workgroups[0], workgroups[1], workgroups[2]);
        }
        self.queue.submit([encoder.finish()]);
        let written = storages.iter().zip(&buffers).filter(|(storage, _)| storage.written);
        written.map(|(_, buffer)| self.read_back(buffer)).collect()
    }

    fn pipeline(&self, source: &str) -> wgpu::ComputePipeline {
        let module = self.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: None,
            source: wgpu::ShaderSource::Wgsl(source.into()),
        });
        self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: None,
            layout: None,
            module: &module,
            entry_point: None,
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        })
    }

    fn buffer(&self, storage: &Storage) -> wgpu::Buffer {
        self.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: None,
            contents: &storage.bytes,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
        })
    }

    fn read_back(&self, buffer: &wgpu::Buffer) -> Vec<u8> {
        let mapped = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: None,
            size: buffer.size(),
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.copy_buffer_to_buffer(buffer, 0, &mapped, 0, buffer.size());
        self.queue.submit([encoder.finish()]);
        mapped.map_async(wgpu::MapMode::Read, .., |result| result.expect("the buffer maps"));
        self.device.poll(wgpu::PollType::wait_indefinitely()).expect("the device finishes");
        mapped.get_mapped_range(..).expect("the buffer is mapped").to_vec()
    }
}

/// A source in df64 with pairs in place of f64.
fn rewritten(source: &str) -> Option<String> {
    source.contains(df64::LIBRARY).then(|| {
        let module = naga::front::wgsl::parse_str(source).expect("the source is valid");
        df64::rewrite(&module).expect("the source has a counterpart in df64").1
    })
}
