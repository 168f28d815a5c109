//! Pictures on the graphics card. They are drawn by a shader of our own: egui's chooses at run time between
//! two ways to filter, and a driver without a GPU computes both for every pixel, which takes most of the time
//! of a large picture. Ours also averages where a picture is shown smaller than it is.

use crate::viewer::picture::draw::{begin, pipeline};
use eframe::{
    egui_wgpu::{Callback, CallbackResources, CallbackTrait, RenderState, ScreenDescriptor},
    wgpu,
};
use egui::{ColorImage, PaintCallbackInfo, Painter, Pos2, Rect, Vec2};
use std::{
    borrow::Cow,
    sync::{Arc, OnceLock},
};

/// A picture that is sent to the graphics card once, when it is first drawn.
#[derive(Clone)]
pub(crate) struct Texture(Arc<Contents>);

struct Contents {
    image: Arc<ColorImage>,
    on_card: OnceLock<wgpu::TextureView>,
}

impl Texture {
    pub(crate) fn new(image: impl Into<Arc<ColorImage>>) -> Self {
        Self(Arc::new(Contents { image: image.into(), on_card: OnceLock::new() }))
    }

    /// Returns `true` if this is a texture of the same image in memory.
    pub(crate) fn is_of(&self, image: &Arc<ColorImage>) -> bool {
        Arc::ptr_eq(&self.0.image, image)
    }

    /// Draws the whole picture into a rectangle, as far as the painter's clip rectangle shows it.
    pub(crate) fn paint(&self, painter: &Painter, rect: Rect) {
        let visible = rect.intersect(painter.clip_rect()).intersect(painter.ctx().viewport_rect());
        if visible.is_positive() {
            let quad = Quad { texture: self.clone(), rect, visible, bound: OnceLock::new() };
            painter.add(Callback::new_paint_callback(visible, quad));
        }
    }

    /// Returns the picture on the card.
    fn on_card(
        &self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        format: wgpu::TextureFormat,
    ) -> &wgpu::TextureView {
        self.0.on_card.get_or_init(|| {
            let image = fitting(&self.0.image, device.limits().max_texture_dimension_2d as usize);
            let [width, height] = image.size.map(|n| n as u32);
            let size = wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
            let texture = device.create_texture(&wgpu::TextureDescriptor {
                label: Some("picture"),
                size,
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
                view_formats: &[],
            });
            let layout = wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(4 * width),
                rows_per_image: None,
            };
            queue.write_texture(texture.as_image_copy(), image.as_raw(), layout, size);
            texture.create_view(&wgpu::TextureViewDescriptor::default())
        })
    }
}

/// Returns an image whose sides are at most `limit` px: larger ones leave out pixels.
fn fitting(image: &ColorImage, limit: usize) -> Cow<'_, ColorImage> {
    let [width, height] = image.size;
    let every = width.max(height).div_ceil(limit);
    if every <= 1 {
        return Cow::Borrowed(image);
    }
    let size = [width, height].map(|n| n.div_ceil(every));
    let rows = (0..height).step_by(every);
    let pixels = rows.flat_map(|y| (0..width).step_by(every).map(move |x| image.pixels[y * width + x]));
    Cow::Owned(ColorImage::new(size, pixels.collect()))
}

/// Prepares a window for drawing textures.
pub(crate) fn install(state: &RenderState) {
    let quads = Quads::new(&state.device, state.target_format);
    state.renderer.write().callback_resources.insert(quads);
}

/// The shaders of a window, for textures.
struct Quads {
    /// Draws pictures that are about as large as they are, or larger.
    plain: wgpu::RenderPipeline,
    /// Draws pictures smaller than they are.
    averaged: wgpu::RenderPipeline,
    sampler: wgpu::Sampler,
    /// Format of textures: a target that is linear wants linear colours.
    format: wgpu::TextureFormat,
}

/// Largest number of samples per pixel of the window, across or down.
const MAX_SAMPLES: f32 = 8.0;
/// Number of the picture's pixels that one sample covers, across or down: it lies between two.
const SAMPLE_PX: f32 = 2.0;

