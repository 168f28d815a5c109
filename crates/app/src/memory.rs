//! What the system tells about memory (Linux; elsewhere nothing is known).

/// The most memory this process has had, bytes.
pub fn peak_rss_bytes() -> Option<u64> {
    field(&std::fs::read_to_string("/proc/self/status").ok()?, "VmHWM:")
}

/// From now on [`peak_rss_bytes`] is about what comes, where the system can do that.
pub fn forget_peak() {
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// Memory that is left for programs before the system has to write it to disk or to end one of them, bytes.
pub fn available_bytes() -> Option<u64> {
    field(&std::fs::read_to_string("/proc/meminfo").ok()?, "MemAvailable:")
}

/// A line such as "MemAvailable:  1024 kB", in bytes.
fn field(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find(|l| l.starts_with(name))?;
    line.split_whitespace().nth(1)?.parse::<u64>().ok().map(|kib| kib * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_is_found_by_its_name() {
        let text = "MemTotal:       4 kB\nMemAvailable:   3 kB\n";
        assert_eq!(field(text, "MemAvailable:"), Some(3072));
        assert_eq!((field(text, "Swap:"), field("MemAvailable: much", "MemAvailable:")), (None, None));
        if cfg!(target_os = "linux") {
            assert!(peak_rss_bytes().unwrap() > 1_000_000 && available_bytes().unwrap() > 1_000_000);
        }
    }
}
