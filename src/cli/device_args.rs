//! The options that name a device, which commands that trace share.

use crate::error::Result;
use crate::gpu::{AdapterChoice, Gpu, Native};

/// On which adapter to trace, and with what of it.
#[derive(Debug, Clone, clap::Args)]
pub(crate) struct DeviceArgs {
    /// Part of the adapter's name (see `nsq-gpu adapters`).
    #[arg(long, value_name = "NAME")]
    adapter: Option<String>,
    /// Use no native 64-bit integers or atomics of the device: the same bits from plain WebGPU.
    #[arg(long)]
    portable: bool,
}

impl DeviceArgs {
    /// The adapter.
    pub(crate) fn choice(&self) -> AdapterChoice {
        let native = if self.portable { Native::Off } else { Native::Allowed };
        AdapterChoice { name: self.adapter.clone(), native, ..AdapterChoice::default() }
    }

    /// Opens the device.
    pub(crate) fn open(&self) -> Result<Gpu> {
        Gpu::open(&self.choice())
    }
}
