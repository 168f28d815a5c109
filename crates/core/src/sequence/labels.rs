//! Label files and their conversion into class ids. The meaning of the numbers is decided once for all
//! pictures of a recording, from the contents of some of them.

use super::{
    classes::{Class, NO_LABEL},
    read,
};
use crate::{
    Result,
    annotations::Shape,
    dicom::Segmentation,
    grid::Grid,
    reading::{self, Values},
};
use std::{
    cmp::Ordering,
    collections::BTreeSet,
    path::{Path, PathBuf},
    sync::Arc,
};

/// Class ids per pixel; [`NO_LABEL`] where unknown.
pub type LabelMap = Grid<u8>;

/// The label files of one frame.
#[derive(Clone, Debug)]
pub(super) enum LabelFiles {
    /// One picture whose values, or colours, name the classes.
    Picture(PathBuf),
    /// One mask per class id (non-zero = this class); later ones win.
    PerClass(Vec<(u8, PathBuf)>),
    /// Frames of a DICOM segmentation; the number of a segment is its class id, and later frames win.
    Segmentation(Arc<Segmentation>, Vec<usize>),
    /// Shapes of a file of annotations, with class ids; later ones win.
    Shapes(Vec<(u8, Shape)>),
}

/// The way in which the values of a label picture name classes.
#[derive(Clone, Debug)]
pub(super) enum LabelCoding {
    /// A grey picture holds class ids. A coloured one holds the classes' display colours, unless its
    /// numbers are ids: see [`NumbersAre`].
    IdsOrColours,
    /// The first channel holds class ids.
    Ids,
    /// The first channel holds codes: (code, class id).
    Codes(&'static [(u8, u8)]),
}

/// Meaning of the numbers of pictures that could be read in two ways.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum NumbersAre {
    /// Colours or codes, as the [`LabelCoding`] says.
    Coded,
    /// Class ids: the indices into a palette, or the greys of a coloured picture.
    Ids,
}

/// The way in which the pixels of a picture were understood.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Way {
    /// The first way that its [`LabelCoding`] names.
    Ordinary,
    /// The palette's colours name no class; the indices into it are ids.
    PalettePlaces,
    /// The colours name no class, but all are grey, and the greys are ids.
    GreyColours,
}

/// Class ids per pixel, and statistics of the reading.
#[derive(Clone, Debug)]
pub(super) struct ReadLabels {
    /// [`NO_LABEL`] where no class is named.
    pub ids: LabelMap,
    pub way: Way,
    /// Number of pixels that name a class.
    pub known: usize,
    /// Number of pixels that name no class and do not say "unknown" (255) either.
    pub strangers: usize,
    /// A few values of these pixels: numbers or colours.
    pub examples: BTreeSet<String>,
}

/// Number of unknown values that are named in messages.
pub(super) const EXAMPLES: usize = 5;

impl LabelFiles {
    /// Reads the class ids per pixel, at the size of the frames.
    pub(super) fn read(
        &self,
        coding: &LabelCoding,
        numbers: NumbersAre,
        classes: &[Class],
        (width, height): (usize, usize),
    ) -> Result<ReadLabels> {
        match self {
            Self::Picture(path) => {
                let picture = reading::values(path)?;
                let size = (picture.image.width() as usize, picture.image.height() as usize);
                read::expect_size(path, size, (width, height))?;
                Ok(decoded(picture, coding, numbers, classes))
            }
            Self::PerClass(files) => {
                let mut labels = Grid::filled(width, height, NO_LABEL);
                for (id, path) in files {
                    let mask = read::lightness(path)?;
                    read::expect_size(path, (mask.width, mask.height), (width, height))?;
                    for (label, _) in labels.data.iter_mut().zip(&mask.data).filter(|(_, m)| **m != 0) {
                        *label = *id;
                    }
                }
                Ok(ReadLabels::certain(labels))
            }
            Self::Segmentation(file, frames) => {
                let mut labels = Grid::filled(width, height, NO_LABEL);
                for &i in frames {
                    let shown = file.shown(i)?;
                    let of_class = |number: u16| classes.iter().find(|c| u16::from(c.id) == number);
                    for (label, number) in labels.data.iter_mut().zip(&shown.data).filter(|(_, n)| **n != 0) {
                        *label = of_class(*number).map_or(*label, |class| class.id);
                    }
                }
                Ok(ReadLabels::certain(labels))
            }
            Self::Shapes(shapes) => {
                let mut labels = Grid::filled(width, height, NO_LABEL);
                for (id, shape) in shapes {
                    let mask = shape.pixels(width, height);
                    for (label, _) in labels.data.iter_mut().zip(&mask.data).filter(|(_, m)| **m) {
                        *label = *id;
                    }
                }
                Ok(ReadLabels::certain(labels))
            }
        }
    }

