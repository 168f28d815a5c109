//! CVAT's XML: tracks of a video, or images, with masks, polygons and boxes. A mask is a rectangle of run
//! lengths, row by row.

use super::{Annotation, Canvas, Shape, images::Images, names::FrameNames};
use crate::{Error, Result, grid::Mask, mask::Runs};
use quick_xml::{
    Reader, XmlVersion,
    events::{BytesStart, Event},
};
use std::{str::FromStr, sync::Arc};

/// Elements that are drawn on a frame but have no area.
const WITHOUT_AREA: [&str; 5] = ["polyline", "points", "cuboid", "skeleton", "ellipse"];

/// Returns the annotations of a file of CVAT.
pub(super) fn read(text: &[u8], canvas: &Canvas) -> Result<Vec<Annotation>> {
    let mut reader = Reader::from_reader(text);
    let (names, images) = (FrameNames::of(canvas), Images::default());
    let mut place = Place { canvas, names, images, original_size: None, label: None, frame: None };
    let mut found = Vec::new();
    let mut is_cvat = false;
    loop {
        match reader.read_event().map_err(malformed)? {
            Event::Start(element) if element.name().as_ref() == b"original_size" => {
                place.original_size = size(&mut reader)?;
            }
            Event::Start(element) | Event::Empty(element) => {
                is_cvat |= element.name().as_ref() == b"annotations";
                found.extend(place.element(&element)?);
            }
            Event::Eof if is_cvat => return Ok(found),
            Event::Eof => return Err(malformed("it has no element \"annotations\"")),
            _ => {}
        }
    }
}

fn malformed(e: impl std::fmt::Display) -> Error {
    Error::input(
        format!("this is no XML file of CVAT: {e}"),
        "Export \"CVAT for video\" or \"CVAT for images\".",
    )
}

/// The track or image that is being read.
struct Place<'a> {
    canvas: &'a Canvas,
    names: FrameNames<'a>,
    images: Images,
    /// Columns and rows of the video that tracks are of.
    original_size: Option<(usize, usize)>,
    label: Option<String>,
    frame: Option<usize>,
}

impl Place<'_> {
    /// Takes an element, and returns the annotation that it is, if it is one.
    fn element(&mut self, element: &BytesStart<'_>) -> Result<Option<Annotation>> {
        let name = String::from_utf8_lossy(element.name().as_ref()).into_owned();
        match name.as_str() {
            "track" => {
                (self.label, self.frame) = (text(element, "label")?, None);
                self.original_size
                    .map_or(Ok(()), |(width, height)| self.canvas.expect_size(width, height))?;
            }
            "image" => (self.label, self.frame) = (None, Some(self.image(element)?)),
            "mask" | "polygon" | "box" => return self.shape(&name, element),
            kind if WITHOUT_AREA.contains(&kind) => {
                let what = format!("the file holds a {kind}, which cannot be read as an area");
                return Err(Error::input(what, "Turn it into a mask or a polygon, or leave it out."));
            }
            _ => {}
        }
        Ok(None)
    }

    /// Returns the frame of an image.
    fn image(&mut self, element: &BytesStart<'_>) -> Result<usize> {
        if let (Some(width), Some(height)) = (number(element, "width")?, number(element, "height")?) {
            self.canvas.expect_size(width, height)?;
        }
        let name = text(element, "name")?.unwrap_or_default();
        let frame = self.names.frame_named(&name).ok_or_else(|| {
            let what = format!("the image \"{name}\" is no frame of the recording");
            Error::input(what, "Images are found by their names.")
        })?;
        self.images.add(frame, &name)?;
        Ok(frame)
    }

    fn shape(&self, kind: &str, element: &BytesStart<'_>) -> Result<Option<Annotation>> {
        if text(element, "outside")?.as_deref() == Some("1") {
            return Ok(None);
        }
        let name = match &self.label {
            Some(label) => label.clone(),
            None => required(text(element, "label")?, kind, "label")?,
        };
        let frame = match self.frame {
            Some(frame) => frame,
            None => required(number(element, "frame")?, kind, "frame")?,
        };
        let wrong = |problem: &str| {
            let what = format!("the {kind} of \"{name}\" on frame {frame} cannot be used: {problem}");
            Error::input(what, "Frames count from 0, as CVAT counts them.")
        };
        let frame = self.canvas.frame(frame).ok_or_else(|| wrong("there is no such frame"))?;
        let shape = match kind {
            "mask" => self.mask(element)?.ok_or_else(|| wrong("its run lengths are none"))?,
            "polygon" => polygon(element)?.ok_or_else(|| wrong("its points are none"))?,
            _ => rectangle(element)?.ok_or_else(|| wrong("its corners are none"))?,
        };
        Ok(Some(Annotation { frame, name, shape }))
    }

    fn mask(&self, element: &BytesStart<'_>) -> Result<Option<Shape>> {
        let side = |name| required(number::<usize>(element, name)?, "mask", name);
        let (left, top, width, height) = (side("left")?, side("top")?, side("width")?, side("height")?);
        let fits = |at: usize, length: usize, whole| at.checked_add(length).is_some_and(|end| end <= whole);
        if !fits(left, width, self.canvas.width) || !fits(top, height, self.canvas.height) {
            return Ok(None);
        }
        let mut pixels = Vec::with_capacity(width * height);
        for (i, run) in text(element, "rle")?.unwrap_or_default().split(',').enumerate() {
            let Ok(run) = run.trim().parse::<usize>() else { return Ok(None) };
            if run > width * height - pixels.len() {
                return Ok(None);
            }
            pixels.resize(pixels.len() + run, i % 2 == 1);
        }
        if pixels.len() != width * height {
            return Ok(None);
        }
        let part = Mask::from_vec(width, height, pixels);
        let runs = Runs::placed(&part, (left, top), (self.canvas.width, self.canvas.height));
        Ok(Some(Shape::Mask(Arc::new(runs))))
    }
}

