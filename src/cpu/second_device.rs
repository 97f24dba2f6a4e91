//! A second device on the same adapter, which takes turns with the first: on processors two keep it busier than one
//! ([`crate::cpu::adapter_traits::AdapterTraits::two_devices`]).

use crate::cpu::Cpu;
use crate::engine::Engine;
use crate::error::Result;

/// A second device saves a tenth of the time and more, and takes a fifth of a second to open: it pays where so much is left.
const PAYS_SEC: f64 = 2.0;
/// It needs as much memory as the first, which may be so much \[bytes\].
const MOST_BYTES: u64 = 64 << 20;

impl Cpu {
    /// Opens a second device if that pays for so many rays as are left, or is asked for.
    pub(super) fn consider_second_device(
        &mut self,
        engine: &Engine,
        rays_left: u64,
        seconds_left: Option<f64>,
    ) -> Result<()> {
        let is_possible = self.takes_second_device
            && rays_left > 0
            && engine.profile.is_none()
            && !engine.device.keeps_rows()
            && engine.num_bound_additions <= 1
            && engine.device.bytes + self.bytes <= MOST_BYTES;
        let pays = || self.traits.two_devices && seconds_left.is_some_and(|left| left >= PAYS_SEC);
        if is_possible && self.overrides.second_device.holds(pays) {
            self.takes_second_device = false;
            self.open_second_device(engine)?;
        }
        Ok(())
    }

    /// Where none can be opened, the first goes on alone.
    fn open_second_device(&mut self, engine: &Engine) -> Result<()> {
        let Some(mut logs) = self.logs.take() else { return Ok(()) };
        let opened = engine.gpu.open_again().and_then(|gpu| {
            let own_logs = logs.logs_on(&gpu)?;
            let extra = self.extra(&gpu, &engine.plan, &own_logs)?;
            Ok((engine.plan.open(&gpu, &extra)?, own_logs))
        });
        let added = match opened {
            Ok((device, own_logs)) => logs.add_device(own_logs).map(|()| self.second.push(device)),
            Err(_) => Ok(()),
        };
        self.ids.truncate(1 + self.second.len());
        self.logs = Some(logs);
        added
    }
}
