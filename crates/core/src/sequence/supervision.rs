//! Everything that is learned from besides the pictures, told apart by a hash.

use super::Sequence;
use sha2::{Digest, Sha256};

impl Sequence {
    /// Returns the SHA-256, hexadecimal, over what is learned from besides the pictures: places of the frames,
    /// cameras as they were recorded, origin and meaning of depth and masks, and the field of view. The content
    /// of depth and mask files does not count.
    pub(crate) fn supervision_digest(&self) -> String {
        let recording = self.recording();
        let mut hash = Sha256::new();
        let mut tell = |what: String| hash.update(what + "\n");
        tell(format!("{:?}, {:?}", recording.camera_source, self.depth_origin()));
        tell(format!("{:?}, {:?}", recording.depth_rule, recording.mask_rule));
        if let Some(depth) = self.estimated_depth() {
            tell(format!("{} {:?} {:?}", depth.network, depth.kind, depth.drift));
        }
        for (i, (frame, camera)) in recording.frames.iter().zip(&recording.cameras).enumerate() {
            let lens = [camera.fx, camera.fy, camera.cx, camera.cy];
            let pose = camera.camera_from_world.to_cols_array();
            let files = [frame.depth.is_some(), frame.mask.is_some()];
            tell(format!("{:?} {lens:?} {pose:?} {files:?}", self.time(i)));
        }
        let inside: Vec<u8> = self.field_of_view().data.iter().map(|inside| u8::from(*inside)).collect();
        hash.update(inside);
        format!("{:x}", hash.finalize())
    }
}
