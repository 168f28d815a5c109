//! Commands that make ffmpeg read a video.

use super::{Container, Unread};
use crate::Error;
use std::{
    ffi::OsString,
    process::{Command, Stdio},
};

/// Two fields of one picture show two times: the second is guessed anew. Other pictures stay as they are.
pub(super) const WHOLE_PICTURES: &str = "bwdif=mode=send_frame:deint=interlaced";
/// A new, steady clock. With its own clock ffmpeg would repeat and drop frames to keep a steady rate.
const STEADY_CLOCK: &str = "settb=1/25,setpts=N";

impl Unread {
    /// Returns `true` if all frames of an mp4 come, those among them that an edit list hides. By itself ffmpeg
    /// leaves them out.
    pub(super) fn ignores_edits(&self) -> bool {
        self.kind == Container::Mp4 && !self.follows_edits
    }

    /// Begins a command that reads the video track, from a time on if one is given, seconds on its own clock.
    /// Reading begins there or earlier, where decoding may start.
    pub(super) fn reading(&self, from: Option<f64>) -> Command {
        let mut command = Command::new(&self.program);
        command.args(["-hide_banner", "-nostats", "-nostdin", "-loglevel", "level+info"]);
        if self.ignores_edits() {
            command.args(["-ignore_editlist", "1"]);
        }
        if let Some(form) = self.form {
            command.args(["-f", form]);
        }
        if let Some(from) = from {
            command.args(["-noaccurate_seek", "-seek_timestamp", "1", "-ss", &format!("{from:.6}")]);
        }
        // Names such as `concat:a` would be read as something else than a file.
        let mut input = OsString::from("file:");
        input.push(&self.input);
        command.arg("-i").arg(input).args(["-map", "0:v:0"]);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
        command
    }

    /// Returns the error if ffmpeg cannot be started or waited for.
    pub(super) fn missing(&self, e: &std::io::Error) -> Error {
        Error::Missing {
            what: format!(
                "this video cannot be read here ({}), nor by the program ffmpeg ({e})",
                self.why_not_here
            ),
            hint: "Install ffmpeg, or convert the video to H.264 in mp4 or to a folder of PNG frames.".into(),
        }
    }
}

/// Adds filters, after which pictures follow each other steadily.
pub(super) fn add_filters(command: &mut Command, filters: &str) {
    command.args(["-vf", &format!("{filters},{STEADY_CLOCK}"), "-r", "25"]);
}
