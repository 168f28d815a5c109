//! Opens a graphics adapter, or says plainly why there is none.

use crate::{
    buffers::Constants,
    traffic::{Counters, Traffic},
};
use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};
use surgtpgs_core::{Error, Remedy, Result};

/// Time after which a GPU that has not finished its work counts as hung. Systems with a display give it a
/// few seconds. A software adapter may take ten times as long.
const PATIENCE: Duration = Duration::from_secs(60);

/// Adapters that may be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AdapterChoice {
    /// Real GPUs only. A software adapter is refused, because the CPU twin is many times faster.
    RealGpu,
    /// A real GPU if there is one, else a software adapter; for tests.
    Any,
}

/// Reason why no GPU can be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unavailable {
    /// No driver offers an adapter with compute shaders.
    #[error("no graphics adapter with compute shaders was found")]
    NoAdapter,
    /// Only a software adapter exists, but a real GPU was asked for.
    #[error("only a software adapter was found ({0})")]
    OnlySoftware(String),
    /// The driver refused to open the adapter.
    #[error("the graphics adapter {adapter} could not be opened: {reason}")]
    Refused {
        /// Name of the adapter.
        adapter: String,
        /// Message of the driver.
        reason: String,
    },
}

impl From<Unavailable> for Error {
    fn from(reason: Unavailable) -> Self {
        Error::Missing {
            what: reason.to_string(),
            hint: Remedy::UseCpu.after("Install a Vulkan, Metal or DirectX 12 driver."),
        }
    }
}

/// An open graphics device; clones share it.
#[derive(Clone, Debug)]
pub struct Gpu {
    device: wgpu::Device,
    queue: wgpu::Queue,
    lost: Arc<Mutex<Option<Loss>>>,
    patience: Duration,
    counters: Arc<Counters>,
    constants: Arc<Mutex<Constants>>,
}

/// An adapter that a driver offers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AdapterFacts {
    /// Name, kind and interface, as [`Gpu::name`] has them.
    pub name: String,
    /// Name and version of the driver.
    pub driver: String,
    /// Names of those features that passes use, or could use, and that it has.
    pub features: Vec<&'static str>,
}

/// Features of adapters that passes use or could use, with their names.
const FEATURES: [(wgpu::Features, &str); 4] = [
    (wgpu::Features::TIMESTAMP_QUERY, "timestamps"),
    (wgpu::Features::SUBGROUP, "subgroups"),
    (wgpu::Features::SHADER_F16, "f16"),
    (wgpu::Features::SHADER_FLOAT32_ATOMIC, "float atomics"),
];

/// Reason why a device can no longer be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Loss {
    /// Message of the driver, or the time that it did not answer.
    pub reason: String,
    /// `true` if it never answered, so that the same adapter would not do so either.
    pub hangs: bool,
}

impl Gpu {
    /// Opens the best adapter that can be opened: discrete before integrated before virtual before software.
    pub fn open(choice: AdapterChoice) -> Result<Self, Unavailable> {
        // The default limits are lower than those of every adapter.
        Self::open_within(choice, wgpu::Adapter::limits)
    }

    /// Opens any adapter with the limits that every browser offers, and at most `bytes` in a binding; for
    /// tests.
    pub fn open_small(bytes: u64) -> Result<Self, Unavailable> {
        let limits = wgpu::Limits { max_storage_buffer_binding_size: bytes, ..Default::default() };
        Self::open_within(AdapterChoice::Any, |_| limits.clone())
    }

    /// Opens the best adapter that can be opened with the limits that `limits` gives it.
    fn open_within(
        choice: AdapterChoice,
        limits: impl Fn(&wgpu::Adapter) -> wgpu::Limits,
    ) -> Result<Self, Unavailable> {
        let mut adapters = all_adapters();
        adapters.retain(is_usable);
        adapters.sort_by_key(|a| rank(a.get_info().device_type));
        let mut best_problem = None;
        for adapter in adapters {
            match Self::open_adapter(choice, &adapter, limits(&adapter)) {
                Ok(gpu) => return Ok(gpu),
                Err(problem) => best_problem = best_problem.or(Some(problem)),
            }
        }
        Err(best_problem.unwrap_or(Unavailable::NoAdapter))
    }