impl Quads {
    fn new(device: &wgpu::Device, target: wgpu::TextureFormat) -> Self {
        let shader = device.create_shader_module(wgpu::include_wgsl!("texture.wgsl"));
        let sampler = device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("picture"),
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        });
        let format = if target.is_srgb() {
            wgpu::TextureFormat::Rgba8UnormSrgb
        } else {
            wgpu::TextureFormat::Rgba8Unorm
        };
        let strip = wgpu::PrimitiveTopology::TriangleStrip;
        let [plain, averaged] =
            ["plain", "averaged"].map(|entry| pipeline(device, &shader, entry, &[], strip, target));
        Self { plain, averaged, sampler, format }
    }

    fn pipeline(&self, is_plain: bool) -> &wgpu::RenderPipeline {
        if is_plain { &self.plain } else { &self.averaged }
    }
}

/// A texture to be drawn.
struct Quad {
    texture: Texture,
    /// Place of the whole picture, points.
    rect: Rect,
    /// Part of the place that is drawn, points.
    visible: Rect,
    bound: OnceLock<Bound>,
}

/// Everything that a quad is drawn with, on the card.
struct Bound {
    group: wgpu::BindGroup,
    is_plain: bool,
}

/// The shader's `Quad`.
struct Values {
    place: [f32; 4],
    part: [f32; 4],
    step: [f32; 2],
    samples: [f32; 2],
}

impl Values {
    fn is_plain(&self) -> bool {
        self.samples == [1.0; 2]
    }

    fn bytes(&self) -> Vec<u8> {
        let values = self.place.iter().chain(&self.part).chain(&self.step).chain(&self.samples);
        values.flat_map(|value| value.to_ne_bytes()).collect()
    }
}

impl Quad {
    fn values(&self, screen: &ScreenDescriptor) -> Values {
        let pixels_per_point = screen.pixels_per_point;
        let [width, height] = screen.size_in_pixels.map(|n| n as f32 / pixels_per_point);
        let corner = |p: Pos2| [2.0 * p.x / width - 1.0, 1.0 - 2.0 * p.y / height];
        let share = |p: Pos2| <[f32; 2]>::from((p - self.rect.min) / self.rect.size());
        let both = |of: &dyn Fn(Pos2) -> [f32; 2]| {
            let ([left, top], [right, bottom]) = (of(self.visible.min), of(self.visible.max));
            [left, top, right, bottom]
        };
        let [columns, rows] = self.texture.0.image.size;
        let step = <[f32; 2]>::from(Vec2::splat(1.0 / pixels_per_point) / self.rect.size());
        let samples =
            |step: f32, pixels: usize| (step * pixels as f32 / SAMPLE_PX).ceil().clamp(1.0, MAX_SAMPLES);
        Values {
            place: both(&corner),
            part: both(&share),
            step,
            samples: [samples(step[0], columns), samples(step[1], rows)],
        }
    }
}

