//! The playback clock, from time to frame. It knows no window and no thread, so a test can be its clock.

use std::sync::Arc;
use surgtpgs_core::sequence::shown_for;

/// Frames per second where the recording does not state them.
pub(crate) const ASSUMED_FPS: f64 = 25.0;

/// Time without a repaint, seconds, after which rounds that were missed are not walked through.
const LONG_AGO_S: f64 = 60.0;
/// Shortest time that a frame is shown at the recording's speed, seconds: a recording may give several frames
/// the same time.
const SHORTEST_SHOWN_S: f64 = 1e-3;
/// Number of frames of the long step.
pub(crate) const HOP: isize = 10;
/// Speeds that the keys step through, as multiples of the recording's speed.
const SPEEDS: [f64; 7] = [0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0];

/// A frame that was asked for, unlike those that follow it while it plays.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Jump {
    /// Number of frames that were asked for so far.
    pub(crate) number: u64,
    pub(crate) frame: usize,
}

/// Chooses the frame to show at a time. Times are seconds of any steady clock.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Playback {
    num_frames: usize,
    fps: f64,
    /// Time of every frame, seconds after the first; empty if `fps` tells it.
    frame_seconds: Arc<[f64]>,
    /// Multiple of the recording's speed; negative plays backwards.
    speed: f64,
    looping: bool,
    /// First and last frame of the part that plays.
    range: Option<(usize, usize)>,
    frame: usize,
    /// The last frame that was asked for.
    jump: Jump,
    /// Time since which the present frame is shown; `None` while it stands still.
    playing_since: Option<f64>,
}

impl Playback {
    /// Makes a clock that stands on frame 0. Frame rates that are not positive numbers count as unknown.
    pub(crate) fn new(num_frames: usize, fps: Option<f32>) -> Self {
        let fps = fps.map(f64::from).filter(|f| f.is_finite() && *f > 0.0).unwrap_or(ASSUMED_FPS);
        Self {
            num_frames: num_frames.max(1),
            fps,
            frame_seconds: Arc::default(),
            speed: 1.0,
            looping: true,
            range: None,
            frame: 0,
            jump: Jump::default(),
            playing_since: None,
        }
    }

    pub(crate) fn frame(&self) -> usize {
        self.frame
    }
    pub(crate) fn num_frames(&self) -> usize {
        self.num_frames
    }
    pub(crate) fn fps(&self) -> f64 {
        self.fps
    }
    pub(crate) fn speed(&self) -> f64 {
        self.speed
    }
    pub(crate) fn is_playing(&self) -> bool {
        self.playing_since.is_some()
    }
    pub(crate) fn is_looping(&self) -> bool {
        self.looping
    }
    pub(crate) fn range(&self) -> Option<(usize, usize)> {
        self.range
    }
    pub(crate) fn jump(&self) -> Jump {
        self.jump
    }

    /// Gives every frame its own time, seconds after the first; none if there are not as many as frames.
    pub(crate) fn with_times(self, frame_seconds: &Arc<[f64]>) -> Self {
        let is_whole = frame_seconds.len() == self.num_frames;
        Self { frame_seconds: if is_whole { frame_seconds.clone() } else { Arc::default() }, ..self }
    }

    /// Goes on where the clock of an earlier state of the same recording stands: on its frame, at its speed,
    /// repeating and playing if that does.
    pub(crate) fn going_on(self, before: &Self, now: f64) -> Self {
        let (speed, looping) = (before.speed, before.looping);
        let mut clock = Self { speed, looping, playing_since: before.playing_since, ..self };
        clock.go_to(before.frame, now);
        clock
    }

    /// Returns the seconds from the start of the recording to `frame`. Past the end, frames follow each other
    /// at the usual pace.
    pub(crate) fn seconds(&self, frame: usize) -> f64 {
        let known = frame.min(self.frame_seconds.len().saturating_sub(1));
        let start = self.frame_seconds.get(known);
        start.map_or(frame as f64 / self.fps, |start| start + (frame - known) as f64 / self.fps)
    }

