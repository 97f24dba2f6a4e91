//! Draws the window's frame without a window: on a device into a texture, and from there into a file.

use crate::error::{Error, Result};
use crate::format::hex;
use crate::gpu::{AdapterChoice, Gpu};
use crate::viewer::app::App;
use eframe::egui::{self, Pos2, Rect, ViewportId, vec2};
use eframe::egui_wgpu::{Renderer, RendererOptions, ScreenDescriptor};
use sha2::{Digest, Sha256};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A picture as RGBA bytes, top row first.
pub struct Picture {
    /// Width and height \[pixels\].
    pub size: [u32; 2],
    /// Four bytes a pixel.
    pub rgba: Vec<u8>,
}

/// Number of frames until panels have found their sizes.
const SETTLING: u32 = 6;
/// Longest wait for a trace; then the window is drawn as it is.
const PATIENCE: Duration = Duration::from_secs(3600);
const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

/// Draws the window of `app` once no further result will come by itself, or once it is stopped. `size` is in points.
///
/// # Errors
/// [`Error::Device`] or [`Error::NoAdapter`] if drawing is impossible.
pub fn draw(
    app: &mut App,
    size: (f32, f32),
    pixels_per_point: f32,
    is_stopped: impl Fn() -> bool,
) -> Result<Picture> {
    let gpu = Arc::new(Gpu::open(&AdapterChoice::default())?);
    let mut canvas = OffscreenTexture::new(gpu, size, pixels_per_point, RendererOptions::PREDICTABLE);
    let start = Instant::now();
    let mut settled = 0;
    while settled < SETTLING {
        canvas.frame(app, Vec::new());
        // A frame may ask for something, such as recorded rays. A further frame must follow with the answer.
        if app.model.is_idle() || start.elapsed() > PATIENCE || is_stopped() {
            settled += 1;
        } else {
            settled = 0;
            std::thread::sleep(Duration::from_millis(20));
        }
    }
    let primitives = canvas.frame(app, Vec::new());
    canvas.render(&primitives);
    canvas.picture()
}

impl Picture {
    /// The contents of a `.png` file.
    ///
    /// # Errors
    /// [`Error::Internal`] if the picture cannot be encoded.
    pub fn to_png(&self) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.size[0], self.size[1]);
        encoder.set_color(png::ColorType::Rgba);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_compression(png::Compression::Best);
        let written = encoder
            .add_text_chunk("Software".into(), env!("CARGO_PKG_NAME").into())
            .and_then(|()| encoder.add_text_chunk(HASH.into(), hash(&self.rgba)))
            .and_then(|()| encoder.write_header())
            .and_then(|mut writer| {
                writer.write_image_data(&self.rgba)?;
                writer.finish()
            });
        written.map_err(|error| Error::Internal(format!("encoding the picture: {error}")))?;
        Ok(bytes)
    }
}

/// True of a picture as [`Picture::to_png`] wrote it: nobody has changed its pixels since.
pub fn is_own(path: &Path) -> bool {
    let Ok(file) = std::fs::File::open(path) else { return false };
    let Ok(mut reader) = png::Decoder::new(std::io::BufReader::new(file)).read_info() else { return false };
    let info = reader.info();
    let text = info.uncompressed_latin1_text.iter().find(|text| text.keyword == HASH);
    let Some(hash_then) =
        text.filter(|_| info.width.max(info.height) <= MOST_PIXELS).map(|text| text.text.clone())
    else {
        return false;
    };
    let mut rgba = vec![0; reader.output_buffer_size()];
    reader.next_frame(&mut rgba).is_ok() && hash(&rgba) == hash_then
}

/// Most pixels of a side of a picture: 8192 points of 4 pixels.
const MOST_PIXELS: u32 = 1 << 15;
/// The keyword of the hash of a picture's pixels.
const HASH: &str = "SHA-256";

fn hash(rgba: &[u8]) -> String {
    hex(&Sha256::digest(rgba))
}

