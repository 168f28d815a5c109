//! Turns panics of foreign code on foreign files into errors.

use std::{
    cell::Cell,
    panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook},
    sync::Once,
};

thread_local! {
    /// `true` while [`caught`] runs on this thread, which reports a panic itself.
    static IS_EXPECTED: Cell<bool> = const { Cell::new(false) };
}

/// Runs `work` and returns its result. If it panics, returns the panic's message and prints nothing on
/// standard error.
///
/// Values that `work` was changing must not be used after a panic.
pub(crate) fn caught<T>(work: impl FnOnce() -> T) -> Result<T, String> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let others = take_hook();
        set_hook(Box::new(move |panic| {
            if !IS_EXPECTED.get() {
                others(panic);
            }
        }));
    });
    let before = IS_EXPECTED.replace(true);
    let result = catch_unwind(AssertUnwindSafe(work));
    IS_EXPECTED.set(before);
    result.map_err(|cause| {
        let text = cause.downcast_ref::<&str>().map(|text| (*text).to_owned());
        text.or_else(|| cause.downcast_ref::<String>().cloned()).unwrap_or_else(|| "it panicked".to_owned())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn panics_become_their_message() {
        assert_eq!(caught(|| 7), Ok(7));
        assert_eq!(caught(|| -> u8 { panic!("plain") }), Err("plain".to_owned()));
        let wrong = caught(|| [1, 2][std::hint::black_box(5)]);
        assert_eq!(wrong, Err("index out of bounds: the len is 2 but the index is 5".to_owned()));
        let inner = caught(|| caught(|| -> u8 { panic!("inner") }).unwrap_err());
        assert_eq!(inner, Ok("inner".to_owned()));
        assert!(!IS_EXPECTED.get());
    }
}
