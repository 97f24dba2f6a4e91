//! Adapters and devices.

use crate::error::{Error, Result};
use crate::gpu::adapter_class::AdapterClass;
use crate::gpu::adapter_name::without_width;
use crate::gpu::no_adapter;
use std::sync::{Arc, Mutex, OnceLock};

/// How to choose an adapter.
#[derive(Debug, Clone, Default)]
pub struct AdapterChoice {
    /// Part of the adapter's name, in upper or lower case. `None` chooses the best of all.
    pub name: Option<String>,
    /// Whether native features of the device may be used. Without them, the portable baseline gives the same bits.
    pub native: Native,
    /// The compiler's bounds checks and loop bounding in shaders: on in tests, off where speed counts.
    pub runtime_checks: bool,
    /// Which ways to trace. All ways give the same bits where arithmetic is strict.
    pub ways: Ways,
}

/// Which ways to trace: where sums are added, in what memory tables lie, how many rays an invocation follows.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Ways {
    /// The ways that suit the adapter's kind.
    #[default]
    OfItsKind,
    /// The ways of graphics processors, on any adapter: for tests on machines without one.
    OfGraphicsProcessors,
}

/// Whether optional features of the device are used.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Native {
    /// All that the device has.
    #[default]
    Allowed,
    /// No optional features: plain WebGPU.
    Off,
}

/// The properties of an adapter.
#[derive(Debug, Clone, PartialEq)]
pub struct AdapterInfo {
    /// The adapter's name.
    pub name: String,
    /// Driver and its version.
    pub driver: String,
    /// Vulkan, Metal or DX12.
    pub backend: String,
    /// Discrete GPU, integrated GPU, CPU.
    pub kind: String,
    /// What the adapter computes on: how it is treated follows from that.
    pub class: AdapterClass,
    /// True if shaders have 64-bit floats.
    pub f64: bool,
    /// True if shaders have 64-bit integers and their atomics.
    pub int64: bool,
    /// Largest storage buffer binding \[bytes\].
    pub max_binding_size: u64,
    /// True if the adapter takes SPIR-V, in which arithmetic can be strict (`gpu::strict`).
    pub strict: bool,
}

impl AdapterInfo {
    /// True if the adapter is reached by Vulkan.
    pub fn is_vulkan(&self) -> bool {
        self.backend == wgpu::Backend::Vulkan.to_string()
    }
}

/// An open device. A clone is another handle of the same device.
#[derive(Debug, Clone)]
pub struct Gpu {
    /// The device.
    pub device: wgpu::Device,
    /// The device's queue.
    pub queue: wgpu::Queue,
    /// The adapter on which the device was opened.
    pub info: AdapterInfo,
    /// True if 64-bit floats are enabled.
    pub f64: bool,
    /// True if 64-bit integers and their atomics are enabled.
    pub int64: bool,
    /// True if shaders check bounds.
    pub runtime_checks: bool,
    /// The adapter as wgpu knows it.
    adapter: wgpu::Adapter,
    choice: AdapterChoice,
    failure: Arc<Mutex<Option<String>>>,
    /// The result of the test of double-word arithmetic, after its first run.
    pub(crate) df64: OnceLock<Result<()>>,
}

fn instance() -> wgpu::Instance {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle_from_env();
    // wgpu's own check of an indirect dispatch costs one more dispatch each time. Our counts come from our own shader.
    descriptor.flags.remove(wgpu::InstanceFlags::VALIDATION_INDIRECT_CALL);
    wgpu::Instance::new(descriptor)
}

fn describe(adapter: &wgpu::Adapter) -> AdapterInfo {
    let info = adapter.get_info();
    let features = adapter.features();
    let takes_shaders = features.contains(wgpu::Features::PASSTHROUGH_SHADERS);
    AdapterInfo {
        strict: info.backend == wgpu::Backend::Vulkan && takes_shaders,
        name: without_width(&info.name),
        driver: format!("{} {}", info.driver, info.driver_info).trim().to_string(),
        backend: info.backend.to_string(),
        kind: format!("{:?}", info.device_type),
        class: AdapterClass::of(info.device_type),
        f64: features.contains(wgpu::Features::SHADER_F64),
        int64: features.contains(int64_features()),
        max_binding_size: adapter.limits().max_storage_buffer_binding_size,
    }
}

fn int64_features() -> wgpu::Features {
    wgpu::Features::SHADER_INT64 | wgpu::Features::SHADER_INT64_ATOMIC_ALL_OPS
}

/// The adapters that can compute, best first: discrete, integrated, virtual, then software. Within a kind, adapters
/// with `f64` come first.
fn adapters(instance: &wgpu::Instance) -> Vec<wgpu::Adapter> {
    let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    adapters.retain(|a| a.get_downlevel_capabilities().flags.contains(wgpu::DownlevelFlags::COMPUTE_SHADERS));
    adapters.sort_by_key(|adapter| {
        let kind = match adapter.get_info().device_type {
            wgpu::DeviceType::DiscreteGpu => 0,
            wgpu::DeviceType::IntegratedGpu => 1,
            wgpu::DeviceType::VirtualGpu => 2,
            wgpu::DeviceType::Cpu => 3,
            wgpu::DeviceType::Other => 4,
        };
        (kind, !adapter.features().contains(wgpu::Features::SHADER_F64))
    });
    adapters
}

