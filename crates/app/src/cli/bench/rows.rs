//! The rows of `bench train`: the default, one row for each choice that departs from it, and the
//! whole `paper` profile.

use surgtpgs_core::{
    deform::BasisShape,
    train::{FeatureMode, FrameOrder, LengthUnit, Profile, TrainSettings},
};

/// One way to train.
pub(super) struct Row {
    /// Name in the table and for `--rows`.
    pub(super) name: &'static str,
    /// Difference from the default profile.
    pub(super) what: &'static str,
    pub(super) settings: TrainSettings,
}

/// Returns all rows, each with this number of steps.
pub(super) fn rows(iterations: usize, seed: u64) -> Vec<Row> {
    let paper = TrainSettings { iterations, seed, eval: true, ..TrainSettings::of(Profile::Paper) };
    let default = TrainSettings { iterations, seed, eval: true, ..TrainSettings::default() };
    let row = |name, what, change: &dyn Fn(&mut TrainSettings)| {
        let mut settings = default.clone();
        change(&mut settings);
        Row { name, what, settings }
    };
    let mut rows = vec![
        row("default", "nothing", &|_| {}),
        // The paper's Table 3: deformation tracking of features × region smoothness; both is the default.
        row("no tracking no smoothing", "features still over time, no region smoothness", &|s| {
            s.feature_motion = false;
            s.loss.region_smoothness = 0.0;
        }),
        row("tracking alone", "no region smoothness", &|s| s.loss.region_smoothness = 0.0),
        row("smoothing alone", "features still over time", &|s| s.feature_motion = false),
    ];
    rows.extend(shortcuts(&row, &paper));
    rows.extend(departures(&row, &paper));
    rows.push(Row { name: "paper", what: "all that the released code does", settings: paper });
    rows
}

/// Makes the row of a name and a difference from the default profile by changing its settings.
type MakeRow<'a> = &'a dyn Fn(&'static str, &'static str, &dyn Fn(&mut TrainSettings)) -> Row;

/// Returns the rows about shortcuts for speed.
fn shortcuts(row: MakeRow<'_>, paper: &TrainSettings) -> Vec<Row> {
    vec![
        row("all pixels", "every pixel at every step", &|s| {
            s.pixel_step = 1;
            s.half_size_pixel_step = 1;
        }),
        row("repeats move", "frames that repeat the one before get a time of their own", &|s| {
            s.finds_repeats = false;
        }),
        row("nothing guessed", "held-out frames are not guessed from those around them", &|s| {
            s.guesses_held_out = false;
        }),
        row("absolute colour", "absolute differences of colour alone, as released", &|s| {
            s.loss.absolute = paper.loss.absolute;
            s.loss.square = paper.loss.square;
        }),
        row("many at first", "three times as many first Gaussians, as released", &|s| {
            s.px_per_gaussian = paper.px_per_gaussian;
        }),
        row("slow changes", "rates of colour, turn and stretch over time a third", &|s| {
            s.rates.motion_relative /= 3.0;
        }),
        row("full size", "no steps at half size", &|s| s.half_size_share = 0.0),
        row("Gaussian bases", "Gaussian basis functions instead of splines", &|s| {
            s.basis_shape = BasisShape::Gaussian;
            s.basis_width = 0.8;
            s.rates.motion *= 0.5;
            s.rates.motion_relative *= 0.5;
        }),
        row("features lifted", "features in closed form after training (--fast-features)", &|s| {
            s.feature_mode = FeatureMode::Lifted;
            s.feature_motion = false;
        }),
        row("features lifted first", "learned from the closed form on", &|s| {
            s.feature_mode = FeatureMode::LiftedFirst;
        }),
        row("no densification", "the initial Gaussians only", &|s| s.densify.growth = 0.0),
    ]
}

/// Returns the rows about departures from the released code.
fn departures(row: MakeRow<'_>, paper: &TrainSettings) -> Vec<Row> {
    vec![
        row("own bases", "every Gaussian learns its own quartic bases", &|s| {
            s.own_bases = true;
            s.num_bases = paper.num_bases;
            s.basis_shape = paper.basis_shape;
            s.basis_width = paper.basis_width;
        }),
        row("gate on scale", "the features' gate reads the scale's channels, slope 1.5", &|s| {
            s.gate_on_scale = true;
            s.gate_slope = paper.gate_slope;
        }),
        row("colour still", "colour does not change over time", &|s| s.colour_over_time = false),
        row("depth moves", "centres move along z over time, though nothing tells of it", &|s| {
            s.depth_over_time = true;
        }),
        row("pooled regions", "one mean over all channels of a region", &|s| s.loss.pooled_regions = true),
        row("raw depth", "depth not divided by opacity, and it does not move centres", &|s| {
            s.loss.raw_depth = true;
            s.depth_moves_centres = false;
        }),
        row("unmasked variation", "total variation outside the mask too", &|s| {
            s.loss.unmasked_variation = true;
        }),
        row("frames in order", "frames one after the other", &|s| s.frame_order = FrameOrder::Cyclic),
        row("rates in scene units", "learning rates as released, whatever the scene's size", &|s| {
            s.rates.unit = LengthUnit::Scene;
            s.rates.mean = paper.rates.mean;
            s.rates.motion = paper.rates.motion;
            s.rates.uniform_motion = true;
        }),
        row("rates fall alike", "rates fall to 5 %, however often frames are visited", &|s| {
            s.rates.falls_by_visits = false;
        }),
        row("no cooldown", "rates do not fall to zero at the end", &|s| s.rates.cooldown = 0.0),
        row("slow shapes and colours", "scales and colours learn half as fast, as released", &|s| {
            s.rates.log_scale = paper.rates.log_scale;
            s.rates.colour = paper.rates.colour;
        }),
        row("split only", "split above a threshold, never clone, lose the step", &|s| {
            s.densify = paper.densify.clone();
        }),
        row("faint start", "first Gaussians as released: opacity 0.1, neighbours' distance", &|s| {
            s.initial_opacity = paper.initial_opacity;
            s.neighbour_sizes = true;
        }),
        row("spherical harmonics", "degree 3 although the camera is still", &|s| {
            s.sh_degree = 3;
            s.sh_when_still = true;
            s.sh_every = paper.sh_every;
        }),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_have_names_of_their_own_and_differ_from_the_default() {
        let rows = rows(100, 7);
        let names: std::collections::BTreeSet<_> = rows.iter().map(|r| r.name).collect();
        assert_eq!(names.len(), rows.len());
        assert!(names.iter().all(|name| !name.contains(',')), "`--rows` is a list with commas");
        assert!(rows[1..].iter().all(|r| r.settings != rows[0].settings));
        assert!(rows.iter().all(|r| r.settings.iterations == 100 && r.settings.seed == 7 && r.settings.eval));
    }
}