/// Returns the columns and rows that an element `original_size` holds; `None` if it lacks one.
fn size(reader: &mut Reader<&[u8]>) -> Result<Option<(usize, usize)>> {
    let (mut width, mut height) = (None, None);
    loop {
        match reader.read_event().map_err(malformed)? {
            Event::Start(element) => {
                let text = reader.read_text(element.name()).map_err(malformed)?;
                let side = std::str::from_utf8(&text).ok().and_then(|text| text.trim().parse().ok());
                match element.name().as_ref() {
                    b"width" => width = side,
                    b"height" => height = side,
                    _ => {}
                }
            }
            Event::End(_) | Event::Eof => return Ok(width.zip(height)),
            _ => {}
        }
    }
}

fn polygon(element: &BytesStart<'_>) -> Result<Option<Shape>> {
    let points = text(element, "points")?.unwrap_or_default();
    let point = |pair: &str| {
        let (x, y) = pair.split_once(',')?;
        Some([x.trim().parse().ok()?, y.trim().parse().ok()?])
    };
    let points_px: Option<Vec<[f32; 2]>> = points.split(';').map(point).collect();
    Ok(points_px.map(|points_px| Shape::Polygon { points_px }))
}

/// Returns a box, turned by its rotation (degrees, clockwise as seen) around its centre.
fn rectangle(element: &BytesStart<'_>) -> Result<Option<Shape>> {
    let side = |name| number::<f32>(element, name);
    let (Some(x0), Some(y0), Some(x1), Some(y1)) = (side("xtl")?, side("ytl")?, side("xbr")?, side("ybr")?)
    else {
        return Ok(None);
    };
    let turn = side("rotation")?.unwrap_or(0.0);
    if turn == 0.0 {
        return Ok(Some(Shape::Box { corners_px: [[x0, y0], [x1, y1]] }));
    }
    let (sin, cos) = turn.to_radians().sin_cos();
    let centre = [0.5 * (x0 + x1), 0.5 * (y0 + y1)];
    let turned = |[x, y]: [f32; 2]| {
        let (dx, dy) = (x - centre[0], y - centre[1]);
        [centre[0] + cos * dx - sin * dy, centre[1] + sin * dx + cos * dy]
    };
    let points_px = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]].map(turned).to_vec();
    Ok(Some(Shape::Polygon { points_px }))
}

fn text(element: &BytesStart<'_>, name: &str) -> Result<Option<String>> {
    let Some(attribute) = element.try_get_attribute(name).map_err(malformed)? else { return Ok(None) };
    let value = attribute.normalized_value(XmlVersion::Implicit1_0).map_err(malformed)?;
    Ok(Some(value.into_owned()))
}

fn number<T: FromStr>(element: &BytesStart<'_>, name: &str) -> Result<Option<T>> {
    let Some(text) = text(element, name)? else { return Ok(None) };
    text.trim().parse().map(Some).map_err(|_| malformed(format!("{name} is \"{text}\"")))
}

fn required<T>(value: Option<T>, kind: &str, name: &str) -> Result<T> {
    value.ok_or_else(|| malformed(format!("a {kind} has no {name}")))
}
