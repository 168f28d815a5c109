//! The report as a page of Markdown.

use super::{Report, frames::Frames, steps::PassRow};
use crate::cli::document::{escaped, number, table};
use std::fmt::Write;

/// Number of bytes in a megabyte.
const MB: f64 = 1e6;

impl Report {
    /// Returns the page; parts that are not made yet are left out.
    pub(super) fn page(&self) -> String {
        let mut page = format!("## Adapter\n\n{}", self.adapter_table());
        if !self.steps.is_empty() {
            let _ = write!(page, "## Training steps\n\n{}", self.steps_table());
        }
        if !self.trainings.is_empty() {
            let _ = write!(page, "## Trainings\n\n{}", self.trainings_table());
        }
        if !self.frames.is_empty() {
            let _ = write!(page, "## Frames\n\n{}{}", frames_table(&self.frames), errors_table(&self.frames));
        }
        let passes: Vec<&PassRow> =
            self.step_passes.iter().chain(self.frames.iter().flat_map(|f| &f.passes)).collect();
        if !passes.is_empty() {
            let _ = write!(page, "## Passes\n\n{}", self.passes_table(&passes));
        }
        if !self.failures.is_empty() {
            let lines =
                self.failures.iter().map(|f| format!("- {}: {}\n", escaped(&f.part), escaped(&f.reason)));
            let _ = write!(page, "## What failed\n\n{}", lines.collect::<String>());
        }
        page
    }

    fn adapter_table(&self) -> String {
        let bandwidth = if self.bandwidth > 0.0 {
            format!("{:.0} GB/s, reading and writing of a copy on the device", self.bandwidth * 1e-9)
        } else {
            "not measured".to_owned()
        };
        let found = |[name, about]: &[String; 2]| vec![format!("found: {}", escaped(name)), escaped(about)];
        let rows = [
            ("adapter", escaped(&self.adapter)),
            ("driver", escaped(&self.driver)),
            ("memory bandwidth", bandwidth),
            ("compared with", escaped(&self.cpu)),
            ("sizes", self.scale.to_owned()),
            ("program", format!("surgtpgs {}, {:.0} s for this page", self.version, self.seconds)),
        ];
        let rows = rows.map(|(what, value)| vec![what.to_owned(), value]);
        table(&["what", "value"], rows.into_iter().chain(self.adapters.iter().map(found)))
    }

    fn steps_table(&self) -> String {
        let rows = self.steps.iter().map(|row| {
            vec![
                format!("{}×{}, {} Gaussians", row.width, row.height, row.gaussians),
                row.pixels.to_owned(),
                format!("{:.1}", row.gpu_steps_per_second),
                format!("{:.1}", row.cpu_steps_per_second),
                format!("{:.2}", row.gpu_steps_per_second / row.cpu_steps_per_second.max(1e-9)),
                kilobytes(row.uploaded),
                kilobytes(row.read_back),
            ]
        });
        let head =
            ["size", "pixels", "GPU, steps/s", "CPU, steps/s", "times", "up, kB a step", "back, kB a step"];
        table(&head, rows)
    }

    fn trainings_table(&self) -> String {
        let rows = self.trainings.iter().map(|row| {
            let early = if row.steps < row.planned_steps { ", out of time" } else { "" };
            vec![
                escaped(&format!("{}, {}×{}", row.recording, row.width, row.height)),
                row.backend.to_owned(),
                format!("{:.1}", row.seconds),
                format!("{} of {}{early}", row.steps, row.planned_steps),
                format!("{:.1}", row.steps as f64 / row.seconds.max(1e-9)),
                row.gaussians.to_string(),
                number(row.psnr_masked_db, 2),
                number(row.ssim, 4),
                number(row.miou_paper, 3),
                number(row.miou_strict, 3),
                row.dropped_steps.to_string(),
            ]
        });
        let head = [
            "recording",
            "backend",
            "seconds",
            "steps",
            "steps/s",
            "Gaussians",
            "PSNR, dB",
            "SSIM",
            "IoU, paper",
            "IoU, strict",
            "dropped steps",
        ];
        format!("Quality is that of held-out frames, rendered on the CPU.\n\n{}", table(&head, rows))
    }

    /// Times of passes beside the least that the memory's bandwidth allows.
    fn passes_table(&self, passes: &[&PassRow]) -> String {
        let rows = passes.iter().map(|row| {
            let floor_ms = (self.bandwidth > 0.0).then(|| row.bytes / self.bandwidth * 1e3);
            vec![
                escaped(&row.of),
                escaped(&row.pass),
                format!("{:.4}", row.ms),
                format!("{:.3}", row.bytes / MB),
                number(floor_ms, 4),
                number(floor_ms.map(|floor| row.ms / floor.max(1e-9)), 1),
            ]
        });
        let head = ["of", "pass", "ms", "MB moved", "floor, ms", "times the floor"];
        format!(
            "Times are by the device's own clock. *MB moved* is what a pass has to read and write at least. The\n\
             floor is the time of that at the memory bandwidth above; what stays in a cache can be faster.\n\n{}",
            table(&head, rows)
        )
    }
}

fn frames_table(frames: &[Frames]) -> String {
    let rows = frames.iter().flat_map(|f| {
        f.ways.iter().map(|way| {
            vec![
                scene_of(f),
                f.prompts.to_string(),
                way.way.to_owned(),
                format!("{:.1}", 1e3 / way.gpu_ms.max(1e-6)),
                format!("{:.1}", 1e3 / way.cpu_ms.max(1e-6)),
                kilobytes(way.uploaded),
                kilobytes(way.read_back),
            ]
        })
    });
    let head =
        ["scene", "prompts", "from", "GPU, frames/s", "CPU, frames/s", "up, kB a frame", "back, kB a frame"];
    table(&head, rows)
}

fn errors_table(frames: &[Frames]) -> String {
    let share = |share: f64| format!("{:.3} %", 100.0 * share);
    let rows = frames.iter().map(|f| {
        vec![
            scene_of(f),
            f.prompts.to_string(),
            share(f.pictures.beyond_a_level),
            format!("{:.4}", f.pictures.mean_levels),
            share(f.scores.beyond_a_level),
            format!("{:.4}", f.scores.mean_levels),
        ]
    });
    let head = [
        "differences from the CPU of",
        "prompts",
        "channels of pictures beyond 1/255",
        "their mean, 1/255",
        "scores beyond 1/255",
        "their mean, 1/255",
    ];
    table(&head, rows)
}

fn scene_of(f: &Frames) -> String {
    escaped(&format!("{}, {}×{}, {} Gaussians", f.scene, f.width, f.height, f.gaussians))
}

fn kilobytes(bytes: f64) -> String {
    format!("{:.1}", bytes / 1e3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pass_is_beside_the_least_time_that_the_memory_allows() {
        let mut report = Report::new("short");
        report.bandwidth = 2e9;
        report.step_passes.push(PassRow { of: "step".into(), pass: "raster".into(), ms: 3.0, bytes: 4e6 });
        let page = report.page();
        assert!(page.contains("| step | raster | 3.0000 | 4.000 | 2.0000 | 1.5 |"), "{page}");
        assert!(page.contains("2 GB/s") && !page.contains("What failed"), "{page}");
        report.bandwidth = 0.0;
        assert!(report.page().contains("| step | raster | 3.0000 | 4.000 | unknown | unknown |"));
    }
}
