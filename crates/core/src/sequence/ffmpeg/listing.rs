//! The frames of a video and their times, as its packets list them. Nothing is decoded for it, so that it
//! takes as long as reading the file.

use super::{
    Unread,
    command::add_filters,
    messages::{LEADING_FRAMES, Told, ratio},
};
use crate::Result;
use std::process::Stdio;

/// Number of frames at either end whose listed times are compared with those of decoded frames.
const COMPARED: usize = 32;
/// Bit of a packet's flags that says that decoding may start there.
const KEY: u32 = 1;
/// Bit of a packet's flags that says that its frame is not shown: an edit list hides it.
const HIDDEN: u32 = 4;

/// Times of all frames, in the order of showing.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Listing {
    /// Times in ticks, ascending, at least one.
    pub ticks: Vec<i64>,
    /// Frames at which decoding may start, ascending.
    pub keys: Vec<usize>,
    /// Seconds per tick.
    pub tick_s: f64,
}

impl Listing {
    /// Lists the packets of a video. `None` if they do not tell when each frame is shown. Also returns what
    /// ffmpeg said of the file.
    pub(super) fn of_packets(video: &Unread) -> Result<(Option<Self>, Told)> {
        let mut command = video.reading(None);
        command.args(["-copyts", "-c", "copy", "-f", "framecrc", "-"]).stdout(Stdio::piped());
        let output = command.output().map_err(|e| video.missing(&e))?;
        let told = Told::listen(&output.stderr[..]);
        let listed = Self::parse(&String::from_utf8_lossy(&output.stdout));
        Ok((listed.filter(|_| output.status.success()), told))
    }

    /// Lists the frames of a video by decoding all of them.
    pub(super) fn of_pictures(video: &Unread) -> Result<Told> {
        decode(video, None, "1", None)
    }

    /// Lists the frames that were decoded, if all of them have a time, each a later one.
    pub(super) fn of_decoded(told: &Told) -> Option<Self> {
        let ticks: Vec<i64> = told.ticks.iter().copied().collect::<Option<_>>()?;
        let is_in_order = !ticks.is_empty() && ticks.is_sorted_by(|a, b| a < b);
        is_in_order.then_some(Self { ticks, keys: told.keys.clone(), tick_s: told.tick_s? })
    }

    /// Reads what ffmpeg's `framecrc` writes: `0, dts, pts, duration, size, checksum, F=flags`, where no flags
    /// stand for a key.
    fn parse(text: &str) -> Option<Self> {
        let mut tick_s = None;
        let mut packets = Vec::new();
        for line in text.lines() {
            if let Some(head) = line.strip_prefix("#tb 0:") {
                tick_s = ratio(head.trim());
            }
            if line.starts_with('#') {
                continue;
            }
            let fields: Vec<&str> = line.split(',').map(str::trim).collect();
            let [_, _, pts, _, size, _, rest @ ..] = &fields[..] else { return None };
            let flags = rest.iter().find_map(|field| field.strip_prefix("F=0x"));
            let flags = flags.map_or(Some(KEY), |flags| u32::from_str_radix(flags, 16).ok())?;
            // An empty packet shows the frame before once more: no frame comes out.
            if *size != "0" && flags & HIDDEN == 0 {
                packets.push((pts.parse::<i64>().ok()?, flags & KEY != 0));
            }
        }
        packets.sort_unstable();
        let keys = packets.iter().enumerate().filter(|(_, (_, is_key))| *is_key).map(|(i, _)| i).collect();
        let ticks: Vec<i64> = packets.into_iter().map(|(pts, _)| pts).collect();
        let is_in_order = !ticks.is_empty() && ticks.is_sorted_by(|a, b| a < b);
        is_in_order.then_some(Self { ticks, keys, tick_s: tick_s? })
    }

    /// Compares the frames at both ends with those that are decoded. Leaves out listed frames at the
    /// beginning that need earlier ones. Returns the number of frames that come out if the last ones are
    /// missing, and the size of the first; `None` if other frames come out than are listed.
    pub(super) fn compare_ends(&mut self, video: &Unread) -> Result<Option<(usize, (usize, usize))>> {
        let (head, there) =
            rayon::join(|| decode(video, None, "1", Some(COMPARED)), || self.decoded_end(video));
        let (head, there) = (head?, there?);
        let Some((size, head)) = head.size.zip(Self::of_decoded(&head)) else { return Ok(None) };
        let leading = self.ticks.partition_point(|ticks| *ticks < head.ticks[0]);
        if leading > LEADING_FRAMES || !self.ticks[leading..].starts_with(&head.ticks) {
            return Ok(None);
        }
        self.leave_out(leading);
        Ok(there.map(|there| (there - leading, size)))
    }

    /// Returns the number of frames up to the last one that is decoded; `None` if others come out at the end than
    /// are listed.
    fn decoded_end(&self, video: &Unread) -> Result<Option<usize>> {
        let first = self.ticks.len().saturating_sub(COMPARED);
        let condition = format!("gte(pts,{})", self.ticks[first]);
        for from in self.seeks(first) {
            let told = decode(video, from, &condition, None)?;
            let ticks: Vec<i64> = told.ticks.into_iter().flatten().collect();
            if self.ticks[first..].starts_with(&ticks) && !ticks.is_empty() {
                return Ok(Some(first + ticks.len()));
            }
        }
        Ok(None)
    }

    fn leave_out(&mut self, leading: usize) {
        self.ticks.drain(..leading);
        self.keys.retain(|key| *key >= leading);
        self.keys.iter_mut().for_each(|key| *key -= leading);
    }

    /// Returns the time of a frame, seconds.
    pub(super) fn seconds(&self, frame: usize) -> f64 {
        self.tick_s * self.ticks[frame] as f64
    }

    /// Returns the last frame up to `frame` at which decoding may start.
    pub(super) fn key_before(&self, frame: usize) -> usize {
        self.keys[..self.keys.partition_point(|key| *key <= frame)].last().copied().unwrap_or(0)
    }

    /// Returns times from which a video is read for a frame, seconds, the best first. From the wrong one too
    /// late a frame comes; `None`, from the start of the file, is never wrong.
    pub(super) fn seeks(&self, frame: usize) -> Vec<Option<f64>> {
        /// Seconds before a key that streams without an index are entered at.
        const EARLIER: f64 = 0.5;
        /// Seconds before the next key within which a frame may be coded after it.
        const REORDERED: f64 = 0.3;
        let key = self.key_before(frame);
        if key == 0 {
            return vec![None];
        }
        let next = self.keys.get(self.keys.partition_point(|key| *key <= frame));
        let latest = next.map_or(f64::INFINITY, |next| self.seconds(*next) - REORDERED);
        let start = self.seconds(key);
        let before = self.key_before(key - 1);
        vec![
            Some(self.seconds(frame).min(latest).max(start)),
            Some(start - EARLIER),
            Some(self.seconds(before) - EARLIER),
            None,
        ]
    }
}

/// Decodes frames that meet a condition, from a time on, and keeps no picture.
fn decode(video: &Unread, from: Option<f64>, condition: &str, most: Option<usize>) -> Result<Told> {
    let mut command = video.reading(from);
    command.arg("-copyts");
    add_filters(&mut command, &format!("select='{condition}',showinfo"));
    if let Some(most) = most {
        command.args(["-frames:v", &most.to_string()]);
    }
    let mut child = command.args(["-f", "null", "-"]).spawn().map_err(|e| video.missing(&e))?;
    let told = child.stderr.take().map_or_else(Told::default, Told::listen);
    child.wait().map_err(|e| video.missing(&e))?;
    Ok(told)
}