    /// Returns the seconds for which `frame` is shown at the present speed.
    fn shown_for(&self, frame: usize) -> f64 {
        let lasts = shown_for(frame, &self.frame_seconds).unwrap_or(1.0 / self.fps);
        lasts.max(SHORTEST_SHOWN_S) / self.speed.abs()
    }

    /// Moves to the frame that is due at `now`. If the machine is too slow, frames are skipped: playback
    /// never slows down.
    pub(crate) fn advance(&mut self, now: f64) {
        let Some(mut since) = self.playing_since else { return };
        let (first, last) = self.bounds();
        if self.looping && now - since > LONG_AGO_S {
            let whole: f64 = (first..=last).map(|i| self.shown_for(i)).sum();
            since += ((now - since) / whole).floor() * whole;
        }
        loop {
            let lasts = self.shown_for(self.frame);
            // The small addition keeps a frame that is due exactly at `now` from being lost to rounding.
            if since + lasts > now + 1e-6 * lasts.max(1e-3) {
                break;
            }
            let (end, begin) = if self.speed < 0.0 { (first, last) } else { (last, first) };
            let is_at_end = if self.speed < 0.0 { self.frame <= end } else { self.frame >= end };
            if is_at_end && !self.looping {
                self.pause();
                return;
            }
            self.frame = match (is_at_end, self.speed < 0.0) {
                (true, _) => begin,
                (false, true) => self.frame - 1,
                (false, false) => self.frame + 1,
            };
            since += lasts;
        }
        self.playing_since = Some(since);
    }

    /// Returns the seconds until another frame is due; `None` while it stands still.
    pub(crate) fn seconds_to_next(&self, now: f64) -> Option<f64> {
        Some((self.playing_since? + self.shown_for(self.frame) - now).max(0.0))
    }

    /// Starts or stops. Starting at the end begins again at the start.
    pub(crate) fn toggle(&mut self, now: f64) {
        if self.is_playing() { self.pause() } else { self.play(now) }
    }

    pub(crate) fn play(&mut self, now: f64) {
        let (first, last) = self.bounds();
        let is_outside = !(first..=last).contains(&self.frame);
        if self.speed > 0.0 && (self.frame == last || is_outside) {
            self.frame = first;
        } else if self.speed < 0.0 && (self.frame == first || is_outside) {
            self.frame = last;
        }
        self.playing_since = Some(now);
    }

    /// Stops. What played backwards plays forwards next, at the recording's own speed.
    pub(crate) fn pause(&mut self) {
        self.playing_since = None;
        if self.speed < 0.0 {
            self.speed = 1.0;
        }
    }

    /// Moves the clock to a frame that nobody asked for, at most to the last one. If it plays, it goes on from
    /// there.
    pub(crate) fn seek(&mut self, frame: usize, now: f64) {
        self.frame = frame.min(self.num_frames - 1);
        self.restart(now);
    }

    /// Goes to a frame that is asked for, at most to the last one. If it plays, it goes on from there.
    pub(crate) fn go_to(&mut self, frame: usize, now: f64) {
        self.jump_to(frame);
        self.restart(now);
    }

    /// Stops and moves by `frames`, at most to the first or last one.
    pub(crate) fn step(&mut self, frames: isize) {
        self.pause();
        self.jump_to(self.frame.saturating_add_signed(frames));
    }

    /// Moves to a frame that is asked for. Asking again for the one that it stands on is no other jump.
    fn jump_to(&mut self, frame: usize) {
        let frame = frame.min(self.num_frames - 1);
        let stands_on_it = !self.is_playing() && [self.frame, self.jump.frame] == [frame; 2];
        self.frame = frame;
        if !stands_on_it {
            self.jump = Jump { number: self.jump.number + 1, frame };
        }
    }

