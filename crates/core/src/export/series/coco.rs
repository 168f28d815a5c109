//! COCO annotations: categories are prompts, images are frames, masks are run lengths.

use super::{Series, SeriesPlan, list::JsonList};
use crate::{
    export::frame::FrameContent,
    files::WholeFile,
    grid::Mask,
    mask::{bounding_box, column_runs, compressed},
};
use serde_json::{Value, json};
use std::io;

pub(super) struct Coco {
    annotations: JsonList,
    next_id: usize,
}

impl Coco {
    pub(super) fn begin(file: WholeFile, plan: SeriesPlan<'_>) -> io::Result<Self> {
        let SeriesPlan { provenance, frames, size: (width, height), .. } = plan;
        let image = |&frame: &usize| {
            json!({
                "id": frame, "file_name": format!("frame_{frame:06}.png"), "width": width, "height": height,
                "frame": frame, "time_s": provenance.seconds(frame), "source": provenance.source(frame),
            })
        };
        let category = |(i, p): (usize, &crate::export::ExportPrompt)| json!({ "id": i + 1, "name": p.text, "supercategory": "prompt" });
        let head = json!({
            "info": { "description": provenance.intended_use, "contributor": provenance.tool },
            "categories": provenance.prompts.iter().enumerate().map(category).collect::<Vec<_>>(),
            // An image without annotations says that nothing is there.
            "images": frames.iter().filter(|&&f| provenance.shows(f)).map(image).collect::<Vec<_>>(),
        });
        // Evaluators take annotation 0 for no annotation.
        Ok(Self { annotations: JsonList::begin(file, &head, "annotations")?, next_id: 1 })
    }
}

impl Series for Coco {
    /// Adds one annotation per prompt that was found, even if it has several parts.
    fn add(&mut self, frame: &FrameContent<'_>) -> io::Result<()> {
        for (prompt, mask) in frame.masks.iter().enumerate() {
            if let Some(mut annotation) = annotation(mask) {
                annotation["id"] = self.next_id.into();
                annotation["image_id"] = frame.frame.into();
                annotation["category_id"] = (prompt + 1).into();
                self.annotations.push(&annotation)?;
                self.next_id += 1;
            }
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> io::Result<WholeFile> {
        self.annotations.finish()
    }
}

/// Returns the annotation of a mask; `None` if the mask is empty.
fn annotation(mask: &Mask) -> Option<Value> {
    let rect = bounding_box(mask)?;
    Some(json!({
        "segmentation": { "size": [mask.height, mask.width], "counts": compressed(&column_runs(mask)) },
        "area": mask.count(),
        "bbox": [rect.x, rect.y, rect.width, rect.height],
        "iscrowd": 0,
    }))
}