    /// Returns the paths of the files that are the recording's own.
    pub(super) fn paths(&self) -> Vec<&Path> {
        match self {
            Self::Picture(path) => vec![path],
            Self::PerClass(files) => files.iter().map(|(_, path)| path.as_path()).collect(),
            Self::Segmentation(file, _) => vec![file.path()],
            Self::Shapes(_) => Vec::new(),
        }
    }
}

impl ReadLabels {
    /// Takes class ids whose meaning is certain.
    fn certain(ids: LabelMap) -> Self {
        let known = ids.data.iter().filter(|id| **id != NO_LABEL).count();
        Self { ids, way: Way::Ordinary, known, strangers: 0, examples: BTreeSet::new() }
    }
}

/// Returns the way of reading the numbers of some pictures by which more of their pixels name a class;
/// `first` if both are equal. Pictures that cannot be read are skipped.
pub(super) fn numbers_of(
    pictures: &[&Path],
    coding: &LabelCoding,
    classes: &[Class],
    first: NumbersAre,
) -> NumbersAre {
    let (mut coded, mut ids) = (0, 0);
    for picture in pictures.iter().filter_map(|path| reading::values(path).ok()) {
        coded += decoded(picture.clone(), coding, NumbersAre::Coded, classes).known;
        ids += decoded(picture, coding, NumbersAre::Ids, classes).known;
    }
    match coded.cmp(&ids) {
        Ordering::Less => NumbersAre::Ids,
        Ordering::Equal => first,
        Ordering::Greater => NumbersAre::Coded,
    }
}

fn decoded(picture: Values, coding: &LabelCoding, numbers: NumbersAre, classes: &[Class]) -> ReadLabels {
    let takes_ids = numbers == NumbersAre::Ids;
    let size = (picture.image.width() as usize, picture.image.height() as usize);
    let of_id = |v: u16| classes.iter().find(|c| u16::from(c.id) == v).map(|c| c.id);
    let of_colour = |colour: [u8; 3]| classes.iter().find(|c| c.colour == colour).map(|c| c.id);
    let Values { image, palette } = picture;
    if let LabelCoding::Codes(codes) = coding
        && !takes_ids
    {
        let of_code = |v: u16| codes.iter().find(|(code, _)| u16::from(*code) == v).map(|(_, id)| *id);
        let shown = |v: u16| palette.as_ref().map_or(Some(v), |p| Some(u16::from(p.get(usize::from(v))?[0])));
        let numbers = read::first_channel_of(image);
        return look_up(&numbers.data, Way::Ordinary, size, |v| shown(v).and_then(of_code));
    }
    if let LabelCoding::Ids | LabelCoding::Codes(_) = coding {
        return look_up(&read::first_channel_of(image).data, Way::Ordinary, size, of_id);
    }
    if let Some(palette) = palette {
        let places = read::first_channel_of(image).data;
        let colour = |place: u16| palette.get(usize::from(place)).and_then(|c| of_colour(*c));
        return match takes_ids {
            true => look_up(&places, Way::PalettePlaces, size, of_id),
            false => look_up(&places, Way::Ordinary, size, colour),
        };
    }
    if !image.color().has_color() {
        return look_up(&read::first_channel_of(image).data, Way::Ordinary, size, of_id);
    }
    if image.color().bytes_per_pixel() > image.color().channel_count() {
        let deep = image.into_rgb16();
        let colours = deep.as_raw().as_chunks::<3>().0;
        if takes_ids && colours.iter().all(|[r, g, b]| r == g && g == b) {
            let first: Vec<u16> = colours.iter().map(|[v, _, _]| *v).collect();
            return look_up(&first, Way::GreyColours, size, of_id);
        }
        let exact = |colour: [u16; 3]| {
            let is_exact = colour.iter().all(|v| v % DEEPER == 0);
            is_exact.then(|| of_colour(colour.map(|v| (v / DEEPER) as u8))).flatten()
        };
        return look_up(colours, Way::Ordinary, size, exact);
    }
    let image = image.into_rgb8();
    let colours = image.as_raw().as_chunks::<3>().0;
    if takes_ids && colours.iter().all(|[r, g, b]| r == g && g == b) {
        return look_up(colours, Way::GreyColours, size, |[v, _, _]| of_id(u16::from(v)));
    }
    look_up(colours, Way::Ordinary, size, of_colour)
}

