//! Values that know when they were changed last.

use std::{
    ops::{Deref, DerefMut},
    sync::atomic::{AtomicU64, Ordering},
};

/// A value with a revision. Values of equal revision are equal: each new value, and each change, gets a
/// number that no other value of this process has. Clones keep theirs.
#[derive(Clone, Debug)]
pub struct Revised<T> {
    value: T,
    revision: u64,
}

impl<T> Revised<T> {
    /// Returns the revision of the value.
    pub fn revision(&self) -> u64 {
        self.revision
    }
}

fn next_revision() -> u64 {
    static LAST: AtomicU64 = AtomicU64::new(0);
    LAST.fetch_add(1, Ordering::Relaxed)
}

impl<T> From<T> for Revised<T> {
    fn from(value: T) -> Self {
        Self { value, revision: next_revision() }
    }
}

impl<T> Deref for Revised<T> {
    type Target = T;

    fn deref(&self) -> &T {
        &self.value
    }
}

impl<T> DerefMut for Revised<T> {
    /// Lends the value to be changed; its revision is a new one, whether it is changed or not.
    fn deref_mut(&mut self) -> &mut T {
        self.revision = next_revision();
        &mut self.value
    }
}

impl<T: PartialEq> PartialEq for Revised<T> {
    fn eq(&self, other: &Self) -> bool {
        self.value == other.value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_revision_belongs_to_one_value() {
        let first = Revised::from(vec![1, 2]);
        let mut second = first.clone();
        assert_eq!(first.revision(), second.revision());
        second[0] = 3;
        assert_ne!(first.revision(), second.revision());
        assert_ne!(first.revision(), Revised::from(vec![1, 2]).revision());
        second[0] = 1;
        assert_eq!(first, second);
    }
}
