//! Sizes of everything that is measured, and the time that it may take.

use crate::cli::bench::step::Size;
use std::time::{Duration, Instant};
use surgtpgs_core::demo::DemoSettings;

/// Sizes of everything that is measured.
pub(super) struct Scale {
    /// Name on the page.
    pub(super) name: &'static str,
    /// Sizes of training steps.
    pub(super) sizes: [Size; 3],
    /// Number of steps that are averaged.
    pub(super) steps: usize,
    pub(super) demo: DemoSettings,
    pub(super) demo_steps: usize,
    /// Number of training steps on recordings.
    pub(super) recording_steps: usize,
    /// Number of frames that are shown.
    pub(super) frames: usize,
}

impl Scale {
    /// Returns the sizes for a GPU, for a software adapter, or for a trial of the measurement itself.
    pub(super) fn of(is_short: bool, is_software: bool) -> Self {
        if is_short {
            Self {
                name: "short: tiny sizes, to try the measurement itself",
                sizes: [Size::new(32, 24, 100), Size::new(48, 36, 200), Size::new(64, 48, 400)],
                steps: 3,
                demo: DemoSettings { width: 64, height: 48, frames: 10, ..Default::default() },
                demo_steps: 60,
                recording_steps: 20,
                frames: 3,
            }
        } else if is_software {
            Self {
                name: "small, because the adapter is a program on the CPU",
                sizes: [Size::new(64, 48, 400), Size::new(96, 72, 900), Size::new(160, 128, 2_500)],
                steps: 4,
                demo: DemoSettings { width: 96, height: 72, ..Default::default() },
                demo_steps: 150,
                recording_steps: 50,
                frames: 4,
            }
        } else {
            Self {
                name: "full",
                sizes: [
                    Size::new(320, 256, 10_000),
                    Size::new(640, 512, 40_000),
                    Size::new(1280, 1024, 160_000),
                ],
                steps: 40,
                demo: DemoSettings::default(),
                demo_steps: 2000,
                recording_steps: 3000,
                frames: 16,
            }
        }
    }
}

/// Time that the measurement may take.
pub(super) struct Budget {
    started: Instant,
    limit: Duration,
}

/// Share of the time that is left over for what cannot be stopped half-way.
const RESERVE: f64 = 0.2;

impl Budget {
    pub(super) fn new(seconds: u32) -> Self {
        Self { started: Instant::now(), limit: Duration::from_secs(seconds.into()) }
    }

    /// Returns the seconds since the start.
    pub(super) fn spent(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }

    /// Returns `true` if nothing more should be begun.
    pub(super) fn is_spent(&self) -> bool {
        self.started.elapsed() >= self.limit
    }

    /// Returns the time that the next of `num_left` equal works may take.
    pub(super) fn share(&self, num_left: usize) -> Duration {
        let left = self.limit.saturating_sub(self.started.elapsed());
        left.mul_f64(1.0 - RESERVE) / num_left.max(1) as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn works_of_one_share_each_leave_some_of_the_time() {
        let budget = Budget::new(100);
        assert!(budget.share(4) * 4 <= Duration::from_secs(80) && budget.share(1) > budget.share(2));
        assert_eq!(Budget { limit: Duration::ZERO, ..budget }.share(0), Duration::ZERO);
    }

    #[test]
    fn a_software_adapter_gets_less_than_a_gpu_and_more_than_a_trial() {
        let pixels = |short, software| {
            Scale::of(short, software).sizes.map(|s| s.width * s.height * s.gaussians).iter().sum::<usize>()
        };
        assert!(pixels(true, true) < pixels(false, true) && pixels(false, true) < pixels(false, false));
        assert_eq!(pixels(true, true), pixels(true, false));
    }
}