/// A label picture that is not the recording's own.
#[derive(Clone, Debug)]
pub(crate) struct PictureOfIds {
    /// [`NO_LABEL`] where no class is named.
    pub(crate) ids: LabelMap,
    /// Number of pixels that name a class.
    pub(crate) known: usize,
    /// Number of pixels with another value; 0 and 255 are not counted.
    pub(crate) strangers: usize,
    /// A few values of these pixels.
    pub(crate) examples: Vec<String>,
}

/// Implements [`Sequence::picture_of_ids`](super::Sequence::picture_of_ids).
pub(super) fn picture_of_ids(
    path: &Path,
    coding: &LabelCoding,
    numbers: NumbersAre,
    classes: &[Class],
    names: Option<&[(u8, Option<u8>)]>,
) -> Result<PictureOfIds> {
    let picture = reading::values(path)?;
    let mut read = if let Some(names) = names {
        // The names are read as if they were classes with these ids; then each id becomes that of its class.
        let values: Vec<Class> =
            names.iter().map(|&(id, _)| Class { id, name: String::new(), colour: [0; 3] }).collect();
        let places = Values { palette: None, ..picture };
        let mut read = decoded(places, &LabelCoding::Ids, NumbersAre::Ids, &values);
        let class = |value: u8| names.iter().find(|(id, _)| *id == value).and_then(|(_, class)| *class);
        read.ids.data.iter_mut().for_each(|id| *id = class(*id).unwrap_or(NO_LABEL));
        read
    } else {
        decoded(picture, coding, numbers, classes)
    };
    // These values stand for nothing in most pictures.
    for nothing in ["0", "[0, 0, 0]"] {
        read.examples.remove(nothing);
    }
    let strangers = if read.examples.is_empty() { 0 } else { read.strangers };
    let examples = read.examples.into_iter().collect();
    Ok(PictureOfIds { ids: read.ids, known: read.known, strangers, examples })
}

/// Value of a pixel of a label picture.
trait PixelValue: Copy + PartialEq {
    fn says_unknown(self) -> bool;
    fn words(self) -> String;
}

impl PixelValue for u16 {
    fn says_unknown(self) -> bool {
        self == u16::from(NO_LABEL)
    }
    fn words(self) -> String {
        self.to_string()
    }
}

/// Factor from a colour of 8 bits to the same of 16.
const DEEPER: u16 = 257;

impl PixelValue for [u16; 3] {
    fn says_unknown(self) -> bool {
        self == [u16::from(NO_LABEL) * DEEPER; 3]
    }
    fn words(self) -> String {
        format!("{self:?}")
    }
}

impl PixelValue for [u8; 3] {
    fn says_unknown(self) -> bool {
        self == [NO_LABEL; 3]
    }
    fn words(self) -> String {
        format!("{self:?}")
    }
}

