//! Hands what has no texture over to a shader that does nothing but colour: grounds of cards, bars, buttons,
//! outlines and curves. egui's shader looks into its texture for every pixel, in two ways where there is no
//! GPU.

use crate::viewer::picture::draw::{begin, pipeline};
use eframe::{
    egui_wgpu::{Callback, CallbackResources, CallbackTrait, RenderState, ScreenDescriptor},
    wgpu::{self, util::DeviceExt as _},
};
use egui::{
    Context, FullOutput, Mesh, PaintCallbackInfo, Plugin, Rect, Shape, TextureId,
    emath::TSTransform,
    epaint::{ClippedShape, Tessellator, WHITE_UV},
};
use std::sync::OnceLock;

/// Smallest area around a shape that is worth a call of its own, square points.
const MIN_AREA: f32 = 2000.0;

/// Prepares a window for drawing meshes.
pub(crate) fn install(state: &RenderState, ctx: &Context) {
    state.renderer.write().callback_resources.insert(Shader::new(&state.device, state.target_format));
    ctx.add_plugin(Meshes);
}

/// Replaces large shapes without a texture, whoever paints them, just before a frame is drawn.
struct Meshes;

impl Plugin for Meshes {
    fn debug_name(&self) -> &'static str {
        "meshes"
    }

    fn output_hook(&mut self, ctx: &Context, output: &mut FullOutput) {
        let options = ctx.tessellation_options(|options| *options);
        let tessellator = Tessellator::new(output.pixels_per_point, options, [1, 1], Vec::new());
        let window = ctx.viewport_rect();
        let mut sorting =
            Sorting { tessellator, window, mesh: Mesh::default(), clip: window, sorted: Vec::new() };
        for shape in std::mem::take(&mut output.shapes) {
            sorting.add(shape);
        }
        sorting.flush();
        output.shapes = sorting.sorted;
    }
}

/// Shapes in the order in which they are painted, with meshes in place of some.
struct Sorting {
    tessellator: Tessellator,
    window: Rect,
    /// Shapes that follow each other within the same clip rectangle are one mesh.
    mesh: Mesh,
    clip: Rect,
    sorted: Vec<ClippedShape>,
}

impl Sorting {
    fn add(&mut self, clipped: ClippedShape) {
        let ClippedShape { clip_rect, shape, transform_after_tessellation: transform } = clipped;
        match shape {
            Shape::Noop => {}
            Shape::Vec(shapes) => shapes.into_iter().for_each(|shape| {
                self.add(ClippedShape { clip_rect, shape, transform_after_tessellation: transform });
            }),
            shape if transform == TSTransform::IDENTITY && self.is_ours(&shape, clip_rect) => {
                if self.clip != clip_rect {
                    self.flush();
                }
                self.clip = clip_rect;
                self.tessellator.set_clip_rect(clip_rect);
                self.tessellator.tessellate_shape(shape, &mut self.mesh);
            }
            shape => {
                self.flush();
                self.sorted.push(ClippedShape { clip_rect, shape, transform_after_tessellation: transform });
            }
        }
    }

    /// Returns `true` for a large shape without a texture.
    fn is_ours(&self, shape: &Shape, clip: Rect) -> bool {
        let is_plain = match shape {
            Shape::Rect(rect) => rect.brush.is_none(),
            Shape::Mesh(mesh) => {
                mesh.texture_id == TextureId::default() && mesh.vertices.iter().all(|v| v.uv == WHITE_UV)
            }
            Shape::Path(_) | Shape::LineSegment { .. } => true,
            _ => false,
        };
        let visible = || shape.visual_bounding_rect().intersect(clip).intersect(self.window);
        is_plain && visible().is_positive() && visible().area() >= MIN_AREA
    }