    fn open_adapter(
        choice: AdapterChoice,
        adapter: &wgpu::Adapter,
        limits: wgpu::Limits,
    ) -> Result<Self, Unavailable> {
        let info = adapter.get_info();
        let is_software = info.device_type == wgpu::DeviceType::Cpu;
        if choice == AdapterChoice::RealGpu && is_software {
            return Err(Unavailable::OnlySoftware(info.name));
        }
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("surgtpgs"),
            // For timing passes, if supported; no other feature is needed.
            required_features: adapter.features() & wgpu::Features::TIMESTAMP_QUERY,
            required_limits: limits,
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|e| Unavailable::Refused { adapter: info.name, reason: e.to_string() })?;
        let patience = if is_software { 10 * PATIENCE } else { PATIENCE };
        let (lost, counters, constants) = Default::default();
        let gpu = Self { device, queue, lost, patience, counters, constants };
        let lost = gpu.lost.clone();
        gpu.device.set_device_lost_callback(move |_, message| {
            let loss = Loss { reason: message, hangs: false };
            lost.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(loss);
        });
        Ok(gpu)
    }

    /// Returns all adapters that drivers offer, whether or not they can be used.
    pub fn adapters() -> Vec<AdapterFacts> {
        let facts = |adapter: wgpu::Adapter| {
            let info = adapter.get_info();
            let has = |(feature, _): &&(wgpu::Features, _)| adapter.features().contains(*feature);
            AdapterFacts {
                name: name_of(&info),
                driver: driver_of(&info),
                features: FEATURES.iter().filter(has).map(|(_, name)| *name).collect(),
            }
        };
        all_adapters().into_iter().map(facts).collect()
    }

    /// Sets the time after which unfinished work makes the device count as lost.
    pub fn set_patience(&mut self, patience: Duration) {
        self.patience = patience;
    }

    /// The device.
    pub fn device(&self) -> &wgpu::Device {
        &self.device
    }

    /// Queue of the device.
    pub fn queue(&self) -> &wgpu::Queue {
        &self.queue
    }

    /// Name, kind and interface of the adapter, e.g. "NVIDIA H200 (discrete GPU, Vulkan)".
    pub fn name(&self) -> String {
        name_of(&self.device.adapter_info())
    }

    /// Name and version of the driver.
    pub fn driver(&self) -> String {
        driver_of(&self.device.adapter_info())
    }

    /// Returns `true` if the adapter is a program on the CPU rather than a GPU.
    pub fn is_software(&self) -> bool {
        self.device.adapter_info().device_type == wgpu::DeviceType::Cpu
    }

    /// Bytes that went to and from the device so far.
    pub fn traffic(&self) -> Traffic {
        self.counters.total()
    }

    /// Returns the reason why a new [`Gpu`] is needed, if the device was lost (driver reset, GPU
    /// unplugged) or hangs.
    pub fn loss(&self) -> Option<Loss> {
        self.lost.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Fails if the device was lost.
    pub fn check_alive(&self) -> Result<()> {
        match self.loss() {
            None => Ok(()),
            Some(loss) => Err(self.failure("the graphics device was lost", &loss.reason)),
        }
    }

    /// Waits for all submitted work, but not forever if the device hangs.
    pub(crate) fn wait(&self) -> Result<()> {
        let wait = wgpu::PollType::Wait { submission_index: None, timeout: Some(self.patience) };
        match self.device.poll(wait) {
            Ok(_) => {}
            Err(wgpu::PollError::Timeout) => {
                let reason = format!("it did not answer for {} s", self.patience.as_secs());
                let loss = Loss { reason, hangs: true };
                self.lost.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(loss);
                // Dropping the last handle of the queue would still wait for it.
                std::mem::forget(self.clone());
            }
            Err(e) => return Err(self.failure("waiting for the GPU failed", &e)),
        }
        self.check_alive()
    }

    /// Runs `work` and turns every error that the device reports meanwhile into an [`Error`].
    pub(crate) fn guarded<T>(&self, work: impl FnOnce() -> Result<T>) -> Result<T> {
        // Lets the driver report a loss since the last frame. A failed poll shows in the calls that follow.
        let _ = self.device.poll(wgpu::PollType::Poll);
        self.check_alive()?;
        let scopes =
            [wgpu::ErrorFilter::Validation, wgpu::ErrorFilter::Internal, wgpu::ErrorFilter::OutOfMemory]
                .map(|filter| self.device.push_error_scope(filter));
        let result = work();
        // Inner scopes must be popped first.
        let [validation, internal, memory] = scopes;
        let errors = [memory, internal, validation].map(|scope| pollster::block_on(scope.pop()));
        self.check_alive()?;
        match errors.into_iter().flatten().next() {
            None => result,
            Some(error) => Err(reported(&self.device.adapter_info().name, error)),
        }
    }

    fn failure(&self, what: &str, reason: &dyn std::fmt::Display) -> Error {
        let adapter = self.device.adapter_info().name;
        Error::Missing {
            what: format!("{what} ({adapter}): {reason}"),
            hint: Remedy::UseCpu.after("Close other programs that use the GPU, and try again."),
        }
    }

    /// The constants of commands.
    pub(crate) fn constants(&self) -> MutexGuard<'_, Constants> {
        self.constants.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Submits commands, after their constants.
    pub(crate) fn submit(&self, commands: wgpu::CommandEncoder) {
        self.constants().flush(self);
        self.queue.submit([commands.finish()]);
    }

    /// Writes bytes into a buffer, from byte `at` on.
    pub(crate) fn upload(&self, buffer: &wgpu::Buffer, at: u64, bytes: &[u8]) {
        self.counters.count_upload(bytes.len());
        self.queue.write_buffer(buffer, at, bytes);
    }

    /// Waits for the device and copies out the first `size` bytes of `buffer`.
    pub(crate) fn read_bytes(&self, buffer: &wgpu::Buffer, size: u64) -> Result<Vec<u8>> {
        let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("readback"),
            size: size.max(4),
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut encoder = self.device.create_command_encoder(&Default::default());
        encoder.copy_buffer_to_buffer(buffer, 0, &staging, 0, size);
        self.submit(encoder);
        self.read_staging(&staging, size, <[u8]>::to_vec)
    }

    /// Waits for all submitted work and reads the first `size` bytes of a mappable buffer, where they lie.
    pub(crate) fn read_staging<T>(
        &self,
        staging: &wgpu::Buffer,
        size: u64,
        read: impl FnOnce(&[u8]) -> T,
    ) -> Result<T> {
        if size == 0 {
            return Ok(read(&[]));
        }
        let (sender, receiver) = std::sync::mpsc::sync_channel(1);
        staging.map_async(wgpu::MapMode::Read, ..size, move |result| {
            // The receiver outlives the wait below.
            let _ = sender.send(result);
        });
        self.wait()?;
        let mapped = receiver.recv().map_err(|e| self.failure("reading from the GPU failed", &e))?;
        mapped.map_err(|e| self.failure("reading from the GPU failed", &e))?;
        let bytes =
            staging.get_mapped_range(..size).map_err(|e| self.failure("reading from the GPU failed", &e))?;
        let value = read(&bytes);
        drop(bytes);
        staging.unmap();
        self.counters.count_read_back(size);
        Ok(value)
    }
}