impl CallbackTrait for Quad {
    fn prepare(
        &self,
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        screen: &ScreenDescriptor,
        _: &mut wgpu::CommandEncoder,
        resources: &mut CallbackResources,
    ) -> Vec<wgpu::CommandBuffer> {
        let Some(quads) = resources.get::<Quads>() else { return Vec::new() };
        let values = self.values(screen);
        let is_plain = values.is_plain();
        let buffer = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("quad"),
            size: size_of::<Values>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        queue.write_buffer(&buffer, 0, &values.bytes());
        let picture = self.texture.on_card(device, queue, quads.format);
        let entry = |binding, resource| wgpu::BindGroupEntry { binding, resource };
        let sampler = wgpu::BindingResource::Sampler(&quads.sampler);
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("picture"),
            layout: &quads.pipeline(is_plain).get_bind_group_layout(0),
            entries: &[
                entry(0, buffer.as_entire_binding()),
                entry(1, wgpu::BindingResource::TextureView(picture)),
                entry(2, sampler),
            ],
        });
        let _ = self.bound.set(Bound { group, is_plain });
        Vec::new()
    }

    fn paint(
        &self,
        info: PaintCallbackInfo,
        pass: &mut wgpu::RenderPass<'static>,
        resources: &CallbackResources,
    ) {
        let (Some(quads), Some(bound)) = (resources.get::<Quads>(), self.bound.get()) else { return };
        begin(pass, &info, quads.pipeline(bound.is_plain));
        pass.set_bind_group(0, &bound.group, &[]);
        pass.draw(0..4, 0..1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::asking_tests::adapter;
    use crate::viewer::picture::on_adapter::{SRGB, UNORM, WINDOW, painted};
    use egui::{Color32, Context, pos2, vec2};
    use surgtpgs_render::Gpu;

    /// Shows a picture at a place of a window, within a clip rectangle; returns the window's pixels.
    fn shown(
        gpu: &Gpu,
        format: wgpu::TextureFormat,
        image: ColorImage,
        at: Rect,
        clip: Rect,
    ) -> Vec<[u8; 4]> {
        let texture = Texture::new(image);
        let paint = |painter: &Painter| texture.paint(&painter.with_clip_rect(clip), at);
        painted(gpu, format, &Context::default(), Quads::new(gpu.device(), format), paint)
    }

    /// Returns a picture of which every pixel has another colour.
    fn many_colours([width, height]: [usize; 2]) -> ColorImage {
        let colour = |i: usize| Color32::from_rgb((3 * (i % width)) as u8, (5 * (i / width)) as u8, i as u8);
        ColorImage::new([width, height], (0..width * height).map(colour).collect())
    }

    fn whole() -> Rect {
        Rect::from_min_size(Pos2::ZERO, vec2(WINDOW[0] as f32, WINDOW[1] as f32))
    }

    #[test]
    fn a_picture_of_the_window_s_size_is_shown_as_it_is() {
        let Some(gpu) = adapter() else { return };
        let image = many_colours(WINDOW.map(|n| n as usize));
        let colours: Vec<[u8; 4]> = image.pixels.iter().map(Color32::to_array).collect();
        assert_eq!(shown(&gpu, UNORM, image.clone(), whole(), whole()), colours);
        let linear = shown(&gpu, SRGB, image, whole(), whole());
        let differ = |(a, b): (&[u8; 4], &[u8; 4])| a.iter().zip(b).any(|(a, b)| a.abs_diff(*b) > 1);
        assert_eq!(linear.iter().zip(&colours).filter(|pair| differ(*pair)).count(), 0);
    }

    #[test]
    fn a_zoomed_picture_is_cut_off_by_its_pane_and_by_the_window() {
        let Some(gpu) = adapter() else { return };
        let image = many_colours([6, 6]);
        // Each pixel of the picture is 100 wide; the third one of the fourth row begins at 4, 6.
        let at = Rect::from_min_size(pos2(4.0 - 200.0, 6.0 - 300.0), vec2(600.0, 600.0));
        let pane = Rect::from_min_max(pos2(10.0, 8.0), pos2(500.0, 40.0));
        let pixels = shown(&gpu, UNORM, image.clone(), at, pane);
        let pixel = |x: usize, y: usize| pixels[y * WINDOW[0] as usize + x];
        assert_eq!([pixel(9, 20), pixel(20, 7), pixel(20, 40)], [[0; 4]; 3]);
        let own = image.pixels[3 * 6 + 2].to_array();
        assert!(
            own.iter().zip(pixel(53, 39)).all(|(a, b)| a.abs_diff(b) <= 2),
            "{own:?} {:?}",
            pixel(53, 39)
        );
        assert_ne!(pixel(10, 8), [0; 4]);
    }

    #[test]
    fn a_pixel_of_a_smaller_picture_is_the_mean_of_what_it_covers() {
        let Some(gpu) = adapter() else { return };
        // One bright column of four, shown at a quarter of its size.
        let column = |i: usize| if i.is_multiple_of(4) { Color32::WHITE } else { Color32::BLACK };
        let image = ColorImage::new([256, 192], (0..256 * 192).map(column).collect());
        let pixels = shown(&gpu, UNORM, image, whole(), whole());
        assert!(
            pixels.iter().all(|[r, g, b, a]| [r, g, b].iter().all(|v| (63..=65).contains(*v)) && *a == 255)
        );
    }

    #[test]
    fn a_picture_that_is_too_large_for_the_card_loses_pixels() {
        let image = many_colours([9, 4]);
        assert!(matches!(fitting(&image, 9), Cow::Borrowed(_)));
        let smaller = fitting(&image, 4);
        assert_eq!(smaller.size, [3, 2]);
        assert_eq!((smaller.pixels[1], smaller.pixels[3]), (image.pixels[3], image.pixels[27]));
    }
}