    fn flush(&mut self) {
        let mesh = std::mem::take(&mut self.mesh);
        if !mesh.is_empty() {
            let callback = Callback::new_paint_callback(self.window, Drawn { mesh, bound: OnceLock::new() });
            let transform_after_tessellation = TSTransform::IDENTITY;
            let shape = Shape::Callback(callback);
            self.sorted.push(ClippedShape { clip_rect: self.clip, shape, transform_after_tessellation });
        }
    }
}

/// The shader of a window, for meshes.
struct Shader(wgpu::RenderPipeline);

impl Shader {
    fn new(device: &wgpu::Device, target: wgpu::TextureFormat) -> Self {
        let module = device.create_shader_module(wgpu::include_wgsl!("meshes.wgsl"));
        let attributes = wgpu::vertex_attr_array![0 => Float32x2, 1 => Unorm8x4];
        let buffer = wgpu::VertexBufferLayout {
            array_stride: VERTEX_BYTES as u64,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &attributes,
        };
        let entry = if target.is_srgb() { "linear" } else { "gamma" };
        let list = wgpu::PrimitiveTopology::TriangleList;
        Self(pipeline(device, &module, entry, &[Some(buffer)], list, target))
    }
}

/// Size of a vertex on the card: its position in the window, -1 to 1, upwards, and its colour.
const VERTEX_BYTES: usize = 12;

/// A mesh to be drawn.
struct Drawn {
    mesh: Mesh,
    bound: OnceLock<Buffers>,
}

/// A mesh on the card.
struct Buffers {
    vertices: wgpu::Buffer,
    indices: wgpu::Buffer,
}

impl Drawn {
    fn vertices(&self, screen: &ScreenDescriptor) -> Vec<u8> {
        let [width, height] = screen.size_in_pixels.map(|n| n as f32 / screen.pixels_per_point);
        let mut bytes = Vec::with_capacity(VERTEX_BYTES * self.mesh.vertices.len());
        for vertex in &self.mesh.vertices {
            bytes.extend((2.0 * vertex.pos.x / width - 1.0).to_ne_bytes());
            bytes.extend((1.0 - 2.0 * vertex.pos.y / height).to_ne_bytes());
            bytes.extend(vertex.color.to_array());
        }
        bytes
    }
}

