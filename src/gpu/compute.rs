//! Buffers, bind groups and pipelines of compute shaders.

use crate::error::{Error, Result};
use crate::gpu::Gpu;
use wgpu::util::DeviceExt;

/// One variable of a module's bind groups.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Binding {
    /// The bind group.
    pub group: u32,
    /// The number in the group.
    pub number: u32,
    /// How shaders use it.
    pub access: Access,
}

/// How shaders use a buffer or an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// Small and read by all invocations alike.
    Uniform,
    /// Read only.
    Read,
    /// Read and written.
    ReadWrite,
    /// Read only, from an image of four words a texel.
    Texels,
}

impl Access {
    fn binding_type(self) -> wgpu::BindingType {
        let buffer = |ty| wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None };
        match self {
            Access::Uniform => buffer(wgpu::BufferBindingType::Uniform),
            Access::Read => buffer(wgpu::BufferBindingType::Storage { read_only: true }),
            Access::ReadWrite => buffer(wgpu::BufferBindingType::Storage { read_only: false }),
            Access::Texels => wgpu::BindingType::StorageTexture {
                access: wgpu::StorageTextureAccess::ReadOnly,
                format: wgpu::TextureFormat::Rgba32Uint,
                view_dimension: wgpu::TextureViewDimension::D2,
            },
        }
    }
}

/// The buffers and images that a module declares. Stages may declare one buffer under several names, with different
/// types; such a buffer counts once.
pub fn bindings_of(module: &naga::Module) -> Vec<Binding> {
    let mut bindings: Vec<Binding> = module
        .global_variables
        .iter()
        .filter_map(|(_, variable)| {
            let binding = variable.binding.as_ref()?;
            let access = match variable.space {
                naga::AddressSpace::Uniform => Access::Uniform,
                naga::AddressSpace::Storage { access } if access.contains(naga::StorageAccess::STORE) => {
                    Access::ReadWrite
                }
                naga::AddressSpace::Storage { .. } => Access::Read,
                naga::AddressSpace::Handle => Access::Texels,
                _ => return None,
            };
            Some(Binding { group: binding.group, number: binding.binding, access })
        })
        .collect();
    bindings.sort_by_key(|b| (b.group, b.number));
    bindings.dedup();
    bindings
}

/// Bytes that are read back at once. Data in transit lies in memory twice; a small block stays in a processor's caches.
const READ_BLOCK: u64 = 16 << 20;

/// Bytes of a texel of a table: four words.
pub const TEXEL_BYTES: u32 = 16;

fn extent(width: u32, height: u32) -> wgpu::Extent3d {
    wgpu::Extent3d { width, height, depth_or_array_layers: 1 }
}

/// The advice for a buffer that is too large and grows with the detectors.
const FEWER_PIXELS: &str = "fewer pixels";

impl Gpu {
    /// Compiles a module.
    pub fn shader(&self, label: &str, wgsl: &str) -> wgpu::ShaderModule {
        let descriptor = wgpu::ShaderModuleDescriptor {
            label: Some(label),
            source: wgpu::ShaderSource::Wgsl(wgsl.into()),
        };
        if self.runtime_checks {
            return self.device.create_shader_module(descriptor);
        }
        // SAFETY: every index is built from counts that also sized the host's buffers, and every loop has its own
        // bound. The tests run the same shaders with the checks on.
        #[allow(unsafe_code)]
        unsafe {
            self.device.create_shader_module_trusted(descriptor, wgpu::ShaderRuntimeChecks::unchecked())
        }
    }

