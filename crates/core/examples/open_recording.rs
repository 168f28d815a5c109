//! Opens a recording and prints its contents. The argument is a folder or a video file.

#![expect(clippy::print_stdout, reason = "an example prints its results")]

use std::path::Path;
use surgtpgs_core::{Error, Result, sequence::Sequence};

fn main() -> Result<()> {
    let Some(path) = std::env::args().nth(1) else {
        return Err(Error::input("no recording is given", "Usage: open_recording RECORDING"));
    };
    let sequence = Sequence::open(Path::new(&path))?;
    println!("{}: {:?}, {} frames", sequence.name(), sequence.layout(), sequence.num_frames());
    println!("size: {}×{} px", sequence.width(), sequence.height());
    println!("camera: {:?}, moves: {}", sequence.camera_source(), sequence.camera_moves());
    println!("depth: {}, labels: {}", sequence.has_depth(), sequence.has_labels());
    for class in sequence.classes() {
        println!("class {}: {}", class.id, class.name);
    }
    for i in 0..sequence.num_frames() {
        let supervised = sequence.mask(i)?.count();
        println!("{} at {:.3}: {supervised} px are supervised", sequence.frame_name(i), sequence.time(i));
    }
    Ok(())
}
