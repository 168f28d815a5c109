//! CVAT for video: XML with one track per mask, because CVAT takes masks from the first frame of a track
//! alone.

use super::{Series, SeriesPlan};
use crate::{
    export::{frame::FrameContent, xml::xml},
    files::WholeFile,
    grid::Mask,
    mask::{PixelRect, bounding_box},
};
use std::io::{self, BufWriter, Write};

pub(super) struct Cvat {
    file: BufWriter<WholeFile>,
    next_id: usize,
    last_frame: usize,
}

impl Cvat {
    pub(super) fn begin(file: WholeFile, plan: SeriesPlan<'_>) -> io::Result<Self> {
        let mut file = BufWriter::new(file);
        let SeriesPlan { provenance, size: (width, height), .. } = plan;
        let frames = provenance.sequence_frames;
        let labels: String = provenance.prompts.iter().map(|prompt| {
            let [r, g, b] = prompt.colour;
            format!(
                "<label><name>{}</name><color>#{r:02x}{g:02x}{b:02x}</color><type>mask</type><attributes></attributes></label>\n",
                xml(&prompt.text)
            )
        }).collect();
        write!(
            file,
            "<?xml version=\"1.0\" encoding=\"utf-8\"?>\n<annotations>\n<version>1.1</version>\n<meta>\n<task>\n\
             <name>{}</name>\n<size>{frames}</size>\n<mode>interpolation</mode>\n<start_frame>0</start_frame>\n\
             <stop_frame>{}</stop_frame>\n<labels>\n{labels}</labels>\n\
             <original_size><width>{width}</width><height>{height}</height></original_size>\n\
             </task>\n<contributor>{}</contributor>\n<intended_use>{}</intended_use>\n</meta>\n",
            xml(&provenance.sequence_name),
            frames.saturating_sub(1),
            xml(&provenance.tool),
            xml(&provenance.intended_use),
        )?;
        Ok(Self { file, next_id: 0, last_frame: frames.saturating_sub(1) })
    }

    fn mask(&mut self, frame: usize, is_outside: bool, mask: &Mask, rect: PixelRect) -> io::Result<()> {
        let outside = u8::from(is_outside);
        writeln!(
            self.file,
            "<mask frame=\"{frame}\" keyframe=\"1\" outside=\"{outside}\" occluded=\"0\" rle=\"{}\" left=\"{}\" top=\"{}\" \
             width=\"{}\" height=\"{}\" z_order=\"0\"></mask>",
            row_runs(mask, rect),
            rect.x,
            rect.y,
            rect.width,
            rect.height
        )
    }
}

impl Series for Cvat {
    fn add(&mut self, frame: &FrameContent<'_>) -> io::Result<()> {
        for (prompt, mask) in frame.found() {
            let Some(rect) = bounding_box(mask) else { continue };
            writeln!(
                self.file,
                "<track id=\"{}\" label=\"{}\" source=\"auto\">",
                self.next_id,
                xml(&prompt.text)
            )?;
            self.mask(frame.frame, false, mask, rect)?;
            // It ends with its frame, as CVAT itself writes shapes of a single frame.
            if frame.frame < self.last_frame {
                self.mask(frame.frame + 1, true, mask, rect)?;
            }
            writeln!(self.file, "</track>")?;
            self.next_id += 1;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> io::Result<WholeFile> {
        self.file.write_all(b"</annotations>\n")?;
        Ok(self.file.into_inner()?)
    }
}

/// Returns the run lengths of a rectangle of the mask, row by row, beginning with pixels that are not set.
fn row_runs(mask: &Mask, rect: PixelRect) -> String {
    let rows = rect.y..rect.y + rect.height;
    let pixels: Vec<bool> = rows.flat_map(|y| &mask.row(y)[rect.x..rect.x + rect.width]).copied().collect();
    let first = if pixels.first() == Some(&true) { vec![0] } else { Vec::new() };
    let runs = first.into_iter().chain(pixels.chunk_by(|a, b| a == b).map(<[bool]>::len));
    runs.map(|run| run.to_string()).collect::<Vec<_>>().join(", ")
}