impl CallbackTrait for Drawn {
    fn prepare(
        &self,
        device: &wgpu::Device,
        _: &wgpu::Queue,
        screen: &ScreenDescriptor,
        _: &mut wgpu::CommandEncoder,
        _: &mut CallbackResources,
    ) -> Vec<wgpu::CommandBuffer> {
        let buffer = |contents: &[u8], usage| {
            device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some("mesh"),
                contents,
                usage,
            })
        };
        let indices: Vec<u8> = self.mesh.indices.iter().flat_map(|i| i.to_ne_bytes()).collect();
        let _ = self.bound.set(Buffers {
            vertices: buffer(&self.vertices(screen), wgpu::BufferUsages::VERTEX),
            indices: buffer(&indices, wgpu::BufferUsages::INDEX),
        });
        Vec::new()
    }

    fn paint(
        &self,
        info: PaintCallbackInfo,
        pass: &mut wgpu::RenderPass<'static>,
        resources: &CallbackResources,
    ) {
        let (Some(shader), Some(buffers)) = (resources.get::<Shader>(), self.bound.get()) else { return };
        begin(pass, &info, &shader.0);
        pass.set_vertex_buffer(0, buffers.vertices.slice(..));
        pass.set_index_buffer(buffers.indices.slice(..), wgpu::IndexFormat::Uint32);
        pass.draw_indexed(0..self.mesh.indices.len() as u32, 0, 0..1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::asking_tests::adapter;
    use crate::viewer::picture::on_adapter::{SRGB, UNORM, WINDOW, painted};
    use egui::{Color32, LayerId, Painter, RawInput, Stroke, StrokeKind, epaint::Primitive, pos2, vec2};

    fn with_meshes() -> Context {
        let ctx = Context::default();
        ctx.add_plugin(Meshes);
        ctx
    }

    fn at(x: f32, y: f32, width: f32, height: f32) -> Rect {
        Rect::from_min_size(pos2(x, y), vec2(width, height))
    }

    /// Paints a window of 400 × 300 points; returns how many parts are ours, and how many egui's.
    fn shares(shapes: &[Shape]) -> [usize; 2] {
        let ctx = with_meshes();
        let input = RawInput { screen_rect: Some(at(0.0, 0.0, 400.0, 300.0)), ..Default::default() };
        let mut output = ctx.run_ui(input, |ui| {
            let painter = ui.ctx().layer_painter(LayerId::background());
            painter.extend(shapes.iter().cloned());
            // Another part of the window.
            painter.with_clip_rect(at(0.0, 250.0, 400.0, 50.0)).extend(shapes.iter().cloned());
        });
        output.textures_delta.clear();
        let parts = ctx.tessellate(output.shapes, 1.0);
        let ours = parts.iter().filter(|part| matches!(part.primitive, Primitive::Callback(_))).count();
        [ours, parts.len() - ours]
    }

    #[test]
    fn what_is_large_and_has_no_texture_is_handed_over_in_order() {
        let rect = |rect: Rect| Shape::rect_filled(rect, 4.0, Color32::RED);
        let [large, small] = [at(10.0, 10.0, 100.0, 50.0), at(50.0, 15.0, 20.0, 20.0)].map(rect);
        assert_eq!(shares(std::slice::from_ref(&large)), [1, 0]);
        assert_eq!(shares(std::slice::from_ref(&small))[0], 0);
        assert_eq!(shares(&[rect(at(410.0, 10.0, 100.0, 50.0))])[0], 0);
        // Whatever follows each other in the same part of the window is one mesh, also in groups.
        let group = Shape::Vec(vec![large.clone(), Shape::Vec(vec![large.clone()])]);
        assert_eq!(shares(&[group]), [1, 0]);
        assert_eq!(shares(&[rect(Rect::EVERYTHING), large.clone()]), [2, 0]);
        // Whatever lies between keeps its place.
        assert_eq!(shares(&[large.clone(), small, large])[0], 2);
    }

    #[test]
    fn meshes_are_as_egui_draws_them() {
        let Some(gpu) = adapter() else { return };
        let line = Stroke::new(1.0, Color32::from_rgb(60, 67, 77));
        let paint = |painter: &Painter| {
            painter.rect_filled(at(0.0, 0.0, 64.0, 48.0), 0.0, Color32::from_rgb(36, 40, 47));
            let orange = Color32::from_rgb(200, 90, 30);
            painter.rect(at(2.0, 1.0, 60.0, 44.3), 8.0, orange, line, StrokeKind::Inside);
            painter.rect_filled(at(7.0, 9.0, 12.0, 6.0), 2.0, Color32::WHITE);
            let curve = (0..64).map(|x| pos2(x as f32, 24.0 + 20.0 * (0.2 * x as f32).sin())).collect();
            painter.add(Shape::line(curve, Stroke::new(2.5, Color32::from_rgb(61, 214, 255))));
            let part = painter.with_clip_rect(at(20.0, 5.0, 30.0, 40.0));
            part.rect_filled(at(-9.0, 4.0, 120.0, 60.0), 5.0, Color32::from_black_alpha(150));
        };
        for format in [UNORM, SRGB] {
            let shader = || Shader::new(gpu.device(), format);
            let eguis = painted(&gpu, format, &Context::default(), shader(), paint);
            let ours = painted(&gpu, format, &with_meshes(), shader(), paint);
            assert_eq!(eguis.len(), WINDOW.iter().product::<u32>() as usize);
            let difference =
                |(a, b): (&[u8; 4], &[u8; 4])| a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max();
            let largest = eguis.iter().zip(&ours).filter_map(difference).max().unwrap();
            // egui dithers, and some pixels are blended three times.
            assert!(largest <= 2, "{largest} of 255 in {format:?}");
        }
    }
}
