//! Scatter plots as SVG.

use plotters::prelude::*;
use surgtpgs_core::{Error, Result};

/// A named measurement.
pub(super) struct Point<'a> {
    pub(super) name: &'a str,
    pub(super) x: f64,
    pub(super) y: f64,
}

/// Width and height of a plot, px.
const SIZE: (u32, u32) = (1000, 700);

/// A scatter plot with a name beside each point; the first point stands out.
pub(super) fn scatter(title: &str, x_label: &str, y_label: &str, points: &[Point<'_>]) -> Result<String> {
    let mut svg = String::new();
    draw(&mut svg, title, x_label, y_label, points)
        .map_err(|e| Error::input(format!("the plot could not be drawn: {e}"), ""))?;
    Ok(svg)
}

fn draw(
    svg: &mut String,
    title: &str,
    x_label: &str,
    y_label: &str,
    points: &[Point<'_>],
) -> std::result::Result<(), Box<dyn std::error::Error>> {
    let root = SVGBackend::with_string(svg, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let span = |value: fn(&Point<'_>) -> f64| {
        let (low, high) =
            points.iter().map(value).fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
        let margin = 0.08 * (high - low).max(1e-3 * high.abs()).max(1e-9);
        (low - margin, high + margin)
    };
    let ((x0, x1), (y0, y1)) = (span(|p| p.x), span(|p| p.y));
    let mut chart = ChartBuilder::on(&root)
        .caption(title, ("sans-serif", 22))
        .margin(14)
        .x_label_area_size(44)
        .y_label_area_size(64)
        // Room for the names of the rightmost points.
        .build_cartesian_2d(x0..x1 + 0.25 * (x1 - x0), y0..y1)?;
    chart.configure_mesh().x_desc(x_label).y_desc(y_label).light_line_style(WHITE).draw()?;
    chart.draw_series(points.iter().enumerate().map(|(k, p)| {
        let colour = if k == 0 { RGBColor(200, 30, 30) } else { RGBColor(40, 90, 160) };
        EmptyElement::at((p.x, p.y))
            + Circle::new((0, 0), 4, colour.filled())
            + Text::new(p.name.to_owned(), (8, -6), ("sans-serif", 13).into_font().color(&colour))
    }))?;
    root.present()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_is_named_even_if_all_are_the_same() {
        let points = [Point { name: "default", x: 1.0, y: 2.0 }, Point { name: "paper", x: 1.0, y: 2.0 }];
        let svg = scatter("t", "x", "y", &points).unwrap();
        assert!(svg.contains("default") && svg.contains("paper") && svg.trim_end().ends_with("</svg>"));
    }
}
