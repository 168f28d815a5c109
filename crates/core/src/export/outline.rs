//! Border lines of found regions, as SVG.

use super::{frame::FrameContent, stamp, xml::xml};
use crate::mask::{Corner, contours};
use std::fmt::Write;

/// Returns one path per prompt that was found, titled with its words, on the frame's pixel grid and
/// without the frame itself. The lines run along the edges of pixels: filled, they are the mask.
pub(super) fn svg(frame: &FrameContent<'_>) -> String {
    let (width, height) = frame.size();
    let mut text = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
         viewBox=\"0 0 {width} {height}\">\n<title>frame {}</title>\n",
        frame.frame
    );
    for (prompt, mask) in frame.found() {
        let lines = contours(mask);
        if lines.is_empty() {
            continue;
        }
        let [r, g, b] = prompt.colour;
        let data: String = lines.iter().map(|line| path(line)).collect();
        // Writing into a text never fails.
        let _ = writeln!(
            text,
            "<path fill=\"none\" stroke=\"#{r:02x}{g:02x}{b:02x}\" stroke-width=\"2\" \
             vector-effect=\"non-scaling-stroke\" fill-rule=\"evenodd\" d=\"{data}\"><title>{}</title></path>",
            xml(&prompt.text)
        );
    }
    if frame.provenance.options.stamp {
        // Grey is readable on white and on black.
        let _ = writeln!(
            text,
            "<text x=\"2\" y=\"{}\" font-family=\"sans-serif\" font-size=\"{}\" fill=\"#808080\">{}</text>",
            height.saturating_sub(2),
            (height / 30).max(6),
            stamp::WORDS
        );
    }
    text + "</svg>\n"
}

/// Returns the path data of a closed line of horizontal and vertical steps.
fn path(line: &[Corner]) -> String {
    let Some(&(x, y)) = line.first() else { return String::new() };
    let mut data = format!("M{x} {y}");
    for (from, to) in line.iter().zip(&line[1..]) {
        data += &if from.1 == to.1 { format!("H{}", to.0) } else { format!("V{}", to.1) };
    }
    data + "Z"
}
