//! Whether an adapter is a processor or a GPU: found out once. What is done otherwise for that reason has a name here.

/// What an adapter computes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AdapterClass {
    /// A processor, whose driver is software, such as lavapipe.
    Processor,
    /// A graphics processor.
    Graphics,
}

impl AdapterClass {
    pub(crate) fn of(device_type: wgpu::DeviceType) -> Self {
        match device_type {
            wgpu::DeviceType::Cpu => AdapterClass::Processor,
            _ => AdapterClass::Graphics,
        }
    }

    fn is_processor(self) -> bool {
        self == AdapterClass::Processor
    }

    /// It is taken where no GPU is found.
    pub fn stands_in_for_gpu(self) -> bool {
        self.is_processor()
    }

    /// Arithmetic is strict unless a user says otherwise: strictness costs nothing there.
    pub fn is_strict_by_default(self) -> bool {
        self.is_processor()
    }

    /// It computes f64 about as fast as f32.
    pub fn computes_f64_as_fast_as_f32(self) -> bool {
        self.is_processor()
    }

    /// The device's memory is the host's.
    pub fn shares_memory_with_host(self) -> bool {
        self.is_processor()
    }

    /// A variable of its driver may set how wide vectors are.
    pub fn has_vectors_of_a_set_width(self) -> bool {
        self.is_processor()
    }

    /// Lanes are emulated: workgroups cost memory each, and stores and atomics go lane by lane.
    pub fn emulates_lanes(self) -> bool {
        self.is_processor()
    }
}