    /// Selects the next faster (`+1`) or slower (`-1`) speed; the direction stays.
    pub(crate) fn change_speed(&mut self, by: isize, now: f64) {
        let nearest = |s: &f64| (s - self.speed.abs()).abs();
        let at = (0..SPEEDS.len()).min_by(|a, b| nearest(&SPEEDS[*a]).total_cmp(&nearest(&SPEEDS[*b])));
        let to = at.unwrap_or(3).saturating_add_signed(by).min(SPEEDS.len() - 1);
        self.set_speed(SPEEDS[to] * self.speed.signum(), now);
    }

    /// Returns to the recording's own speed, forwards.
    pub(crate) fn normal_speed(&mut self, now: f64) {
        self.set_speed(1.0, now);
    }

    /// Plays in a direction (`1` or `-1`), as on a video deck. Repeated calls double the speed, up to 8×.
    pub(crate) fn shuttle(&mut self, direction: f64, now: f64) {
        let goes_on = self.is_playing() && self.speed.signum() == direction;
        let faster = if goes_on { (self.speed.abs() * 2.0).min(8.0) } else { 1.0 };
        self.set_speed(faster * direction, now);
        if !self.is_playing() {
            self.play(now);
        }
    }

    pub(crate) fn toggle_looping(&mut self) {
        self.looping = !self.looping;
    }

    /// Returns the part that plays, with its start moved to the present frame.
    pub(crate) fn range_from_here(&self) -> (usize, usize) {
        let end = self.range.map_or(self.num_frames - 1, |(_, end)| end);
        (self.frame, end.max(self.frame))
    }

    /// Returns the part that plays, with its end moved to the present frame.
    pub(crate) fn range_to_here(&self) -> (usize, usize) {
        let start = self.range.map_or(0, |(start, _)| start);
        (start.min(self.frame), self.frame)
    }

    /// Sets the part that plays; `None` is the whole recording.
    pub(crate) fn set_range(&mut self, range: Option<(usize, usize)>) {
        let last = self.num_frames - 1;
        self.range = range.map(|(from, to)| (from.min(last), to.clamp(from.min(last), last)));
    }

    /// Restores a saved speed and repetition. What was saved playing backwards plays forwards.
    pub(crate) fn restore(&mut self, speed: f64, looping: bool, now: f64) {
        self.looping = looping;
        if speed.is_finite() && speed != 0.0 {
            self.set_speed(if speed < 0.0 { 1.0 } else { speed.min(8.0) }, now);
        }
    }

    /// Returns the first and last frame that play.
    pub(crate) fn bounds(&self) -> (usize, usize) {
        self.range.unwrap_or((0, self.num_frames - 1))
    }

    fn set_speed(&mut self, speed: f64, now: f64) {
        self.advance(now);
        self.speed = speed;
        self.restart(now);
    }