fn look_up<T: PixelValue>(
    pixels: &[T],
    way: Way,
    (width, height): (usize, usize),
    class: impl Fn(T) -> Option<u8>,
) -> ReadLabels {
    let (mut known, mut strangers, mut examples) = (0, 0, BTreeSet::new());
    let mut data = Vec::with_capacity(pixels.len());
    // Neighbours mostly share a class, so it is looked up only where the value changes.
    for run in pixels.chunk_by(|a, b| a == b) {
        let id = class(run[0]);
        match id {
            Some(_) => known += run.len(),
            None if run[0].says_unknown() => {}
            None => {
                strangers += run.len();
                if examples.len() < EXAMPLES {
                    examples.insert(run[0].words());
                }
            }
        }
        data.resize(data.len() + run.len(), id.unwrap_or(NO_LABEL));
    }
    ReadLabels { ids: Grid::from_vec(width, height, data), way, known, strangers, examples }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{DynamicImage, GrayImage, RgbImage};

    fn classes() -> Vec<Class> {
        let class = |id: u8, colour| Class { id, name: format!("class {id}"), colour };
        vec![class(0, [0; 3]), class(1, [200, 100, 0]), class(2, [0, 50, 200])]
    }

    /// Reads in the way that names more pixels.
    fn read(image: impl Into<DynamicImage>, palette: Option<Vec<[u8; 3]>>) -> ReadLabels {
        let values = Values { image: image.into(), palette };
        let [coded, ids] = [NumbersAre::Coded, NumbersAre::Ids]
            .map(|numbers| decoded(values.clone(), &LabelCoding::IdsOrColours, numbers, &classes()));
        if ids.known > coded.known { ids } else { coded }
    }

    fn grey(values: &[u8]) -> GrayImage {
        GrayImage::from_raw(values.len() as u32, 1, values.to_vec()).unwrap()
    }

    fn rgb(values: &[[u8; 3]]) -> RgbImage {
        RgbImage::from_raw(values.len() as u32, 1, values.concat()).unwrap()
    }

    #[test]
    fn ids_and_colours_name_classes() {
        let ids = read(grey(&[0, 1, 2, 7, 255]), None);
        assert_eq!(ids.ids.data, [0, 1, 2, NO_LABEL, NO_LABEL]);
        assert_eq!((ids.way, ids.known, ids.strangers), (Way::Ordinary, 3, 1));
        assert_eq!(ids.examples, BTreeSet::from(["7".to_owned()]));
        let colours = read(rgb(&[[0, 50, 200], [200, 100, 0], [9, 9, 9]]), None);
        assert_eq!((colours.ids.data, colours.way), (vec![2, 1, NO_LABEL], Way::Ordinary));
        assert_eq!(colours.examples, BTreeSet::from(["[9, 9, 9]".to_owned()]));
    }

    #[test]
    fn a_palette_is_colours_where_these_are_the_classes_else_ids() {
        let known = read(grey(&[2, 1, 0]), Some(vec![[0; 3], [0, 50, 200], [200, 100, 0]]));
        assert_eq!((known.ids.data, known.way), (vec![1, 2, 0], Way::Ordinary));
        let foreign = read(grey(&[2, 1, 0, 5]), Some(vec![[0; 3], [128, 0, 0], [0, 128, 0]]));
        assert_eq!((foreign.ids.data, foreign.way), (vec![2, 1, 0, NO_LABEL], Way::PalettePlaces));
    }

    #[test]
    fn deep_greys_in_colour_are_ids_as_they_are() {
        let deep = image::ImageBuffer::from_raw(3, 1, vec![0, 0, 0, 2, 2, 2, 255, 255, 255_u16]).unwrap();
        let ids = read(DynamicImage::ImageRgb16(deep), None);
        assert_eq!((ids.ids.data, ids.way, ids.strangers), (vec![0, 2, NO_LABEL], Way::GreyColours, 0));
    }

    #[test]
    fn greys_of_a_coloured_picture_are_ids_where_no_colour_fits_better() {
        let ids = read(rgb(&[[0; 3], [1; 3], [2; 3], [2; 3]]), None);
        assert_eq!((ids.ids.data, ids.way), (vec![0, 1, 2, 2], Way::GreyColours));
        let black = read(rgb(&[[0; 3], [0; 3]]), None);
        assert_eq!((black.ids.data, black.way), (vec![0, 0], Way::Ordinary));
        let one_colour = read(rgb(&[[1; 3], [0, 50, 200]]), None);
        assert_eq!(one_colour.ids.data, [NO_LABEL, 2]);
    }
}