    /// The layout of one bind group.
    pub fn bind_group_layout(&self, label: &str, bindings: &[Binding], group: u32) -> wgpu::BindGroupLayout {
        let entries: Vec<wgpu::BindGroupLayoutEntry> = bindings
            .iter()
            .filter(|b| b.group == group)
            .map(|b| wgpu::BindGroupLayoutEntry {
                binding: b.number,
                visibility: wgpu::ShaderStages::COMPUTE,
                ty: b.access.binding_type(),
                count: None,
            })
            .collect();
        self.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some(label),
            entries: &entries,
        })
    }

    /// A bind group of whole buffers, and of images.
    pub fn bind_group<'a>(
        &self,
        label: &str,
        layout: &wgpu::BindGroupLayout,
        buffers: impl IntoIterator<Item = (u32, &'a wgpu::Buffer)>,
        images: &'a [(u32, wgpu::TextureView)],
    ) -> wgpu::BindGroup {
        let buffers = buffers.into_iter().map(|(binding, buffer)| (binding, buffer.as_entire_binding()));
        let images =
            images.iter().map(|(binding, view)| (*binding, wgpu::BindingResource::TextureView(view)));
        let entries: Vec<wgpu::BindGroupEntry> = buffers
            .chain(images)
            .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource })
            .collect();
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(label),
            layout,
            entries: &entries,
        })
    }

    /// A compute pipeline.
    pub fn pipeline(
        &self,
        entry_point: &str,
        shader: &wgpu::ShaderModule,
        layouts: &[&wgpu::BindGroupLayout],
        constants: &[(&str, f64)],
    ) -> wgpu::ComputePipeline {
        let layouts: Vec<Option<&wgpu::BindGroupLayout>> = layouts.iter().map(|l| Some(*l)).collect();
        let layout = self.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(entry_point),
            bind_group_layouts: &layouts,
            immediate_size: 0,
        });
        self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(entry_point),
            layout: Some(&layout),
            module: shader,
            entry_point: Some(entry_point),
            compilation_options: wgpu::PipelineCompilationOptions { constants, ..Default::default() },
            cache: None,
        })
    }

    /// Submits one dispatch of a pipeline by itself.
    pub fn dispatch(&self, pipeline: &wgpu::ComputePipeline, group: &wgpu::BindGroup, workgroups: u32) {
        let mut encoder = self.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(pipeline);
            pass.set_bind_group(0, group, &[]);
            pass.dispatch_workgroups(workgroups, 1, 1);
        }
        self.queue.submit([encoder.finish()]);
    }

    /// A zeroed storage buffer that can be copied from and to.
    ///
    /// # Errors
    /// [`Error::Device`] if the adapter cannot bind so much.
    pub fn buffer(&self, label: &str, size: u64) -> Result<wgpu::Buffer> {
        self.check_binding(label, size, FEWER_PIXELS)?;
        let usage = wgpu::BufferUsages::STORAGE
            | wgpu::BufferUsages::COPY_SRC
            | wgpu::BufferUsages::COPY_DST
            | wgpu::BufferUsages::INDIRECT;
        Ok(self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: size.max(16).next_multiple_of(4),
            usage,
            mapped_at_creation: false,
        }))
    }

    /// A buffer that shaders write and the host reads in place ([`Gpu::has_shared_memory`]).
    ///
    /// # Errors
    /// [`Error::Device`] if the adapter cannot bind so much.
    pub fn mappable_buffer(&self, label: &str, size: u64) -> Result<wgpu::Buffer> {
        self.check_binding(label, size, FEWER_PIXELS)?;
        Ok(self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: size.max(16).next_multiple_of(8),
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        }))
    }

    /// A buffer with fixed contents, which shaders only read.
    pub fn constant_buffer(&self, label: &str, contents: &[u8]) -> wgpu::Buffer {
        let mut padded = contents.to_vec();
        padded.resize(contents.len().max(16).next_multiple_of(4), 0);
        self.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some(label),
            contents: &padded,
            usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
        })
    }

    /// Largest storage buffer that can be bound \[bytes\].
    pub fn largest_binding(&self) -> u64 {
        let limits = self.device.limits();
        limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
    }

    /// Fails if the adapter cannot bind a buffer of this size. `advice` names what would need less.
    fn check_binding(&self, label: &str, size: u64, advice: &str) -> Result<()> {
        let limit = self.largest_binding();
        if size > limit {
            return Err(Error::Device(format!(
                "{label} needs {size} bytes, and the adapter `{}` binds at most {limit}; use {advice} or another adapter",
                self.info.name
            )));
        }
        Ok(())
    }

    /// A table of the scene that shaders only read.
    ///
    /// # Errors
    /// [`Error::Device`] if the adapter cannot bind so much.
    pub fn scene_buffer(&self, contents: &[u8]) -> Result<wgpu::Buffer> {
        let size = contents.len() as u64;
        self.check_binding("a table of the scene", size, "meshes of fewer triangles, --precision f32")?;
        Ok(self.constant_buffer("scene", contents))
    }

    /// A table of the scene, which shaders only read, as an image: four words a texel, and `texels_per_line` texels a
    /// line.
    pub fn scene_texels(&self, contents: &[u8], texels_per_line: u32) -> wgpu::TextureView {
        let bytes_per_line = TEXEL_BYTES * texels_per_line;
        let (lines, last) = contents.split_at(contents.len() - contents.len() % bytes_per_line as usize);
        let num_lines = (lines.len() / bytes_per_line as usize) as u32;
        let descriptor = wgpu::TextureDescriptor {
            label: Some("scene"),
            size: extent(texels_per_line, num_lines + u32::from(!last.is_empty())),
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rgba32Uint,
            usage: wgpu::TextureUsages::STORAGE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        };
        let texture = self.device.create_texture(&descriptor);
        let write = |y: u32, bytes: &[u8], size: wgpu::Extent3d| {
            let origin = wgpu::Origin3d { x: 0, y, z: 0 };
            let place = wgpu::TexelCopyTextureInfo { origin, ..texture.as_image_copy() };
            let layout =
                wgpu::TexelCopyBufferLayout { bytes_per_row: Some(bytes_per_line), ..Default::default() };
            self.queue.write_texture(place, bytes, layout, size);
        };
        if num_lines > 0 {
            write(0, lines, extent(texels_per_line, num_lines));
        }
        if !last.is_empty() {
            write(num_lines, last, extent(last.len() as u32 / TEXEL_BYTES, 1));
        }
        texture.create_view(&Default::default())
    }

    /// Reads the first `size` bytes of a buffer, after everything submitted before.
    pub fn read(&self, buffer: &wgpu::Buffer, size: u64) -> Result<Vec<u8>> {
        self.read_at(buffer, 0, size)
    }

    /// Reads `size` bytes of a buffer from `offset` on, after everything submitted before.
    pub fn read_at(&self, buffer: &wgpu::Buffer, offset: u64, size: u64) -> Result<Vec<u8>> {
        let mut all = Vec::with_capacity(size as usize);
        self.read_blocks(buffer, offset, size.next_multiple_of(4), |_, bytes| all.extend_from_slice(bytes))?;
        Ok(all)
    }

    /// Reads `size` bytes of a buffer, a multiple of 4, from `offset` on, after everything submitted before. Each block
    /// is passed to `visit` with its offset among these bytes.
    pub fn read_blocks(
        &self,
        buffer: &wgpu::Buffer,
        offset: u64,
        size: u64,
        mut visit: impl FnMut(u64, &[u8]),
    ) -> Result<()> {
        if size == 0 {
            return Ok(());
        }
        let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("read-back"),
            size: size.min(READ_BLOCK),
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        for first in (0..size).step_by(READ_BLOCK as usize) {
            let block = (size - first).min(READ_BLOCK);
            let mut encoder = self.device.create_command_encoder(&Default::default());
            encoder.copy_buffer_to_buffer(buffer, offset + first, &staging, 0, block);
            self.queue.submit([encoder.finish()]);
            staging.map_async(wgpu::MapMode::Read, ..block, |_| {});
            self.wait()?;
            let bytes =
                staging.get_mapped_range(..block).map_err(|e| Error::Device(format!("reading back: {e}")))?;
            visit(first, &bytes);
            drop(bytes);
            staging.unmap();
        }
        Ok(())
    }
}