/// Turns the driver's report into an error with a hint.
fn reported(adapter: &str, error: wgpu::Error) -> Error {
    match error {
        wgpu::Error::OutOfMemory { source } => Error::Missing {
            what: format!("the GPU's memory is full ({adapter}): {source}"),
            hint: Remedy::UseCpu
                .after("Close other programs that use the GPU, or take smaller pictures or fewer Gaussians."),
        },
        error => Error::Missing {
            what: format!("the GPU driver reported an error ({adapter}): {error}"),
            hint: Remedy::UseCpu.after("Update the driver."),
        },
    }
}

fn all_adapters() -> Vec<wgpu::Adapter> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
    pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()))
}

fn name_of(info: &wgpu::AdapterInfo) -> String {
    let kind = match info.device_type {
        wgpu::DeviceType::DiscreteGpu => "discrete GPU",
        wgpu::DeviceType::IntegratedGpu => "integrated GPU",
        wgpu::DeviceType::VirtualGpu => "virtual GPU",
        wgpu::DeviceType::Cpu => "software",
        wgpu::DeviceType::Other => "unknown kind",
    };
    format!("{} ({kind}, {:?})", info.name, info.backend)
}

fn driver_of(info: &wgpu::AdapterInfo) -> String {
    format!("{} {}", info.driver, info.driver_info).trim().to_owned()
}

/// Returns `true` if an adapter can run the passes.
fn is_usable(adapter: &wgpu::Adapter) -> bool {
    let (limits, least) = (adapter.limits(), wgpu::Limits::default());
    adapter.get_downlevel_capabilities().flags.contains(wgpu::DownlevelFlags::COMPUTE_SHADERS)
        && limits.max_compute_invocations_per_workgroup >= least.max_compute_invocations_per_workgroup
        && limits.max_compute_workgroup_storage_size >= least.max_compute_workgroup_storage_size
        && limits.max_storage_buffers_per_shader_stage >= least.max_storage_buffers_per_shader_stage
}

fn rank(kind: wgpu::DeviceType) -> u8 {
    match kind {
        wgpu::DeviceType::DiscreteGpu => 0,
        wgpu::DeviceType::IntegratedGpu => 1,
        wgpu::DeviceType::VirtualGpu => 2,
        wgpu::DeviceType::Other => 3,
        wgpu::DeviceType::Cpu => 4,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn full_memory_is_said_plainly_and_what_to_lower() {
        let error = wgpu::Error::OutOfMemory { source: "16 GiB were asked for".into() };
        let error = reported("NVIDIA H200", error);
        let message = error.to_string();
        for part in ["memory is full (NVIDIA H200)", "16 GiB", "fewer Gaussians"] {
            assert!(message.contains(part), "{message}");
        }
        assert_eq!(error.remedy(), Some(Remedy::UseCpu));
    }

    #[test]
    fn what_is_missing_says_how_to_get_it() {
        let error = Error::from(Unavailable::OnlySoftware("llvmpipe".into()));
        assert!(error.to_string().contains("llvmpipe") && error.remedy() == Some(Remedy::UseCpu), "{error}");
    }
}