/// Every adapter that can compute, best first.
pub fn list_adapters() -> Vec<AdapterInfo> {
    adapters(&instance()).iter().map(describe).collect()
}

impl Gpu {
    /// Opens the best adapter that fits.
    ///
    /// # Errors
    /// [`Error::NoAdapter`] if none fits. The message lists the adapters that exist, and how to get one.
    pub fn open(choice: &AdapterChoice) -> Result<Self> {
        let adapters = adapters(&instance());
        if adapters.is_empty() {
            return Err(Error::NoAdapter(no_adapter::message()));
        }
        let wanted = without_width(choice.name.as_deref().unwrap_or("")).to_lowercase();
        let name = |a: &wgpu::Adapter| without_width(&a.get_info().name);
        let fits = |a: &&wgpu::Adapter| name(a).to_lowercase().contains(&wanted);
        let adapter = adapters.iter().find(fits).ok_or_else(|| {
            let names: Vec<String> = adapters.iter().map(|a| format!("`{}`", name(a))).collect();
            Error::NoAdapter(format!("no adapter is named like `{wanted}`; there are {}", names.join(", ")))
        })?;
        Self::from_adapter(adapter, choice)
    }

    /// Opens the same adapter once more, as a device of its own. What one device compiles and runs does not wait for
    /// the other.
    ///
    /// # Errors
    /// [`Error::NoAdapter`] if the adapter gives no more devices.
    pub fn open_again(&self) -> Result<Self> {
        Self::from_adapter(&self.adapter, &self.choice)
    }

    fn from_adapter(adapter: &wgpu::Adapter, choice: &AdapterChoice) -> Result<Self> {
        let mut info = describe(adapter);
        if choice.ways == Ways::OfGraphicsProcessors {
            info.class = AdapterClass::Graphics;
        }
        let native = choice.native == Native::Allowed;
        let mut features = wgpu::Features::empty();
        // 64-bit floats are enabled even without native features, because f64 is a tier of its own and no shortcut.
        if info.f64 {
            features |= wgpu::Features::SHADER_F64;
        }
        if native && info.int64 {
            features |= int64_features();
        }
        if native {
            features |= adapter.features() & wgpu::Features::TIMESTAMP_QUERY;
        }
        if native && info.class.shares_memory_with_host() {
            features |= adapter.features() & wgpu::Features::MAPPABLE_PRIMARY_BUFFERS;
        }
        if info.strict {
            features |= wgpu::Features::PASSTHROUGH_SHADERS;
        }
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("nsq-gpu"),
            required_features: features,
            required_limits: adapter.limits(),
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|e| Error::NoAdapter(format!("the adapter `{}` gives no device: {e}", info.name)))?;
        let failure = Arc::new(Mutex::new(None));
        let (lost, uncaptured) = (failure.clone(), failure.clone());
        device.set_device_lost_callback(move |reason, message| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                note(&lost, format!("the device was lost: {message}"));
            }
        });
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            note(
                &uncaptured,
                match error {
                    wgpu::Error::OutOfMemory { .. } => "the device is out of memory".to_string(),
                    other => other.to_string(),
                },
            );
        }));
        let (f64, int64) = (info.f64, native && info.int64);
        let (runtime_checks, df64) = (choice.runtime_checks, OnceLock::new());
        let (adapter, choice) = (adapter.clone(), choice.clone());
        Ok(Gpu { device, queue, info, f64, int64, runtime_checks, adapter, choice, failure, df64 })
    }

    /// The greatest number of lanes of the driver's vectors. The text of shaders must differ with this number. Some
    /// drivers take the number from the environment, as lavapipe does, but ignore it when they look for a compiled
    /// shader in their cache.
    pub fn vector_lanes(&self) -> u32 {
        self.adapter.get_info().subgroup_max_size
    }

    /// True if a processor stands in for a GPU: none was found, and nobody named this adapter.
    pub fn stands_in_for_gpu(&self) -> bool {
        self.info.class.stands_in_for_gpu() && self.choice.name.is_none()
    }

    /// True if the host can read a dispatch's output in place.
    pub fn has_shared_memory(&self) -> bool {
        self.device.features().contains(wgpu::Features::MAPPABLE_PRIMARY_BUFFERS)
    }

    /// Fails if the device was lost, ran out of memory or reported an error.
    pub fn check(&self) -> Result<()> {
        let failure = self.failure.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        failure.as_ref().map_or(Ok(()), |message| Err(Error::Device(message.clone())))
    }

    /// Waits until everything submitted is done.
    pub fn wait(&self) -> Result<()> {
        self.poll(None)
    }

    /// Waits until a submission and those before it are done.
    pub fn wait_for(&self, submission: wgpu::SubmissionIndex) -> Result<()> {
        self.poll(Some(submission))
    }

    fn poll(&self, submission_index: Option<wgpu::SubmissionIndex>) -> Result<()> {
        let polled = self.device.poll(wgpu::PollType::Wait { submission_index, timeout: None });
        self.check()?;
        polled.map(|_| ()).map_err(|e| Error::Device(format!("waiting for the device: {e}")))
    }
}

/// Keeps the first failure, because later failures are its consequences.
fn note(failure: &Mutex<Option<String>>, message: String) {
    failure.lock().unwrap_or_else(std::sync::PoisonError::into_inner).get_or_insert(message);
}
