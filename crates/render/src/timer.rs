//! Cost of each pass on the device, if the device can measure time.

use crate::{device::Gpu, kernel::Pass};
use surgtpgs_core::Result;

/// Largest number of passes of one frame that can be timed.
const MAX_PASSES: usize = 16;

/// Cost of one pass.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PassCost {
    /// Name of the pass.
    pub name: &'static str,
    /// Time by the device's clock, ms.
    pub ms: f64,
    /// Bytes that the pass has to move at least: all that its dispatches read and write, each value once per
    /// dispatch. Lists of splat-tile pairs count with their spare room, a quarter at most once they have grown.
    pub bytes: u64,
}

/// Encloses passes in timestamps, if asked for, and counts the bytes that they move.
#[derive(Debug, Default)]
pub(crate) struct Timer {
    queries: Option<(wgpu::QuerySet, wgpu::Buffer)>,
    /// Name of each pass of this frame, and the bytes that it moves.
    passes: Vec<(&'static str, u64)>,
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
        self.passes.clear();
    }

    /// Begins a pass.
    pub(crate) fn begin<'a>(
        &'a mut self,
        encoder: &'a mut wgpu::CommandEncoder,
        name: &'static str,
    ) -> Pass<'a> {
        let first = 2 * self.passes.len() as u32;
        let queries = self.queries.as_ref().filter(|_| self.passes.len() < MAX_PASSES);
        let timestamp_writes = queries.map(|(query_set, _)| wgpu::ComputePassTimestampWrites {
            query_set,
            beginning_of_pass_write_index: Some(first),
            end_of_pass_write_index: Some(first + 1),
        });
        let is_timed = timestamp_writes.is_some();
        let descriptor = wgpu::ComputePassDescriptor { label: Some(name), timestamp_writes };
        let commands = encoder.begin_compute_pass(&descriptor);
        if is_timed {
            self.passes.push((name, 0));
        }
        Pass::new(commands, self.passes.last_mut().filter(|_| is_timed).map(|(_, moved)| moved))
    }

    /// Ends the frame's commands.
    pub(crate) fn finish(&self, encoder: &mut wgpu::CommandEncoder) {
        if let (Some((set, resolved)), false) = (&self.queries, self.passes.is_empty()) {
            encoder.resolve_query_set(set, 0..2 * self.passes.len() as u32, resolved, 0);
        }
    }

    /// Cost of each pass of the last submitted frame.
    pub(crate) fn read(&self, gpu: &Gpu) -> Result<Vec<PassCost>> {
        let Some((_, resolved)) = &self.queries else { return Ok(Vec::new()) };
        let bytes = gpu.read_bytes(resolved, (2 * self.passes.len() * size_of::<u64>()) as u64)?;
        let ticks: Vec<u64> = bytemuck::pod_collect_to_vec(&bytes);
        let period_ms = f64::from(gpu.queue().get_timestamp_period()) * 1e-6;
        let times = ticks.as_chunks::<2>().0.iter().map(|[a, b]| b.saturating_sub(*a) as f64 * period_ms);
        let costs = self.passes.iter().zip(times).map(|(&(name, bytes), ms)| PassCost { name, ms, bytes });
        Ok(costs.collect())
    }
}
