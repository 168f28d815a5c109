//! Quality of pictures, depth and masks.

mod boundary;
mod depth;
mod masks;
#[cfg(test)]
mod oracle_tests;
mod pictures;
mod predicted;

pub use boundary::boundary_f;
pub use depth::{DepthErrors, depth_errors};
pub use masks::{Absent, ClassOnFrame, ClassSummary, Confusion, IouReport, MaskScores, MaskSummary};
pub use pictures::{Ssim, masked, psnr_db, psnr_per_channel_db, psnr_published_db, ssim};
pub use predicted::PredictedMasks;
