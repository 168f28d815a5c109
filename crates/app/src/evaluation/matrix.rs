//! Confusion matrix of the classes, as a picture.

use plotters::prelude::*;
use surgtpgs_core::{Error, Result, metrics::Confusion};

/// Side of a cell, and room for names, px.
const CELL: i32 = 56;
const NAMES: i32 = 190;

/// Draws a row per labelled class that occurs, a column per predicted class and one for none. A cell tells
/// the share of the row's pixels that it has.
pub(super) fn svg(confusion: &Confusion) -> Result<String> {
    let mut svg = String::new();
    draw(&mut svg, confusion).map_err(|e| Error::input(format!("the matrix could not be drawn: {e}"), ""))?;
    Ok(svg)
}

fn draw(svg: &mut String, confusion: &Confusion) -> std::result::Result<(), Box<dyn std::error::Error>> {
    let rows: Vec<usize> =
        (0..confusion.classes.len()).filter(|&k| confusion.pixels[k].iter().any(|n| *n > 0)).collect();
    let columns: Vec<usize> = (0..=confusion.classes.len())
        .filter(|&k| rows.contains(&k) || confusion.pixels.iter().any(|row| row[k] > 0))
        .collect();
    let name = |k: usize| confusion.classes.get(k).map_or("none", String::as_str);
    let size = (NAMES + CELL * columns.len() as i32 + 20, NAMES + CELL * rows.len() as i32 + 20);
    let root = SVGBackend::with_string(svg, (size.0 as u32, size.1 as u32)).into_drawing_area();
    root.fill(&WHITE)?;
    let text = |size: i32, colour: &RGBColor| ("sans-serif", size).into_font().color(colour);
    root.draw(&Text::new("labelled (rows), predicted (columns)", (8, 8), text(13, &BLACK)))?;
    for (x, &column) in columns.iter().enumerate() {
        let at = (NAMES + CELL * x as i32 + CELL / 2 + 6, NAMES - 8);
        let upright = ("sans-serif", 14).into_font().transform(FontTransform::Rotate270).color(&BLACK);
        root.draw(&Text::new(name(column), (at.0 - 14, at.1), upright))?;
    }
    for (y, &row) in rows.iter().enumerate() {
        let top = NAMES + CELL * y as i32;
        root.draw(&Text::new(name(row), (8, top + CELL / 2 - 7), text(14, &BLACK)))?;
        let total: u64 = confusion.pixels[row].iter().sum();
        for (x, &column) in columns.iter().enumerate() {
            let share = confusion.pixels[row][column] as f64 / total.max(1) as f64;
            let left = NAMES + CELL * x as i32;
            let light = |full: u8| (255.0 - (255.0 - f64::from(full)) * share) as u8;
            // Right in blue, wrong in orange.
            let full: [u8; 3] = if row == column { [0, 114, 178] } else { [213, 94, 0] };
            let [r, g, b] = full.map(light);
            let cell = [(left, top), (left + CELL - 2, top + CELL - 2)];
            root.draw(&Rectangle::new(cell, RGBColor(r, g, b).filled()))?;
            let ink = if share > 0.5 { WHITE } else { BLACK };
            let label = if share >= 0.0005 { format!("{:.1}", 100.0 * share) } else { String::new() };
            root.draw(&Text::new(label, (left + 12, top + CELL / 2 - 8), text(14, &ink)))?;
        }
    }
    root.present()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_that_occur_have_a_row_and_shares_are_of_the_row() {
        let confusion = Confusion {
            classes: vec!["liver".into(), "fat".into(), "blood".into()],
            pixels: vec![vec![3, 1, 0, 0], vec![0, 0, 0, 5], vec![0; 4]],
        };
        let svg = svg(&confusion).unwrap();
        for text in ["liver", "fat", "none", "75.0", "25.0", "100.0"] {
            assert!(svg.contains(text), "{text}");
        }
        assert!(!svg.contains("blood"));
    }
}
