//! Label Studio: a list of tasks, one per frame, with brush masks as predictions that can be corrected there.

use super::{Series, SeriesPlan, list::JsonList};
use crate::{annotations::packed, export::frame::FrameContent, files::WholeFile};
use serde_json::json;
use std::io;

pub(super) struct LabelStudio {
    tasks: JsonList,
}

impl LabelStudio {
    pub(super) fn begin(file: WholeFile, _plan: SeriesPlan<'_>) -> io::Result<Self> {
        Ok(Self { tasks: JsonList::bare(file)? })
    }
}

impl Series for LabelStudio {
    /// Adds a task. A frame that the scene does not show has none: it would say that nothing is there.
    fn add(&mut self, frame: &FrameContent<'_>) -> io::Result<()> {
        if !frame.is_shown() {
            return Ok(());
        }
        let (width, height) = frame.size();
        let found = frame.found().enumerate().filter(|(_, (_, mask))| mask.data.contains(&true));
        let region = |(i, (prompt, mask)): (usize, (&crate::export::ExportPrompt, &_))| {
            json!({
                "id": format!("{}-{}", frame.frame, i + 1), "type": "brushlabels",
                "from_name": "tag", "to_name": "image",
                "original_width": width, "original_height": height, "image_rotation": 0,
                "value": { "format": "rle", "rle": packed::pack(mask), "brushlabels": [prompt.text] },
            })
        };
        let provenance = frame.provenance;
        let name =
            provenance.source(frame.frame).map_or(format!("frame_{:06}.png", frame.frame), str::to_owned);
        self.tasks.push(&json!({
            "data": {
                "image": format!("/data/local-files/?d={name}"), "frame": frame.frame,
                "intended_use": provenance.intended_use,
            },
            "predictions": [{ "model_version": provenance.tool, "result": found.map(region).collect::<Vec<_>>() }],
        }))
    }

    fn finish(self: Box<Self>) -> io::Result<WholeFile> {
        self.tasks.finish()
    }
}
