//! Scatter plots as SVG.

use super::measure::Files;
use plotters::prelude::*;
use surgtpgs_core::{Error, Result};

/// A named measurement.
pub(super) struct Point<'a> {
    pub(super) name: &'a str,
    pub(super) x: f64,
    pub(super) y: f64,
}

/// Title of a plot, and labels of its axes.
#[derive(Clone, Copy)]
pub(super) struct Axes<'a> {
    pub(super) title: &'a str,
    pub(super) x: &'a str,
    pub(super) y: &'a str,
}

/// Width and height of a plot, px.
const SIZE: (u32, u32) = (1100, 700);
/// Width of the list of names, px.
const LEGEND_WIDTH: u32 = 280;

/// Writes a scatter plot, if there are points and files are wanted.
pub(super) fn write(files: &Files, name: &str, axes: Axes<'_>, points: &[Point<'_>]) -> Result<()> {
    if points.is_empty() { Ok(()) } else { files.write(name, scatter(axes, points)?.as_bytes()) }
}

/// Draws a scatter plot of numbered points with their names at the side, x logarithmic; the first
/// point stands out.
fn scatter(axes: Axes<'_>, points: &[Point<'_>]) -> Result<String> {
    let mut svg = String::new();
    draw(&mut svg, axes, points)
        .map_err(|e| Error::input(format!("the plot could not be drawn: {e}"), ""))?;
    Ok(svg)
}

fn draw(
    svg: &mut String,
    axes: Axes<'_>,
    points: &[Point<'_>],
) -> std::result::Result<(), Box<dyn std::error::Error>> {
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let (left, right) = root.split_horizontally(SIZE.0 - LEGEND_WIDTH);
    let colour = |k: usize| if k == 0 { RGBColor(200, 30, 30) } else { RGBColor(40, 90, 160) };
    let font = |size: u32, k: usize| ("sans-serif", size).into_font().color(&colour(k));
    let (x0, x1) = span(points.iter().map(|p| p.x.max(1e-9).ln()));
    let (y0, y1) = span(points.iter().map(|p| p.y));
    let mut chart = ChartBuilder::on(&left)
        .caption(axes.title, ("sans-serif", 22))
        .margin(14)
        .x_label_area_size(44)
        .y_label_area_size(64)
        .build_cartesian_2d((x0.exp()..x1.exp()).log_scale(), y0..y1)?;
    // The positions of a logarithmic axis carry rounding errors, which are rounded away.
    let seconds = |x: &f64| ((x * 1e3).round() / 1e3).to_string();
    let mut mesh = chart.configure_mesh();
    mesh.x_desc(axes.x).y_desc(axes.y).light_line_style(WHITE).x_label_formatter(&seconds).draw()?;
    // The first point is drawn last, on top.
    chart.draw_series(points.iter().enumerate().rev().map(|(k, p)| {
        EmptyElement::at((p.x.max(1e-9), p.y))
            + Circle::new((0, 0), 4, colour(k).filled())
            + Text::new((k + 1).to_string(), (6, -6), font(12, k))
    }))?;
    for (k, p) in points.iter().enumerate() {
        let at = (8, 50 + 22 * k as i32);
        right.draw(&Text::new(format!("{}  {}", k + 1, p.name), at, font(14, k)))?;
    }
    root.present()?;
    Ok(())
}

/// Returns the smallest and largest value, with a margin.
fn span(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values.fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
    let margin = 0.08 * (high - low).max(1e-3 * high.abs()).max(1e-6);
    (low - margin, high + margin)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_is_named_even_if_all_are_the_same() {
        let points = [Point { name: "default", x: 1.0, y: 2.0 }, Point { name: "paper", x: 1.0, y: 2.0 }];
        let svg = scatter(Axes { title: "t", x: "x", y: "y" }, &points).unwrap();
        assert!(svg.contains("default") && svg.contains("paper") && svg.trim_end().ends_with("</svg>"));
    }
}