    /// Restarts the clock at the present frame and time, if it plays.
    fn restart(&mut self, now: f64) {
        if let Some(since) = &mut self.playing_since {
            *since = now;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::viewer::state::phases::{Phase, csv};

    #[test]
    fn ten_seconds_at_25_fps_are_250_frames() {
        let mut clock = Playback::new(1000, Some(25.0));
        clock.play(100.0);
        for ms in 0..=10_000 {
            clock.advance(100.0 + f64::from(ms) / 1000.0);
        }
        assert_eq!(clock.frame(), 250);
    }

    #[test]
    fn a_slow_machine_leaves_frames_out_instead_of_slowing_down() {
        let mut clock = Playback::new(100, Some(25.0));
        clock.play(0.0);
        clock.advance(0.9);
        assert_eq!(clock.frame(), 22);
        assert!((clock.seconds_to_next(0.9).unwrap() - 0.02).abs() < 1e-9);
    }

    #[test]
    fn without_looping_it_stops_on_the_last_frame_and_play_begins_again() {
        let mut clock = Playback::new(10, Some(10.0));
        clock.toggle_looping();
        clock.play(0.0);
        clock.advance(5.0);
        assert_eq!((clock.frame(), clock.is_playing()), (9, false));
        assert_eq!(clock.seconds_to_next(5.0), None);
        clock.toggle(6.0);
        assert_eq!((clock.frame(), clock.is_playing()), (0, true));
    }

    #[test]
    fn looping_stays_inside_the_range_in_both_directions() {
        let mut clock = Playback::new(100, Some(10.0));
        clock.seek(20, 0.0);
        clock.set_range(Some(clock.range_from_here()));
        clock.seek(24, 0.0);
        clock.set_range(Some(clock.range_to_here()));
        clock.seek(20, 0.0);
        clock.play(0.0);
        let mut shown = Vec::new();
        for tick in 0..7 {
            clock.advance(f64::from(tick) * 0.1);
            shown.push(clock.frame());
        }
        assert_eq!(shown, [20, 21, 22, 23, 24, 20, 21]);
        clock.shuttle(-1.0, 0.6);
        clock.advance(0.8);
        assert_eq!(clock.frame(), 24);
    }

    #[test]
    fn one_step_and_a_hop_are_different_and_end_at_the_ends() {
        let mut clock = Playback::new(48, None);
        clock.step(1);
        assert_eq!(clock.frame(), 1);
        clock.step(10);
        assert_eq!(clock.frame(), 11);
        clock.step(-1);
        assert_eq!(clock.frame(), 10);
        clock.step(-10);
        clock.step(-10);
        assert_eq!(clock.frame(), 0);
        clock.step(1000);
        assert_eq!(clock.frame(), 47);
    }

    #[test]
    fn the_frame_that_was_asked_for_is_known_while_it_plays_on() {
        let mut clock = Playback::new(100, Some(10.0));
        clock.play(0.0);
        clock.go_to(40, 0.0);
        clock.advance(0.5);
        let asked = clock.jump();
        assert_eq!((asked.frame, clock.frame()), (40, 45));
        clock.seek(42, 0.5);
        assert_eq!(clock.jump(), asked, "nobody asked for it");
        clock.pause();
        clock.go_to(40, 0.6);
        let again = clock.jump();
        assert!(again.frame == 40 && again.number != asked.number);
        clock.go_to(40, 0.7);
        assert_eq!(clock.jump(), again, "it stands on it");
        clock.step(-50);
        assert_eq!((clock.jump().frame, clock.frame()), (0, 0));
        clock.go_to(usize::MAX, 0.8);
        assert_eq!((clock.jump().frame, clock.frame()), (99, 99));
    }

    #[test]
    fn changing_speed_does_not_jump() {
        let mut clock = Playback::new(1000, Some(10.0));
        clock.play(0.0);
        clock.change_speed(1, 1.0);
        assert_eq!((clock.frame(), clock.speed()), (10, 2.0));
        clock.advance(2.0);
        assert_eq!(clock.frame(), 30);
        clock.shuttle(1.0, 2.0);
        assert_eq!(clock.speed(), 4.0);
        clock.normal_speed(2.0);
        assert_eq!(clock.speed(), 1.0);
        for _ in 0..20 {
            clock.change_speed(-1, 2.0);
        }
        assert_eq!(clock.speed(), 0.1);
    }

    #[test]
    fn after_playing_backwards_it_plays_forwards_at_the_recordings_speed() {
        let mut clock = Playback::new(1000, Some(10.0));
        clock.seek(500, 0.0);
        clock.shuttle(-1.0, 0.0);
        clock.change_speed(1, 1.0);
        assert_eq!((clock.frame(), clock.speed()), (490, -2.0), "the direction stays while it plays");
        clock.toggle(2.0);
        assert_eq!((clock.speed(), clock.is_playing()), (1.0, false));
        clock.toggle(3.0);
        clock.advance(4.0);
        assert_eq!((clock.frame(), clock.speed()), (500, 1.0));
        clock.toggle(4.0);
        clock.change_speed(1, 4.0);
        assert_eq!(clock.speed(), 2.0);
        clock.restore(-2.0, true, 5.0);
        assert_eq!(clock.speed(), 1.0);
    }

    #[test]
    fn uneven_frames_are_shown_as_long_as_they_were_taken() {
        let times: Arc<[f64]> = [0.0, 0.1, 0.5, 0.6].into();
        let mut clock = Playback::new(4, Some(10.0)).with_times(&times);
        assert_eq!(clock.seconds(2), 0.5);
        clock.play(0.0);
        let mut shown = |ms: u32| {
            clock.advance(f64::from(ms) / 1e3);
            clock.frame()
        };
        assert_eq!([50, 100, 450, 500, 600, 699, 700, 1250].map(&mut shown), [0, 1, 1, 2, 3, 3, 0, 2]);
        clock.shuttle(-1.0, 1.25);
        clock.advance(1.35);
        assert_eq!(clock.frame(), 1);
        clock.advance(1.70);
        assert_eq!((clock.frame(), clock.seconds_to_next(1.7).map(|s| (1e3 * s).round())), (1, Some(50.0)));
        assert_eq!(Playback::new(9, None).with_times(&times).seconds(5), 0.2, "of another recording");
    }

    #[test]
    fn the_last_frame_ends_behind_its_start() {
        let times: Arc<[f64]> = [0.0, 0.04, 40.0].into();
        let clock = Playback::new(3, Some(25.0)).with_times(&times);
        let ms = [0, 1, 2, 3, 5].map(|i| (1e3 * clock.seconds(i)).round());
        assert_eq!(ms, [0.0, 40.0, 40_000.0, 40_040.0, 40_120.0]);
        let table = csv(&[Phase::new("End", 2, 2)], |frame| clock.seconds(frame));
        assert!(table.ends_with("\"End\",3,3,40.000,40.040\n"), "{table}");
        assert_eq!(Playback::new(3, Some(25.0)).seconds(3), 0.12);
    }

    #[test]
    fn frames_of_one_time_are_played_one_after_the_other() {
        let times: Arc<[f64]> = [0.0, 0.0, 0.0, 0.0, 0.1].into();
        let mut clock = Playback::new(5, Some(10.0)).with_times(&times);
        clock.set_range(Some((0, 2)));
        clock.play(0.0);
        clock.advance(0.0015);
        assert_eq!(clock.frame(), 1);
        clock.advance(0.0035);
        assert_eq!(clock.frame(), 0);
        clock.advance(1e6);
        assert!(clock.is_playing() && clock.frame() <= 2);
    }

    #[test]
    fn another_state_of_the_recording_goes_on_where_the_first_one_stands() {
        let mut first = Playback::new(100, Some(10.0));
        first.toggle_looping();
        first.change_speed(1, 0.0);
        first.seek(40, 0.0);
        let again = || Playback::new(100, Some(10.0));
        let stands = again().going_on(&first, 7.0);
        assert_eq!((stands.frame(), stands.jump().frame, stands.speed()), (40, 40, 2.0));
        assert!(!stands.is_looping() && !stands.is_playing());
        first.play(7.0);
        let mut plays = again().going_on(&first, 7.0);
        plays.advance(8.0);
        assert_eq!((plays.frame(), plays.is_playing()), (60, true));
    }

    #[test]
    fn nonsense_is_survived() {
        let mut clock = Playback::new(0, Some(f32::NAN));
        assert_eq!((clock.num_frames(), clock.fps()), (1, ASSUMED_FPS));
        clock.play(0.0);
        clock.advance(-5.0);
        clock.advance(1e9);
        assert_eq!(clock.frame(), 0);
        clock.seek(usize::MAX, 0.0);
        assert_eq!(clock.frame(), 0);
    }
}
