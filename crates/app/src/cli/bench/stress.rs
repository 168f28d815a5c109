//! `bench stress`: renders scenes that break renderers, and tells how far each picture is from the f64
//! twin's. Then it makes changes to a scene that must not change its picture, and tells how far the picture
//! is from what it must be.

use super::measure::{Files, Measure};
use crate::{
    cli::{
        console::{print_report, say},
        verb::Exit,
    },
    engine::{BackendChoice, Machine},
    tables,
};
use clap::Args;
use std::path::PathBuf;
use surgtpgs_core::{
    Result,
    camera::Camera,
    files::Inputs,
    raster::Renderer,
    scene::Scene,
    stress::{CUT_OFF, Case, Difference, a_million, cases, compare, invariances},
};

/// Render scenes that break renderers, and compare with f64: stress.csv
#[derive(Debug, Args)]
pub(super) struct BenchStressArgs {
    /// Device to render on
    #[arg(long, value_enum, default_value_t = BackendChoice::Auto)]
    backend: BackendChoice,
    /// Folder for stress.csv
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Report as JSON
    #[arg(long)]
    json: bool,
}

/// All cases of one family together.
#[derive(serde::Serialize)]
struct Family {
    name: &'static str,
    cases: usize,
    /// Count of values in the pictures that are not finite.
    not_finite: usize,
    /// Largest relative difference from f64, without the differences that [`Family::beyond`] counts.
    largest_error: f64,
    /// Largest share of a picture that fell on another side of a cut-off in f32.
    beyond: f64,
}

impl Measure for BenchStressArgs {
    fn run(&self, force: bool) -> Result<Exit> {
        let files = Files::claim(self.output.as_ref(), &Inputs::none(), force)?;
        let mut renderer = Machine::open(self.backend)?;
        say(&format!("rendering on {}", renderer.name()));
        let mut families: Vec<Family> = Vec::new();
        for case in cases().into_iter().chain([a_million()]) {
            let Case { family: name, scene, camera, time } = &case;
            add(&mut families, name, compare(&renderer.render(scene, camera, *time, true)?, &case));
        }
        for case in invariances() {
            let mut render =
                |(scene, camera): &(Scene, Camera)| renderer.render(scene, camera, case.time, true);
            let (before, after) = (render(&case.before)?, render(&case.after)?);
            add(&mut families, case.family, case.difference(&before, &after));
        }
        let table = csv(&families)?;
        files.write("stress.csv", &table)?;
        print_report(&families, &String::from_utf8_lossy(&table), self.json)?;
        files.finish()?;
        Ok(Exit::Done)
    }
}

fn add(families: &mut Vec<Family>, name: &'static str, found: Difference) {
    let known = families.iter().position(|f| f.name == name);
    let i = known.unwrap_or_else(|| {
        families.push(Family { name, cases: 0, not_finite: 0, largest_error: 0.0, beyond: 0.0 });
        families.len() - 1
    });
    let family = &mut families[i];
    family.cases += 1;
    family.not_finite += found.not_finite;
    family.largest_error = family.largest_error.max(found.largest);
    family.beyond = family.beyond.max(found.beyond);
}

fn csv(families: &[Family]) -> Result<Vec<u8>> {
    let beyond = format!("share_beyond_{CUT_OFF}");
    tables::csv_under(&["family", "cases", "not_finite", "largest_error", &beyond], families)
}
