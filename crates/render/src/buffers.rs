//! Device buffers that grow and are reused from frame to frame, within the adapter's limits.

use crate::device::Gpu;
use bytemuck::{NoUninit, Pod};
use std::marker::PhantomData;
use surgtpgs_core::{Error, Remedy, Result};

/// A growable array of `T` on the device. Its binding is exactly as long as the array.
#[derive(Debug)]
pub(crate) struct DeviceVec<T> {
    name: &'static str,
    buffer: wgpu::Buffer,
    len: usize,
    marker: PhantomData<T>,
}

/// A buffer and the number of its bytes that are used.
pub(crate) type Part = (wgpu::Buffer, u64);

const USAGES: wgpu::BufferUsages =
    wgpu::BufferUsages::STORAGE.union(wgpu::BufferUsages::COPY_SRC).union(wgpu::BufferUsages::COPY_DST);

impl<T: Pod> DeviceVec<T> {
    /// Makes an array of one zero, because a binding cannot be empty. `name` is the contents' name in
    /// messages.
    pub(crate) fn new(gpu: &Gpu, name: &'static str) -> Self {
        Self { name, buffer: allocate(gpu, name, size_of::<T>() as u64), len: 1, marker: Default::default() }
    }

    /// Makes an array of these values; of one zero if there are none.
    pub(crate) fn from_slice(gpu: &Gpu, name: &'static str, values: &[T]) -> Result<Self> {
        let mut array = Self::new(gpu, name);
        array.write(gpu, values)?;
        Ok(array)
    }

    /// Makes room for `len` values (at least one). The contents are lost if the buffer has to grow. An array that
    /// grows again gets half as much more, so that a slowly growing scene does not reallocate every time.
    pub(crate) fn resize(&mut self, gpu: &Gpu, len: usize) -> Result<()> {
        let bytes = (len.max(1) * size_of::<T>()) as u64;
        check_size(gpu, self.name, bytes)?;
        if bytes > self.buffer.size() {
            let slack = if self.len > 1 { bytes / 2 } else { 0 };
            let roomy = (bytes + slack).min(max_bytes(gpu)) / 4 * 4;
            self.buffer = allocate(gpu, self.name, roomy.max(bytes));
        }
        self.len = len.max(1);
        Ok(())
    }

    /// Replaces the values.
    pub(crate) fn write(&mut self, gpu: &Gpu, values: &[T]) -> Result<()> {
        self.resize(gpu, values.len())?;
        gpu.upload(&self.buffer, 0, bytemuck::cast_slice(values));
        Ok(())
    }

    /// Writes some values from index `at` on, within the length.
    pub(crate) fn write_at(&self, gpu: &Gpu, at: usize, values: &[T]) {
        gpu.upload(&self.buffer, (at * size_of::<T>()) as u64, bytemuck::cast_slice(values));
    }

    /// Makes another array of the same name, of one zero.
    pub(crate) fn same_kind(&self, gpu: &Gpu) -> Self {
        Self::new(gpu, self.name)
    }

    /// Number of values.
    pub(crate) fn len(&self) -> usize {
        self.len
    }

    /// Buffer of the array; may be longer than the array.
    pub(crate) fn buffer(&self) -> &wgpu::Buffer {
        &self.buffer
    }

    /// Size of the array in bytes.
    pub(crate) fn num_bytes(&self) -> u64 {
        (self.len * size_of::<T>()) as u64
    }

    /// The whole array, to be read back.
    pub(crate) fn part(&self) -> Part {
        (self.buffer.clone(), self.num_bytes())
    }

    /// The rows as bare numbers.
    pub(crate) fn numbers(&self) -> Array<'_, f32> {
        Array::new(&self.buffer, self.num_bytes())
    }

    /// The whole array, each value of which is read and written again.
    pub(crate) fn in_place(&self) -> Array<'_, T> {
        Array::from(self).moving(2 * self.num_bytes())
    }

    /// Waits for the device and copies out the first `len` values.
    pub(crate) fn read(&self, gpu: &Gpu, len: usize) -> Result<Vec<T>> {
        let bytes = gpu.read_bytes(&self.buffer, (len.min(self.len) * size_of::<T>()) as u64)?;
        Ok(bytemuck::pod_collect_to_vec(&bytes))
    }
}

/// Values on the device as a shader sees them.
#[derive(Clone, Copy)]
pub(crate) struct Array<'a, T> {
    buffer: &'a wgpu::Buffer,
    num_bytes: u64,
    /// Number of bytes that a shader reads and writes.
    moved: u64,
    marker: PhantomData<T>,
}

/// A binding, and the number of bytes behind it that a shader reads and writes.
#[derive(Clone, Debug)]
pub(crate) struct Bound<'a> {
    pub entry: wgpu::BindGroupEntry<'a>,
    pub moved: u64,
}

