//! Time of each pass on the device, if the device can measure it.

use crate::device::Gpu;
use surgtpgs_core::Result;

/// Largest number of passes of one frame that can be timed.
const MAX_PASSES: usize = 16;

/// Encloses passes in timestamps, if asked for.
#[derive(Debug, Default)]
pub(crate) struct Timer {
    queries: Option<(wgpu::QuerySet, wgpu::Buffer)>,
    names: Vec<&'static str>,
}

impl Timer {
    /// Starts timing with the next frame; returns `false` if the adapter cannot.
    pub(crate) fn switch_on(&mut self, gpu: &Gpu) -> bool {
        let device = gpu.device();
        if !device.features().contains(wgpu::Features::TIMESTAMP_QUERY) {
            return false;
        }
        let set = device.create_query_set(&wgpu::QuerySetDescriptor {
            label: Some("passes"),
            ty: wgpu::QueryType::Timestamp,
            count: 2 * MAX_PASSES as u32,
        });
        let resolved = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("timestamps"),
            size: (2 * MAX_PASSES * size_of::<u64>()) as u64,
            usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        self.queries = Some((set, resolved));
        true
    }

    /// Returns `true` if passes are timed.
    pub(crate) fn is_on(&self) -> bool {
        self.queries.is_some()
    }

    /// Starts a new frame.
    pub(crate) fn start(&mut self) {
        self.names.clear();
    }

    /// Begins a pass.
    pub(crate) fn begin<'a>(
        &mut self,
        encoder: &'a mut wgpu::CommandEncoder,
        name: &'static str,
    ) -> wgpu::ComputePass<'a> {
        let first = 2 * self.names.len() as u32;
        let queries = self.queries.as_ref().filter(|_| self.names.len() < MAX_PASSES);
        let timestamp_writes = queries.map(|(query_set, _)| wgpu::ComputePassTimestampWrites {
            query_set,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        });
        if timestamp_writes.is_some() {
            self.names.push(name);
        }
        encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some(name), timestamp_writes })
    }

    /// Ends the frame's commands.
    pub(crate) fn finish(&self, encoder: &mut wgpu::CommandEncoder) {
        if let (Some((set, resolved)), false) = (&self.queries, self.names.is_empty()) {
            encoder.resolve_query_set(set, 0..2 * self.names.len() as u32, resolved, 0);
        }
    }

    /// Milliseconds of each pass of the last submitted frame.
    pub(crate) fn read(&self, gpu: &Gpu) -> Result<Vec<(&'static str, f64)>> {
        let Some((_, resolved)) = &self.queries else { return Ok(Vec::new()) };
        let bytes = gpu.read_bytes(resolved, (2 * self.names.len() * size_of::<u64>()) as u64)?;
        let ticks: Vec<u64> = bytemuck::pod_collect_to_vec(&bytes);
        let period_ms = f64::from(gpu.queue().get_timestamp_period()) * 1e-6;
        let times = ticks.as_chunks::<2>().0.iter().map(|[a, b]| b.saturating_sub(*a) as f64 * period_ms);
        Ok(self.names.iter().copied().zip(times).collect())
    }
}