/// The texture in which frames are drawn.
pub struct OffscreenTexture {
    gpu: Arc<Gpu>,
    context: egui::Context,
    renderer: Renderer,
    size: (f32, f32),
    pixels_per_point: f32,
    texture: wgpu::Texture,
    start: Instant,
}

impl OffscreenTexture {
    /// A canvas on a device; `size` is in points.
    pub fn new(gpu: Arc<Gpu>, size: (f32, f32), pixels_per_point: f32, options: RendererOptions) -> Self {
        let renderer = Renderer::new(&gpu.device, FORMAT, options);
        let pixels = |points: f32| (points * pixels_per_point).round() as u32;
        let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("screenshot"),
            size: wgpu::Extent3d { width: pixels(size.0), height: pixels(size.1), depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: FORMAT,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let context = egui::Context::default();
        OffscreenTexture { gpu, context, renderer, size, pixels_per_point, texture, start: Instant::now() }
    }

    /// Computes one frame of a user who does `events`, and takes over its textures.
    pub fn frame(&mut self, app: &mut App, events: Vec<egui::Event>) -> Vec<egui::epaint::ClippedPrimitive> {
        let mut input = egui::RawInput {
            events,
            screen_rect: Some(Rect::from_min_size(Pos2::ZERO, vec2(self.size.0, self.size.1))),
            time: Some(self.start.elapsed().as_secs_f64()),
            max_texture_side: Some(self.gpu.device.limits().max_texture_dimension_2d as usize),
            ..Default::default()
        };
        input.viewports.entry(ViewportId::ROOT).or_default().native_pixels_per_point =
            Some(self.pixels_per_point);
        let mut output = self.context.run_ui(input, |ui| app.ui(ui));
        for (id, deltas) in output.textures_delta.set.drain() {
            for delta in deltas {
                self.renderer.update_texture(&self.gpu.device, &self.gpu.queue, id, &delta);
            }
        }
        for id in output.textures_delta.free.drain() {
            self.renderer.free_texture(&id);
        }
        self.context.tessellate(output.shapes, self.pixels_per_point)
    }

    /// Draws a frame on the device, and returns the index of the submission.
    pub fn render(&mut self, primitives: &[egui::epaint::ClippedPrimitive]) -> wgpu::SubmissionIndex {
        let Gpu { device, queue, .. } = self.gpu.as_ref();
        let screen = ScreenDescriptor {
            size_in_pixels: [self.texture.width(), self.texture.height()],
            pixels_per_point: self.pixels_per_point,
        };
        let mut encoder = device.create_command_encoder(&Default::default());
        let uploads = self.renderer.update_buffers(device, queue, &mut encoder, primitives, &screen);
        {
            let view = self.texture.create_view(&Default::default());
            let attachment = wgpu::RenderPassColorAttachment {
                view: &view,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                    store: wgpu::StoreOp::Store,
                },
                depth_slice: None,
            };
            let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("screenshot"),
                color_attachments: &[Some(attachment)],
                ..Default::default()
            });
            self.renderer.render(&mut pass.forget_lifetime(), primitives, &screen);
        }
        queue.submit(uploads.into_iter().chain([encoder.finish()]))
    }

    /// The picture that was drawn.
    fn picture(&self) -> Result<Picture> {
        let [width, height] = [self.texture.width(), self.texture.height()];
        // Rows of a copy are padded to a multiple of 256 bytes.
        let stride = (4 * width).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let buffer = self.gpu.buffer("screenshot", u64::from(stride) * u64::from(height))?;
        let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
        encoder.copy_texture_to_buffer(
            self.texture.as_image_copy(),
            wgpu::TexelCopyBufferInfo {
                buffer: &buffer,
                layout: wgpu::TexelCopyBufferLayout {
                    offset: 0,
                    bytes_per_row: Some(stride),
                    rows_per_image: None,
                },
            },
            wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        );
        self.gpu.queue.submit([encoder.finish()]);
        let bytes = self.gpu.read(&buffer, buffer.size())?;
        let rows = bytes.chunks_exact(stride as usize);
        let rgba = rows.flat_map(|row| &row[..4 * width as usize]).copied().collect();
        Ok(Picture { size: [width, height], rgba })
    }
}