impl<'a, T: Pod> From<&'a DeviceVec<T>> for Array<'a, T> {
    fn from(values: &'a DeviceVec<T>) -> Self {
        Self::new(&values.buffer, values.num_bytes())
    }
}

impl<'a, T> Array<'a, T> {
    fn new(buffer: &'a wgpu::Buffer, num_bytes: u64) -> Self {
        Self { buffer, num_bytes, moved: num_bytes, marker: PhantomData }
    }

    /// The same array, of which a shader reads and writes this number of bytes: not all of it, or all of it
    /// twice.
    pub(crate) fn moving(self, moved: u64) -> Self {
        Self { moved, ..self }
    }

    /// Binds exactly the whole array, so that a shader's `arrayLength` is its length.
    pub(crate) fn bound_to(self, binding: u32) -> Bound<'a> {
        let size = wgpu::BufferSize::new(self.num_bytes);
        let resource = wgpu::BufferBinding { buffer: self.buffer, offset: 0, size };
        let entry = wgpu::BindGroupEntry { binding, resource: wgpu::BindingResource::Buffer(resource) };
        Bound { entry, moved: self.moved }
    }
}

/// A small constant for one dispatch or a few.
#[derive(Debug)]
pub(crate) struct Uniform<T> {
    buffer: wgpu::Buffer,
    offset: u64,
    marker: PhantomData<T>,
}

impl<T> Uniform<T> {
    pub(crate) fn bound_to(&self, binding: u32) -> Bound<'_> {
        let size = size_of::<T>() as u64;
        let resource = wgpu::BufferBinding {
            buffer: &self.buffer,
            offset: self.offset,
            size: wgpu::BufferSize::new(size),
        };
        let entry = wgpu::BindGroupEntry { binding, resource: wgpu::BindingResource::Buffer(resource) };
        Bound { entry, moved: size }
    }
}

/// Makes a small constant. It reaches the device with the commands that [`Gpu::submit`] submits next.
pub(crate) fn uniform<T: NoUninit>(gpu: &Gpu, value: &T) -> Uniform<T> {
    let (buffer, offset) = gpu.constants().add(gpu, bytemuck::bytes_of(value));
    Uniform { buffer, offset, marker: PhantomData }
}

/// Constants, one after the other in buffers that are never written over. A training step has about thirty,
/// and uploads them at once.
#[derive(Debug, Default)]
pub(crate) struct Constants {
    buffer: Option<wgpu::Buffer>,
    /// The buffer's contents so far.
    bytes: Vec<u8>,
    /// Number of bytes that the device has.
    flushed: usize,
}

impl Constants {
    /// Size of a buffer, enough for the constants of a few steps.
    const CAPACITY: usize = 1 << 16;

    /// Adds a constant; returns its place.
    fn add(&mut self, gpu: &Gpu, constant: &[u8]) -> (wgpu::Buffer, u64) {
        let alignment = gpu.device().limits().min_uniform_buffer_offset_alignment.max(4) as usize;
        let mut offset = self.bytes.len().next_multiple_of(alignment);
        if offset + constant.len() > Self::CAPACITY {
            self.flush(gpu);
            *self = Self::default();
            offset = 0;
        }
        // Not created mapped, because that panics if the device was lost.
        let buffer = self.buffer.get_or_insert_with(|| {
            gpu.device().create_buffer(&wgpu::BufferDescriptor {
                label: Some("constants"),
                size: Self::CAPACITY as u64,
                usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        });
        self.bytes.resize(offset, 0);
        self.bytes.extend_from_slice(constant);
        (buffer.clone(), offset as u64)
    }

    /// Uploads what the device does not have.
    pub(crate) fn flush(&mut self, gpu: &Gpu) {
        if let Some(buffer) = self.buffer.as_ref().filter(|_| self.flushed < self.bytes.len()) {
            self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
            gpu.upload(buffer, self.flushed as u64, &self.bytes[self.flushed..]);
            self.flushed = self.bytes.len();
        }
    }
}

fn allocate(gpu: &Gpu, name: &str, bytes: u64) -> wgpu::Buffer {
    gpu.device().create_buffer(&wgpu::BufferDescriptor {
        label: Some(name),
        size: bytes.max(16),
        usage: USAGES,
        mapped_at_creation: false,
    })
}

/// Size of the largest array that can be bound.
pub(crate) fn max_bytes(gpu: &Gpu) -> u64 {
    let limits = gpu.device().limits();
    limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
}

fn check_size(gpu: &Gpu, name: &str, bytes: u64) -> Result<()> {
    let limit = max_bytes(gpu);
    if bytes <= limit {
        return Ok(());
    }
    Err(Error::input(
        format!(
            "the GPU holds at most {} MiB of {name} at once, {} MiB are needed",
            limit >> 20,
            bytes.div_ceil(1 << 20)
        ),
        Remedy::UseCpu.after("Use a smaller scene or picture."),
    ))
}
