//! Measures the time spent in each pass of a chain of passes, and the bytes it moves.

use std::{
    marker::PhantomData,
    time::{Duration, Instant},
};

/// The passes of a chain, as a fieldless enum whose numbers count from 0.
pub trait PassName: Copy + 'static {
    /// All passes, in order.
    const ALL: &'static [Self];
    /// Index of the pass in [`PassName::ALL`].
    fn number(self) -> usize;
}

/// Counts the runs of each pass and adds up their durations.
#[derive(Clone, Debug)]
pub struct PassClock<P> {
    spent: Vec<Duration>,
    runs: Vec<usize>,
    bytes: Vec<u64>,
    lap: Option<Instant>,
    passes: PhantomData<P>,
}

impl<P: PassName> Default for PassClock<P> {
    fn default() -> Self {
        let n = P::ALL.len();
        Self {
            spent: vec![Duration::ZERO; n],
            runs: vec![0; n],
            bytes: vec![0; n],
            lap: None,
            passes: PhantomData,
        }
    }
}

impl<P: PassName> PassClock<P> {
    /// Starts the clock: the first pass begins.
    pub fn start(&mut self) {
        self.lap = Some(Instant::now());
    }

    /// Counts a run of `pass`, which ends here; the next pass begins.
    pub fn lap(&mut self, pass: P) {
        self.runs[pass.number()] += 1;
        self.waited(pass);
    }

    /// Adds the time since the last lap to `pass` without counting another run.
    pub fn waited(&mut self, pass: P) {
        let now = Instant::now();
        if let Some(before) = self.lap.replace(now) {
            self.spent[pass.number()] += now - before;
        }
    }

    /// Counts a run of `pass` whose duration another clock measured, and which moved `bytes` in memory.
    pub fn add(&mut self, pass: P, spent: Duration, bytes: u64) {
        self.runs[pass.number()] += 1;
        self.spent[pass.number()] += spent;
        self.bytes[pass.number()] += bytes;
    }

    /// Returns the seconds spent in a pass.
    pub fn seconds(&self, pass: P) -> f64 {
        self.spent[pass.number()].as_secs_f64()
    }

    /// Returns the bytes that a pass has moved in memory, as far as they were counted.
    pub fn bytes(&self, pass: P) -> u64 {
        self.bytes[pass.number()]
    }

    /// Returns the number of runs of a pass.
    pub fn runs(&self, pass: P) -> usize {
        self.runs[pass.number()]
    }

    /// Returns the number of passes that have run since `earlier`.
    pub fn ran_since(&self, earlier: &Self) -> usize {
        self.runs.iter().zip(&earlier.runs).filter(|(now, before)| now > before).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Clone, Copy)]
    enum Step {
        First,
        Second,
    }

    impl PassName for Step {
        const ALL: &'static [Self] = &[Self::First, Self::Second];
        fn number(self) -> usize {
            self as usize
        }
    }

    #[test]
    fn runs_are_counted_and_time_belongs_to_the_pass_that_ended() {
        let mut clock = PassClock::default();
        clock.start();
        clock.lap(Step::First);
        let earlier = clock.clone();
        std::thread::sleep(Duration::from_millis(2));
        clock.lap(Step::Second);
        assert_eq!((clock.runs(Step::First), clock.runs(Step::Second)), (1, 1));
        assert!(clock.seconds(Step::Second) >= 2e-3);
        assert_eq!(clock.seconds(Step::First), earlier.seconds(Step::First));
        clock.waited(Step::First);
        assert_eq!(clock.runs(Step::First), 1);
        clock.add(Step::First, Duration::ZERO, 40);
        assert_eq!(
            (clock.runs(Step::First), clock.bytes(Step::First), clock.bytes(Step::Second)),
            (2, 40, 0)
        );
        assert_eq!((clock.ran_since(&earlier), clock.ran_since(&clock)), (2, 0));
    }
}
